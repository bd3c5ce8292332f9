"""What takes long, away from the service's loop: preparing, refining, writing. What comes of it is posted there."""

import hashlib
import logging
from collections.abc import Callable
from dataclasses import dataclass

from common.config import JobConfig
from common.errors import DataError, RemoteProtocolError, StoreError, UsageError
from common.logs import fields
from common.wire.codec import dataset_to_bytes
from coordinator.model.known import known_entries, with_remarks
from coordinator.model.refinement import Pools, Refinement
from coordinator.service.archipelago import Checkpoint
from coordinator.service.job import Fault, Prepared
from coordinator.service.ports import Ports, StorePort
from coordinator.service.resolve import resolve

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Ready:
    """Posted when a job is prepared: its dataset, also as bytes."""

    job: str
    prepared: Prepared
    data: bytes


@dataclass(frozen=True, slots=True)
class Unprepared:
    """Posted when a job cannot be prepared: why there is no dataset."""

    job: str
    fault: Fault
    sentence: str


@dataclass(frozen=True, slots=True)
class Refined:
    """Posted when a job is refined: what was made of its pools."""

    job: str
    refinement: Refinement


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
        """Prepare a table; `Ready` or `Unprepared` is posted."""
        self._ports.background(lambda: self._prepare_ahead(job, table, config))

    def _prepare_ahead(self, job: str, table: bytes, config: JobConfig) -> None:
        """Prepare the job; then, while it is searched, what refining it will need. Runs in the background."""
        self._post(self._prepare(job, table, config))
        try:
            self._ports.warm_up()
        except Exception:  # refining meets the same trouble and tells it
            _LOG.exception("warm-up failed")

    def _prepare(self, job: str, table: bytes, config: JobConfig) -> Ready | Unprepared:
        """Smooth and differentiate; runs in the background."""
        try:
            preparation = self._ports.preparer(table, config)
            data = dataset_to_bytes(preparation.dataset)
            blob = hashlib.sha256(data).hexdigest()
            resolved = resolve(config, preparation.dataset)
            known = known_entries(preparation.dataset, resolved)
            preparation = with_remarks(preparation, resolved)
            prepared = Prepared(preparation, resolved, blob, len(data), known)
            return Ready(job, prepared, data)
        except (DataError, UsageError, RemoteProtocolError) as error:
            return Unprepared(job, "data", str(error))
        except Exception as error:  # the job fails with it, the coordinator goes on
            _LOG.exception("preparing broke", extra=fields(job=job))
            return Unprepared(job, "internal", f"preparing the data broke ({type(error).__name__}: {error})")

    def refine(self, job: str, prepared: Prepared, pools: Pools) -> None:
        """Make the equations of the pools; `Refined` is posted."""
        self._ports.background(lambda: self._post(self._refine(job, prepared, pools)))

    def _refine(self, job: str, prepared: Prepared, pools: Pools) -> Refined:
        """Make the equations; runs in the background. When that breaks, the selected members stay as they are."""
        try:
            return Refined(job, self._ports.refiner(prepared.preparation, prepared.config, pools))
        except Exception as error:  # the job is done all the same
            _LOG.exception("refining broke", extra=fields(job=job))
            sentence = f"Refining broke ({type(error).__name__}: {error}); equations are as found."
            return Refined(job, Refinement(warnings=(sentence,)))
