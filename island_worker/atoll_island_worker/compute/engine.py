"""Islands of `atoll_island_worker.evolution`, computed on the caller's thread."""

from typing import TYPE_CHECKING, Final

from atoll_core.config import JobConfig
from atoll_core.errors import RemoteProtocolError
from atoll_island_worker.session.epoch_tasks import ShardKey, Task
from atoll_island_worker.session.events import Computed, JobReady, LoadFailed

if TYPE_CHECKING:
    from atoll_core.data.dataset import Dataset
    from atoll_island_worker.evolution.island import Island

_MOST: Final = 10
"""Generations at a time, however long a slice is: in between it is asked what else there is to do."""


class Engine:
    """The islands and datasets of one worker."""

    def __init__(self) -> None:
        self._jobs: dict[str, tuple[JobConfig, Dataset]] = {}
        self._islands: dict[ShardKey, dict[int, Island]] = {}

    def load(self, job: str, config: JobConfig, dataset: bytes) -> JobReady | LoadFailed:
        """Take in a job's configuration and encoded dataset."""
        from atoll_core.wire.codec import dataset_from_bytes

        try:
            self._jobs[job] = (config, dataset_from_bytes(dataset))
        except RemoteProtocolError as error:
            return LoadFailed(job, str(error))
        return JobReady(job)

    def begin(self, task: Task) -> "Epoch":
        """Begin an island's epoch; raises RemoteProtocolError when its immigrants or its state are malformed."""
        from atoll_island_worker.evolution.island import Island

        key = task.key
        config, dataset = self._jobs[key.job]
        problem, islands = dataset.problem(key.variable), self._islands.setdefault(key.shard, {})
        if task.state is not None:
            island = Island.from_bytes(task.state, problem, config, key.island)
            if island.epoch != key.epoch:
                raise RemoteProtocolError(f"a state of epoch {island.epoch} came for epoch {key.epoch}")
            islands[key.island] = island
        elif task.blocks is None:
            islands[key.island] = Island(problem, config, key.island)
        else:
            islands[key.island].immigrate(task.blocks)
        return Epoch(task, islands[key.island])

    def forget(self, shard: ShardKey) -> None:
        """Forget the islands of an archipelago's term."""
        self._islands.pop(shard, None)

    def forget_job(self, job: str) -> None:
        """Forget a job's dataset."""
        self._jobs.pop(job, None)


class Epoch:
    """One epoch of one island under way; see `atoll_island_worker.compute.run_queue.Work`."""

    def __init__(self, task: Task, island: "Island") -> None:
        self._task = task
        self._island = island
        self._is_over = False
        self.snapshot: Final = island.to_bytes() if task.takes_snapshot else None

    @property
    def generation(self) -> int:
        """See `Work.generation`."""
        return self._island.generation

    def advance(self) -> bool:
        """See `Work.advance`."""
        stride = self._task.commit_order.stride
        left = stride - self._island.generation % stride
        self._is_over = self._island.advance(min(_MOST, left))
        return self._is_over

    def computed(self) -> Computed:
        """See `Work.computed`. There are emigrants after a whole epoch that is not the last."""
        key, report = self._task.key, self._island.report()
        if not self._is_over or report.hit is not None or self._task.is_last:
            return Computed(key, report, {}, frozenset())
        return Computed(key, report, self._island.emigrants(), self._island.senders())
