"""Refining a job as a task: what preparing gave and the pools of the search in, a refinement out."""

from collections.abc import Callable

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.refinement import LawsByGroup, Pool, Pools, Refinement
from atoll_coordinator.tasks.preparing import Prepared
from atoll_core.config import JobConfig
from atoll_core.wire.values import decode_value, encode_value

Refiner = Callable[[Preparation, JobConfig, Pools, Deadline, LawsByGroup | None], Refinement]
"""Makes the equations that are shown from the search's pools; see `atoll_coordinator.model.pipeline.refine_all`."""


def refine(prepared: bytes, pools: bytes, seconds: float | None, refiner: Refiner) -> bytes:
    """Return the encoded Refinement of encoded pools, made in so many seconds (None: any time)."""
    job = decode_value(prepared, Prepared)
    made = refiner(job.preparation, job.config, decode_value(pools, dict[str, Pool]), Deadline(seconds), job.laws)
    return encode_value(made)
