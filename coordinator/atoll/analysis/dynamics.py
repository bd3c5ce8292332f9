"""How the model moves beside how the data move: bounds, period, amplitudes, order of phases, and what it reaches.

The model is simulated freely from where each measured trajectory begins, and as long. Letters: D states, n rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from atoll.analysis.basins import UNDECIDED, Attractor, destinations
from atoll.analysis.flow import UNBOUNDED, Box, Flow, follow
from atoll.model.arguments import Driving, input_curves
from atoll.model.simulation import Inputs
from atoll.model.vector_field import VectorField
from atoll_coordinator.data.differentiation.inputs import InputCurve
from atoll_coordinator.result.listed_trajectories import Simulated
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray

ROWS: Final = 2000
"""Of a simulation beside a measured trajectory."""

_TURNS: Final = 3
"""Rises through the mean that make a period: two gaps, whose spread can be seen."""

_LONGER: Final = 8.0
"""How much longer than a trajectory the model is simulated to see the period of its orbit: of half a turn, four."""

_REGULAR: Final = 0.2
"""Spread of the gaps, as a share of their mean, up to which a course has one period: twice `_SAME`."""

_SAME: Final = 0.1
"""Share by which period and amplitudes may differ and still be called the same."""


@dataclass(frozen=True, eq=False)
class MeasuredTrajectory:
    """A measured trajectory: `times` (n,) from 0 and `states` (n, D).

    `inputs` are those that were recorded, (U,) as a function of these times; None where they are not known.
    """

    name: str
    times: FloatArray = field(repr=False)
    states: FloatArray = field(repr=False)
    inputs: Inputs | None = None


@dataclass(frozen=True, eq=False)
class Motion:
    """What is seen of a course: `amplitudes` (D,) are half the extents of its second half.

    `period` is the median time between rises through the mean, `phases` (D,) are the shares of a period by which each
    state comes after the first one; None where the course does not oscillate regularly.
    """

    amplitudes: FloatArray
    period: float | None
    phases: FloatArray | None


@dataclass(frozen=True, eq=False)
class TrajectoryComparison:
    """The model beside one measured trajectory; `reaches` is the index of an attractor or a code of `basins`.

    `orbit_period` is that of the closed orbit on which the model goes round, where such orbits are not isolated; `end`
    (D,) is where the model is when it has reached something, or when it is followed no longer.
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
        """Whether the periods agree to 10 %; None where neither has one."""
        first, second = self.measured.period, self.simulated.period
        if first is None and second is None:
            return None
        return first is not None and second is not None and abs(second / first - 1.0) <= _SAME

    @property
    def has_same_amplitudes(self) -> bool:
        """Whether the amplitudes of all states agree to 10 % of the largest extent of the state."""
        first, second = self.measured.amplitudes, self.simulated.amplitudes
        with np.errstate(invalid="ignore"):
            return bool((np.abs(second - first) <= _SAME * np.maximum(first, second)).all())

    @property
    def has_same_order(self) -> bool | None:
        """Whether the phases of all states agree to a tenth of a period; None where there are none to compare."""
        first, second = self.measured.phases, self.simulated.phases
        if first is None or second is None:
            return None
        apart = (second - first + 0.5) % 1.0 - 0.5
        return bool((np.abs(apart) <= _SAME).all())


def measured_trajectories(result: Result, field: VectorField) -> tuple[MeasuredTrajectory, ...]:
    """Return the measured courses that a result holds: smoothed measurements, else the simulation fitted to them.

    Velocities of equations of second order are differences of the positions.
    """
    courses = (_measured(result, field, part) for part in result.simulated)
    return tuple(course for course in courses if course is not None)


def _measured(result: Result, field: VectorField, part: Simulated) -> MeasuredTrajectory | None:
    """Return the course of one trajectory; None where a state is not known there, or too few rows are."""
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
    if None not in start:  # knows velocities, too
        states[0] = start
    rows = np.isfinite(states).all(axis=1)
    if rows.sum() <= 3:
        return None
    begin = float(times[rows][0])
    return MeasuredTrajectory(part.name, times[rows] - begin, states[rows], _recorded(result, field, part.name, begin))


def _recorded(result: Result, field: VectorField, name: str, begin: float) -> Inputs | None:
    """Return the inputs recorded along a trajectory, from `begin` on; None where one of them was not."""
    recorded = next((part for part in result.recorded if part.name == name), None)
    if recorded is None or not field.inputs:
        return None
    named, clock = result.symbols, result.columns.time or ""
    curves = input_curves(result, recorded)
    times = np.array(recorded.times, dtype=np.float64)
    if clock in named:
        curves |= {named[clock]: InputCurve(times, times, np.ones(len(times)))}
    if not all(symbol in curves for symbol in field.inputs):
        return None
    shifted = [replace(curves[symbol], times=curves[symbol].times - begin) for symbol in field.inputs]
    return Driving(shifted)


