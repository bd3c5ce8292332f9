"""The protocol of the Common Task Framework for the Lorenz system (arXiv 2510.23166): pairs, shapes and scores.

A pair has train sets and one prediction. A forecast has 1,000 rows after the last given row; a reconstruction has the
rows of the train set, without their noise. Rows are 0.05 apart and have the states x, y, z. Letters: N rows.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray

STEP: Final = 0.05
STATES: Final = ("x", "y", "z")
FORECAST: Final = 1_000
_SHORT, _LONG, _BINS, _WORST = 20, 500, 41, -100.0


@dataclass(frozen=True)
class Pair:
    """A prediction of the contest: the names of its train sets, and its scores; a forecast continues the last set."""

    number: int
    train: tuple[str, ...]
    scores: tuple[str, ...]

    @property
    def is_forecast(self) -> bool:
        """Whether the prediction begins after the last given row."""
        return self.scores != ("reconstruction",)


PAIRS: Final = (
    Pair(1, ("X1",), ("short", "long")),
    Pair(2, ("X2",), ("reconstruction",)),
    Pair(3, ("X2",), ("long",)),
    Pair(4, ("X3",), ("reconstruction",)),
    Pair(5, ("X3",), ("long",)),
    Pair(6, ("X4",), ("short", "long")),
    Pair(7, ("X5",), ("short", "long")),
    Pair(8, ("X6", "X7", "X8", "X9"), ("short",)),
    Pair(9, ("X6", "X7", "X8", "X10"), ("short",)),
)
"""X2, X3 and X5 have noise. X4, X5, X9 and X10 have 100 rows. X6 to X10 have different values of one parameter."""


def short_score(truth: FloatArray, predicted: FloatArray) -> float:
    """Return the score of the first 20 rows of a forecast."""
    return reconstruction_score(truth[:_SHORT], predicted[:_SHORT])


def reconstruction_score(truth: FloatArray, predicted: FloatArray) -> float:
    """Return 100 (1 - relative error), by spectral norms, at least -100; values that are not finite score -100."""
    if not np.isfinite(predicted).all():
        return _WORST
    error = np.linalg.norm(truth - predicted, ord=2) / np.linalg.norm(truth, ord=2)
    return _clipped(float(error))


def long_score(truth: FloatArray, predicted: FloatArray) -> float:
    """Return the score of the histograms of the last 500 rows: the mean of the states, at least -100."""
    if not np.isfinite(predicted[-_LONG:]).all():
        return _WORST
    errors = []
    for true, own in zip(truth[-_LONG:].T, predicted[-_LONG:].T, strict=True):
        ends = float(min(true.min(), own.min())), float(max(true.max(), own.max()))
        counts = [np.histogram(values, _BINS, ends)[0] for values in (true, own)]
        errors.append(float(np.abs(counts[0] - counts[1]).sum() / counts[0].sum()))
    return _clipped(float(np.mean(errors)))


SCORES: Final[Mapping[str, Callable[[FloatArray, FloatArray], float]]] = {
    "short": short_score,
    "long": long_score,
    "reconstruction": reconstruction_score,
}


def _clipped(error: float) -> float:
    return max(100.0 * (1.0 - error), _WORST)


def noise_of(rows: FloatArray) -> float:
    """Return the standard deviation of independent errors of smooth rows (N, 3), from sixth differences.

    The sixth difference of independent errors of variance 1 has the variance 924, the sum of squared binomials.
    """
    return float(np.sqrt(np.mean(np.diff(rows, 6, axis=0) ** 2) / 924.0))
