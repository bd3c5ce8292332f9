"""The equations of a result as systems that can be fitted, with all their constants free.

Letters: P fitted constants, G segments, D states.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from atoll.experiments.measured import Measured, starts_of
from atoll.model.equations import program_of
from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting, fit_in_stages
from atoll_coordinator.model.shooting.system import System, system_of, variable_program
from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit, bounded_covariance
from atoll_coordinator.result.equations import Equation
from atoll_coordinator.result.result import Result
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import AtollError
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.unit_coefficients import ExplicitCoefficients, as_written, make_coefficients_explicit

_FINEST: Final = 1e-9
_COARSEST: Final = 1e-5
_TOLERANCE_OF_NOISE: Final = 1e-3
"""Errors of a step of the integration over those of the measurements: below what a deviance shows."""


@dataclass(frozen=True)
class Constant:
    """A constant that is fitted.

    `name` is that of `atoll.Model.params` (c1, c2, …), of a factor of one that nobody writes `1 of` its term;
    `variable` is the state whose equation it stands in, `sign` whether the text has a minus before it, and `is_written`
    whether it is in the text.
    """

    name: str
    variable: str
    sign: float
    is_written: bool


@dataclass(frozen=True, eq=False)
class Equations:
    """Right-hand sides of the states that have an equation: `programs` over `names`, the symbols of the result.

    `explicit` are the same with factors of one as constants, unless they are taken as they are written; `fixed` are
    those (by index) whose constants are given, `bounds` are on all constants of an equation (by index), where the user
    has set some.
    """

    names: tuple[str, ...]
    variables: tuple[str, ...]
    programs: tuple[Program, ...]
    fixed: frozenset[int]
    bounds: Mapping[int, tuple[tuple[float, float], ...]]
    are_as_written: bool = False

    @cached_property
    def explicit(self) -> tuple[ExplicitCoefficients, ...]:
        """The programs with their factors of one as constants, but those that are given or bounded."""
        kept = range(len(self.programs)) if self.are_as_written else {*self.fixed, *self.bounds}
        return tuple(
            as_written(program) if place in kept else make_coefficients_explicit(program)
            for place, program in enumerate(self.programs)
        )

    def exchanged(self, place: int, program: Program) -> "Equations":
        """Return the same with another equation, which has no bounds."""
        bounds = {index: pairs for index, pairs in self.bounds.items() if index != place}
        programs = (*self.programs[:place], program, *self.programs[place + 1 :])
        return replace(self, programs=programs, bounds=bounds, are_as_written=False)

    def system(self, measurements: Measurements, order: int) -> System:
        """Return the system of the explicit programs; with order 2, positions change by the velocities."""
        programs = [explicit.program for explicit in self.explicit]
        count = len(programs) if order == 2 else 0
        velocities = measurements.variables[count : 2 * count]
        leading = [variable_program(self.names.index(name)) for name in velocities]
        fixed = [set[int]() for _ in range(count + len(programs))]
        for place in self.fixed:
            fixed[count + place].update(constant_places(programs[place]))
        system = system_of([*leading, *programs], self.names, measurements.variables, fixed)
        if not self.bounds:
            return system
        ends = [
            (-math.inf, math.inf) if place not in self.bounds else self.bounds[place][number]
            for place, explicit in enumerate(self.explicit)
            for number in range(len(explicit.origins) if place not in self.fixed else 0)
        ]
        lower, upper = np.array(ends).reshape(-1, 2).T.copy()
        return replace(system, lower=lower, upper=upper)


def equations_of(result: Result) -> Equations:
    """Return the equations that a result shows."""
    names, entries = result.names, result.equations
    programs = tuple(program_of(equation, names) for equation in entries)
    fixed = frozenset(place for place, equation in enumerate(entries) if equation.origin == "known")
    ends = {place: _bounds(equation) for place, equation in enumerate(entries)}
    bounds = {place: pairs for place, pairs in ends.items() if pairs and place not in fixed}
    return Equations(names, tuple(equation.variable for equation in entries), programs, fixed, bounds)


def _bounds(equation: Equation) -> tuple[tuple[float, float], ...]:
    """Return the bounds of all constants of an equation; none where no constant has any."""
    ends = [constant.bounds or (None, None) for constant in equation.constants]
    if not any(end is not None for pair in ends for end in pair):
        return ()
    return tuple((-math.inf if low is None else low, math.inf if high is None else high) for low, high in ends)


def constants_of(equations: Equations, result: Result) -> tuple[Constant, ...]:
    """Return the fitted constants in the order of the system; names are those of the text of the result's equations."""
    constants: list[Constant] = []
    taken = 0
    for place, (variable, explicit) in enumerate(zip(equations.variables, equations.explicit, strict=True)):
        program = equations.programs[place]
        values = program.constants[constant_places(program)].tolist()
        text = from_infix(result.equations[place].expression or "", equations.names)
        shown = text.constants[constant_places(text)].tolist()
        numbers = _matched(values, shown)
        terms = iter(explicit.terms)
        for origin in explicit.origins if place not in equations.fixed else ():
            if origin is None:
                of = to_infix(next(terms), equations.names, digits=4)
                constants.append(Constant(f"1 of {of} (d{variable})", variable, 1.0, False))
                continue
            number = numbers[origin]
            name = f"c{taken + number + 1}" if number is not None else f"{values[origin]:.4g} (d{variable})"
            sign = 1.0 if number is None or values[origin] * shown[number] >= 0.0 else -1.0
            constants.append(Constant(name, variable, sign, True))
        taken += len(shown)
    return tuple(constants)


