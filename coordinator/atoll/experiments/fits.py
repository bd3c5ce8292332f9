"""Fit the equations of a result again, with all constants free, to its trajectories or to data files.

A result may list only some of its measured rows. Fits use the listed rows, and errors take all rows into account. The
measurement errors are estimated from the residuals of the first fit and are constant in all later fits. Therefore the
deviances of later fits are comparable. Equations are fitted to whole trajectories. If the residuals exceed the noise,
they are fitted to shorter pieces. A coefficient of 1 that the text does not show is a free constant too.

Doubtful: pieces hide errors that grow over long times. Correlated errors enter only as a smaller number of independent
rows.

Letters: O measured states, P fitted constants, G segments, D states.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, get_args

import numpy as np

from atoll.model.core import config_of
from atoll.model.equations import differing_groups, match_constants, numbers_of
from atoll.model.given_sides import GivenSides
from atoll_coordinator.data.recording import Method, Recording, StateSmoothing, Trajectory
from atoll_coordinator.data.trajectories.measurements import format_number
from atoll_coordinator.model.shooting.composed_system import composed_system
from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit, bounded_covariance
from atoll_coordinator.model.shooting.many_starts import fit_from_many_starts
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements, measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting, fit_in_stages
from atoll_coordinator.model.shooting.system import OdeSystem, variable_program
from atoll_coordinator.model.template.hidden_states import initial_values
from atoll_coordinator.result.base import Curve
from atoll_coordinator.result.equations import Constant, Equation
from atoll_coordinator.result.findings import Errors, Noise
from atoll_coordinator.result.listed_trajectories import Recorded, Smoothed
from atoll_coordinator.result.result import Result
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import AtollError, UsageError
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.template import ConstantSource, written_sources
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.unit_coefficients import ExplicitCoefficients, as_written, make_coefficients_explicit

_FEWEST_ROWS: Final = 5
_OTHER_KINDS: Final = {"regression": "a regression without time", "process": "a stochastic process"}


@dataclass(frozen=True, eq=False)
class FitData:
    """Measured trajectories for fits of a result: `measurements` of the states with an equation (`modelled`, indices).

    `rows` counts all measured rows; `measurements` may have only some of them, spread evenly. `independent` (O,) is the
    effective number of rows of each state, because errors may be correlated. `source` names the data in words.
    """

    recording: Recording
    measurements: TrajectoryMeasurements
    modelled: Sequence[int]
    rows: int
    independent: FloatArray
    source: str

    @property
    def observed(self) -> list[int]:
        """The measured columns (indices) that are computed from states."""
        return [self.recording.states.index(name) for name in self.recording.observed]

    @property
    def share(self) -> FloatArray:
        """The number of independent rows divided by the number of rows in a fit, (O,)."""
        return np.asarray(self.independent / np.maximum(self.measurements.weights.sum(axis=1), 1.0))

    @property
    def longest(self) -> int:
        """The largest number of rows that are simulated from one initial state."""
        return int(np.diff(self.measurements.bounds, axis=1).max())

    def with_piece(self, piece: int) -> "FitData":
        """Return the same trajectories, with at most `piece` rows simulated from one initial state.

        With hidden states, trajectories are always whole: the initial values of later pieces would not be known.
        """
        if self.measurements.hidden:
            return self
        measurements = measurements_of(self.recording, self.modelled, piece=piece, observed=self.observed)
        return replace(self, measurements=measurements)


def columns_of(recording: Recording, equations: Sequence[str]) -> tuple[str, ...]:
    """Return the measured columns (O) of a system with these equations: states, then columns computed from states."""
    return (*(name for name in equations if name not in recording.hidden), *recording.observed)


def measured_of(result: Result, table: Table | None = None) -> FitData:
    """Return the measurements of a result, or the measurements in `table`, which is read with the settings of the job.

    Raises:
        UsageError: the states were not measured over time, or the result has no measurements.
        DataError: the data have an error.
    """
    kind = result.columns.kind
    if kind != "dynamics":
        name = _OTHER_KINDS.get(str(kind), "a model of an unknown kind")
        raise UsageError(f"the result is {name}; only models of measured trajectories can be fitted again")
    if config_of(result).data.observe and not result.observations:
        raise UsageError(
            "the result has no fitted observation, because its equations were not refined; run the job again "
            "with more time"
        )
    recording = _listed_recording(result) if table is None else _prepare_recording(result, table)
    if recording.hidden:
        recording = replace(_with_simulated_course(recording, result), initial=initial_values(config_of(result)))
    rows = kept = sum(len(trajectory.times) for trajectory in recording.trajectories if not trajectory.held_out)
    source = "the given data"
    if table is None:
        searched = [part for part in result.recorded if not part.held_out]
        rows = sum(part.rows or len(part.times) for part in searched)
        of = f"{kept} of {rows} rows" if kept < rows else f"{rows} rows"
        source = f"{len(searched)} {'trajectories' if len(searched) > 1 else 'trajectory'} of the result, {of}"
    groups = {trajectory.group for trajectory in recording.trajectories}
    if differing_groups(result) and (table is None or len(groups) > 1):
        raise UsageError(
            "the constants of the model differ between groups of trajectories, so they cannot be fitted together",
            python="give the data of one group as data",
            command="give the data of one group with --data",
        )
    names = [str(equation.variable) for equation in result.equations]
    modelled = [recording.states.index(name) for name in names]
    errors = [result.noise.get(name, Noise()).errors or Errors() for name in columns_of(recording, names)]
    share = kept / max(rows, 1)
    pieces = [known.piece for known in errors if known.piece]
    piece = max(_FEWEST_ROWS, int(min(pieces) * share)) if pieces else SETTINGS.shooting.piece
    if recording.hidden:
        piece = max(len(trajectory.times) for trajectory in recording.trajectories)
    observed = [recording.states.index(name) for name in recording.observed]
    measurements = measurements_of(recording, modelled, piece=piece, observed=observed)
    independent = measurements.weights.sum(axis=1)
    if table is None:  # measured rows that the result does not list count as well
        independent = independent / max(share, 1e-300)
    fitted = sum(part.rows or 0 for part in result.recorded if not part.held_out)
    ratios = [min(1.0, (known.independent_rows or fitted) / fitted) if fitted else 1.0 for known in errors]
    independent = independent * np.array(ratios)
    return FitData(recording, measurements, modelled, rows, independent, source)


@dataclass(frozen=True)
class EncodedData:
    """A result as JSON and, if data were given, a table as bytes: from these, workers repeat the fits."""

    result: str
    table: bytes | None

    @classmethod
    def of(cls, result: Result, table: Table | None) -> "EncodedData":
        """Return what is sent to workers."""
        return cls(result.to_json(), None if table is None else table.to_bytes())

    def decode(self) -> tuple[Result, Table | None]:
        """Return the result and the table."""
        return Result.of(json.loads(self.result)), None if self.table is None else Table.from_bytes(self.table)


def _listed_recording(result: Result) -> Recording:
    if not result.recorded:
        raise UsageError(
            "the result has no measurements", python="give them as data", command="give the data file with --data"
        )
    columns, symbols = result.columns, result.symbols
    states, inputs = (*columns.states, *result.unmeasured), columns.inputs
    smoothing = []
    for name in states:
        noise = result.noise.get(name, Noise())
        method: Method = next((method for method in get_args(Method) if method == noise.method), "interpolation")
        method = "hidden" if name in result.by_run else method
        smoothing.append(StateSmoothing(name, method, noise.sd or 0.0, noise.relative or 0.0))
    smoothed = {part.name: part for part in result.smoothed}
    return Recording(
        states,
        tuple(symbols.get(name, name) for name in states),
        tuple(symbols[name] for name in columns.velocities),
        inputs,
        tuple(symbols[name] for name in inputs),
        2 if columns.order == 2 else 1,
        0.0,
        tuple(smoothing),
        tuple(_trajectory(part, smoothed.get(part.name), states, inputs) for part in result.recorded),
        tuple(config_of(result).data.offsets),
        hidden=result.unmeasured,
        observed=tuple(one.column for one in result.observations),
    )


def _with_simulated_course(recording: Recording, result: Result) -> Recording:
    """Return the recording with the simulations of a result as the smoothed values of its hidden states."""
    simulated, parts = {part.name: part for part in result.simulated}, list[Trajectory]()
    for part in recording.trajectories:
        smoothed, slopes, found = part.smoothed.copy(), part.slopes.copy(), simulated.get(part.name)
        for name in recording.hidden if found is not None else ():
            assert found is not None
            values = np.array((found.values or {}).get(name, ()), dtype=np.float64)
            if not len(values) or not np.isfinite(values).all():
                continue
            place, times = recording.states.index(name), np.array(found.times, dtype=np.float64)
            smoothed[place] = np.interp(part.times + recording.offset, times, values)
            slopes[place] = np.gradient(smoothed[place], part.times) if len(part.times) > 1 else 0.0
        parts.append(replace(part, smoothed=smoothed, slopes=slopes))
    return replace(recording, trajectories=tuple(parts))


def _trajectory(
    recorded: Recorded, smoothed: Smoothed | None, states: Sequence[str], inputs: Sequence[str]
) -> Trajectory:
    times = np.array(recorded.times, dtype=np.float64)
    unknown = (None,) * len(times)  # a hidden state has no measured values
    measured = _stack([recorded.measured.get(name, unknown) for name in states], len(times))
    curves = [_curve(times, row, name, smoothed) for name, row in zip(states, measured, strict=True)]
    positions = _stack(curves, len(times))
    robust, weights = recorded.robustness_weights, recorded.weights
    return Trajectory(
        recorded.name,
        times,
        measured,
        positions,
        np.gradient(positions, times, axis=1) if len(times) > 1 else np.zeros_like(positions),
        _stack([recorded.inputs[name] for name in inputs], len(times)),
        _stack([(recorded.input_slopes or {})[name] for name in inputs], len(times)),
        recorded.held_out,
        None if robust is None else _stack([robust.get(name, (1.0,) * len(times)) for name in states], len(times)),
        None if weights is None else np.array(weights, dtype=np.float64),
    )


def _curve(times: FloatArray, measured: FloatArray, name: str, smoothed: Smoothed | None) -> FloatArray:
    """Return the smoothed state at `times` (n,); without smoothing, the interpolated measured values."""
    if smoothed is not None and name in smoothed.smoothed:
        known, values = np.array(smoothed.times), np.array(smoothed.smoothed[name], dtype=np.float64)
    else:
        known, values = times, measured
    is_known = np.isfinite(values)
    return np.interp(times, known[is_known], values[is_known]) if is_known.any() else np.zeros(len(times))


def _stack(rows: Sequence[FloatArray | Curve], count: int) -> FloatArray:
    return np.ascontiguousarray(np.array(rows, dtype=np.float64).reshape(len(rows), count))


def starts_of(result: Result, measured: FitData) -> FloatArray | None:
    """Return the initial states (G, D) that the result has; None if segments are not whole trajectories."""
    known = {part.name: part.start for part in result.simulated}
    measurements, columns = measured.measurements, result.columns_by_symbol
    rows = [known.get(measurements.names[owner]) for owner in measurements.owners.tolist()]
    names = [columns[name] for name in measurements.variables[: len(measurements.scales)]]
    is_whole = len(set(measurements.owners.tolist())) == len(rows)
    if not is_whole or not all(row and all(name in row for name in names) for row in rows):
        return None
    starts = np.array([[row[name] for name in names] for row in rows if row], dtype=np.float64)
    return starts if np.isfinite(starts).all() else None


def _prepare_recording(result: Result, table: Table) -> Recording:
    """Return the recording of a table, read and smoothed with the settings of the job.

    If the result belongs to one group, the recording has only the trajectories of this group.
    """
    from atoll_coordinator.data.prepare import prepare

    config, group = config_of(result), result.group
    column = config.data.group
    if group is not None:
        table = table if column is None else _rows_of_group(table, column, group, config.data.trajectory)
        settings = config.data.model_copy(update={"group": None, "per_trajectory": False})
        config = config.model_copy(update={"data": settings})
    recording = prepare(table, config).recording
    if recording is None or set(recording.states) != {*result.columns.states, *result.unmeasured}:
        raise UsageError(f"the data must have measurements of {', '.join(result.columns.states)} over time")
    return recording if group is None or column is not None else _trajectory_of_group(recording, group)


def _rows_of_group(table: Table, column: str, group: str, trajectory: str | None) -> Table:
    """Return the rows of one group, without the `column` of groups, unless the column also separates trajectories."""
    if column not in table.names:
        raise UsageError(
            f"the data have no column {column!r}, which marks the rows of group {group!r}; add this column"
        )
    values = table.column(column)
    names = {value: table.label(column, value) or format_number(value) for value in dict.fromkeys(values.tolist())}
    rows = np.flatnonzero([names[value] == group for value in values.tolist()])
    if not len(rows):
        raise _missing_group(group, list(names.values()))
    begins = np.diff(rows, prepend=-2) > 1
    begins |= np.isin(rows, table.starts)
    kept = [place for place, name in enumerate(table.names) if name != column or name == trajectory]
    return replace(
        table,
        names=tuple(table.names[place] for place in kept),
        units=tuple(table.units[place] for place in kept),
        columns=np.ascontiguousarray(table.columns[kept][:, rows]),
        starts=tuple(np.flatnonzero(begins).tolist()),
        file_of_row=table.file_of_row[rows],
        line_of_row=table.line_of_row[rows],
    )


def _trajectory_of_group(recording: Recording, group: str) -> Recording:
    """Return the trajectory of the group; a single trajectory is returned unchanged."""
    names = [trajectory.name for trajectory in recording.trajectories]
    if len(names) == 1:
        return recording
    if group not in names:
        raise _missing_group(group, names)
    return replace(recording, trajectories=(recording.trajectories[names.index(group)],))


def _missing_group(group: str, names: Sequence[str]) -> UsageError:
    found = f"the data have no rows of group {group!r}, only of {', '.join(names)}"
    return UsageError(f"{found}; give the data of group {group!r}")


_FINEST: Final = 1e-9
_COARSEST: Final = 1e-5
_TOLERANCE_OF_NOISE: Final = 1e-3
"""Ratio of the integration error of a step to the measurement error: too small to change a deviance."""


@dataclass(frozen=True)
class FreeConstant:
    """A constant that is fitted.

    `name` is its name in `atoll.Model.params` (c1, c2, …, or the name of a parameter). The name of an unwritten
    coefficient is `1 of` and its term. `variable` is the state of its equation. `sign` is -1 if the text has a minus
    before it. `is_written`: the text shows it.
    """

    name: str
    variable: str
    sign: float
    is_written: bool


@dataclass(frozen=True, eq=False)
class EquationSet:
    """Right-hand sides of the states with an equation, and which of their numbers are fitted.

    The `programs` of `given` are the searched ones: whole right-hand sides or, for sides that the user gave, unknown
    parts. `explicit` are the same programs with unwritten coefficients of 1 as constants, unless `are_as_written`. The
    constants of `fixed` equations (by index) are not fitted. `bounds` has, by index of an equation, the user's bounds
    (lower, upper) on all constants of its program. Numbers of the user's text are not fitted, and a parameter, or a
    constant of an unknown part, is one number in all sides.
    """

    given: GivenSides
    fixed: frozenset[int]
    bounds: Mapping[int, tuple[tuple[float, float], ...]]
    are_as_written: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """The variables of the programs: the symbols of the result."""
        return self.given.template.names

    @property
    def variables(self) -> tuple[str, ...]:
        """The states with an equation."""
        return self.given.equations

    @property
    def programs(self) -> tuple[Program, ...]:
        """The searched programs."""
        return self.given.slots

    @cached_property
    def explicit(self) -> tuple[ExplicitCoefficients, ...]:
        """The programs with unwritten coefficients of 1 as constants; fixed and bounded programs are unchanged, and
        sides in which nothing is searched."""
        every = range(len(self.programs))
        kept = {*self.fixed, *self.bounds, *(place for place in every if not self.is_searched(place))}
        kept = {*every} if self.are_as_written else kept
        return tuple(
            as_written(program) if place in kept else make_coefficients_explicit(program)
            for place, program in enumerate(self.programs)
        )

    def is_searched(self, place: int) -> bool:
        """Tell whether the program of an equation was searched: the side is not given without an unknown part."""
        return not self.given.template.is_given(self.variables[place])

    @cached_property
    def whole(self) -> GivenSides:
        """The right-hand sides that are fitted, with unwritten coefficients of 1 as constants."""
        return self.given.with_slots([one.program for one in self.explicit])

    def with_equation(self, place: int, program: Program) -> "EquationSet":
        """Return the same set with another equation at index `place`, which has no bounds, and is not a given side."""
        if not self.given.is_given(place):
            return self.with_searched(place, program)
        return replace(self._without_bounds(place), given=self.given.without_side(place, program))

    def with_searched(self, place: int, program: Program) -> "EquationSet":
        """Return the same set with another searched program at index `place`, which has no bounds."""
        given = self.given.with_slots((*self.programs[:place], program, *self.programs[place + 1 :]))
        return replace(self._without_bounds(place), given=given)

    def _without_bounds(self, place: int) -> "EquationSet":
        bounds = {index: pairs for index, pairs in self.bounds.items() if index != place}
        return replace(self, bounds=bounds, are_as_written=False)

    def system(self, measurements: TrajectoryMeasurements, order: int) -> OdeSystem:
        """Return the system of the explicit programs; for order 2, the rates of the positions are the velocities."""
        count, whole = len(self.programs) if order == 2 else 0, self.whole
        velocities = measurements.variables[count : 2 * count]
        leading = [variable_program(self.names.index(name)) for name in velocities]
        nodes = [constant_places(explicit.program) for explicit in self.explicit]
        bounds = {
            there: self.bounds[home][number]
            for home in self.bounds
            for number, node in enumerate(nodes[home])
            for there in whole.composition.places[home].get(node, ())
        }
        fixed = [own if place in self.fixed else () for place, own in enumerate(nodes)]
        system = composed_system(
            whole.template, whole.composition, self.names, measurements.variables, leading, fixed, bounds
        )
        return system if whole.template.sides else replace(system, is_logarithmic=None)


def equations_of(result: Result) -> EquationSet:
    """Return the displayed equations of a result."""
    entries, given = result.equations, GivenSides.of(result)
    fixed = frozenset(
        place for place, equation in enumerate(entries) if equation.origin == "known" and not given.is_given(place)
    )
    ends = {place: _bounds(_searched_constants(equation, place, given)) for place, equation in enumerate(entries)}
    return EquationSet(given, fixed, {place: pairs for place, pairs in ends.items() if pairs and place not in fixed})


def _searched_constants(equation: Equation, place: int, given: GivenSides) -> list[Constant]:
    """Return the constants of the program that was searched for an equation."""
    if not given.is_given(place):
        return [*equation.constants]
    sources = zip(equation.constants, given.composition.sources(place), strict=True)
    return [constant for constant, source in sources if source.home == place]


def _bounds(constants: Sequence[Constant]) -> tuple[tuple[float, float], ...]:
    ends = [constant.bounds or (None, None) for constant in constants]
    if not any(end is not None for pair in ends for end in pair):
        return ()
    return tuple((-math.inf if low is None else low, math.inf if high is None else high) for low, high in ends)


def constants_of(equations: EquationSet, result: Result) -> tuple[FreeConstant, ...]:
    """Return the fitted constants in the order of the system, with the names in the texts of the result."""
    names, whole = _names_in_texts(equations, result), equations.whole
    constants: dict[ConstantSource, FreeConstant] = {}
    for place, variable in enumerate((*equations.variables, *whole.observations)):
        sources = whole.composition.sources(place)
        for index, written in written_sources(sources, equations.explicit) if place not in equations.fixed else ():
            source = sources[index]
            if source.home is None:
                name = whole.template.parameters[source.parameter or 0].name
                constants.setdefault(source, FreeConstant(name, variable, 1.0, True))
                continue
            home, explicit = equations.variables[source.home], equations.explicit[source.home]
            if written is None:
                term = explicit.terms[explicit.origins[: source.number].count(None)]
                name = f"1 of {to_infix(term, equations.names, digits=4)} (d{home})"
                constants[source] = FreeConstant(name, home, 1.0, False)
            else:
                constants[source] = FreeConstant(names[written][0], home, names[written][1], True)
    return tuple(constants.values())


def _names_in_texts(equations: EquationSet, result: Result) -> dict[ConstantSource, tuple[str, float]]:
    """Return the names of the constants of searched programs as they are written, and their signs in the texts."""
    names: dict[ConstantSource, tuple[str, float]] = {}
    for place, (variable, listed) in enumerate(numbers_of(result).items()):
        if variable in equations.given.template.sides:
            sources = equations.given.composition.sources(place)
            names |= {source: (number.name, 1.0) for source, number in zip(sources, listed, strict=True)}
            continue
        program = equations.programs[place]
        values = program.constants[constant_places(program)].tolist()
        for number, written in enumerate(match_constants(values, [one.value for one in listed])):
            value, shown = values[number], None if written is None else listed[written]
            name = f"{value:.4g} (d{variable})" if shown is None else shown.name
            sign = -1.0 if shown is not None and value * shown.value < 0.0 else 1.0
            names[ConstantSource(None, place, number)] = name, sign
    return names


@dataclass(frozen=True, eq=False)
class EquationSetFit:
    """Equations fitted to whole measured trajectories, or to pieces of them.

    `errors` are the measurement errors, estimated from the residuals and corrected for the number of fitted values;
    later fits use the same errors. `degrees_of_freedom` are the independent rows minus the number of fitted values.
    `misfit` is minus the log-likelihood with fitted variances, up to a constant, in nats.
    """

    equations: EquationSet
    measured: FitData
    fit: TrajectoryFit
    errors: ErrorModel
    degrees_of_freedom: float
    misfit: float

    @property
    def values(self) -> FloatArray:
        """The fitted constants (P,)."""
        return self.fit.system.values

    def texts(self, result: Result) -> dict[str, str]:
        """Return the fitted right-hand sides with rounded constants, by the left-hand sides of a result."""
        names, given, system = self.equations.names, self.equations.given, self.fit.system
        count = len(system.outputs)
        programs = system.programs[count - len(self.equations.programs) : count]
        texts = {
            equation.lhs: to_infix(program, names, digits=4, is_given=given.is_given(place))
            for place, (equation, program) in enumerate(zip(result.equations, programs, strict=True))
        }
        return texts | {
            column: to_infix(program, names, digits=4, is_given=True)
            for column, program in zip(given.observations, system.programs[count:], strict=True)
        }

    @property
    def fitted_starts(self) -> int:
        """The number of fitted initial values and offsets; given initial values are not fitted."""
        return _count_fitted_starts(self.fit)

    @cached_property
    def bounded_covariance(self) -> FloatArray:
        """The covariance (P, P) of the constants; constants that the data do not determine have large variances."""
        return bounded_covariance(self.fit)

    @cached_property
    def root(self) -> FloatArray:
        """A square root (P, P) of the covariance of the constants, which have a prior standard error of 100 %."""
        sizes = np.abs(self.values)
        sizes = np.maximum(sizes, 1e-12 * max(float(sizes.max(initial=0.0)), 1e-280))
        unit = np.nan_to_num(self.fit.reduced) * np.outer(sizes, sizes) + np.eye(len(sizes))
        known, directions = eigenaxes(unit, 1.0)
        return np.asarray(sizes[:, None] * directions / np.sqrt(known))

    def deviance(self, fit: TrajectoryFit) -> float:
        """Return the sum of squared residuals over the variances of `errors`, minus the same sum of this fit."""
        return self.fit.estimator.cost(fit) - self.fit.estimator.cost(self.fit)

    def deviance_of(self, residuals: FloatArray) -> float:
        """Return `deviance` of residuals (O, N)."""
        return self.deviance(replace(self.fit, residuals=residuals))

    def refit(self, system: OdeSystem, starts: FloatArray) -> TrajectoryFit | None:
        """Fit a system to the same trajectories with the same errors; None if it cannot be simulated.

        `starts` (G, D) are the initial states at which the fit begins.
        """
        steps, is_stiff = SETTINGS.effort.steps, self.fit.is_stiff
        return self.fit.estimator.fit(system, None, steps, starts, self.errors, is_stiff=is_stiff)


def eigenaxes(matrix: FloatArray, least: float) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues (n,), at least `least`, and eigenvectors (n, n) of a symmetric matrix (n, n).

    An inverse is not accurate enough, because information about constants can span many orders of magnitude.
    """
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.maximum(values, least), np.asarray(vectors)


