"""Ensembles of paths of a fitted process, and its stationary density compared with the measured density.

`simulate_ensemble` starts all paths in the first measured state; `simulate_stationary_density` starts them in measured
states and simulates until the density no longer changes.

Doubtful: one ensemble, from one initial state, does not test the law; it is only an illustration. A wrong law can have
the same stationary density as the right law.
"""

from typing import Final

import numpy as np

from atoll_coordinator.data.increments import Steps
from atoll_coordinator.data.recording import ProcessRecording
from atoll_coordinator.model.thinning import curve, spread_places
from atoll_coordinator.process_steps.paths import PATHS, Ensemble, Simulator, density_of, histograms, settled_paths
from atoll_coordinator.result.findings import Density, PathEnsemble
from atoll_core.data.dataset import FloatArray

_STEPS: Final = 500
"""Most steps of a simulated ensemble."""
_MOST_POINTS: Final = 101
"""Most times of an ensemble in a result."""


def simulate_ensemble(simulator: Simulator, process: ProcessRecording) -> PathEnsemble | None:
    """Return an ensemble of paths. They have the initial state, the times and the inputs of the first trajectory.

    The result is None if fewer than half of the paths are finite to the end. Times are the times in the user's file.
    """
    path = next(path for path in process.paths if not path.held_out)
    rows = min(len(path.times), _STEPS + 1)
    inputs = 0.5 * (path.inputs[:, 1:rows] + path.inputs[:, : rows - 1])
    starts = np.repeat(path.states[:, :1], PATHS, axis=1)
    paths = simulator.paths(starts, inputs, path.times[1:rows] - path.times[: rows - 1])
    ensemble = Ensemble(process.states, path.times[:rows], paths.transpose(2, 0, 1))
    if len(ensemble.finite) < PATHS // 2:
        return None
    listed = spread_places(len(ensemble.t), _MOST_POINTS)

    def curves(values: FloatArray) -> dict[str, tuple[float | None, ...]]:
        return {state: curve(values[listed, index]) for index, state in enumerate(ensemble.states)}

    return PathEnsemble(
        trajectory=path.name,
        paths=len(ensemble.x),
        finite_paths=len(ensemble.finite),
        times=curve(ensemble.t[listed] + process.offset, digits=12),
        mean=curves(ensemble.mean),
        lower=curves(ensemble.lower),
        median=curves(ensemble.median),
        upper=curves(ensemble.upper),
    )


def simulate_stationary_density(
    simulator: Simulator, process: ProcessRecording, steps: Steps
) -> dict[str, Density] | None:
    """Return the stationary density of paths from measured states, and the measured density, by state.

    The result is None if the paths do not become stationary, or if there are inputs. `overlap` is the integral of the
    smaller of the two densities.
    """
    if process.inputs:
        return None
    measured_states = steps.points[: len(process.states)]
    chosen = simulator.random.integers(0, measured_states.shape[1], PATHS)
    paths = settled_paths(simulator, measured_states[:, chosen], np.zeros(0), float(np.median(steps.lengths)))
    if paths is None:
        return None
    density = density_of(process.states, paths, measured_states)
    measured = histograms(measured_states, density.edges)
    overlap = (np.minimum(density.density, measured) * np.diff(density.edges, axis=1)).sum(axis=1)
    return {
        state: Density(
            mean=float(density.mean[index]),
            sd=float(density.sd[index]),
            overlap=float(overlap[index]),
            edges=curve(density.edges[index]),
            density=curve(density.density[index]),
            measured=curve(measured[index]),
        )
        for index, state in enumerate(density.states)
    }
