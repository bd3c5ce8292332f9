"""Ensembles of paths of a fitted process, and their stationary density next to the measured one."""

import numpy as np

from atoll_coordinator.data.increments.steps import Steps
from atoll_coordinator.data.recording import ProcessRecording
from atoll_coordinator.model.refinement import MeasuredDensity
from atoll_coordinator.stochastic.densities import density_of, histograms, settled_paths
from atoll_coordinator.stochastic.paths import PATHS, Ensemble, Simulator

_STEPS = 500
"""That are shown of an ensemble."""


def simulate_ensemble(simulator: Simulator, process: ProcessRecording) -> tuple[str, Ensemble | None]:
    """Return an ensemble from where the first trajectory begins, at its times and with its inputs, after its name.

    No ensemble when hardly a path has finite states to the end.
    """
    path = next(path for path in process.paths if not path.held_out)
    rows = min(len(path.times), _STEPS + 1)
    inputs = 0.5 * (path.inputs[:, 1:rows] + path.inputs[:, : rows - 1])
    starts = np.repeat(path.states[:, :1], PATHS, axis=1)
    paths = simulator.paths(starts, inputs, path.times[1:rows] - path.times[: rows - 1])
    ensemble = Ensemble(process.states, path.times[:rows], paths.transpose(2, 0, 1))
    return path.name, ensemble if len(ensemble.finite) >= PATHS // 2 else None


def settle(simulator: Simulator, process: ProcessRecording, steps: Steps) -> MeasuredDensity | None:
    """Return the density that paths from measured states settle into; None when they do not, or there are inputs."""
    if process.inputs:
        return None
    seen = steps.points[: len(process.states)]
    chosen = simulator.random.integers(0, seen.shape[1], PATHS)
    paths = settled_paths(simulator, seen[:, chosen], np.zeros(0), float(np.median(steps.lengths)))
    if paths is None:
        return None
    density = density_of(process.states, paths, seen)
    measured = histograms(seen, density.edges)
    overlap = (np.minimum(density.density, measured) * np.diff(density.edges, axis=1)).sum(axis=1)
    return MeasuredDensity(density, measured, overlap)
