"""Tail probabilities of quadratic forms in normal errors, to compare two sums of squares of the same errors. Pure.

`variance_ratio_tail` compares the residual variance of a model with the noise that loess estimates from the same rows.
Both variances are quadratic forms in the same errors, so their ratio has no F distribution.
`probability_of_positive_sum` computes the tail probability from the eigenvalues of a weighted difference of both forms.

Doubtful: errors must be normal and independent. The derivatives by the parameters are assumed to be smooth: they are
combinations of the eigenvectors of B with the smallest eigenvalues. The saddlepoint approximation has relative errors
of a few percent.

Letters: n rows, p fitted parameters; S is the matrix (n, n) of loess: S y are the smoothed values for measured values
y. B is (I - S)'(I - S): y'B y is the sum of squared residuals of loess.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np

from atoll_coordinator.model.loess_matrix import loess_matrix
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

_REPRESENTED: Final = 8
"""If there are more trajectories than this, their lengths are represented by this number of lengths. Eigenvalues hardly
depend on the length."""
_MOST_BINS: Final = 6 * SETTINGS.smoothing.bins
"""Most bins of a trajectory whose eigenvalues are computed; a longer trajectory is represented by a part."""


def variance_ratio_tail(ratio: float, lengths: Sequence[int], parameters: float, span: int, degree: int) -> float:
    """Return the probability that two variances have at least this ratio if the model is right. Both are computed from
    the same errors e.

    The numerator is the residual variance of a model with p parameters, e'(I - H)e/(n - p), with the projection H on
    the derivatives by the parameters. The denominator is the residual variance of loess, e'Be/tr B. The derivatives are
    smooth, so H removes the p smallest eigenvalues of B. Let the errors have coordinates z along the eigenvectors of B.
    The ratio exceeds r if the sum of w z^2 over the other eigenvalues b is positive, with the weights w = 1/(n - p) - r
    b/tr B. Compare Cleveland & Devlin (1988), section 4: they match two moments instead.

    Args:
        ratio: r, the ratio of the two variances.
        lengths: number of rows of each trajectory.
        parameters: p.
        span: rows in one window of loess.
        degree: the degree of its polynomials.
    """
    values, counts = _residual_eigenvalues(tuple(sorted(lengths)), span, degree)
    trace = float(values @ counts)
    free = max(float(counts.sum()) - parameters, 1.0)
    left = np.clip(np.cumsum(counts) - parameters, 0.0, counts)
    return probability_of_positive_sum(1.0 / free - ratio * values / trace, left) if trace > 0.0 else 0.0


def probability_of_positive_sum(weights: FloatArray, counts: FloatArray) -> float:
    """Return the probability that the sum of w z^2 is positive, with standard normal z; `counts` are the multiplicities
    of the weights w.

    This is the saddlepoint approximation of Lugannani & Rice (1980), as used by Kuonen (1999). The relative error of
    the approximation is a few hundredths at most, also for very small probabilities.
    """
    from scipy import special

    kept = (counts > 0.0) & (weights != 0.0)
    weights, counts = weights[kept] / max(float(np.abs(weights[kept]).max(initial=0.0)), 1e-300), counts[kept]
    if not (weights > 0.0).any():
        return 0.0
    if not (weights < 0.0).any():
        return 1.0
    point = _saddlepoint(weights, counts)
    rest = 1.0 - 2.0 * point * weights
    second = float((counts * 2.0 * (weights / rest) ** 2).sum())
    if abs(point) * math.sqrt(second) < 1e-4:
        third = float((counts * 8.0 * (weights / rest) ** 3).sum())
        return 0.5 - third / (6.0 * math.sqrt(2.0 * math.pi * second**3))
    depth = math.copysign(math.sqrt(max(float((counts * np.log(rest)).sum()), 1e-300)), point)
    height = point * math.sqrt(second)
    return float(special.ndtr(-depth - math.log(height / depth) / depth))


def _saddlepoint(weights: FloatArray, counts: FloatArray) -> float:
    """Return the point at which the derivative of the cumulant generating function is zero, by bisection."""
    low, high = 0.5 / float(weights.min()), 0.5 / float(weights.max())
    for _ in range(100):
        middle = 0.5 * (low + high)
        if float((counts * weights / (1.0 - 2.0 * middle * weights)).sum()) > 0.0:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


@lru_cache(maxsize=64)
def _residual_eigenvalues(lengths: tuple[int, ...], span: int, degree: int) -> tuple[FloatArray, FloatArray]:
    """Return the eigenvalues of B for all trajectories together, in rising order, and how often each occurs.

    If there are many trajectories, some of their lengths represent all. A part represents a long trajectory.
    """
    values, counts = [], []
    for group in np.array_split(np.array(lengths), min(len(lengths), _REPRESENTED)):
        rows = int(group[len(group) // 2])
        eigenvalues, times = _eigenvalues(rows, span, degree)
        values.append(eigenvalues)
        counts.append(times * (float(group.sum()) / rows))
    joined, numbers = np.concatenate(values), np.concatenate(counts)
    order = np.argsort(joined, kind="stable")
    return joined[order], numbers[order]


def _eigenvalues(rows: int, span: int, degree: int) -> tuple[FloatArray, FloatArray]:
    """Return the eigenvalues of B for one trajectory of evenly spaced rows, and how often each occurs.

    If the span is wide, bins of several rows are smoothed. Differences within bins remain in the residuals: their
    eigenvalues are one. If there are too many bins for the matrix, a part of the trajectory is used.
    """
    degree = min(degree, rows - 2)
    if degree < 0:
        return np.ones(1), np.array([float(rows)])
    thinning = max(1, min(span, rows) // SETTINGS.smoothing.bins)
    bins = rows // thinning
    taken = min(bins, max(_MOST_BINS, 2 * (span // thinning)))
    rest = np.eye(taken) - loess_matrix(taken, max(span // thinning, degree + 2), degree)
    values = np.maximum(np.linalg.eigvalsh(rest.T @ rest), 0.0)
    return np.append(values, 1.0), np.append(np.full(taken, bins / taken), float(rows - bins))
