"""Does what a model leaves of a state grow like a random walk? Then noise is part of the law. Pure.

The mean square of second differences of rows l apart is constant for errors of measurement, grows with l for a random
walk and with l^4 for what is smooth (compare variograms, Matheron 1963). An exponent between 1/2 and 5/2 is nearest to
that of a walk; a mixture of the other two passes through these values, but not over three doublings of the lag.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from atoll_coordinator.data.recording import Recording
from atoll_coordinator.model.inference.trajectory_simulation import SimulatedTrajectory
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

_LAGS: Final = (1, 2, 4, 8)


def stochastic_remarks(
    recording: Recording, states: Sequence[str] = (), simulated: Sequence[SimulatedTrajectory] = ()
) -> list[str]:
    """Return a sentence that proposes ``--stochastic``, if the residuals of states look like it.

    `states` are those that are `simulated` along the trajectories that were not held out. Without a simulation the
    measurements stand for the residuals: of a process, hardly a model can be simulated.
    """
    walking = []
    for index, state in enumerate(recording.states):
        measured = [part.measured[index] for part in recording.trajectories if not part.held_out]
        residuals = _residuals(measured, state, states, simulated) if simulated else measured
        if _walks(measured, residuals, _rounding(recording, index)):
            walking.append(state)
    if not walking:
        return []
    named = ", ".join(f"'{state}'" for state in walking)
    what = "The residuals" if simulated else "The measurements"
    return [
        f"{what} of {named} grow like a random walk, as where noise moves the system itself: with --stochastic, drift "
        "and diffusion are sought."
    ]


def _residuals(
    measured: Sequence[FloatArray], state: str, states: Sequence[str], simulated: Sequence[SimulatedTrajectory]
) -> list[FloatArray]:
    """Return measured minus simulated values of a state along each trajectory that was simulated in whole."""
    if state not in states or len(simulated) != len(measured):
        return []
    place = states.index(state)
    return [
        values - part.values[place]
        for values, part in zip(measured, simulated, strict=True)
        if part.values is not None and len(part.values[place]) == len(values)
    ]


def _rounding(recording: Recording, index: int) -> float:
    """Return the variance of what rounding left of a state; such errors stay the same from row to row, and so walk."""
    quantisation = recording.smoothing[index].quantisation if index < len(recording.smoothing) else None
    return 0.0 if quantisation is None else quantisation.error**2


def _walks(measured: Sequence[FloatArray], residuals: Sequence[FloatArray], rounding: float) -> bool:
    """Tell whether residuals grow like a walk that leaves a tenth of the state's variance behind in a trajectory.

    Not where they are no larger than errors of rounding, whose variance is given.
    """
    if residuals and float(np.nanvar(np.concatenate(residuals))) <= SETTINGS.inference.excess**2 * rounding:
        return False
    values, rows = np.concatenate(measured), max(map(len, residuals), default=0)
    if rows <= SETTINGS.process.fewest_steps:
        return False
    squares = [_mean_square(residuals, lag) for lag in _LAGS]
    variance = float(np.nanvar(values))
    if not all(0.0 < square < math.inf for square in squares) or rows * squares[0] < SETTINGS.inference.part * variance:
        return False
    exponents = [math.log2(after / before) for before, after in pairwise(squares)]
    return all(0.5 < exponent < 2.5 for exponent in exponents)


def _mean_square(residuals: Sequence[FloatArray], lag: int) -> float:
    """Return the mean square of second differences of rows so far apart, over that of one walk; NaN left out."""
    parts = [
        series[2 * lag :] - 2.0 * series[lag:-lag] + series[: -2 * lag] for series in residuals if len(series) > 2 * lag
    ]
    differences = np.concatenate(parts) / math.sqrt(2.0)
    known = differences[np.isfinite(differences)]
    return float(np.mean(known * known)) if len(known) else math.nan
