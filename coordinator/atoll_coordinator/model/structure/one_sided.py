"""One-sided intervals of constants that lie on a bound. Pure."""

import math

import numpy as np
import numpy.typing as npt

from atoll_coordinator.model.least_squares import inverse
from atoll_coordinator.result.equations import Constant
from atoll_core.data.dataset import FloatArray


def one_sided_reaches(
    information: FloatArray, gradient: FloatArray | None, held: npt.NDArray[np.bool_]
) -> dict[int, float]:
    """Return for each constant on a bound, by number, how far from it 95 % of its distribution reach.

    Near the bound the likelihood is a normal distribution whose centre lies beyond it, by the Newton step that
    the gradient asks for; its part on the near side is the distribution of the constant.

    Args:
        information: the curvature (P, P) of minus the log-likelihood.
        gradient: the slope (P,) of the log-likelihood.
        held: which constants (P,) lie on a bound.
    """
    from scipy import special

    free, reaches = np.flatnonzero(~held), {}
    for number in np.flatnonzero(held).tolist():
        chosen = np.array([*free, number])
        error = math.sqrt(max(float(inverse(information[np.ix_(chosen, chosen)])[-1, -1]), 0.0))
        beyond = 0.0 if gradient is None else abs(float(gradient[number])) * error
        tail = math.log(0.05) + float(special.log_ndtr(-beyond))  # of all that lies beyond the centre
        reach = error * (-float(special.ndtri_exp(tail)) - beyond)
        reaches[number] = reach if math.isfinite(reach) else 0.0
    return reaches


def within_bounds(constant: Constant, lower: float, upper: float, reach: float | None) -> Constant:
    """Return a constant with its interval clipped to its bounds; on a bound, with the one-sided one that `reach` makes.

    Its `bounds` are given then, infinite on an open side. There is no standard error on a bound: the data would have
    the constant beyond.
    """
    if reach is None:
        low, high = constant.interval or (None, None)
        clipped = (lower if low is None else max(low, lower), upper if high is None else min(high, upper))
        return constant.replaced(bounds=(lower, upper), interval=constant.interval and clipped)
    at = lower if constant.fitted is not None and constant.fitted <= lower else upper
    interval = (at, min(at + reach, upper)) if at == lower else (max(at - reach, lower), at)
    return constant.replaced(
        value=at, std_error=None, interval=interval, identifiable=True, bounds=(lower, upper), at_bound=True
    )
