"""Computing islands: the port that the runtime uses, and the real thing, one thread over `Island`.

The thread takes commands from a queue and posts what came of them; it never touches the bus itself. `progress` rises
while it gets on, so that a heartbeat can tell slow work from a hung process.
"""

import logging
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from common.config import JobConfig
from common.errors import RemoteProtocolError
from common.wire.messages import Addition, HitStatement, IslandReport
from island_worker.events import Abandoned, Broken, Computed, JobReady, Rejected, Task, Unloadable

if TYPE_CHECKING:
    from common.dataset import Dataset
    from island_worker.evolution.island import EpochOutcome, Island

_LOG = logging.getLogger(__name__)
_STRIDE: Final = 10
"""Generations between two looks at whether the work is still wanted."""

_JOIN_LIMIT_S: Final = 2.0


@dataclass(frozen=True, slots=True)
class WarmUpNote:
    """Something a person should know about the warm-up, such as that kernels are being compiled."""

    sentence: str


@dataclass(frozen=True, slots=True)
class WarmedUp:
    """The kernels are loaded and have run; it took `seconds`. `fingerprint` names what the bits depend on."""

    seconds: float
    fingerprint: str


@dataclass(frozen=True, slots=True)
class WarmUpFailed:
    """The kernels cannot be compiled or run here."""

    sentence: str


Word = WarmUpNote | WarmedUp | WarmUpFailed | JobReady | Unloadable | Computed | Rejected | Broken | Abandoned
"""What a Compute posts."""


class Compute(Protocol):
    """Computes islands elsewhere than on the caller's thread. Every call returns at once; words are posted later."""

    @property
    def progress(self) -> int:
        """A number that rises while work gets on."""

    def attach(self, post: Callable[[object], None]) -> None:
        """Post every word, also those that came before, through `post`."""

    def warm_up(self) -> None:
        """Make the kernels ready: any number of WarmUpNote, then WarmedUp or WarmUpFailed."""

    def load(self, job: str, config: JobConfig, dataset: bytes) -> None:
        """Take in a job's configuration and encoded dataset: JobReady or Unloadable."""

    def advance(self, task: Task) -> None:
        """Compute one epoch of one island: Computed, Rejected, Broken or Abandoned."""

    def discard(self, job: str, variable: str, term: int) -> None:
        """Forget the islands of an archipelago's term, and give up the one under way."""

    def discard_job(self, job: str) -> None:
        """Forget a job's dataset."""

    def close(self) -> None:
        """Give up everything. Repeatable."""


Share = tuple[str, str, int]


class Engine:
    """Islands of `island_worker.evolution`, computed on the caller's thread: tasks in, words out."""

    def __init__(self) -> None:
        self._jobs: dict[str, tuple[JobConfig, Dataset]] = {}
        self._islands: dict[Share, dict[int, Island]] = {}

    def load(self, job: str, config: JobConfig, dataset: bytes) -> JobReady | Unloadable:
        """Take in a job's configuration and encoded dataset."""
        from common.wire.codec import dataset_from_bytes

        try:
            self._jobs[job] = (config, dataset_from_bytes(dataset))
        except RemoteProtocolError as error:
            return Unloadable(job, str(error))
        return JobReady(job)

    def advance(self, task: Task, goes_on: Callable[[], bool]) -> Computed | Rejected | Broken | Abandoned:
        """Compute one epoch of one island; `goes_on` is asked now and then whether it is still wanted."""
        key = task.key
        try:
            return self._advance(task, goes_on)
        except RemoteProtocolError as error:
            return Rejected(key, str(error))
        except Exception as error:  # it is the job that fails, not the worker
            _LOG.exception("island broke job=%s variable=%s island=%d", key.job, key.variable, key.island)
            return Broken(key, f"island {key.island} of {key.variable} broke in epoch {key.epoch}: {_brief(error)}")

    def forget(self, share: Share) -> None:
        """Forget the islands of an archipelago's term."""
        self._islands.pop(share, None)

    def forget_job(self, job: str) -> None:
        """Forget a job's dataset."""
        self._jobs.pop(job, None)

    def _advance(self, task: Task, goes_on: Callable[[], bool]) -> Computed | Abandoned:
        from island_worker.evolution.island import senders

        began = time.monotonic()
        key = task.key
        island = self._begin(task)
        while not island.advance(_STRIDE):
            if not goes_on():
                return Abandoned(key)
        outcome = island.outcome()
        report = report_of(key.island, outcome)
        if outcome.hit is not None or task.is_last:
            return Computed(key, report, {}, frozenset(), time.monotonic() - began)
        config, _ = self._jobs[key.job]
        awaited = senders(config, key.variable, key.epoch, key.island)
        return Computed(key, report, island.emigrants(), awaited, time.monotonic() - began)

    def _begin(self, task: Task) -> "Island":
        from island_worker.evolution.island import Island

        key = task.key
        islands = self._islands.setdefault((key.job, key.variable, key.term), {})
        if task.blocks is None:
            config, dataset = self._jobs[key.job]
            islands[key.island] = Island(dataset.problem(key.variable), config, key.island)
        else:
            islands[key.island].immigrate(task.blocks)
        return islands[key.island]