def fit_equations(measured: FitData, equations: EquationSet, starts: FloatArray | None = None) -> EquationSetFit | None:
    """Fit the equations with all their constants free; None if they cannot be simulated.

    If the fit with unwritten coefficients of 1 as constants fails, the equations are fitted as written.
    """
    written = replace(equations, are_as_written=True)
    return _fit(measured, equations, starts) or _fit(measured, written, starts)


def fit_displayed(measured: FitData, result: Result) -> EquationSetFit:
    """Fit the equations of a result again; raises AtollError if they cannot be simulated.

    If the residuals of whole trajectories exceed the noise, the equations are fitted to shorter pieces.
    """
    equations, most = equations_of(result), most_residuals(measured.measurements)
    first = None
    for rows in (None, *reversed(SETTINGS.shooting.lengths[1:])):
        if rows is not None and 2 * rows > measured.longest:
            continue
        data = measured if rows is None else measured.with_piece(rows)
        fitted = fit_equations(data, equations, starts_of(result, data))
        if fitted is not None and np.all(fitted.errors.sigmas <= most):
            return fitted
        first = first or fitted
    if first is None:
        raise AtollError("the equations cannot be simulated along the measured trajectories, so they cannot be fitted")
    return first


def most_residuals(measurements: TrajectoryMeasurements) -> FloatArray:
    """Return the largest root mean squared residuals (O,) that count as noise."""
    negligible = SETTINGS.common.negligible * measurements.observed_scales
    return np.asarray(SETTINGS.inference.excess * np.maximum(measurements.noise, negligible))