def _matched(values: Sequence[float], shown: Sequence[float]) -> list[int | None]:
    """Return for each constant of a program its place in the text, as `atoll.model.parameters` numbers them."""
    left = list(range(len(values)))
    numbers: list[int | None] = [None] * len(values)
    for number, value in enumerate(shown):
        place = next((index for index in left if abs(values[index]) == abs(value)), None)
        if place is not None:
            numbers[place] = number
            left.remove(place)
    return numbers


@dataclass(frozen=True, eq=False)
class Fitted:
    """Equations fitted to measured trajectories in whole, or in pieces of at most `piece` rows.

    `errors` are those of the measurements by the residuals, corrected for the numbers fitted; they are held from now
    on. `degrees_of_freedom` are those that are left, `misfit` is minus the log-likelihood with fitted variances,
    up to a constant. Rows count as `share` (O,) of a row each, as errors go together.
    """

    equations: Equations
    measured: Measured
    fit: TrajectoryFit
    errors: ErrorModel
    degrees_of_freedom: float
    misfit: float

    @property
    def values(self) -> FloatArray:
        """The fitted constants (P,)."""
        return self.fit.system.values

    @cached_property
    def bounded_covariance(self) -> FloatArray:
        """The covariance (P, P) of the constants, with large variances of those that the data leave open."""
        return bounded_covariance(self.fit)

    def deviance(self, fit: TrajectoryFit) -> float:
        """Return the squared residuals of a fit with these errors over their variances, beyond those of this fit."""
        return self.fit.estimator.cost(fit) - self.fit.estimator.cost(self.fit)

    def again(self, system: System, starts: FloatArray) -> TrajectoryFit | None:
        """Return a system fitted to the same trajectories with the same errors; None where it cannot be simulated."""
        steps, is_stiff = SETTINGS.effort.steps, self.fit.is_stiff
        return self.fit.estimator.fit(system, None, steps, starts, self.errors, is_stiff=is_stiff)


def fit_equations(measured: Measured, equations: Equations, starts: FloatArray | None = None) -> Fitted | None:
    """Return the equations fitted with all their constants free; None where they cannot be simulated.

    Where trajectories cannot be fitted in whole, shorter pieces are, of which the errors are those of the smoother.
    """
    written = replace(equations, are_as_written=True)
    return _fitted(measured, equations, starts) or _fitted(measured, written, starts)


def fit_shown(measured: Measured, result: Result) -> Fitted:
    """Return the equations of a result fitted again; raises AtollError where they cannot be simulated.

    In shorter pieces where whole trajectories leave more than the noise.
    """
    equations, measurements = equations_of(result), measured.measurements
    negligible = SETTINGS.common.negligible * measurements.scales[measurements.observed]
    most = SETTINGS.inference.excess * np.maximum(measurements.noise, negligible)
    first = None
    for rows in (None, *reversed(SETTINGS.shooting.lengths[1:])):
        if rows is not None and 2 * rows > measured.longest:
            continue
        data = measured if rows is None else measured.shortened(rows)
        fitted = fit_equations(data, equations, starts_of(result, data))
        if fitted is not None and np.all(fitted.errors.sigmas <= most):
            return fitted
        first = first or fitted
    if first is None:
        raise AtollError("the equations cannot be simulated along the measured trajectories, so nothing can be fitted")
    return first


def _fitted(measured: Measured, equations: Equations, starts: FloatArray | None) -> Fitted | None:
    measurements = measured.measurements
    precise = _TOLERANCE_OF_NOISE * float(measurements.relative_noise.min())
    estimator = MultipleShooting(measurements, min(max(precise, _FINEST), _COARSEST * 0.1))
    system = equations.system(measurements, measured.recording.order)
    fit = estimator.fit(system, None, SETTINGS.effort.steps, starts)
    staged = fit_in_stages(estimator, system, (*SETTINGS.shooting.lengths[1:2], None), SETTINGS.effort.steps)
    fits = [candidate for candidate in (fit, staged) if candidate is not None]
    counts = measurements.weights.sum(axis=1)
    best = min(fits, key=lambda fit: float(counts @ np.log(np.maximum(fit.squares, 1e-300))), default=None)
    if best is None:
        return None
    decided = float(np.minimum(counts * measured.share, measured.independent).sum())
    left = max(counts.sum() - best.system.values.size - best.starts.size, 1.0)
    degrees_of_freedom = max(decided - best.system.values.size - best.starts.size, 1.0)
    # with all rows that decide, and as many numbers fitted, the variance of a row that a fit counts
    widened = np.sqrt(counts.sum() / left / measured.share)
    least = SETTINGS.interpolation.smallest_noise * measurements.scales[measurements.observed]
    sigmas = np.maximum(np.sqrt(best.squares), least) * widened
    errors = replace(best.errors, sigmas=sigmas, is_known=True)
    held = estimator.fit(best.system, None, SETTINGS.effort.steps, best.starts, errors, is_stiff=best.is_stiff)
    if held is None:
        return None
    return Fitted(equations, measured, held, errors, degrees_of_freedom, _misfit(measured, best))


def _misfit(measured: Measured, fit: TrajectoryFit) -> float:
    """Return n/2 ln s, summed over the measured states: n independent rows of mean square s."""
    floor = (SETTINGS.shooting.exact * measured.measurements.scales[measured.measurements.observed]) ** 2
    terms = 0.5 * measured.independent * np.log(np.maximum(fit.squares, floor))
    return math.fsum(terms.tolist())
