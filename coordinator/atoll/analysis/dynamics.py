"""Compare the motion of the model with the data: bounds, period, amplitudes, phases, and the attractor it reaches.

The model is simulated from the initial state of each measured trajectory, over the same time. Letters: D states, n
rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from atoll.analysis.basins import UNDECIDED, Attractor, destinations
from atoll.analysis.flow import UNBOUNDED, Box, Flow, follow
from atoll.model.arguments import InputFunctions, input_curves
from atoll.model.simulation import Inputs
from atoll.model.vector_field import VectorField
from atoll_coordinator.data.differentiation.inputs import InputCurve
from atoll_coordinator.result.listed_trajectories import Simulated
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray

ROWS: Final = 2000
"""Number of rows of a simulation that is compared with a measured trajectory."""

_FEWEST_GAPS: Final = 2
"""Smallest number of intervals between upward crossings of the mean for a period; their spread needs two."""

_ORBIT_DURATIONS: Final = 8.0
"""Duration of the simulation that finds the period of a closed orbit, in durations of the measured trajectory. If the
trajectory is half a turn, the simulation has four turns."""

_LARGEST_SPREAD: Final = 0.2
"""Largest standard deviation of these intervals, as a share of their mean, in a regular oscillation: twice `_EQUAL`."""

_EQUAL: Final = 0.1
"""Relative difference up to which periods and amplitudes count as equal."""


@dataclass(frozen=True, eq=False)
class MeasuredTrajectory:
    """A measured trajectory: `times` (n,) from 0 and `states` (n, D).

    `inputs` is a function of these times that returns the recorded inputs (U,); None if they are not known.
    """

    name: str
    times: FloatArray = field(repr=False)
    states: FloatArray = field(repr=False)
    inputs: Inputs | None = None


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion along a trajectory: `amplitudes` (D,) are half the ranges of the states in its second half.

    `period` is the median time between upward crossings of the mean. `phases` (D,) are the delays of the states
    relative to the first state, as shares of a period. Both are None if the trajectory does not oscillate regularly.
    """

    amplitudes: FloatArray
    period: float | None
    phases: FloatArray | None


@dataclass(frozen=True, eq=False)
class TrajectoryComparison:
    """The model compared with one measured trajectory; `reaches` is the index of an attractor or a code of `basins`.

    `orbit_period` is the period of the closed orbit that the model follows, if closed orbits are not isolated. `end`
    (D,) is the last state of the simulation that determines the attractor.
    """

    name: str
    is_bounded: bool
    measured: Motion
    simulated: Motion
    reaches: int
    orbit_period: float | None = None
    end: FloatArray | None = None

    @property
    def has_same_period(self) -> bool | None:
        """Whether the periods agree to 10 %; None if neither the data nor the model has a period."""
        first, second = self.measured.period, self.simulated.period
        if first is None and second is None:
            return None
        return first is not None and second is not None and abs(second / first - 1.0) <= _EQUAL

    @property
    def has_same_amplitudes(self) -> bool:
        """Whether the amplitudes of all states agree to 10 % of the larger amplitude."""
        first, second = self.measured.amplitudes, self.simulated.amplitudes
        with np.errstate(invalid="ignore"):
            return bool((np.abs(second - first) <= _EQUAL * np.maximum(first, second)).all())

    @property
    def has_same_phases(self) -> bool | None:
        """Whether the phases of all states agree to a tenth of a period; None if the data or the model have none."""
        first, second = self.measured.phases, self.simulated.phases
        if first is None or second is None:
            return None
        differences = (second - first + 0.5) % 1.0 - 0.5
        return bool((np.abs(differences) <= _EQUAL).all())


def measured_trajectories(result: Result, field: VectorField) -> tuple[MeasuredTrajectory, ...]:
    """Return the trajectories of a result: smoothed measurements if there are any, otherwise fitted simulations.

    For equations of second order, velocities are finite differences of the positions.
    """
    known = (_read_trajectory(result, field, part) for part in result.simulated)
    return tuple(trajectory for trajectory in known if trajectory is not None)


def _read_trajectory(result: Result, field: VectorField, part: Simulated) -> MeasuredTrajectory | None:
    """Return one trajectory; None if a state is unknown or fewer than 4 rows are known."""
    columns, half = [result.columns_by_symbol[name] for name in field.states], len(field.states) // 2
    known, values = part.times, part.values or {}
    smoothed = next((other for other in result.smoothed if other.name == part.name), None)
    if smoothed is not None and all(name in smoothed.smoothed for name in columns if name in values):
        known, values = smoothed.times, smoothed.smoothed
    times = np.array(known, dtype=np.float64)
    if len(times) <= 3:
        return None
    curves: list[FloatArray] = []
    for index, column in enumerate(columns):
        if column in values:
            curves.append(np.array(values[column], dtype=np.float64))
        elif index >= half > 0 and columns[index - half] in values:
            curves.append(np.gradient(np.array(values[columns[index - half]], dtype=np.float64), times))
        else:
            return None
    states = np.array(curves).T
    start = [(part.start or {}).get(name) for name in columns]
    if None not in start:  # the fitted initial state includes velocities
        states[0] = start
    rows = np.isfinite(states).all(axis=1)
    if rows.sum() <= 3:
        return None
    begin = float(times[rows][0])
    inputs = _recorded_inputs(result, field, part.name, begin)
    return MeasuredTrajectory(part.name, times[rows] - begin, states[rows], inputs)