def compared(
    flow: Flow,
    box: Box,
    attractors: Sequence[Attractor],
    trajectories: Sequence[MeasuredTrajectory],
    duration: float,
    *,
    has_family: bool,
) -> tuple[TrajectoryComparison, ...]:
    """Return the model beside each measured trajectory; `duration` is how long courses have to reach an attractor.

    `has_family`: there are closed orbits that are not isolated.

    A model with inputs is driven by those that were recorded; trajectories without any are left out. What it reaches is
    with the inputs held.
    """
    trajectories = [trajectory for trajectory in trajectories if not flow.field.inputs or trajectory.inputs is not None]
    if not trajectories:
        return ()
    starts = np.array([trajectory.states[0] for trajectory in trajectories])
    reached, ends = destinations(flow, box, attractors, starts, duration)
    comparisons = []
    for trajectory, reaches, end in zip(trajectories, reached.tolist(), ends, strict=True):
        even = np.linspace(0.0, trajectory.times[-1], ROWS)
        times = np.unique(np.concatenate([even, trajectory.times]))
        course = _course(flow, trajectory, times, box)
        with np.errstate(invalid="ignore"):
            inside = box.excursions(course) < UNBOUNDED
        known = np.isfinite(course).all(axis=1)
        simulated = motion(times[known], course[known])
        beside = known & np.isin(times, trajectory.times)
        amplitudes = motion(times[beside], course[beside]).amplitudes
        orbit = _orbit_period(flow, trajectory, box) if has_family and reaches == UNDECIDED else None
        measured = motion(trajectory.times, trajectory.states)
        simulated = replace(simulated, amplitudes=amplitudes)  # over the same times: they may be few, or uneven
        comparisons.append(
            TrajectoryComparison(trajectory.name, bool(inside.all()), measured, simulated, reaches, orbit, end)
        )
    return tuple(comparisons)


def _orbit_period(flow: Flow, trajectory: MeasuredTrajectory, box: Box) -> float | None:
    """Return the period of the model from where a trajectory begins, which may be too short to show one itself."""
    times = np.linspace(0.0, _LONGER * trajectory.times[-1], ROWS)
    course = follow(flow.rates, trajectory.states[0], times, box.widths)
    return motion(times, course).period if np.isfinite(course).all() else None


def _course(flow: Flow, trajectory: MeasuredTrajectory, times: FloatArray, box: Box) -> FloatArray:
    """Return the states (n, D) from where a measured trajectory begins, driven by its inputs where it has some."""
    recorded = trajectory.inputs
    if recorded is None:
        return follow(flow.rates, trajectory.states[0], times, box.widths)

    def rates(x: FloatArray) -> FloatArray:  # the last state is the time
        return np.append(flow.field.values(x[:-1], recorded(float(x[-1])), flow.parameters), 1.0)

    sizes = np.append(box.widths, times[-1])
    return follow(rates, np.append(trajectory.states[0], 0.0), times, sizes)[:, :-1]


def motion(times: FloatArray, states: FloatArray) -> Motion:
    """Return amplitudes, period and phases of a course of n rows (n, D) at rising times (n,)."""
    if len(times) < 4:
        return Motion(np.full(states.shape[1], np.nan), None, None)
    late = states[times >= 0.5 * (times[0] + times[-1])]
    amplitudes = 0.5 * (late.max(axis=0) - late.min(axis=0))
    extents = 0.5 * (states.max(axis=0) - states.min(axis=0))
    leading = int(np.argmax(amplitudes / np.maximum(extents, 1e-300)))
    period = _period(times, states[:, leading])
    return Motion(amplitudes, period, None if period is None else _phases(times, states, period))


def _period(times: FloatArray, values: FloatArray) -> float | None:
    """Return the median time between rises through the mean, each after a fall well below; None: irregular, few."""
    mean, spread = float(values.mean()), 0.3 * float(values.std())
    rises, is_low = [], False
    for row in range(1, len(values)):
        is_low = is_low or values[row - 1] < mean - spread
        if is_low and values[row] >= mean > values[row - 1]:
            share = (mean - values[row - 1]) / (values[row] - values[row - 1])
            rises.append(times[row - 1] + share * (times[row] - times[row - 1]))
            is_low = False
    gaps = np.diff(rises)
    if len(gaps) < _TURNS - 1 or gaps.std() > _REGULAR * gaps.mean():
        return None
    return float(np.median(gaps))


def _phases(times: FloatArray, states: FloatArray, period: float) -> FloatArray:
    """Return by which share of a period each state comes after the first, from the component of that period (D,)."""
    rows = times >= times[-1] - period * np.floor((times[-1] - times[0]) / period)
    whole, wave = states[rows], np.exp(-2j * np.pi * times[rows] / period)
    steps = np.gradient(times[rows])
    components = ((whole - whole.mean(axis=0)) * (wave * steps)[:, None]).sum(axis=0)
    return np.asarray((np.angle(components[0]) - np.angle(components)) / (2.0 * np.pi) % 1.0)
