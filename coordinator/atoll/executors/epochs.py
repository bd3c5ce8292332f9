"""One epoch of some islands of an archipelago as a batch, so that any task process can compute it.

It uses the engine and the queue of turns of the island worker. `atoll.executors` is the only folder of the library that
imports the island worker.
"""

import functools
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from atoll_coordinator.model.batches import BatchFunction
from atoll_core.config import JobConfig
from atoll_core.errors import AtollError
from atoll_island_worker.compute.compute_thread import Engine
from atoll_island_worker.compute.run_queue import RunQueue
from atoll_island_worker.session import interface as io

JOB: Final = "job"
"""The name of every job in the keys of its tasks: an engine has one job."""


@dataclass(frozen=True, slots=True)
class SearchedJob:
    """The context of all epochs of a job: its resolved configuration and its encoded dataset."""

    config: JobConfig
    dataset: bytes

    def engine(self) -> Engine:
        """Return an engine with the job; raises AtollError if the dataset is malformed."""
        engine = Engine()
        loaded = engine.load(JOB, self.config, self.dataset)
        if isinstance(loaded, io.LoadFailed):
            raise AtollError(loaded.sentence)
        return engine


@dataclass(frozen=True, slots=True)
class ComputedEpoch:
    """An epoch of some islands, or the `sentence` why it failed.

    `states` are the states at the end of the epoch, by island, for islands with emigrants.
    """

    islands: tuple[io.EpochComputed, ...] = ()
    states: Mapping[int, bytes] = field(default_factory=dict)
    sentence: str = ""


def compute_epoch(engine: Engine, tasks: tuple[io.EpochTask, ...]) -> ComputedEpoch:
    """Compute tasks whose keys differ only in the island.

    The islands take turns slice by slice. When one of them meets the target, slices that do not count are left out.
    """
    load_kernels()
    turns = RunQueue(engine.begin, time.monotonic)
    outcomes = [outcome for task in tasks for outcome in turns.add(task)]
    while not turns.is_idle:
        outcomes += [outcome for outcome in turns.turn() if not isinstance(outcome, io.Snapshot)]
    failed = [outcome.sentence for outcome in outcomes if isinstance(outcome, io.Broken | io.Rejected)]
    computed = [outcome for outcome in outcomes if isinstance(outcome, io.EpochComputed)]
    states = {} if failed else {one.key.island: engine.state_of(one.key) for one in computed if one.emigrants}
    engine.forget(tasks[0].key.shard)
    return ComputedEpoch(sentence=failed[0]) if failed else ComputedEpoch(tuple(computed), states)


@functools.cache
def load_kernels() -> None:
    """Load the kernels of the search; only one process of a machine compiles them."""
    from atoll_island_worker.compute.warmup import warm_up

    warm_up(lambda sentence: None)


EPOCHS: Final = BatchFunction(
    "epochs", SearchedJob, tuple[io.EpochTask, ...], ComputedEpoch, compute_epoch, SearchedJob.engine
)
