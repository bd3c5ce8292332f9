"""Making the kernels of data preparation ready before they are needed: compiled once per machine, else loaded."""

import os
from typing import Final

import numpy as np

from atoll_coordinator.data.differentiation.derivatives import Differentiation, estimate_derivatives
from atoll_coordinator.data.differentiation.smoothing import Signal, Smoother, smooth

_ROWS: Final = 24


def warm_up() -> None:
    """Compile or load every kernel that preparing data needs, by a few rows with noise and a few without.

    Interpreted kernels (``NUMBA_DISABLE_JIT``) need nothing. Takes some seconds the first time on a machine.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return
    numbers = np.arange(float(_ROWS))
    times = 0.1 * numbers
    noisy, clean = Signal(times, numbers * 31.0 % 47.0), Signal(times, 1.0 / (1.0 + times))
    estimate_derivatives([noisy], Differentiation())
    estimate_derivatives([clean], Differentiation())
    smooth(noisy, Smoother(5, 1, 0.0, thinning=2))
