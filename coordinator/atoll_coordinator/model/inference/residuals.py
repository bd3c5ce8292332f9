"""What a simulation leaves of a state: is it as large as the noise, and is it without a pattern? Pure.

Residuals of a right model are the measurement errors: their variance is that of the noise, and neighbours do not know
of each other. Both are asked of all trajectories together, with p-values. Letters: R rows of one trajectory, n rows of
all, p fitted parameters.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from atoll_coordinator.model.inference.quadratic_forms import variance_ratio_tail
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray


@dataclass(frozen=True)
class ReferenceSmoother:
    """Loess of the same measurements, by which residuals are judged: its `span` (rows), its `degree`, its `noise`."""

    span: int
    degree: int
    noise: float


@dataclass(frozen=True)
class Check:
    """What was found of the residuals of one state.

    `standard_deviation` is theirs, corrected for what was fitted. `ratio` is that over the noise and
    `too_large` the probability of at least that ratio if they were noise. `correlation` is that of neighbours, as far
    as it exceeds what fitting causes: about the share of the residuals' variance that follows a pattern; `patterned` is
    the probability of at least that much, over a few lags, if they were noise.
    """

    standard_deviation: float
    ratio: float
    too_large: float
    correlation: float
    patterned: float


def check(
    residuals: Sequence[FloatArray], noise: float, parameters: float = 0.0, reference: ReferenceSmoother | None = None,
    innovations: Sequence[FloatArray] | None = None, *, is_robust: bool = False,
) -> Check:  # fmt: skip
    """Return the checks of one state's residuals.

    Args:
        residuals: (R,) for each trajectory, measured minus simulated, finite.
        noise: standard deviation of the measurement errors, in the same unit. 0 gives an infinite ratio.
        parameters: p, how many numbers were fitted to these residuals: constants and initial values, by share where
            other states decide as well.
        innovations: the residuals, what goes together in errors of measurement taken out, for both probabilities; None:
            such errors are independent.
        reference: what estimates the noise from the same errors, for `too_large`; None: `noise` is known.
        is_robust: whether there are outliers, which must not decide.
    """
    from scipy import special

    rows = sum(len(series) for series in residuals)
    free = max(rows - parameters, 1.0)
    errors = _clip_outliers(residuals) if is_robust else residuals
    square = float(sum(series @ series for series in errors))
    standard_deviation = math.sqrt(square / free)
    ratio = standard_deviation / noise if noise > 0.0 else math.inf
    if square == 0.0:
        return Check(0.0, 0.0 if noise > 0.0 else 1.0, 1.0, 0.0, 1.0)
    if innovations is None:
        correlations, weights = _correlations(errors, square, rows / free * parameters)
    else:
        errors = _clip_outliers(innovations) if is_robust else innovations
        square = float(sum(series @ series for series in errors))
        correlations, weights = _correlations(errors, square, parameters)
    score = sum(correlations) / math.sqrt(sum(weights)) if sum(weights) else 0.0
    return Check(
        standard_deviation,
        ratio,
        _too_large(errors, square / free, noise, parameters, reference),
        correlations[0] if correlations else 0.0,
        float(special.ndtr(-score)),
    )


def _too_large(
    errors: Sequence[FloatArray], variance: float, noise: float, parameters: float, reference: ReferenceSmoother | None
) -> float:
    """Return the probability of at least this variance if the residuals were noise."""
    from scipy import special

    if reference is None:
        free = max(sum(map(len, errors)) - parameters, 1.0)
        return float(special.chdtrc(free, free * variance / noise**2)) if noise > 0.0 else 0.0
    if not reference.noise > 0.0:
        return 0.0
    lengths = [len(series) for series in errors]
    return variance_ratio_tail(variance / reference.noise**2, lengths, parameters, reference.span, reference.degree)


def _correlations(errors: Sequence[FloatArray], square: float, parameters: float) -> tuple[list[float], list[float]]:
    """Return the correlation at each lag beyond what fitting causes, and the variance it has in noise.

    With the projection H on what p parameters can do, residuals of noise have E sum e_i e_(i+k) = - sigma^2 sum
    H_(i,i+k) over n_k pairs; that is about - sigma^2 p n_k/n, since what they do is smooth. The variance is that of
    Ljung & Box (1978), n_k/(n (n + 2)).
    """
    rows = sum(len(series) for series in errors)
    correlations, variances = [], []
    for lag in range(1, SETTINGS.inference.lags + 1):
        pairs = sum(max(len(series) - lag, 0) for series in errors)
        if pairs:
            product = float(sum(series[:-lag] @ series[lag:] for series in errors if len(series) > lag))
            correlations.append(product / square + parameters * pairs / rows**2)
            variances.append(pairs / (rows * (rows + 2)))
    return correlations, variances


def _clip_outliers(residuals: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the residuals with those far out, by the median of their size, brought in."""
    limit = SETTINGS.robustness.reach * float(np.median(np.abs(np.concatenate(list(residuals)))))
    return [np.clip(series, -limit, limit) for series in residuals]