def _fit(measured: FitData, equations: EquationSet, starts: FloatArray | None) -> EquationSetFit | None:
    measurements = measured.measurements
    precise = _TOLERANCE_OF_NOISE * float(measurements.relative_noise.min())
    estimator = MultipleShooting(measurements, min(max(precise, _FINEST), _COARSEST * 0.1))
    system = equations.system(measurements, measured.recording.order)
    if measurements.hidden and starts is None:
        found = fit_from_many_starts(estimator, system.with_fixed_constants())
        if found is None:
            return None
        starts, estimator = found.fit.starts, found.fit.estimator
        measurements = estimator.measurements  # with the sizes of the hidden states
        measured = replace(measured, measurements=measurements)
    fit = estimator.fit(system, None, SETTINGS.effort.steps, starts)
    # short segments in the middle of a trajectory would need initial values of hidden states, which are not known
    lengths = (None,) if measurements.hidden else (*SETTINGS.shooting.lengths[1:2], None)
    staged = fit_in_stages(estimator, system, lengths, SETTINGS.effort.steps)
    fits = [candidate for candidate in (fit, staged) if candidate is not None]
    counts = measurements.weights.sum(axis=1)
    best = min(fits, key=lambda fit: float(counts @ np.log(np.maximum(fit.squares, 1e-300))), default=None)
    if best is None:
        return None
    decided = float(np.minimum(counts * measured.share, measured.independent).sum())
    fitted = best.system.values.size + _count_fitted_starts(best)
    left = max(counts.sum() - fitted, 1.0)
    degrees_of_freedom = max(decided - fitted, 1.0)
    # the variance of a row in the fit, corrected for the number of fitted values and for correlated or unlisted rows
    widened = np.sqrt(counts.sum() / left / measured.share)
    least = SETTINGS.smoothing.smallest_noise * measurements.observed_scales
    sigmas = np.maximum(np.sqrt(best.squares), least) * widened
    errors = replace(best.errors, sigmas=sigmas, is_known=True)
    held = estimator.fit(best.system, None, SETTINGS.effort.steps, best.starts, errors, is_stiff=best.is_stiff)
    if held is None:
        return None
    return EquationSetFit(equations, measured, held, errors, degrees_of_freedom, _misfit(measured, best))


def _count_fitted_starts(fit: TrajectoryFit) -> int:
    ranges = fit.estimator.measurements.start_ranges(fit.segments)
    return fit.starts.size - (0 if ranges is None else int((ranges[0] == ranges[1]).sum()))


def _misfit(measured: FitData, fit: TrajectoryFit) -> float:
    """Return n/2 ln s, summed over the measured states: n independent rows with the mean squared residual s."""
    floor = (SETTINGS.shooting.exact * measured.measurements.observed_scales) ** 2
    terms = 0.5 * measured.independent * np.log(np.maximum(fit.squares, floor))
    return math.fsum(terms.tolist())
