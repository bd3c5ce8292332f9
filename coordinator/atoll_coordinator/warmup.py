"""Prepares all kernels of the coordinator before work arrives: compiled once per machine, loaded afterwards."""

from typing import Final

from atoll_coordinator.data.differentiation.derivatives import warm_up as warm_up_data
from atoll_coordinator.model.shooting.warmup import warm_up as warm_up_trajectories
from atoll_coordinator.model.sparse.warmup import warm_up as warm_up_sparse
from atoll_core.compilation.cache import Report, compile_or_load

KERNELS: Final = 18
"""Number of separately compiled kernels."""


def warm_up(report: Report) -> None:
    """Compile or load every kernel of data preparation, trajectory fits, sparse regression; see `compile_or_load`."""
    compile_or_load("atoll_coordinator", _run_all, KERNELS, report)


def _run_all() -> None:
    warm_up_data()
    warm_up_trajectories()
    warm_up_sparse()
