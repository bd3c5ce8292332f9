"""What takes long, away from the service's loop: preparing, refining, writing. What comes of it is posted there."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from atoll.config import JobConfig
from atoll.errors import StoreError
from atoll.logs import fields
from atoll_coordinator.model.inference.refinement import Pools
from atoll_coordinator.service.background.interface import LostError, StoppedError
from atoll_coordinator.service.background.tasks import make_ready, not_prepared, not_refined, prepare_job, refine_job
from atoll_coordinator.service.jobs.job import Prepared
from atoll_coordinator.service.ports import Ports, StorePort
from atoll_coordinator.service.search.archipelago import Checkpoint

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Written:
    """Posted when a checkpoint has been written: it is durable, or why it is not."""

    checkpoint: Checkpoint
    error: StoreError | None = None


class SlowWork:
    """Has slow work done where the ports say, and posts what comes of it to the service's loop."""

    def __init__(self, ports: Ports, store: StorePort, post: Callable[[object], None]) -> None:
        """`post` may be called by any thread."""
        self._ports = ports
        self._store = store
        self._post = post
        self._errands = ports.errands

    def write(self, checkpoint: Checkpoint, progress: bytes, elapsed: float) -> None:
        """Make a checkpoint durable after those that came before it; `Written` is posted."""
        self._ports.writer(lambda: self._post(self._write(checkpoint, progress, elapsed)))

    def _write(self, checkpoint: Checkpoint, progress: bytes, elapsed: float) -> Written:
        """Make a checkpoint durable; runs in the writer."""
        try:
            self._store.commit_checkpoint(
                checkpoint.job, checkpoint.variable, checkpoint.epoch, progress, checkpoint.states, elapsed
            )
        except StoreError as error:
            return Written(checkpoint, error)
        return Written(checkpoint)

    def prepare(self, job: str, table: bytes, config: JobConfig) -> None:
        """Prepare a table; `Ready` or `Unprepared` is posted, unless it is stopped."""
        try:
            self._ports.background(lambda: self._prepare(job, table, config))
        except RuntimeError as error:  # the system starts no more threads
            self._post(not_prepared(job, str(error)))

    def _prepare(self, job: str, table: bytes, config: JobConfig) -> None:
        """Have the job prepared; then, while it is searched, what refining it will need. Runs in the background."""
        try:
            self._post(self._errands.do(job, partial(prepare_job, self._ports.preparer, job, table, config)))
        except StoppedError:
            return
        except LostError as error:
            self._post(not_prepared(job, str(error)))
            return
        except Exception as error:  # somebody waits for an answer, whatever this machine has run out of
            _LOG.exception("preparing broke", extra=fields(job=job))
            self._post(not_prepared(job, f"{type(error).__name__}: {error}"))
            return
        self._errands.expect(partial(make_ready, self._ports.warm_up))

    def refine(self, job: str, prepared: Prepared, pools: Pools) -> None:
        """Make the equations of the pools; `Refined` is posted, unless it is stopped."""
        try:
            self._ports.background(lambda: self._refine(job, prepared, pools))
        except RuntimeError as error:  # the system starts no more threads
            self._post(not_refined(job, str(error)))

    def _refine(self, job: str, prepared: Prepared, pools: Pools) -> None:
        """Have the equations made; runs in the background."""
        errand = partial(refine_job, self._ports.refiner, job, prepared.preparation, prepared.config, pools)
        try:
            self._post(self._errands.do_in_turn(job, errand))
        except StoppedError:
            return
        except LostError as error:
            self._post(not_refined(job, str(error)))
        except Exception as error:  # as above
            _LOG.exception("refining broke", extra=fields(job=job))
            self._post(not_refined(job, f"{type(error).__name__}: {error}"))

    def stop(self, job: str) -> None:
        """End what is under way for a job, if anything is: nobody waits for it any more."""
        self._errands.stop(job)

    def close(self) -> None:
        """End everything that is under way, but for what is being written."""
        self._errands.close()
