"""Errands: what takes long for one job, preparing and refining. Plain functions, found by name in a child process."""

import hashlib
import logging
from collections.abc import Callable
from dataclasses import dataclass

from atoll.config import JobConfig
from atoll.errors import DataError, RemoteProtocolError, UsageError
from atoll.logs import fields
from atoll.wire.codec import dataset_to_bytes
from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.inference.refinement import Pools, Refinement
from atoll_coordinator.model.report.known import known_entries, with_remarks
from atoll_coordinator.service.jobs.defaults import resolve
from atoll_coordinator.service.jobs.job import Fault, Prepared
from atoll_coordinator.service.ports import Preparer, Refiner

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


def prepare_job(preparer: Preparer, job: str, table: bytes, config: JobConfig) -> Ready | Unprepared:
    """Smooth and differentiate, or say why not."""
    try:
        preparation = preparer(table, config)
        data = dataset_to_bytes(preparation.dataset)
        blob = hashlib.sha256(data).hexdigest()
        resolved = resolve(config, preparation.dataset)
        known = known_entries(preparation.dataset, resolved)
        preparation = with_remarks(preparation, resolved)
        return Ready(job, Prepared(preparation, resolved, blob, len(data), known), data)
    except (DataError, UsageError, RemoteProtocolError) as error:
        return Unprepared(job, "data", str(error))
    except Exception as error:  # the job fails with it, the coordinator goes on
        _LOG.exception("preparing broke", extra=fields(job=job))
        return not_prepared(job, f"{type(error).__name__}: {error}")


def not_prepared(job: str, why: str) -> Unprepared:
    """Return that preparing a job broke."""
    return Unprepared(job, "internal", f"preparing the data broke ({why})")


def refine_job(refiner: Refiner, job: str, preparation: Preparation, config: JobConfig, pools: Pools) -> Refined:
    """Make the equations. When that breaks, the selected members stay as they are."""
    try:
        return Refined(job, refiner(preparation, config, pools))
    except Exception as error:  # the job is done all the same
        _LOG.exception("refining broke", extra=fields(job=job))
        return not_refined(job, f"{type(error).__name__}: {error}")


def not_refined(job: str, why: str) -> Refined:
    """Return that refining a job broke: the selected members stay as they are."""
    return Refined(job, Refinement(warnings=(f"Refining broke ({why}); equations are as found.",)))


def make_ready(warm_up: Callable[[], None]) -> None:
    """Have ready what later errands need; a trouble is logged, for they meet it too and tell it."""
    try:
        warm_up()
    except Exception:
        _LOG.exception("warm-up failed")