class IslandCompute:
    """The real one: an engine in a thread of its own, one task at a time."""

    def __init__(self) -> None:
        self._commands: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._words: list[object] = []
        self._post: Callable[[object], None] | None = None
        self._lock = threading.Lock()
        self._unwanted: set[Share] = set()
        self._closed = False
        self._progress = 0
        self._engine = Engine()
        self._thread = threading.Thread(target=self._work, name="compute", daemon=True)
        self._thread.start()

    @property
    def progress(self) -> int:
        """See `Compute.progress`."""
        return self._progress

    def attach(self, post: Callable[[object], None]) -> None:
        """See `Compute.attach`."""
        with self._lock:
            self._post = post
            for word in self._words:
                post(word)
            self._words.clear()

    def warm_up(self) -> None:
        """See `Compute.warm_up`."""
        self._commands.put(self._warm_up)

    def load(self, job: str, config: JobConfig, dataset: bytes) -> None:
        """See `Compute.load`."""
        self._commands.put(lambda: self._say(self._engine.load(job, config, dataset)))

    def advance(self, task: Task) -> None:
        """See `Compute.advance`."""
        self._commands.put(lambda: self._advance(task))

    def discard(self, job: str, variable: str, term: int) -> None:
        """See `Compute.discard`."""
        share = (job, variable, term)
        self._unwanted.add(share)
        self._commands.put(lambda: self._forget(share))

    def discard_job(self, job: str) -> None:
        """See `Compute.discard_job`."""
        self._commands.put(lambda: self._engine.forget_job(job))

    def close(self) -> None:
        """See `Compute.close`. Waits a little for the thread; it is a daemon and keeps no process alive."""
        self._closed = True
        self._commands.put(None)
        self._thread.join(_JOIN_LIMIT_S)

    # -------------------------------------------------------------------------- on the compute thread

    def _work(self) -> None:
        while not self._closed:
            command = self._commands.get()
            if command is None:
                return
            command()
            self._progress += 1

    def _say(self, word: Word) -> None:
        with self._lock:
            if self._post is None:
                self._words.append(word)
            else:
                self._post(word)

    def _warm_up(self) -> None:
        began = time.monotonic()
        try:
            from common.jit import source_digest
            from island_worker.warmup import warm_up

            warm_up(lambda sentence: self._say(WarmUpNote(sentence)))
        except Exception as error:  # whatever it was, it is said, and the worker ends
            _LOG.exception("warm-up failed")
            self._say(WarmUpFailed(f"the kernels cannot be made ready on this machine: {_brief(error)}"))
        else:
            self._say(WarmedUp(time.monotonic() - began, source_digest()))

    def _advance(self, task: Task) -> None:
        share = (task.key.job, task.key.variable, task.key.term)
        self._say(self._engine.advance(task, lambda: self._goes_on(share)))

    def _goes_on(self, share: Share) -> bool:
        self._progress += 1
        return not self._closed and share not in self._unwanted

    def _forget(self, share: Share) -> None:
        self._engine.forget(share)
        self._unwanted.discard(share)


def report_of(island: int, outcome: "EpochOutcome") -> IslandReport:
    """Return what is reported of an island's finished epoch."""
    hit = outcome.hit
    return IslandReport(
        island=island,
        generations=outcome.generations,
        hit=None if hit is None else HitStatement(generation=hit.generation, error=hit.error),
        additions=tuple(
            Addition(
                complexity=entry.complexity,
                error=entry.error,
                mse=entry.mse,
                generation=entry.generation,
                program=entry.program,
            )
            for entry in outcome.additions
        ),
        evaluations=dict(outcome.evaluations),
        best_error=outcome.best_error,
        digest=outcome.digest,
    )


def _brief(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"[:500]
