"""What a process moves from one row to the next, and differences of high order over windows of steps. Pure.

Smooth motion leaves next to nothing of a divided difference, and noise all: over so many steps it is of that order in
the rows at their ends, a sum of the increments, weighted. Letters: N steps, W windows of neighbouring steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.recording import ProcessRecording
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray


@dataclass(frozen=True, eq=False)
class Steps:
    """N steps of S states, one trajectory after another.

    `points` (V, N) are where they begin, states first, then inputs, each the mean of its values at both ends; `lengths`
    (N,) are in the unit of time, `increments` (S, N) what the states move. `follows` (N,) tells of each step whether
    the one before it ends where it begins.
    """

    points: FloatArray
    lengths: FloatArray
    increments: FloatArray
    follows: npt.NDArray[np.bool_]

    @cached_property
    def least_variances(self) -> FloatArray:
        """The variances (S,) below which what is left of a state's steps does not count as noise."""
        sizes = np.median(np.abs(self.increments), axis=1)
        return np.asarray((SETTINGS.process.least_noise * sizes) ** 2)


def take_steps(process: ProcessRecording, *, held_out: bool = False) -> Steps:
    """Return the steps of the trajectories that take part in fits, or of those that were held out."""
    states, inputs = len(process.states), len(process.inputs)
    parts = [(np.zeros((states + inputs, 0)), np.zeros(0), np.zeros((states, 0)), np.zeros(0, np.bool_))]
    for path in process.paths:
        if path.held_out is held_out:
            middles = path.inputs[:, :-1] + 0.5 * (path.inputs[:, 1:] - path.inputs[:, :-1])
            points = np.concatenate([path.states[:, :-1], middles])
            follows = np.arange(len(path.times) - 1) > 0
            parts.append((points, np.diff(path.times), np.diff(path.states), follows))
    return Steps(*(np.concatenate(columns, axis=-1) for columns in zip(*parts, strict=True)))


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
