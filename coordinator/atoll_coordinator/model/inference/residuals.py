"""Tests of the residuals of a simulated state: their size, compared with the noise, and their pattern. Pure.

The residuals of a right model are the measurement errors: their variance is the variance of the noise, and neighbouring
residuals are independent. `residual_statistics` tests these two properties, over all trajectories together:

- size: the residual variance divided by the noise variance. If the noise is known, the distribution is chi-square. If
  loess estimated the noise from the same errors, it is the distribution of a ratio of quadratic forms
  (`quadratic_forms`).
- pattern: the sum of correlations over a few lags, corrected for fitted parameters. The distribution is approximately
  normal; for few rows, the exact distribution follows from the covariance of the residuals.

Each test has a p-value, and a power: the smallest error of the model that the test detects in five of six tables.
Without this power, a test that passes would show nothing.

Doubtful: errors must be normal and independent, or whitened. The correction for fitted parameters assumes smooth
derivatives. A pattern whose sign changes from row to row is not tested.

Letters: R rows of one trajectory, n rows of all trajectories, p fitted parameters.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_coordinator.data.differentiation.smoothing import REACH
from atoll_coordinator.model.inference.quadratic_forms import probability_of_positive_sum, variance_ratio_tail
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

_LAGS: Final = 3
"""Largest lag in rows. The residuals of a model that lacks a term have the same sign for several rows."""


@dataclass(frozen=True)
class ReferenceSmoother:
    """Loess of the same measurements, the reference for the residuals. `span` is in rows, `degree` is the degree of the
    polynomials, and `noise` is the noise that loess has estimated."""

    span: int
    degree: int
    noise: float


@dataclass(frozen=True)
class ResidualStatistics:
    """Tests of the residuals of one state.

    `standard_deviation` is corrected for the fitted parameters. `ratio` is the standard deviation divided by the noise;
    `size_probability` is the probability of at least this ratio if the residuals were noise. `correlation` is the
    correlation of neighbouring residuals minus the correlation that fitting causes. It is about the share of the
    residual variance that follows a pattern. `pattern_probability` is the probability of a correlation at least as
    large, over a few lags, if the residuals were noise.

    `detectable_ratio` and `detectable_correlation` describe the power of both tests. They are the smallest true ratio,
    and the smallest share of a pattern, that the tests detect in five of six tables. They are infinite if a test
    detects no size.
    """

    standard_deviation: float
    ratio: float
    size_probability: float
    correlation: float
    pattern_probability: float
    detectable_ratio: float = math.inf
    detectable_correlation: float = math.inf


def residual_statistics(
    residuals: Sequence[FloatArray], noise: float, parameters: float = 0.0, reference: ReferenceSmoother | None = None,
    innovations: Sequence[FloatArray] | None = None, covariance: FloatArray | None = None,
) -> ResidualStatistics:  # fmt: skip
    """Return the tests of the residuals of one state.

    Args:
        residuals: (R,) for each trajectory, measured minus simulated, finite.
        noise: standard deviation of the measurement errors, in the same unit. 0 gives an infinite ratio.
        parameters: p, the number of constants and initial values fitted to these residuals. If several states determine
            one fitted number, a part of it counts for each state.
        innovations: the whitened residuals if measurement errors are correlated; both probabilities are computed from
            them. None: errors are independent.
        reference: the smoother that estimates the noise from the same errors; `size_probability` depends on it. None:
            `noise` is known.
        covariance: covariance (n, n) of the residuals for noise of variance one; the rows of all trajectories follow
            one another. With this covariance, the distribution of the correlations is exact. None: the distribution is
            assumed to be about normal, since the fitted curves are smooth.
    """
    rows = sum(len(series) for series in residuals)
    free = max(rows - parameters, 1.0)
    errors = residuals
    square = float(sum(series @ series for series in errors))
    standard_deviation = math.sqrt(square / free)
    ratio = standard_deviation / noise if noise > 0.0 else math.inf
    if square == 0.0:
        return ResidualStatistics(0.0, 0.0 if noise > 0.0 else 1.0, 1.0, 0.0, 1.0)
    if innovations is None:
        correlations, weights = _correlations(errors, square, rows / free * parameters)
    else:
        errors = innovations
        square = float(sum(series @ series for series in errors))
        correlations, weights = _correlations(errors, square, parameters)
    pattern_probability = _normal_pattern(errors, correlations, weights)
    if covariance is not None and len(covariance) == rows and rows - parameters >= 1.0 and correlations:
        correlations[0], pattern_probability = _exact_pattern(errors, square, covariance, _count_lags(rows, parameters))
    is_testable = rows - parameters >= 1.0
    return ResidualStatistics(
        standard_deviation,
        ratio,
        _size_probability(errors, square / free, noise, parameters, reference),
        correlations[0] if correlations else 0.0,
        pattern_probability,
        _detectable_ratio(errors, noise, parameters, reference) if is_testable else math.inf,
        _detectable_correlation(weights, rows) if is_testable else math.inf,
    )


def _normal_pattern(errors: Sequence[FloatArray], correlations: Sequence[float], variances: Sequence[float]) -> float:
    """Return the probability of at least this sum of correlations in noise. The distribution of the sum is about
    normal."""
    from scipy import special

    return float(special.ndtr(-sum(correlations) / math.sqrt(sum(variances)))) if sum(variances) else 0.5


def _count_lags(rows: float, parameters: float) -> int:
    """Return the largest lag in rows. It is limited because, after a fit of p numbers, residuals change their sign
    within n/p rows."""
    return max(1, min(_LAGS, int(rows / (2.0 * max(parameters, 1.0)))))


def _exact_pattern(
    errors: Sequence[FloatArray], square: float, covariance: FloatArray, reach: int
) -> tuple[float, float]:
    """Return the correlation of neighbouring residuals minus its mean in noise, and the probability of at least this
    sum of correlations over all lags.

    If the errors are noise, residuals e have the covariance I - H, with the projection H on the derivatives by the
    fitted numbers. The sum of correlations exceeds r if the quadratic form e'(A - r I)e is positive. A has 1/2 on the
    off-diagonals up to the largest lag, within each trajectory.
    """
    owners = np.repeat(np.arange(len(errors)), list(map(len, errors)))
    places = np.concatenate([np.arange(len(series)) for series in errors])
    lags = np.abs(places[:, None] - places) * (owners[:, None] == owners)
    near = np.where((lags > 0) & (lags <= reach), 0.5, 0.0)
    together = np.concatenate(list(errors))
    ratio = float(together @ near @ together) / square
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    weights = np.linalg.eigvalsh(root.T @ (near - ratio * np.eye(len(near))) @ root)
    first = float(sum(series[:-1] @ series[1:] for series in errors)) / square
    expected = float((covariance * (lags == 1)).sum()) / 2.0 / max(float(np.trace(covariance)), 1.0)
    return first - expected, probability_of_positive_sum(weights, np.ones(len(weights)))


def _detectable_ratio(
    errors: Sequence[FloatArray], noise: float, parameters: float, reference: ReferenceSmoother | None
) -> float:
    """Return the ratio of the standard deviation of residuals to the noise that the test detects in five of six tables.

    At this true ratio, an estimated variance that is one standard deviation too small is just significant.
    """
    free = max(sum(map(len, errors)) - parameters, 1.0)

    def is_too_large(ratio: float) -> bool:
        return (
            _size_probability(errors, (ratio * unit) ** 2, noise, parameters, reference) < SETTINGS.inference.improbable
        )

    unit = noise if reference is None else reference.noise
    if not unit > 0.0:
        return math.inf
    critical, most = SETTINGS.inference.excess, 1e3
    while not is_too_large(critical):
        critical *= SETTINGS.inference.excess
        if critical > most:
            return math.inf
    spread = 1.0 - math.sqrt(2.0 / free)  # relative variance at one standard deviation below its mean
    return critical / math.sqrt(spread) if spread > 0.0 else math.inf


def _detectable_correlation(weights: Sequence[float], rows: int) -> float:
    """Return the share of a slow pattern in the residual variance that the test detects in five of six tables.

    For a slow pattern, the correlation at each lag is about equal to this share.
    """
    from scipy import special

    if not weights:
        return math.inf
    pairs = sum(weight * (rows + 2) for weight in weights)
    critical = -float(special.ndtri(SETTINGS.inference.improbable)) + 1.0
    share = critical * math.sqrt(sum(weights)) / pairs
    return max(share, SETTINGS.inference.part) if share < 1.0 else math.inf


def _size_probability(
    errors: Sequence[FloatArray], variance: float, noise: float, parameters: float, reference: ReferenceSmoother | None
) -> float:
    """Return the probability of a variance at least as large as `variance`, if the residuals were noise."""
    from scipy import special

    if reference is None:
        free = max(sum(map(len, errors)) - parameters, 1.0)
        return float(special.chdtrc(free, free * variance / noise**2)) if noise > 0.0 else 0.0
    if not reference.noise > 0.0:
        return 0.0
    lengths = [len(series) for series in errors]
    return variance_ratio_tail(variance / reference.noise**2, lengths, parameters, reference.span, reference.degree)


def _correlations(errors: Sequence[FloatArray], square: float, parameters: float) -> tuple[list[float], list[float]]:
    """Return the correlation at each lag k, corrected for the effect of fitting, and the variance of this correlation
    in noise.

    H is the projection on the derivatives by p parameters, and sigma^2 is the variance of the noise. Residuals e of
    noise have E sum e_i e_(i+k) = - sigma^2 sum H_(i,i+k) over the n_k pairs of rows. This is about - sigma^2 p n_k/n,
    since the derivatives are smooth. The variance is n_k/(n (n + 2)) (Ljung & Box 1978).
    """
    rows = sum(len(series) for series in errors)
    correlations, variances = [], []
    for lag in range(1, _count_lags(rows, parameters) + 1):
        pairs = sum(max(len(series) - lag, 0) for series in errors)
        if pairs:
            product = float(sum(series[:-lag] @ series[lag:] for series in errors if len(series) > lag))
            correlations.append(product / square + parameters * pairs / rows**2)
            variances.append(pairs / (rows * (rows + 2)))
    return correlations, variances


def clip_outliers(residuals: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the residuals, clipped at a multiple (`REACH`) of their median absolute value."""
    limit = REACH * float(np.median(np.abs(np.concatenate(list(residuals)))))
    return [np.clip(series, -limit, limit) for series in residuals]
