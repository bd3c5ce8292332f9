"""What is posted to the service's loop when a task of a job has got on."""

from dataclasses import dataclass

from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.service.jobs.job import Fault
from atoll_coordinator.service.monitoring.drafts import Draft
from atoll_coordinator.service.search.archipelago import Checkpoint
from atoll_coordinator.tasks.preparing import Prepared


@dataclass(frozen=True, slots=True)
class TableChecked:
    """The table of a job was read: whether it is in the store, undamaged; `error` says why it could not be read."""

    job: str
    is_sound: bool
    error: Exception | None = None


@dataclass(frozen=True, slots=True)
class PreparationBegun:
    """A process that is loaded prepares a job: its time counts from now on."""

    job: str


@dataclass(frozen=True, slots=True)
class JobPrepared:
    """A job is prepared. `encoded` is what was prepared, as bytes with the SHA-256 `digest`, `data` its dataset.

    When it is posted, both are in the store, and `data` is left out; `former` is the digest of the dataset that the
    store had of the job before, None: it had none.
    """

    job: str
    prepared: Prepared
    encoded: bytes
    digest: str
    data: bytes = b""
    former: str | None = None


@dataclass(frozen=True, slots=True)
class PreparationFailed:
    """A job cannot be prepared: why there is no dataset."""

    job: str
    fault: Fault
    sentence: str


@dataclass(frozen=True, slots=True)
class JobRefined:
    """A job is refined: its result as JSON, but for the seconds that it took (`result.result.timed`)."""

    job: str
    text: str


@dataclass(frozen=True, slots=True)
class RefiningFailed:
    """A job could not be refined: a warning in place of what refining gives."""

    job: str
    refinement: Refinement


@dataclass(frozen=True, slots=True)
class ResultComposed:
    """The result of a job was composed: as JSON, but for the seconds; `error` says why it could not be."""

    draft: Draft
    text: str = ""
    error: Exception | None = None


@dataclass(frozen=True, slots=True)
class CheckpointWritten:
    """A checkpoint has been written; `error` says why it is not durable, None that it is."""

    checkpoint: Checkpoint
    error: Exception | None = None


def preparation_failed(job: str, why: str, to_send: str) -> PreparationFailed:
    """Return the outcome of a preparation that ended with an error of ours or of a machine."""
    return PreparationFailed(job, "internal", f"preparing the data broke ({why}){to_send}")


def refinement_failed(job: str, why: str, to_send: str) -> RefiningFailed:
    """Return the outcome of a refinement that failed: the selected members stay as they are."""
    warning = f"Refining broke ({why}); equations are as found{to_send}."
    return RefiningFailed(job, Refinement(warnings=(warning,), end="not refined"))
