"""The right-hand sides of a model as functions of numbers, with their derivatives, and the joint errors of constants.

Values can differ from the values of the search by rounding errors, because this module uses the functions of the C
library. Sine and cosine are also defined for large arguments, for which the search has no values. Letters: D states, U
inputs, P parameters of a field, K constants with known joint covariance, N points.
"""

import itertools
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll.model.equations import Parameter, numbers_of
from atoll.model.given_sides import GivenSides, over_variables, program_of
from atoll_coordinator.result.equations import Equation
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression.derivative import derivative, with_variables
from atoll_core.expression.evaluation import NUMPY, function_of
from atoll_core.expression.operators import CONSTANT, VARIABLE, Functions
from atoll_core.expression.program import Program, constant_places, with_constants
from atoll_core.expression.text.infix import displayed_form, to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.quoting import did_you_mean

MOST_STATES: Final = 200
"""Largest number of states: the Jacobian of 200 states has 40,000 formulas."""

_TERM_DIGITS: Final = 15
"""Significant digits of constants in the names of terms."""

_VELOCITY: Final = "_dot"

_NUMBER_FUNCTIONS: Final = Functions(
    math.sin, math.cos, math.exp, math.log, math.sqrt, abs, math.tanh, math.pow,
    sign=lambda x: (x > 0.0) - (x < 0.0), base_log=lambda x, v: 0.0 if x == v == 0.0 else math.log(x),
)  # fmt: skip
_ARRAY_FUNCTIONS: Final = NUMPY._replace(sin=np.sin, cos=np.cos, power=operator.pow)


