"""Robust loess: rows far from the curve, outliers, lose their weight (Cleveland 1979, section 2). Pure.

Unlike there, span and degree are chosen anew with every set of weights, since outliers make the wide spans look good.
Medians are taken by sorting.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.differentiation.noise import NORMAL_DEVIATION
from atoll_coordinator.data.differentiation.smoothing import (
    Signal,
    SmoothedSignal,
    Smoother,
    select_smoother,
    smooth,
)
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

LIMITS = SETTINGS.robustness


@dataclass(frozen=True, eq=False)
class RobustFit:
    """Signals with robustness weights, the smoother selected with them, and the median residual they are based on."""

    signals: tuple[Signal, ...]
    smoother: Smoother
    median: float

    @property
    def outliers(self) -> int:
        """How many measured rows have no weight."""
        return sum(signal.measured.weights.tolist().count(0.0) for signal in self.signals)


def fit_robustly(signals: Sequence[Signal], degrees: Sequence[int]) -> RobustFit:
    """Return `signals` with low robustness weights in rows far from the curve, 0 in outliers."""
    fit = RobustFit(tuple(signals), select_smoother(signals, degrees), 0.0)
    least = SETTINGS.common.clean * moments(np.concatenate([signal.measured.values for signal in signals]))[1]
    for _ in range(LIMITS.rounds):
        residuals = _residuals(fit.signals, [smooth(signal, fit.smoother) for signal in fit.signals])
        median = max(_median(residuals, signals), least)
        if not median > 0.0:
            break
        weighted = tuple(_weigh(signal, part, median) for signal, part in zip(signals, residuals, strict=True))
        before, fit = fit.outliers, RobustFit(weighted, select_smoother(weighted, degrees), median)
        if fit.outliers == before:
            break
    return fit


def weigh_by(fit: RobustFit, signal: Signal) -> Signal:
    """Return another signal with the robustness weights that smoother and median residual of `fit` give its rows.

    There are outliers in `fit`, so that its median residual is not zero.
    """
    for _ in range(LIMITS.rounds):
        (residuals,) = _residuals([signal], [smooth(signal, fit.smoother)])
        signal = _weigh(signal, residuals, fit.median)
    return signal


def has_heavy_tails(signals: Sequence[Signal], smoothed: Sequence[SmoothedSignal]) -> bool:
    """Say whether some rows lie so far from the curve, and so alone, that they cannot be noise like the others'."""
    residuals = _residuals(signals, smoothed)
    limit = LIMITS.reach * NORMAL_DEVIATION * _median(residuals, signals)
    count = sum(_count_isolated(np.abs(part).tolist(), limit) for part in residuals)
    return limit > 0.0 and count >= max(LIMITS.fewest, sum(len(part) for part in residuals) / LIMITS.rows_per_outlier)


def _count_isolated(sizes: list[float], limit: float) -> int:
    """Return how many of `sizes` exceed `limit` and are at least twice those beside them."""
    padded = [0.0, *sizes, 0.0]
    return sum(
        size > limit and max(before, after) <= LIMITS.isolated * size
        for before, size, after in zip(padded, sizes, padded[2:], strict=False)
    )


def _residuals(signals: Sequence[Signal], smoothed: Sequence[SmoothedSignal]) -> list[FloatArray]:
    """Return measured minus smoothed values, over the standard deviation that a row of this inverse variance has.

    They are 0 where the value is missing.
    """
    return [
        (signal.values - fit.fits[0]) * signal.measured_rows * np.sqrt(signal.filled_inverse_variances)
        for signal, fit in zip(signals, smoothed, strict=True)
    ]


def _median(residuals: Sequence[FloatArray], signals: Sequence[Signal]) -> float:
    """Return the median size of the residuals of what was measured."""
    measured = [part[signal.measured_rows] for part, signal in zip(residuals, signals, strict=True)]
    ordered = np.sort(np.abs(np.concatenate(measured)))
    return float(ordered[len(ordered) // 2])


def _weigh(signal: Signal, residuals: FloatArray, median: float) -> Signal:
    """Return `signal` with bisquare weights (Cleveland 1979, section 2)."""
    shares = residuals / (LIMITS.reach * median)
    rest = np.maximum(1.0 - shares * shares, 0.0)
    return replace(signal, robustness_weights=rest * rest)
