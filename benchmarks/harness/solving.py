"""Solutions of differential equations without time, given up where they run away."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from atoll_core.data.dataset import FloatArray


class DivergedError(Exception):
    """Raised when a solution leaves the finite range or takes too many evaluations."""


def solve(
    rates: Callable[[FloatArray], Sequence[float]], start: Sequence[float] | FloatArray, times: FloatArray, *,
    limit: float, most_evaluations: int, begin: float = 0.0, **options: Any,
) -> FloatArray:  # fmt: skip
    """Return the states (n, S) at `times` (n,) of what is at `start` (S,) at the time `begin`.

    States beyond `limit` have run away; `options` are those of `solve_ivp`. Raises DivergedError, and ValueError for
    times that do not rise from `begin`.
    """
    if times[0] < begin or not (np.diff(times) > 0.0).all():
        raise ValueError(f"times must rise from {begin}")
    evaluations = 0

    def slope(_time: float, state: FloatArray) -> Sequence[float]:
        nonlocal evaluations
        evaluations += 1
        if evaluations > most_evaluations or not np.all(np.abs(state) < limit):
            raise DivergedError
        return rates(state)

    try:
        with np.errstate(all="ignore"):
            solution = solve_ivp(slope, (begin, float(times[-1])), start, t_eval=times, **options)
    except (ArithmeticError, ValueError) as error:
        raise DivergedError from error
    if not solution.success or not np.isfinite(solution.y).all():
        raise DivergedError
    return np.ascontiguousarray(solution.y.T)