def _recorded_inputs(result: Result, field: VectorField, name: str, begin: float) -> Inputs | None:
    """Return the inputs recorded along a trajectory, from `begin` on; None if an input was not recorded."""
    recorded = next((part for part in result.recorded if part.name == name), None)
    if recorded is None or not field.inputs:
        return None
    symbols, time = result.symbols, result.columns.time or ""
    curves = input_curves(result, recorded)
    times = np.array(recorded.times, dtype=np.float64)
    if time in symbols:
        curves |= {symbols[time]: InputCurve(times, times, np.ones(len(times)))}
    if not all(symbol in curves for symbol in field.inputs):
        return None
    return InputFunctions([replace(curves[symbol], times=curves[symbol].times - begin) for symbol in field.inputs])


def compare(
    flow: Flow,
    box: Box,
    attractors: Sequence[Attractor],
    trajectories: Sequence[MeasuredTrajectory],
    duration: float,
    *,
    has_family: bool,
) -> tuple[TrajectoryComparison, ...]:
    """Compare the model with each measured trajectory.

    A model with inputs is simulated with the recorded inputs; a trajectory without recorded inputs is left out. The
    attractor is found by a second simulation over `duration`, at the constant inputs of `flow`. `has_family`: there are
    closed orbits that are not isolated.
    """
    trajectories = [trajectory for trajectory in trajectories if not flow.field.inputs or trajectory.inputs is not None]
    if not trajectories:
        return ()
    starts = np.array([trajectory.states[0] for trajectory in trajectories])
    reached, ends = destinations(flow, box, attractors, starts, duration)
    comparisons = []
    for trajectory, reaches, end in zip(trajectories, reached.tolist(), ends, strict=True):
        times = np.union1d(np.linspace(0.0, trajectory.times[-1], ROWS), trajectory.times)
        states = _simulate(flow, trajectory, times, box)
        with np.errstate(invalid="ignore"):
            is_bounded = bool((box.excursions(states) < UNBOUNDED).all())
        known = np.isfinite(states).all(axis=1)
        at_rows = known & np.isin(times, trajectory.times)
        # amplitudes are compared at the measured times, which may be few or uneven
        amplitudes = motion(times[at_rows], states[at_rows]).amplitudes
        simulated = replace(motion(times[known], states[known]), amplitudes=amplitudes)
        orbit = None
        if has_family and reaches == UNDECIDED:
            longer = np.linspace(0.0, _ORBIT_DURATIONS * trajectory.times[-1], ROWS)
            states = follow(flow.rates, trajectory.states[0], longer, box.widths)
            orbit = motion(longer, states).period if np.isfinite(states).all() else None
        measured = motion(trajectory.times, trajectory.states)
        comparisons.append(TrajectoryComparison(trajectory.name, is_bounded, measured, simulated, reaches, orbit, end))
    return tuple(comparisons)


def _simulate(flow: Flow, trajectory: MeasuredTrajectory, times: FloatArray, box: Box) -> FloatArray:
    """Return the simulated states (n, D) from the initial state of a trajectory, with its recorded inputs if any."""
    recorded = trajectory.inputs
    if recorded is None:
        return follow(flow.rates, trajectory.states[0], times, box.widths)

    def rates(x: FloatArray) -> FloatArray:  # the last state is the time
        return np.append(flow.field.values(x[:-1], recorded(float(x[-1])), flow.parameters), 1.0)

    sizes = np.append(box.widths, times[-1])
    return follow(rates, np.append(trajectory.states[0], 0.0), times, sizes)[:, :-1]


def motion(times: FloatArray, states: FloatArray) -> Motion:
    """Return amplitudes, period and phases of the states (n, D) at ascending times (n,).

    Phases are the phases of the Fourier component with this period.
    """
    if len(times) < 4:
        return Motion(np.full(states.shape[1], np.nan), None, None)
    late = states[times >= 0.5 * (times[0] + times[-1])]
    amplitudes = 0.5 * (late.max(axis=0) - late.min(axis=0))
    extents = 0.5 * (states.max(axis=0) - states.min(axis=0))
    leading = int(np.argmax(amplitudes / np.maximum(extents, 1e-300)))
    period = _period(times, states[:, leading])
    if period is None:
        return Motion(amplitudes, None, None)
    rows = times >= times[-1] - period * np.floor((times[-1] - times[0]) / period)
    whole, wave = states[rows], np.exp(-2j * np.pi * times[rows] / period)
    components = ((whole - whole.mean(axis=0)) * (wave * np.gradient(times[rows]))[:, None]).sum(axis=0)
    phases = (np.angle(components[0]) - np.angle(components)) / (2.0 * np.pi) % 1.0
    return Motion(amplitudes, period, np.asarray(phases))


def _period(times: FloatArray, values: FloatArray) -> float | None:
    """Return the median time between upward crossings of the mean by `values` (n,); None if irregular or too few.

    A crossing counts only if the values were well below the mean before it.
    """
    mean, spread = float(values.mean()), 0.3 * float(values.std())
    rises, is_low = [], False
    for row in range(1, len(values)):
        is_low = is_low or values[row - 1] < mean - spread
        if is_low and values[row] >= mean > values[row - 1]:
            share = (mean - values[row - 1]) / (values[row] - values[row - 1])
            rises.append(times[row - 1] + share * (times[row] - times[row - 1]))
            is_low = False
    gaps = np.diff(rises)
    if len(gaps) < _FEWEST_GAPS or gaps.std() > _LARGEST_SPREAD * gaps.mean():
        return None
    return float(np.median(gaps))
