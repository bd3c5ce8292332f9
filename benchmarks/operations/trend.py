"""Whether a series of measurements rises: the slope of the least squares line, and its standard error."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

FLAT_SHARE: Final = 0.02
"""A rise over the whole series below this share of the mean is none."""

SIGNIFICANT: Final = 2.0
"""A slope within so many of its standard errors is none."""


@dataclass(frozen=True)
class Trend:
    """A line through a series: `slope` and `error` by second, `mean` of the values, `span_s` from first to last."""

    mean: float
    slope: float
    error: float
    span_s: float

    @property
    def rise(self) -> float:
        """How much the line rises from the first to the last measurement."""
        return self.slope * self.span_s

    @property
    def is_flat(self) -> bool:
        """Whether the series does not rise, as far as can be told, or too little to matter."""
        return self.slope <= SIGNIFICANT * self.error or self.rise <= FLAT_SHARE * self.mean


def trend(times_s: Sequence[float], values: Sequence[float]) -> Trend:
    """Return the least squares line through `values` at `times_s` (three at least, not all at one time).

    Neighbours may go together, which makes the error of independent ones too small: it is widened by the factor
    sqrt((1 + r) / (1 - r)), where r is the correlation of neighbouring residuals (for an autoregressive process of
    order 1; Zwiers & von Storch 1995, J. Climate 8:336).
    """
    count = len(times_s)
    middle, mean = sum(times_s) / count, sum(values) / count
    spread = sum((at - middle) ** 2 for at in times_s)
    slope = sum((at - middle) * (value - mean) for at, value in zip(times_s, values, strict=True)) / spread
    residuals = [value - mean - slope * (at - middle) for at, value in zip(times_s, values, strict=True)]
    square = sum(residual * residual for residual in residuals)
    error = math.sqrt(square / max(1, count - 2) / spread)
    if square > 0.0:
        together = sum(one * two for one, two in itertools.pairwise(residuals)) / square
        bounded = min(0.95, max(0.0, together))
        error *= math.sqrt((1.0 + bounded) / (1.0 - bounded))
    return Trend(mean, slope, error, times_s[-1] - times_s[0])
