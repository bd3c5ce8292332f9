"""The thread that computes islands: it takes commands, runs the queue of tasks slice by slice, and posts results.

It never touches the bus. Commands are functions in a queue, so that every change of `RunQueue` and `Engine` happens on
this thread, between two slices. `ComputeThread.progress` increases with every slice, so that the coordinator can
distinguish slow work from a hung process by heartbeats.
"""

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from atoll_core.config import JobConfig
from atoll_core.errors import RemoteProtocolError
from atoll_core.search.commit_order import CommitOrder, Position
from atoll_island_worker.compute.run_queue import RunQueue, brief
from atoll_island_worker.session import interface as io

if TYPE_CHECKING:
    from atoll_core.data.dataset import Dataset, Problem
    from atoll_island_worker.evolution.island import Island

_MOST: Final = 10
"""Most generations between two checks for commands; longer slices are divided."""


class Engine:
    """The islands and datasets of one worker."""

    def __init__(self) -> None:
        self._jobs: dict[str, tuple[JobConfig, Dataset]] = {}
        self._problems: dict[tuple[str, str], Problem] = {}  # islands of one problem share parts of their setups
        self._islands: dict[io.ShardKey, dict[int, Island]] = {}

    def load(self, job: str, config: JobConfig, dataset: bytes) -> io.JobReady | io.LoadFailed:
        """Store a job's configuration and encoded dataset."""
        from atoll_core.wire.codec import dataset_from_bytes

        try:
            self._jobs[job] = (config, dataset_from_bytes(dataset))
        except RemoteProtocolError as error:
            return io.LoadFailed(job, str(error))
        return io.JobReady(job)

    def begin(self, task: io.EpochTask) -> "Epoch":
        """Begin an island's epoch; raises RemoteProtocolError if its immigrants or its state are malformed."""
        from atoll_island_worker.evolution.island import Island

        key = task.key
        config, dataset = self._jobs[key.job]
        if (key.job, key.variable) not in self._problems:
            self._problems[key.job, key.variable] = dataset.problem(key.variable)
        problem, islands = self._problems[key.job, key.variable], self._islands.setdefault(key.shard, {})
        if task.state is not None:
            island = Island.from_bytes(task.state, problem, config, key.island)
            if island.epoch != key.epoch - (task.blocks is not None):
                raise RemoteProtocolError(f"a state of epoch {island.epoch} came for epoch {key.epoch}")
            islands[key.island] = island
        elif task.blocks is None:
            islands[key.island] = Island(problem, config, key.island)
        if task.blocks is not None:
            islands[key.island].immigrate(task.blocks)
        return Epoch(task, islands[key.island])

    def state_of(self, key: io.TaskKey) -> bytes:
        """Return the state of an island after a whole epoch; another process continues from it and its immigrants."""
        return self._islands[key.shard][key.island].to_bytes()

    def forget(self, shard: io.ShardKey) -> None:
        """Forget the islands of an archipelago's term."""
        self._islands.pop(shard, None)

    def forget_job(self, job: str) -> None:
        """Forget a job's dataset."""
        self._jobs.pop(job, None)
        self._problems = {key: problem for key, problem in self._problems.items() if key[0] != job}


class Epoch:
    """One epoch of one island in progress; see `atoll_island_worker.compute.run_queue.RunningEpoch`."""

    def __init__(self, task: io.EpochTask, island: "Island") -> None:
        self._task = task
        self._island = island
        self._is_over = False
        self.snapshot: Final = island.to_bytes() if task.takes_snapshot else None

    @property
    def generation(self) -> int:
        """See `RunningEpoch.generation`."""
        return self._island.generation

    def advance(self) -> bool:
        """See `RunningEpoch.advance`."""
        stride = self._task.commit_order.stride
        left = stride - self._island.generation % stride
        self._is_over = self._island.advance(min(_MOST, left))
        return self._is_over

    def computed(self) -> io.EpochComputed:
        """See `RunningEpoch.computed`. The result has emigrants after a whole epoch that is not the last."""
        key, report = self._task.key, self._island.report()
        if not self._is_over or report.hit is not None or self._task.is_last:
            return io.EpochComputed(key, report, {}, frozenset())
        return io.EpochComputed(key, report, self._island.emigrants(), self._island.senders())


_LOG = logging.getLogger(__name__)
_JOIN_LIMIT_S: Final = 2.0


@dataclass(frozen=True, slots=True)
class WarmUpNote:
    """A sentence about the warm-up for users, such as that kernels are being compiled."""

    sentence: str


@dataclass(frozen=True, slots=True)
class WarmedUp:
    """The kernels were loaded and run within `seconds`. `fingerprint` is a digest of their sources."""

    seconds: float
    fingerprint: str


@dataclass(frozen=True, slots=True)
class ComputeFailed:
    """The kernels cannot be compiled or run here, or the compute thread has failed; the worker ends."""

    sentence: str


