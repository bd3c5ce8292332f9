"""Divided differences along paths, of which smooth motion leaves next to nothing and noise all. Pure.

A difference over so many steps is of that order in the rows at their ends: a sum of the increments, weighted. Letters:
N steps, W windows of neighbouring steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.increments.steps import Steps
from atoll_core.data.dataset import FloatArray


@dataclass(frozen=True, eq=False)
class Windows:
    """Runs of `count` moves that follow each other, each of `lag` steps: the `first` steps (W,) of all."""

    steps: Steps
    first: npt.NDArray[np.intp]
    count: int
    lag: int = 1

    def differences(self, state: int) -> FloatArray:
        """Return the difference of one state in each window (W,), as a share of the deviation of Brownian motion's."""
        differences, variance = np.zeros(len(self.first)), np.zeros(len(self.first))
        lengths = self._moves(self.steps.lengths)
        moves = self._moves(self.steps.increments[state])
        for weight, move, length in zip(_weights(lengths), moves, lengths, strict=True):
            differences += weight * move
            variance += weight * weight * length
        return np.asarray(differences / np.sqrt(variance))

    def _moves(self, values: FloatArray) -> list[FloatArray]:
        """Return the sums of each move's steps, (W,) for each of the moves."""
        moves = [np.zeros(len(self.first)) for _ in range(self.count)]
        for k in range(self.count * self.lag):
            moves[k // self.lag] += values[self.first + k]
        return moves


def all_windows(steps: Steps, count: int, lag: int = 1) -> Windows:
    """Return the windows that begin with any step, as far as a trajectory goes on."""
    span = count * lag
    is_within = np.ones(max(len(steps.lengths) - span + 1, 0), dtype=np.bool_)
    for k in range(1, span):
        is_within &= steps.follows[k : k + len(is_within)]
    return Windows(steps, np.flatnonzero(is_within), count, lag)


def separate_windows(steps: Steps, count: int) -> Windows:
    """Return windows that have no step in common, one after another from the beginning of each trajectory."""
    windows = all_windows(steps, count)
    begins = np.flatnonzero(~steps.follows)
    place = windows.first - begins[np.searchsorted(begins, windows.first, side="right") - 1]
    return Windows(steps, windows.first[place % count == 0], count)


def _weights(lengths: Sequence[FloatArray]) -> list[FloatArray]:
    """Return what multiplies each of the moves of these lengths in the divided difference of the rows at their ends."""
    times = [*accumulate((length / lengths[0] for length in lengths), initial=np.zeros_like(lengths[0]))]
    of_rows = []
    for i, time in enumerate(times):
        product = np.ones_like(time)
        for j, other in enumerate(times):
            product = product * (time - other) if i != j else product
        of_rows.append(1.0 / product)
    return [*accumulate(reversed(of_rows[1:]))][::-1]
