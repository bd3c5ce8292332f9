"""Ensembles of paths of a fitted process, and the density that they settle into. Draws come from the job's seed.

A path goes on by normal steps with the mean and the covariance of `moments`, those that constants were fitted by.
"""

from dataclasses import dataclass

import numpy as np

from atoll.data.dataset import FloatArray
from atoll_coordinator.data.increments.steps import Steps
from atoll_coordinator.data.recording import ProcessRecording
from atoll_coordinator.model.refinement import Ensemble, StationaryDensity
from atoll_coordinator.model.stochastic.likelihood import ProcessModel
from atoll_coordinator.settings import SETTINGS

_PATHS = 256
"""Of an ensemble: means are known to a sixteenth of the spread of the paths; equations and verdicts do not use them."""
_STEPS = 500
"""That are shown of an ensemble; a density settles in as many (`_is_settled` checks it), and is taken over as many."""
_BINS = 40
"""Of a density that is shown."""


@dataclass(frozen=True, eq=False)
class Simulator:
    """Draws paths of `model`."""

    model: ProcessModel
    random: np.random.Generator

    def paths(self, starts: FloatArray, inputs: FloatArray, lengths: FloatArray) -> FloatArray:
        """Return paths (N + 1, S, P) from `starts` (S, P) over N steps; NaN from where one has no finite step.

        Args:
            starts: initial states.
            inputs: (U, N), held in each step.
            lengths: of the steps (N,).
        """
        found = [starts]
        for step, length in enumerate(lengths.tolist()):
            found.append(self._moved(found[-1], inputs[:, step], length))
        return np.array(found)

    def _moved(self, states: FloatArray, inputs: FloatArray, length: float) -> FloatArray:
        count = states.shape[1]
        points = np.concatenate([states, np.repeat(inputs[:, None], count, axis=1)])
        moments = self.model.moments(points, np.full(count, length))
        normal = self.random.standard_normal(states.shape)
        factor = np.zeros_like(moments.covariance)
        moved = states + moments.mean
        with np.errstate(all="ignore"):
            for i in range(len(states)):
                for j in range(i + 1):
                    rest = moments.covariance[i, j] - (factor[i, :j] * factor[j, :j]).sum(axis=0)
                    factor[i, j] = np.sqrt(rest) if i == j else rest / factor[j, j]
                moved[i] += (factor[i, : i + 1] * normal[: i + 1]).sum(axis=0)
        return np.where(np.isfinite(moved).all(axis=0), moved, np.nan)


def simulate_ensemble(simulator: Simulator, process: ProcessRecording) -> Ensemble | None:
    """Return an ensemble from where the first trajectory begins, at its times and with its inputs.

    None when hardly a path has finite states to the end.
    """
    path = next(each for each in process.paths if not each.held_out)
    rows = min(len(path.times), _STEPS + 1)
    inputs = 0.5 * (path.inputs[:, 1:rows] + path.inputs[:, : rows - 1])
    starts = np.repeat(path.states[:, :1], _PATHS, axis=1)
    found = simulator.paths(starts, inputs, path.times[1:rows] - path.times[: rows - 1])
    kept = found[:, :, np.isfinite(found[-1]).all(axis=0)]
    if kept.shape[2] < _PATHS // 2:
        return None
    lower, middle, upper = np.quantile(kept, (0.05, 0.5, 0.95), axis=2)
    return Ensemble(
        path.name, kept.shape[2], _PATHS, path.times[:rows], kept.mean(axis=2).T, lower.T, middle.T, upper.T
    )


def settle(simulator: Simulator, process: ProcessRecording, steps: Steps) -> StationaryDensity | None:
    """Return the density that paths from measured states settle into; None when they do not, or there are inputs.

    They have settled when the means of states and of their squares no longer change from one half to the other by more
    than chance does.
    """
    if process.inputs:
        return None
    states = len(process.states)
    chosen = simulator.random.integers(0, steps.points.shape[1], _PATHS)
    lengths = np.full(2 * _STEPS, float(np.median(steps.lengths)))
    found = simulator.paths(steps.points[:states, chosen], np.zeros((0, 2 * _STEPS)), lengths)[_STEPS + 1 :]
    kept = found[:, :, np.isfinite(found[-1]).all(axis=0)]
    if kept.shape[2] < _PATHS // 2 or not _is_settled(kept):
        return None
    edges, density, measured = [], [], []
    for state in range(states):
        its, seen = kept[:, state].ravel(), steps.points[state]
        bounds = np.linspace(min(its.min(), seen.min()), max(its.max(), seen.max()), _BINS + 1)
        edges.append(bounds)
        density.append(np.histogram(its, bounds, density=True)[0])
        measured.append(np.histogram(seen, bounds, density=True)[0])
    shapes = np.array(edges), np.array(density), np.array(measured)
    overlap = (np.minimum(shapes[1], shapes[2]) * np.diff(shapes[0], axis=1)).sum(axis=1)
    return StationaryDensity(*shapes, overlap, kept.mean(axis=(0, 2)), kept.std(axis=(0, 2)))


def _is_settled(paths: FloatArray) -> bool:
    """Tell whether two halves of paths (N, S, P) agree in the means of states and of their squares."""
    half = len(paths) // 2
    for power in (1, 2):
        moments = paths**power
        change = moments[half:].mean(axis=0) - moments[:half].mean(axis=0)
        error = change.std(axis=1) / np.sqrt(change.shape[1])
        if (np.abs(change.mean(axis=1)) > SETTINGS.process.significant * error).any():
            return False
    return True
