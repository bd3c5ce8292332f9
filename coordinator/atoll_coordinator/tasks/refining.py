"""Refining a job as a task: from the prepared job and the pools of the search to the job's result as JSON."""

from collections.abc import Callable
from dataclasses import dataclass

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.pools import LawsByGroup, Pool, Pools
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.model.result.building import KNOWN, Account, VariableOutcome, build_result
from atoll_coordinator.result.result import UNTIMED
from atoll_coordinator.tasks.preparing import Prepared
from atoll_core.config import JobConfig
from atoll_core.wire.values import decode_value, encode_value

Refiner = Callable[[Preparation, JobConfig, Pools, Deadline, LawsByGroup | None], Refinement]
"""Makes the displayed equations from the search's pools; see `atoll_coordinator.model.pipeline.refine_all`."""


@dataclass(frozen=True, slots=True)
class Searched:
    """The ends of a job's searches, in the order of its dataset, including known equations."""

    job: str
    outcomes: tuple[VariableOutcome, ...]

    @property
    def pools(self) -> Pools:
        """The pools of the searches, by variable."""
        return {one.variable: Pool(one.front, one.runners_up) for one in self.outcomes if one.why != KNOWN}

    def to_bytes(self) -> bytes:
        """Return this as an input of the task."""
        return encode_value(self)


def refine(prepared: bytes, searched: bytes, seconds: float | None, refiner: Refiner) -> bytes:
    """Return the result, as JSON in UTF-8, of a job that is refined in a number of seconds (None: no limit).

    The duration of the whole job is missing; `atoll_coordinator.result.result.timed` fills it in.
    """
    job, search = decode_value(prepared, Prepared), decode_value(searched, Searched)
    refinement = refiner(job.preparation, job.config, search.pools, Deadline(seconds), job.laws)
    account = Account("done", UNTIMED, max((one.seconds for one in search.outcomes), default=0.0))
    result = build_result(search.job, job.config, job.preparation, search.outcomes, account, refinement)
    return result.to_json().encode()
