"""Computing islands: the port that the runtime uses, and the real thing, one thread over agenda and engine.

The thread takes commands from a queue, computes slice after slice while none is there, and posts what came of it; it
never touches the bus itself. `progress` rises while it gets on, so that a heartbeat can tell slow work from a hung
process.
"""

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, Protocol

from atoll.config import JobConfig
from atoll.search.commit_order import CommitOrder, Position
from atoll_island_worker.compute.engine import Engine
from atoll_island_worker.compute.run_queue import Agenda, brief
from atoll_island_worker.session.events import JobReady, Outcome, Snapshot, Unloadable
from atoll_island_worker.session.tasks import ShareKey, Task, TaskKey

_LOG = logging.getLogger(__name__)
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
class ComputeFailed:
    """The kernels cannot be compiled or run here, or the compute thread has ended by an error; the worker ends."""

    sentence: str


Word = WarmUpNote | WarmedUp | ComputeFailed | JobReady | Unloadable | Snapshot | Outcome
"""What a Compute posts."""


class Compute(Protocol):
    """Computes islands elsewhere than on the caller's thread. Every call returns at once; words are posted later."""

    @property
    def progress(self) -> int:
        """A number that rises while work gets on."""

    @property
    def doing(self) -> TaskKey | None:
        """What the last turn was about; None before the first."""

    def attach(self, post: Callable[[object], None]) -> None:
        """Post every word, also those that came before, through `post`."""

    def warm_up(self) -> None:
        """Make the kernels ready: any number of WarmUpNote, then WarmedUp or ComputeFailed."""

    def load(self, job: str, config: JobConfig, dataset: bytes, weight: float = 1.0) -> None:
        """Take in a job's configuration and encoded dataset: JobReady or Unloadable. By `weight` it gets its turns."""

    def advance(self, task: Task) -> None:
        """Compute one epoch of one island: Computed, Rejected, Broken or Abandoned follows, unless it is discarded.

        Before that comes the Snapshot, where one is wanted; of a held epoch nothing else comes. Several take turns.
        """

    def stop_at(self, share: ShareKey, hit: Position, course: CommitOrder) -> None:
        """Compute nothing of this archipelago that is not needed when the target was met there."""

    def discard(self, share: ShareKey) -> None:
        """Forget the islands of an archipelago's term, and give up those under way."""

    def discard_job(self, job: str) -> None:
        """Forget a job's dataset."""

    def close(self) -> None:
        """Give up everything. Repeatable."""


class IslandCompute:
    """The real one: an engine in a thread of its own, one slice at a time."""

    def __init__(self) -> None:
        self._commands: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._words: list[object] = []
        self._post: Callable[[object], None] | None = None
        self._lock = threading.Lock()
        self._closed = False
        self._progress = 0
        self._engine = Engine()
        self._agenda = Agenda(self._engine.begin, time.monotonic)
        self._thread = threading.Thread(target=self._work, name="compute", daemon=True)
        self._thread.start()

    @property
    def progress(self) -> int:
        """See `Compute.progress`."""
        return self._progress

    @property
    def doing(self) -> TaskKey | None:
        """See `Compute.doing`."""
        return self._agenda.doing

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

    def load(self, job: str, config: JobConfig, dataset: bytes, weight: float = 1.0) -> None:
        """See `Compute.load`."""
        self._commands.put(lambda: self._load(job, config, dataset, weight))

    def advance(self, task: Task) -> None:
        """See `Compute.advance`."""
        self._commands.put(lambda: self._say(self._agenda.add(task)))

    def stop_at(self, share: ShareKey, hit: Position, course: CommitOrder) -> None:
        """See `Compute.stop_at`."""
        self._commands.put(lambda: self._say(self._agenda.stop_at(share, hit, course)))

    def discard(self, share: ShareKey) -> None:
        """See `Compute.discard`."""
        self._commands.put(lambda: self._forget(share))

    def discard_job(self, job: str) -> None:
        """See `Compute.discard_job`."""
        self._commands.put(lambda: self._forget_job(job))

    def close(self) -> None:
        """See `Compute.close`. Waits a little for the thread; it is a daemon and keeps no process alive."""
        self._closed = True
        self._commands.put(None)
        self._thread.join(_JOIN_LIMIT_S)

    # -------------------------------------------------------------------------- on the compute thread

    def _work(self) -> None:
        try:
            self._compute_until_closed()
        except BaseException as error:  # a worker without this thread would send heartbeats and compute nothing
            _LOG.exception("the compute thread failed")
            self._say([ComputeFailed(f"the compute thread failed: {brief(error)}")])

    def _compute_until_closed(self) -> None:
        while not self._closed:
            if self._agenda.is_idle or not self._commands.empty():
                command = self._commands.get()
                if command is None:
                    return
                command()
            else:
                self._say(self._agenda.turn())
            self._progress += 1

    def _say(self, words: Iterable[Word]) -> None:
        with self._lock:
            for word in words:
                if self._post is None:
                    self._words.append(word)
                else:
                    self._post(word)

    def _warm_up(self) -> None:
        began = time.monotonic()
        try:
            from atoll.compilation.sources import WORKER, source_digest
            from atoll_island_worker.compute.warmup import warm_up

            warm_up(lambda sentence: self._say([WarmUpNote(sentence)]))
        except Exception as error:  # whatever it was, it is said, and the worker ends
            _LOG.exception("warm-up failed")
            self._say([ComputeFailed(f"the kernels cannot be made ready on this machine: {brief(error)}")])
        else:
            self._say([WarmedUp(time.monotonic() - began, source_digest(WORKER))])

    def _load(self, job: str, config: JobConfig, dataset: bytes, weight: float) -> None:
        self._agenda.weigh(job, weight)
        self._say([self._engine.load(job, config, dataset)])

    def _forget(self, share: ShareKey) -> None:
        self._agenda.discard(share)
        self._engine.forget(share)

    def _forget_job(self, job: str) -> None:
        self._agenda.discard_job(job)
        self._engine.forget_job(job)
