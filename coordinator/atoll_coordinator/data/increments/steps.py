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
    points, lengths, increments, follows = [], [], [], []
    for path in process.paths:
        if path.held_out is not held_out:
            continue
        inputs = path.inputs[:, :-1] + 0.5 * (path.inputs[:, 1:] - path.inputs[:, :-1])
        points.append(np.concatenate([path.states[:, :-1], inputs]))
        lengths.append(path.times[1:] - path.times[:-1])
        increments.append(path.states[:, 1:] - path.states[:, :-1])
        follows.append(np.arange(len(path.times) - 1) > 0)
    variables = len(process.states) + len(process.inputs)
    if not points:
        return Steps(np.zeros((variables, 0)), np.zeros(0), np.zeros((len(process.states), 0)), np.zeros(0, np.bool_))
    return Steps(
        np.ascontiguousarray(np.concatenate(points, axis=1)),
        np.concatenate(lengths),
        np.ascontiguousarray(np.concatenate(increments, axis=1)),
        np.concatenate(follows),
    )
