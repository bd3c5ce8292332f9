"""A stub of a worker's task process: tasks run in this process, and their results come some virtual time later.

A task that refines also has batches, which helpers may take: they change nothing of its result, but each must come back
as what it is.
"""

import hashlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from atoll_coordinator.tasks.preparing import Preparer, prepare
from atoll_coordinator.tasks.refining import Refiner, refine
from atoll_core.task_frames import (
    Ask,
    BatchComputed,
    Begun,
    Ended,
    Failed,
    Failure,
    FromProcess,
    Give,
    ProcessMessage,
    Run,
    Take,
    TaskBatch,
    TaskFinished,
    ToProcess,
)
from tests.simulation.bus.network import SimulatedNetwork

USUAL_S: Final = 0.001
HOLD_S: Final = 0.5
BATCH_S: Final = 0.05
CONTEXT: Final = b"a context"
DIGEST: Final = hashlib.sha256(CONTEXT).hexdigest()
BATCHES: Final = 20


def computed(item: bytes) -> bytes:
    return hashlib.sha256(item).digest()


@dataclass
class Fate:
    """What the next task that runs anywhere meets: a `Failure`, once for each task, or the death of its worker."""

    coming: list[Failure | None] = field(default_factory=list)
    met: set[str] = field(default_factory=set)
    wrong: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)

    def next_of(self, task: str) -> Failure | bool | None:
        """Return what a task meets; False: nothing."""
        if not self.coming or task in self.met:
            return False
        self.met.add(task)
        coming = self.coming.pop(0)
        self.counts[coming or "lost"] += 1
        return coming


class StubTasks:
    """Runs tasks of one worker; `seconds` is how long each takes now, `kill` ends the worker."""

    def __init__(
        self, network: SimulatedNetwork, preparer: Preparer, refiner: Refiner,
        seconds: Callable[[], float] = lambda: USUAL_S, fate: Fate | None = None,
        kill: Callable[[], object] = lambda: None,
    ) -> None:  # fmt: skip
        self.ran: list[Run] = []
        self.helped = 0
        self._network = network
        self._preparer = preparer
        self._refiner = refiner
        self._seconds = seconds
        self._fate = fate or Fate()
        self._kill = kill
        self._post: Callable[[object], None] = lambda message: None
        self._life = 0
        self._is_started = False
        self._given = 0
        self._is_busy = False

    def attach(self, post: Callable[[object], None]) -> None:
        self._post = post

    @property
    def is_started(self) -> bool:
        return self._is_started

    def send(self, message: ToProcess) -> int:
        if isinstance(message, Run | TaskBatch) and not self._is_started:
            self._is_started, self._life = True, self._life + 1
        match message:
            case Run():
                assert not self._is_busy, "one task runs at a time"
                self._is_busy = True
                self.ran.append(message)
                self._later(self._seconds() / 2.0, lambda: self._begin(message))
            case Ask():
                self._later(0.0, lambda: self._give(message))
            case Take():
                if message.result != computed(b"%d" % message.number):
                    self._fate.wrong.append("a batch came back as something else")
            case TaskBatch():
                assert (message.context, message.digest) == (CONTEXT, DIGEST)
                self.helped += 1
                self._later(BATCH_S, lambda: self._say(BatchComputed(message.number, computed(message.item))))
            case _:
                raise AssertionError(f"{message} was sent")
        return self._life

    def load_next(self, function: str) -> None:
        assert not self._is_busy, "nothing runs now"

    def stop(self) -> None:
        self._is_started = self._is_busy = False

    def stop_if_idle(self) -> None:
        pass

    def _later(self, seconds: float, act: Callable[[], None]) -> None:
        """Do something unless this process has ended by then."""
        life = self._life
        self._network.at(
            self._network.now + seconds, lambda: act() if self._is_started and life == self._life else None
        )

    def _say(self, message: FromProcess) -> None:
        self._post(ProcessMessage(self._life, message))

    def _begin(self, run: Run) -> None:
        self._given = 0
        self._say(Begun(run.task))
        match self._fate.next_of(run.task):
            case None:
                self._later(self._seconds() / 2.0, lambda: self._kill() and None)
            case "error":
                self._later(self._seconds() / 2.0, lambda: self._end(Failed(run.task, "error", "planted")))
            case "crash" | "memory" | "time" as failure:
                self._later(self._seconds() / 2.0, lambda: self._die(failure))
            case _:
                self._later(self._seconds() / 2.0, lambda: self._end(self._result(run)))

    def _end(self, message: FromProcess) -> None:
        self._is_busy = False
        self._say(message)

    def _die(self, failure: Failure) -> None:
        life = self._life
        self.stop()
        self._post(ProcessMessage(life, Ended(failure, "planted")))

    def _give(self, question: Ask) -> None:
        if not self._is_busy or self._given >= BATCHES:
            self._later(HOLD_S, lambda: self._say(Give(question.token, None)))
            return
        self._given += 1
        context = b"" if DIGEST in question.contexts else CONTEXT
        self._say(Give(question.token, TaskBatch(self._given, "stub", DIGEST, context, b"%d" % self._given)))

    def _result(self, run: Run) -> FromProcess:
        try:
            if run.function == "prepare":
                return TaskFinished(run.task, prepare(*run.inputs, self._preparer))
            if run.function == "refine":
                return TaskFinished(run.task, refine(*run.inputs, run.seconds, self._refiner))
            return TaskFinished(run.task, computed(b"".join(run.inputs)))
        except Exception as error:
            return Failed(run.task, "error", f"{type(error).__name__}: {error}")