Result = WarmUpNote | WarmedUp | ComputeFailed | io.JobReady | io.LoadFailed | io.Snapshot | io.Outcome
"""All messages that the compute thread posts."""


class ComputeThread:
    """Computes the islands of one worker, one slice at a time. Methods return at once; results are posted later.

    `progress` increases while work makes progress.
    """

    def __init__(self, show: Callable[[str], None] | None = None) -> None:
        """`show` is called with each sentence of the warm-up, on the compute thread."""
        self._show = show
        self._commands: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._unposted: list[Result] = []
        self._post: Callable[[object], None] | None = None
        self._lock = threading.Lock()
        self._closed = False
        self.progress = 0
        self._engine = Engine()
        self._queue = RunQueue(self._engine.begin, time.monotonic)
        self._thread = threading.Thread(target=self._work, name="compute", daemon=True)
        self._thread.start()

    @property
    def current(self) -> io.TaskKey | None:
        """The task of the last slice; None before the first."""
        return self._queue.current

    @property
    def seconds(self) -> dict[str, float]:
        """Seconds of computing islands, by user."""
        return self._queue.seconds.copy()

    def attach(self, post: Callable[[object], None]) -> None:
        """Post every result through `post`, including earlier results."""
        with self._lock:
            self._post = post
            for result in self._unposted:
                post(result)
            self._unposted.clear()

    def warm_up(self) -> None:
        """Load or compile the kernels. Any number of WarmUpNote follow, then WarmedUp or ComputeFailed."""
        self._commands.put(self._warm_up)

    def share(self, job: str, weight: float, user: str) -> None:
        """Set the share of turns that a job has from now on; see `RunQueue.share`."""
        self._commands.put(lambda: self._queue.share(job, weight, user))

    def load(self, job: str, config: JobConfig, dataset: bytes) -> None:
        """Load a job's configuration and encoded dataset. JobReady or LoadFailed follows."""
        self._commands.put(lambda: self._post_all([self._engine.load(job, config, dataset)]))

    def run(self, task: io.EpochTask) -> None:
        """Compute one epoch of one island. Computed, Rejected, Broken or Abandoned follows, unless it is discarded.

        If the task includes a Snapshot, it comes first; at a barrier no other result follows. Tasks take turns.
        """
        self._commands.put(lambda: self._post_all(self._queue.add(task)))

    def stop_at(self, shard: io.ShardKey, hit: Position, commit_order: CommitOrder) -> None:
        """Stop computing tasks of this archipelago that are not needed after the target was met at `hit`."""
        self._commands.put(lambda: self._post_all(self._queue.stop_at(shard, hit, commit_order)))

    def discard(self, shard: io.ShardKey) -> None:
        """Forget the islands of an archipelago under one term, including islands in progress."""

        def discard() -> None:
            self._queue.discard(shard)
            self._engine.forget(shard)

        self._commands.put(discard)

    def discard_job(self, job: str) -> None:
        """Forget a job's dataset and its tasks."""

        def discard() -> None:
            self._queue.discard_job(job)
            self._engine.forget_job(job)

        self._commands.put(discard)

    def close(self) -> None:
        """Stop the thread and wait briefly for it.

        It is a daemon, so it keeps no process alive. May be called again.
        """
        self._closed = True
        self._commands.put(lambda: None)  # the thread may be waiting for a command
        self._thread.join(_JOIN_LIMIT_S)

    # -------------------------------------------------------------------------- on the compute thread

    def _work(self) -> None:
        try:
            while not self._closed:
                if self._queue.is_idle or not self._commands.empty():
                    self._commands.get()()
                else:
                    self._post_all(self._queue.turn())
                self.progress += 1
        except BaseException as error:  # otherwise the worker would send heartbeats and compute nothing
            _LOG.exception("the compute thread failed")
            self._post_all([ComputeFailed(f"the compute thread failed: {brief(error)}")])

    def _post_all(self, results: Iterable[Result]) -> None:
        with self._lock:
            for result in results:
                if self._post is None:
                    self._unposted.append(result)
                else:
                    self._post(result)

    def _warm_up(self) -> None:
        began = time.monotonic()
        try:
            from atoll_core.compilation.cache import WORKER, source_digest
            from atoll_island_worker.compute.warmup import warm_up

            warm_up(self._report)
        except Exception as error:  # the error is reported, and the worker ends
            _LOG.exception("warm-up failed")
            self._post_all([ComputeFailed(f"the kernels cannot be made ready on this machine: {brief(error)}")])
        else:
            self._post_all([WarmedUp(time.monotonic() - began, source_digest(WORKER))])

    def _report(self, sentence: str) -> None:
        if self._show is not None:
            self._show(sentence)
        self._post_all([WarmUpNote(sentence)])
