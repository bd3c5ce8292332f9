"""What a process moves from one row to the next, over all trajectories that the search may see. Pure."""

from dataclasses import dataclass
from functools import cached_property

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
