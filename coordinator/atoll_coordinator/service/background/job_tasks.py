"""The functions that prepare and refine one job. A child process finds them by name; each returns an outcome."""

import hashlib
import logging
from collections.abc import Callable
from dataclasses import dataclass

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.refinement import LawsByGroup, Pools, Refinement
from atoll_coordinator.model.result.known import known_entries, with_remarks
from atoll_coordinator.service.jobs.defaults import resolve, with_units
from atoll_coordinator.service.jobs.job import Fault, Prepared
from atoll_coordinator.service.monitoring.breakages import what_to_send
from atoll_core.config import JobConfig
from atoll_core.errors import DataError, RemoteProtocolError, UsageError
from atoll_core.logs import fields
from atoll_core.wire.codec import dataset_to_bytes

_LOG = logging.getLogger(__name__)

Preparer = Callable[[bytes, JobConfig], Preparation]
"""Turns an uploaded table into regression problems and a recording; raises DataError or UsageError with a sentence for
the user."""

Refiner = Callable[[Preparation, JobConfig, Pools, Deadline, LawsByGroup | None], Refinement]
"""Makes the equations that are shown from the search's pools; see `atoll_coordinator.model.pipeline.refine_all`."""


@dataclass(frozen=True, slots=True)
class PreparationBegun:
    """Posted when the process that prepares a job of limited time is loaded, its kernels compiled: now time counts."""

    job: str


@dataclass(frozen=True, slots=True)
class JobPrepared:
    """Posted when a job is prepared: its dataset, also as bytes."""

    job: str
    prepared: Prepared
    data: bytes


@dataclass(frozen=True, slots=True)
class PreparationFailed:
    """Posted when a job cannot be prepared: why there is no dataset."""

    job: str
    fault: Fault
    sentence: str


@dataclass(frozen=True, slots=True)
class JobRefined:
    """Posted when a job is refined: what was made of its pools."""

    job: str
    refinement: Refinement


def prepare_table(table: bytes, config: JobConfig) -> Preparation:
    """Smooth and differentiate an uploaded table.

    Raises:
        DataError: The measurements cannot be used as they are.
        UsageError: Options contradict each other or name columns that are not there.
        RemoteProtocolError: The bytes are not those of a table.
    """
    from atoll_coordinator.data.prepare import prepare
    from atoll_core.data.table import Table

    return prepare(Table.from_bytes(table), config)


def refine(
    preparation: Preparation, config: JobConfig, pools: Pools, deadline: Deadline, laws: LawsByGroup | None
) -> Refinement:
    """See `atoll_coordinator.model.pipeline.refine_all`, whose kernels are loaded no sooner."""
    from atoll_coordinator.model.pipeline import refine_all

    return refine_all(preparation, config, pools, deadline, laws)


def prepare_job(preparer: Preparer, job: str, table: bytes, config: JobConfig) -> JobPrepared | PreparationFailed:
    """Prepare the table of a job, or say why that cannot be done."""
    from atoll_coordinator.model.sparse.product_laws import laws_among_many, settled_variables  # loads kernels
    from atoll_coordinator.model.sparse.rates.screening import with_screened_variables

    try:
        preparation = preparer(table, config)
        data = dataset_to_bytes(preparation.dataset)
        blob = hashlib.sha256(data).hexdigest()
        resolved = with_screened_variables(preparation, resolve(config, preparation.dataset))
        known = known_entries(preparation.dataset, resolved)
        preparation = with_remarks(preparation, resolved)
        resolved = with_units(resolved, preparation.source)
        laws = laws_among_many(preparation, resolved)
        settled = settled_variables(preparation, resolved, laws)
        return JobPrepared(job, Prepared(preparation, resolved, blob, len(data), known, settled, laws), data)
    except (DataError, UsageError, RemoteProtocolError) as error:
        return PreparationFailed(job, "data", str(error))
    except Exception as error:  # the job fails with it, the coordinator goes on
        _LOG.exception("preparing failed", extra=fields(job=job))
        return preparation_failed(job, _named(error), what_to_send(config))


def preparation_failed(job: str, why: str, to_send: str) -> PreparationFailed:
    """Return the outcome of a preparation that ended with an error of ours or of this machine."""
    return PreparationFailed(job, "internal", f"preparing the data broke ({why}){to_send}")


def refine_job(
    refiner: Refiner, job: str, prepared: Prepared, pools: Pools, seconds: float | None = None
) -> JobRefined:
    """Make the equations of a job, in so many seconds. When that fails, the selected members stay as they are."""
    try:
        return JobRefined(job, refiner(prepared.preparation, prepared.config, pools, Deadline(seconds), prepared.laws))
    except Exception as error:  # the job is done all the same
        _LOG.exception("refining failed", extra=fields(job=job))
        return refinement_failed(job, _named(error), what_to_send(prepared.config))


def refinement_failed(job: str, why: str, to_send: str) -> JobRefined:
    """Return the outcome of a refinement that failed: the selected members stay as they are."""
    warning = f"Refining broke ({why}); equations are as found{to_send}."
    return JobRefined(job, Refinement(warnings=(warning,), end="not refined"))


def _named(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
