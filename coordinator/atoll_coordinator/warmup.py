"""Prepares all kernels of the coordinator before work arrives: compiled once per machine, loaded afterwards."""

import hashlib
from typing import Final

from atoll_coordinator.data.differentiation.derivatives import warm_up as warm_up_data
from atoll_coordinator.model.shooting.warmup import warm_up as warm_up_trajectories
from atoll_coordinator.model.sparse.warmup import warm_up as warm_up_sparse
from atoll_core.compilation.cache import Report, compile_or_load

KERNELS: Final = 17
"""Number of separately compiled kernels."""


def warm_up(report: Report) -> None:
    """Compile or load every kernel of data preparation, trajectory fits, sparse regression; see `compile_or_load`."""
    compile_or_load("atoll_coordinator", exercise, KERNELS, report)


def exercise() -> str:
    """Return a digest of what the kernels computed.

    It is taken in single precision, because trajectory fits also add with numpy, whose last bits differ between
    processors.
    """
    digest = hashlib.blake2b(digest_size=16)
    for array in (*warm_up_data(), *warm_up_trajectories(), *warm_up_sparse()):
        digest.update(array.astype("<f4").tobytes())
    return digest.hexdigest()
