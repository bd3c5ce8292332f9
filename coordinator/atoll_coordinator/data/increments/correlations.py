"""Which states have noises that go together: a test on signs, over all pairs at once. Pure.

While a step lasts, the drift carries the noise of one state into the other, and what bins leave of the drift is common
to both. Neither is left by differences of the path that are high enough: weights w of its increments whose sum is zero
leave of what is carried, J B h^2 (sum w)^2 / 2, nothing, and of smooth motion next to nothing. In windows without a
step in common, the product p of two states' differences has either sign, one as likely as the other, where their
noises are not correlated. Whatever sizes it has, the sum of p over the root of the sum of its squares then has mean
zero and variance one (Efron 1969), and is normal of many windows. Letters: M bins of windows.
"""

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Final

import numpy as np

from atoll_coordinator.data.increments.bins import Rows, total
from atoll_coordinator.data.increments.roughness import is_driven
from atoll_coordinator.data.increments.steps import Steps, separate_windows
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

Pair = tuple[int, int]
_STEPS: Final = 3
"""Steps of a window: the fewest whose difference leaves little of the drift of a step as long as processes allow."""
_TESTS: Final = 2
"""Tests of each pair: of a correlation over all steps, and of such that have turns of either sign."""
_DOUBLED: Final = 1.28
"""By what the square of a normal limit grows where its probability, 0.0027 or less, is halved (1.25 to 1.28)."""


def correlated_pairs(steps: Steps, bins: Sequence[Rows]) -> list[Pair]:
    """Return the pairs of states with noise of their own whose noises are correlated, over all or by turns in bins.

    All tests together see a correlation where there is none as often as one test by `ProcessSettings.significant` does
    (Bonferroni).
    """
    rough = [state for state in range(len(steps.increments)) if not is_driven(steps, state)]
    pairs = [*combinations(rough, 2)]
    doublings = (_TESTS * len(pairs) - 1).bit_length()
    limit = math.sqrt(SETTINGS.process.significant**2 + _DOUBLED * doublings)
    windows = separate_windows(steps, _STEPS)
    places = [np.flatnonzero(np.isin(windows.first, rows)) for rows in bins]
    differences = {state: windows.differences(state) for state in rough}
    return [(i, j) for i, j in pairs if max(correlation_scores(differences[i] * differences[j], places)) > limit]


def correlation_scores(products: FloatArray, bins: Sequence[Rows]) -> tuple[float, float]:
    """Return the scores of both tests for products (W,) in bins: about normal where signs are independent.

    The second, a sum over bins that is about chi-square, is made normal by its cube root (Wilson & Hilferty 1931).
    """
    sums = [total(products[rows]) for rows in bins]
    squares = [total(products[rows] * products[rows]) for rows in bins]
    variance = math.fsum(squares)
    if not variance > 0.0:
        return 0.0, 0.0
    parts = [bin_sum * bin_sum / square for bin_sum, square in zip(sums, squares, strict=True) if square > 0.0]
    spread = 2.0 / (9.0 * len(parts))
    local = (_cube_root(math.fsum(parts) / len(parts)) - (1.0 - spread)) / math.sqrt(spread)
    return abs(math.fsum(sums)) / math.sqrt(variance), local


def _cube_root(value: float) -> float:
    """Return the root by Newton's iteration, the same bits on every machine."""
    root = max(value, 1.0)
    for _ in range(64):
        root -= (root - value / (root * root)) / 3.0
    return root