@dataclass(frozen=True, eq=False)
class VectorField:
    """dx/dt = f(x, u, p) of D states.

    `states` are the names of x in order. `inputs` are the names of u, which have no equation. `expressions` are the D
    right-hand sides as infix text. For equations of second order, the velocities are states after all positions.
    `sizes` are the D largest measured absolute values of the states: 0 where unknown, empty if all are unknown.
    `programs` are the right-hand sides over states and inputs; if empty, they are parsed from `expressions`.
    `constant_names` has the name of each constant of the programs: "" for a number that is no parameter, and equal
    names for one parameter at several places. If it is empty, all constants have the names c1, c2, ….

    The programs may also compute other `outputs` than the rates of all states: the values of columns (`columns_of`).
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    expressions: tuple[str, ...]
    sizes: tuple[float, ...] = ()
    programs: tuple[Program, ...] = field(default=(), repr=False)
    constant_names: tuple[str, ...] = field(default=(), repr=False)
    outputs: tuple[str, ...] | None = field(default=None, repr=False)
    parameters: tuple[Parameter, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        outputs = self.states if self.outputs is None else self.outputs
        if not 1 <= len(self.states) <= MOST_STATES or len(self.expressions) != len(outputs):
            counts = f"{len(self.expressions)} expressions for {len(self.states)} states"
            raise UsageError(f"there are {counts}; give one expression for each state, for 1 to {MOST_STATES} states")
        names = (*self.states, *self.inputs)
        if len(set(names)) < len(names):
            raise UsageError(f"a name occurs twice in {', '.join(names)}; give each state and input its own name")
        programs = self.programs or tuple(from_infix(text, names) for text in self.expressions)
        constants = [
            (output, value)
            for output, program in zip(outputs, programs, strict=True)
            for value in program.constants[constant_places(program)].tolist()
        ]
        called = self.constant_names or [f"c{number}" for number, _ in enumerate(constants, start=1)]
        parameters = tuple(Parameter(name, *its) for name, its in zip(called, constants, strict=True))
        object.__setattr__(self, "programs", programs)
        object.__setattr__(self, "parameters", parameters)

    @classmethod
    def of(cls, equations: Mapping[str, str], inputs: Sequence[str] = (), sizes: Sequence[float] = ()) -> "VectorField":
        """Return the field of ``{state: right-hand side}``, with these `inputs` and `sizes`; raises UsageError."""
        return cls(tuple(equations), tuple(inputs), tuple(equations.values()), tuple(sizes))

    @classmethod
    def from_result(cls, result: Result) -> "VectorField":
        """Return the field of the model of a result; for a stochastic process this is the drift.

        Variables without an equation are inputs. Raises UsageError if an equation was not found or is not differential.
        """
        symbols = result.symbols
        equations = [equation for equation in result.equations if equation.variable in symbols]
        for equation in result.equations:
            side = equation.lhs
            if side == equation.variable or "/" not in side:
                raise UsageError(f"the equation of {side} is not differential; a dynamical model needs d{side}/dt")
        missing = next((equation.lhs for equation in equations if not equation.expression), None)
        if missing is not None:
            raise UsageError(f"the result has no equation for {missing}; a model needs one for each state")
        sides = {symbols[equation.variable]: equation.expression or "" for equation in equations}
        if all(map(is_acceleration, result.equations)):
            velocities = [_velocity_of(equation.variable, symbols) for equation in equations]
            sides = dict(zip(sides, velocities, strict=True)) | dict(zip(velocities, sides.values(), strict=True))
        inputs = [name for name in symbols.values() if name not in sides]
        field, given = cls.of(sides, inputs, result.sizes(tuple(sides))), GivenSides.of(result)
        return _with_given_sides(field, given, result) if given.template.sides else field

    @property
    def named_parameters(self) -> dict[str, Parameter]:
        """The parameters by name, each once."""
        named: dict[str, Parameter] = {}
        for parameter in self.parameters:
            if parameter.name:
                named.setdefault(parameter.name, parameter)
        return named

    def with_values(self, values: Mapping[str, float]) -> "VectorField":
        """Return the field with other values of parameters, by name; raises UsageError for an unknown name."""
        named = self.named_parameters
        wrong = next((name for name in values if name not in named), None)
        if wrong is not None:
            known = ", ".join(named) or "none"
            raise UsageError(f"there is no parameter '{wrong}'; the parameters are {known}{did_you_mean(wrong, named)}")
        constants = iter([values.get(each.name, each.value) for each in self.parameters])
        programs = [
            with_constants(program, {place: next(constants) for place in constant_places(program)})
            for program in self.programs
        ]
        return replace(self, programs=tuple(programs))

    @property
    def values_of_parameters(self) -> FloatArray:
        """The values of the parameters (P,)."""
        return np.array([parameter.value for parameter in self.parameters], dtype=np.float64)

    def values(self, x: npt.ArrayLike, u: npt.ArrayLike | None = None, p: npt.ArrayLike | None = None) -> FloatArray:
        """Return dx/dt at one point, (D,), or at N points, (N, D); values that are not finite are NaN.

        Args:
            x: states (D,) or (N, D).
            u: inputs, (U,) for all points or (N, U); None for a field without inputs.
            p: parameters (P,); None for the parameters of the model.
        """
        return self._evaluate(self._rates, x, u, p)

    def jacobian(self, x: npt.ArrayLike, u: npt.ArrayLike | None = None, p: npt.ArrayLike | None = None) -> FloatArray:
        """Return d(dx_i/dt)/dx_j as (D, D), or (N, D, D) at N points; the arguments are as in `values`."""
        return self._evaluate(self._by_states, x, u, p)

    def parameter_derivatives(
        self, x: npt.ArrayLike, u: npt.ArrayLike | None = None, p: npt.ArrayLike | None = None
    ) -> FloatArray:
        """Return d(dx_i/dt)/dp_k as (D, P), or (N, D, P) at N points; the arguments are as in `values`."""
        return self._evaluate(self._by_parameters, x, u, p)

    def input_derivatives(
        self, x: npt.ArrayLike, u: npt.ArrayLike | None = None, p: npt.ArrayLike | None = None
    ) -> FloatArray:
        """Return d(dx_i/dt)/du_k as (D, U), or (N, D, U) at N points; the arguments are as in `values`."""
        return self._evaluate(self._by_inputs, x, u, p)

    def term_of(self, index: int, p: FloatArray) -> str:
        """Return the term whose coefficient is parameter `index` (from 0), as infix text without sign: x*y for c1*x*y.

        Other parameters in the term have the values `p` (P,).
        """
        names = (*self.states, *self.inputs)
        slope = derivative(self._sides[names.index(self.parameters[index].variable)], len(names) + index)
        operators, left, constants = slope.operators.copy(), slope.left.copy(), slope.constants.copy()
        known = (operators == VARIABLE) & (left >= len(names))
        constants[known] = p[left[known] - len(names)]
        operators[known], left[known] = CONSTANT, 0
        term = Program(operators, left, slope.right, constants)
        is_negative = displayed_form(term, _TERM_DIGITS).whole.negative
        return to_infix(term, names, digits=_TERM_DIGITS).removeprefix("-" if is_negative else "")

    @cached_property
    def _sides(self) -> list[Program]:
        """The right-hand sides; their variables are the states, the inputs, then the parameters."""
        sides: list[Program] = []
        end = len(self.states) + len(self.inputs)
        for program in self.programs:
            sides.append(with_variables(program, end))
            end += len(constant_places(program))
        return sides

    @cached_property
    def _rates(self) -> "CompiledPrograms":
        return self._function(self._sides, (len(self.programs),))

    @cached_property
    def _by_states(self) -> "CompiledPrograms":
        return self._slopes(0, len(self.states))

    @cached_property
    def _by_inputs(self) -> "CompiledPrograms":
        return self._slopes(len(self.states), len(self.inputs))

    @cached_property
    def _by_parameters(self) -> "CompiledPrograms":
        return self._slopes(len(self.states) + len(self.inputs), len(self.parameters))

    def _slopes(self, begin: int, count: int) -> "CompiledPrograms":
        slopes = [derivative(side, variable) for side in self._sides for variable in range(begin, begin + count)]
        return self._function(slopes, (len(self.programs), count))

    def _function(self, programs: Sequence[Program], shape: tuple[int, ...]) -> "CompiledPrograms":
        return CompiledPrograms(programs, shape, len(self.states) + len(self.inputs) + len(self.parameters))

    def _evaluate(
        self, function: "CompiledPrograms", x: npt.ArrayLike, u: npt.ArrayLike | None, p: npt.ArrayLike | None
    ) -> FloatArray:
        points = np.asarray(x, dtype=np.float64)
        inputs = np.asarray(() if u is None else u, dtype=np.float64)
        values = self.values_of_parameters if p is None else np.asarray(p, dtype=np.float64)
        for what, array, size in (("state", points, len(self.states)), ("input", inputs, len(self.inputs))):
            if array.ndim not in (1, 2) or array.shape[-1] != size:
                raise UsageError(f"{what}s have the shape {array.shape}, expected ({size},) or (N, {size})")
        if values.shape != (len(self.parameters),):
            raise UsageError(f"parameters have the shape {values.shape}, expected ({len(self.parameters)},)")
        if points.ndim == 1 and inputs.ndim == 1:
            return function.at_point([*points.tolist(), *inputs.tolist(), *values.tolist()]).reshape(function.shape)
        rows = max(len(array) for array in (points, inputs) if array.ndim == 2)
        columns = [*points.T, *inputs.T]
        return function.at_points(columns, values.tolist(), rows).reshape(rows, *function.shape)


def columns_of(result: Result, field: VectorField) -> VectorField:
    """Return the measured columns of a result that are computed from states, over the states and inputs of `field`.

    Only parameters have names among their constants.
    """
    names, observations = (*field.states, *field.inputs), result.observations
    places = [names.index(name) if name in names else -1 for name in result.names]
    programs = [over_variables(program_of(one, result.names), places) for one in observations]
    called = [{place: name for name, place in one.given.parameters.items()} for one in observations]
    return VectorField(
        field.states,
        field.inputs,
        tuple(one.expression for one in observations),
        programs=tuple(programs),
        constant_names=tuple(
            named.get(number, "")
            for named, program in zip(called, programs, strict=True)
            for number, _ in enumerate(constant_places(program))
        ),
        outputs=tuple(one.column for one in observations),
    )


def _with_given_sides(field: VectorField, given: GivenSides, result: Result) -> VectorField:
    """Return the field with the sides that the user gave as they were fitted, and with the names of all constants."""
    names = (*field.states, *field.inputs)
    places = [names.index(name) for name in result.names]
    programs, called = [*field.programs], [[""] * len(constant_places(program)) for program in field.programs]
    numbers = numbers_of(result)
    shift = len(field.states) // 2 if all(map(is_acceleration, result.equations)) else 0
    for index, equation in enumerate(result.equations):
        place = field.states.index(result.symbols[equation.variable]) + shift
        if equation.given is not None:
            programs[place] = over_variables(given.programs[index], places)
        called[place] = [number.name for number in numbers[equation.variable]]
    return replace(field, programs=tuple(programs), constant_names=tuple(itertools.chain.from_iterable(called)))


def is_acceleration(equation: Equation) -> bool:
    """Tell whether an equation is of second order: d2x/dt2 = …"""
    time = equation.lhs.rpartition("/")[2]
    return equation.lhs == f"d2{equation.variable}/{time}" and time.endswith("2")


def _velocity_of(variable: str, symbols: Mapping[str, str]) -> str:
    """Return the symbol of the velocity of `variable`: its name with _dot, and further _ if that name is taken."""
    name = variable + _VELOCITY
    while name in symbols and name + "_" in symbols:
        name += "_"
    if name not in symbols:
        raise UsageError(f"the result has no velocity of '{variable}'; it was written by another version")
    return symbols[name]


class CompiledPrograms:
    """Programs as two functions: one takes numbers and is fast at a single point, the other one takes arrays.

    Each is compiled when it is first used. `shape` is the shape of the values of all programs at a point.
    """

    def __init__(self, programs: Sequence[Program], shape: tuple[int, ...], variables: int) -> None:
        self.shape = shape
        self._programs, self._variables = programs, variables

    @cached_property
    def _of_numbers(self) -> Callable[..., Sequence[float]]:
        return function_of(self._programs, self._variables, _NUMBER_FUNCTIONS)

    @cached_property
    def _of_arrays(self) -> Callable[..., Sequence[FloatArray | float]]:
        return function_of(self._programs, self._variables, _ARRAY_FUNCTIONS)

    def at_point(self, numbers: Sequence[float]) -> FloatArray:
        """Return the values (programs,) of all programs; undefined values are NaN."""
        try:
            values = np.array(self._of_numbers(*numbers), dtype=np.float64)
        except (ArithmeticError, ValueError):  # a division by zero, log of 0, a root of a negative number
            columns = [np.array([number]) for number in numbers]
            return np.asarray(self.at_points(columns, (), 1)[0])
        if not all(map(math.isfinite, values.tolist())):
            values[~np.isfinite(values)] = np.nan
        return values

    def at_points(self, columns: Sequence[FloatArray], numbers: Sequence[float], rows: int) -> FloatArray:
        """Return the values (rows, programs) of all programs at `rows` points; undefined values are NaN."""
        values = np.zeros((rows, len(self._programs)))
        with np.errstate(all="ignore"):
            for index, column in enumerate(self._of_arrays(*columns, *map(np.float64, numbers))):
                if not isinstance(column, float) or column != 0.0:
                    values[:, index] = column
        values[~np.isfinite(values)] = np.nan
        return values


@dataclass(frozen=True, eq=False)
class JointErrors:
    """The joint covariance (K, K) of the constants, and a field that has these constants among its parameters.

    In `field`, coefficients of 1 are parameters too, although the text of an equation does not show them. `columns`
    are the indices of the first constants among the P parameters of `field`. The last constants belong to columns that
    are computed from states: `observed` has their columns, and their numbers among the constants there.
    """

    field: VectorField
    columns: tuple[int, ...]
    covariance: FloatArray
    observed: tuple[tuple[str, int], ...] = ()

    @classmethod
    def of(cls, result: Result, field: VectorField) -> "JointErrors | None":
        """Return the errors of the constants of a result with the right-hand sides `field`; None if they are not known.

        The constants of a diffusion are left out.
        """
        known = result.covariance
        if known is None or any(None in row for row in known.matrix):
            return None
        rows = [row for row, place in enumerate(known.constants) if place.variable in result.symbols]
        variables = [known.constants[row].variable for row in rows]
        names, programs = (*field.states, *field.inputs), list(field.programs)
        sides: dict[str, int] = {}
        fitted: dict[str, npt.NDArray[np.int64]] = {}
        given = GivenSides.of(result)
        for variable in dict.fromkeys(variables):
            equation = next(equation for equation in result.equations if equation.variable == variable)
            origins = [place.constant for place in known.constants if place.variable == variable]
            side = None if equation.program is None else given.explicit_side(variable, origins)
            if side is None:
                return None
            program, fitted[variable] = side
            position = field.states.index(result.symbols[variable])
            sides[variable] = position + (len(field.states) // 2 if is_acceleration(equation) else 0)
            programs[sides[variable]] = over_variables(program, [names.index(name) for name in result.names])
        ends = np.cumsum([0, *(len(constant_places(program)) for program in programs)])
        # the fitted constants of one right-hand side are in the order of the covariance
        following = {variable: iter(ends[sides[variable]] + places) for variable, places in fitted.items()}
        columns = tuple(int(next(following[variable])) for variable in variables)
        matrix = np.array(known.matrix, dtype=np.float64).reshape(len(known.constants), -1)
        of_columns = {one.column for one in result.observations}
        observed = [row for row, place in enumerate(known.constants) if place.variable in of_columns]
        rows = [row for row in rows if row not in observed] + observed
        places = tuple((known.constants[row].variable, known.constants[row].constant or 0) for row in observed)
        field = replace(field, programs=tuple(programs), constant_names=())
        return cls(field, columns, matrix[np.ix_(rows, rows)], places)

    def rates(self, x: FloatArray, u: FloatArray | None) -> FloatArray:
        """Return the derivatives (D, K) of the rates with respect to the constants at a point `x` (D,), `u` (U,)."""
        of_equations = self.field.parameter_derivatives(x, u)[:, list(self.columns)]
        return np.pad(of_equations, ((0, 0), (0, len(self.observed))))
