"""Starts what takes long (preparing, refining, writing checkpoints) and posts the outcomes to the service's loop."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from atoll_coordinator.model.refinement import Pools
from atoll_coordinator.service.background.child_main import load_refinement, ready_preparation
from atoll_coordinator.service.background.dependencies import Dependencies
from atoll_coordinator.service.background.job_tasks import (
    PreparationBegun,
    preparation_failed,
    prepare_job,
    refine_job,
    refinement_failed,
)
from atoll_coordinator.service.jobs.job import Prepared
from atoll_coordinator.service.monitoring.breakages import what_to_send
from atoll_coordinator.service.search.archipelago import Checkpoint
from atoll_coordinator.service.store.store import Store
from atoll_core.config import JobConfig


@dataclass(frozen=True, slots=True)
class CheckpointWritten:
    """Posted when a checkpoint has been written; `error` says why it is not durable, None that it is."""

    checkpoint: Checkpoint
    error: Exception | None = None


class TaskRunner:
    """Runs tasks where the dependencies say. `post` may be called by any thread."""

    def __init__(self, dependencies: Dependencies, store: Store, post: Callable[[object], None]) -> None:
        self._dependencies = dependencies
        self._store = store
        self._post = post

    def write(self, checkpoint: Checkpoint, progress: bytes, elapsed: float) -> None:
        """Make a checkpoint durable after those that came before it; `CheckpointWritten` is posted."""
        self._dependencies.writer(lambda: self._post(self._write(checkpoint, progress, elapsed)))

    def _write(self, checkpoint: Checkpoint, progress: bytes, elapsed: float) -> CheckpointWritten:
        """Make a checkpoint durable; runs in the writer's thread."""
        key = checkpoint.job, checkpoint.variable, checkpoint.epoch
        try:
            self._store.commit_checkpoint(*key, progress, checkpoint.states, elapsed)
        except Exception as error:  # ends the service's loop
            return CheckpointWritten(checkpoint, error)
        return CheckpointWritten(checkpoint)

    def prepare(self, job: str, table: bytes, config: JobConfig) -> None:
        """Prepare a table; `JobPrepared` or `PreparationFailed` is posted unless the job is cancelled.

        Where `--max-time` counts, a process is made ready before, and `PreparationBegun` is posted between. While the
        job is searched, a process loads what its refinement needs.
        """

        def finish(outcome: object) -> None:
            self._post(outcome)
            self._dependencies.pool.preload(load_refinement)

        to_send = what_to_send(config, is_certain=False)
        task = partial(prepare_job, self._dependencies.preparer, job, table, config)

        def fail(why: str) -> None:
            self._post(preparation_failed(job, why, to_send))

        def begin(_: None) -> None:
            self._post(PreparationBegun(job))
            self._dependencies.pool.submit(job, task, finish, fail)

        if config.budget.max_time is None:
            self._dependencies.pool.submit(job, task, finish, fail)
        else:
            self._dependencies.pool.submit(job, ready_preparation, begin, fail)

    def refine(self, job: str, prepared: Prepared, pools: Pools, seconds: float | None = None) -> None:
        """Make the equations of the pools, in so many seconds if that is not None.

        `JobRefined` is posted unless the job is cancelled.
        """
        to_send = what_to_send(prepared.config, is_certain=False)
        task = partial(refine_job, self._dependencies.refiner, job, prepared, pools, seconds)
        self._dependencies.pool.submit(
            job, task, self._post, lambda why: self._post(refinement_failed(job, why, to_send)), is_queued=True
        )

    def cancel(self, job: str) -> None:
        """End the tasks of a job; nothing is posted for them."""
        self._dependencies.pool.cancel(job)

    def close(self) -> None:
        """End all tasks, but not what is being written."""
        self._dependencies.pool.close()
