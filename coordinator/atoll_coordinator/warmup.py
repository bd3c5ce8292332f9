"""Prepares all kernels of the coordinator before work arrives: compiled once per machine, loaded afterwards."""

import hashlib
from collections.abc import Iterable
from typing import Final

from atoll_coordinator.data.differentiation.derivatives import warm_up as warm_up_data
from atoll_coordinator.model.shooting.warmup import warm_up as warm_up_trajectories
from atoll_coordinator.model.sparse.warmup import warm_up as warm_up_sparse
from atoll_core.compilation.cache import compile_or_load, is_compiled
from atoll_core.compilation.progress import Report
from atoll_core.data.dataset import FloatArray

PACKAGE: Final = "atoll_coordinator"
PREPARING: Final = "preparing"
"""The part of the package whose kernels preparing needs."""

COSTS: Final = {
    "_apply": 2.8, "validate_into": 1.4, "loess_into": 0.8, "left_out_into": 0.6, "moments": 0.1,
    "differences_into": 0.4, "best_stencil_into": 0.2, "thin_into": 0.2, "spread_into": 0.4,
    "largest_sizes": 0.2, "integrate_segments": 9.9, "innovate": 0.5,
    "normal_equations": 1.1, "solve_step": 1.3, "windowed_sums": 0.1, "spread_window_weights": 0.1,
    "scalar_products": 0.2, "sum_products": 0.2, "sum_error_products": 1.0, "eliminate": 3.5,
    "find_shortest_with_each": 4.5, "explained_shares": 1.0,
    "solve_damped": 0.2,
}  # fmt: skip
"""The separately compiled kernels, and the seconds of a processor that each took on one machine
(``python -m benchmarks.kernels.compiling``)."""

_OF_FITS: Final = ("largest_sizes", "integrate_segments", "innovate", "normal_equations", "solve_step")
"""The kernels that only trajectory fits need."""


def warm_up(report: Report) -> None:
    """Compile or load every kernel of data preparation, trajectory fits, sparse regression; see `compile_or_load`.

    If the kernels of preparing are compiled already, only the others take time.
    """
    has_some = is_compiled(PACKAGE, PREPARING)
    costs = {name: 0.0 if has_some and name not in _OF_FITS else cost for name, cost in COSTS.items()}
    compile_or_load(PACKAGE, exercise, costs, report)


def warm_up_preparing(report: Report) -> None:
    """Compile or load every kernel that preparing needs, of data and of sparse regression; see `compile_or_load`."""
    costs = {name: cost for name, cost in COSTS.items() if name not in _OF_FITS}
    compile_or_load(PACKAGE, exercise_preparing, costs, report, PREPARING)


def exercise() -> str:
    """Return a digest of what all kernels computed.

    It is taken in single precision, because trajectory fits also add with numpy, whose last bits differ between
    processors.
    """
    return _digest((*warm_up_data(), *warm_up_trajectories(), *warm_up_sparse()))


def exercise_preparing() -> str:
    """Return a digest of what the kernels of preparing computed, see `exercise`."""
    return _digest((*warm_up_data(), *warm_up_sparse()))


def _digest(arrays: Iterable[FloatArray]) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(array.astype("<f4").tobytes())
    return digest.hexdigest()
