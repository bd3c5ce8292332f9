"""The right-hand sides of a model as functions of numbers, with their derivatives by states and by constants.

Letters: D states, U inputs, P parameters, N points. Values agree with those of the search up to rounding, since
functions are those of the C library, and sine and cosine have values of large numbers, too.

The joint errors of the constants of a model.

Letters: D states, P constants of a vector field, K constants whose joint covariance is known.
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

from atoll.model.equations import Parameter, program_of
from atoll_coordinator.result.equations import Equation
from atoll_coordinator.result.findings import Covariance
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression.compiled import function_of
from atoll_core.expression.derivative import derivative, with_variables
from atoll_core.expression.evaluation import NUMPY
from atoll_core.expression.operators import VARIABLE, Functions
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.text.export import to_sympy
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.unit_coefficients import as_written, make_coefficients_explicit

MOST_STATES: Final = 200
"""More states than this make a Jacobian of more than 40 000 formulas."""

_VELOCITY: Final = "_dot"

_OF_NUMBERS: Final = Functions(
    math.sin, math.cos, math.exp, math.log, math.sqrt, abs, math.tanh, math.pow,
    sign=lambda x: (x > 0.0) - (x < 0.0), base_log=lambda x, v: 0.0 if x == v == 0.0 else math.log(x),
)  # fmt: skip
_OF_ARRAYS: Final = NUMPY._replace(sin=np.sin, cos=np.cos, power=operator.pow)


@dataclass(frozen=True, eq=False)
class VectorField:
    """dx/dt = f(x, u, p) of D states.

    `states` are the names of x in order, `inputs` those of u, which have no equation; `expressions` are the D
    right-hand sides as infix text. Of equations of second order, the velocities are states after all positions.
    `sizes` are the largest absolute values measured of the states, 0 where none is known; empty: of no state.
    `programs` are the right-hand sides over states and inputs; empty: those of the texts.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    expressions: tuple[str, ...]
    sizes: tuple[float, ...] = ()
    programs: tuple[Program, ...] = field(default=(), repr=False)
    parameters: tuple[Parameter, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not 1 <= len(self.states) <= MOST_STATES or len(self.expressions) != len(self.states):
            counts = f"{len(self.expressions)} expressions for {len(self.states)} states"
            raise UsageError(f"there are {counts}; give one for each, of 1 to {MOST_STATES} states")
        names = (*self.states, *self.inputs)
        if len(set(names)) < len(names):
            raise UsageError(f"a name stands twice among {', '.join(names)}; give each state and input its own")
        programs = self.programs or tuple(from_infix(text, names) for text in self.expressions)
        constants = [
            (state, value)
            for state, program in zip(self.states, programs, strict=True)
            for value in program.constants[constant_places(program)].tolist()
        ]
        parameters = tuple(Parameter(f"c{number}", *its) for number, its in enumerate(constants, start=1))
        object.__setattr__(self, "programs", programs)
        object.__setattr__(self, "parameters", parameters)

    @classmethod
    def of(cls, equations: Mapping[str, str], inputs: Sequence[str] = (), sizes: Sequence[float] = ()) -> "VectorField":
        """Return the field of ``{state: right-hand side}``, with these `inputs` and `sizes`; raises UsageError."""
        return cls(tuple(equations), tuple(inputs), tuple(equations.values()), tuple(sizes))

    @classmethod
    def from_result(cls, result: Result) -> "VectorField":
        """Return the field of the model that a result shows.

        Of a stochastic process it is the drift. Variables without an equation of their own are inputs.

        Raises:
            UsageError: there is an equation without an expression, or the equations are not differential.
        """
        symbols = result.symbols
        equations = [equation for equation in result.equations if equation.variable in symbols]
        is_second = _is_of_second_order(result.equations)
        missing = next((equation.lhs for equation in equations if not equation.expression), None)
        if missing is not None:
            raise UsageError(f"the result has no equation for {missing}; a model needs one for each state")
        sides = {symbols[equation.variable]: equation.expression or "" for equation in equations}
        if is_second:
            velocities = [_velocity_of(equation.variable, symbols) for equation in equations]
            sides = dict(zip(sides, velocities, strict=True)) | dict(zip(velocities, sides.values(), strict=True))
        inputs = [name for name in symbols.values() if name not in sides]
        return cls.of(sides, inputs, result.sizes(tuple(sides)))

    @property
    def values_of_parameters(self) -> FloatArray:
        """The values of the parameters (P,)."""
        return np.array([parameter.value for parameter in self.parameters], dtype=np.float64)

    def values(self, x: npt.ArrayLike, u: npt.ArrayLike | None = None, p: npt.ArrayLike | None = None) -> FloatArray:
        """Return dx/dt at one point (D,) or at N points (N, D), of the same shape; NaN where it has no finite value.

        Args:
            x: states.
            u: inputs, (U,) for all points or (N, U); None where there are none.
            p: parameters (P,); None: those of the model.
        """
        return self._evaluated(self._rates, x, u, p)

    def jacobian(self, x: npt.ArrayLike, u: npt.ArrayLike | None = None, p: npt.ArrayLike | None = None) -> FloatArray:
        """Return d(dx_i/dt)/dx_j as (D, D), or (N, D, D) at N points; otherwise as `values`."""
        return self._evaluated(self._by_states, x, u, p)

    def parameter_derivatives(
        self, x: npt.ArrayLike, u: npt.ArrayLike | None = None, p: npt.ArrayLike | None = None
    ) -> FloatArray:
        """Return d(dx_i/dt)/dp_k as (D, P), or (N, D, P) at N points; otherwise as `values`."""
        return self._evaluated(self._by_parameters, x, u, p)

    def input_derivatives(
        self, x: npt.ArrayLike, u: npt.ArrayLike | None = None, p: npt.ArrayLike | None = None
    ) -> FloatArray:
        """Return d(dx_i/dt)/du_k as (D, U), or (N, D, U) at N points; otherwise as `values`."""
        return self._evaluated(self._by_inputs, x, u, p)

    def term_of(self, index: int, p: FloatArray) -> str:
        """Return what a parameter (from 0) is the coefficient of, as infix text without its sign: x*y for c1*x*y.

        Other parameters in it have the values `p` (P,).
        """
        import sympy

        names, values = (*self.states, *self.inputs), p.tolist()
        slope = derivative(self._sides[names.index(self.parameters[index].variable)], len(names) + index)
        marks = [f"[{number}]" for number in range(len(values))]  # which no state is called
        known = {
            sympy.Symbol(mark): sympy.Integer(value) if value.is_integer() else sympy.Float(value)
            for mark, value in zip(marks, values, strict=True)
        }
        term = to_sympy(slope, [*names, *marks]).xreplace(known)
        return str(-term if term.could_extract_minus_sign() else term)

    @cached_property
    def _sides(self) -> list[Program]:
        """The right-hand sides with their parameters as variables behind states and inputs."""
        sides: list[Program] = []
        end = len(self.states) + len(self.inputs)
        for program in self.programs:
            sides.append(with_variables(program, end))
            end += len(constant_places(program))
        return sides

    @cached_property
    def _rates(self) -> "_CompiledPrograms":
        return self._function(self._sides, (len(self.states),))

    @cached_property
    def _by_states(self) -> "_CompiledPrograms":
        return self._slopes(0, len(self.states))

    @cached_property
    def _by_inputs(self) -> "_CompiledPrograms":
        return self._slopes(len(self.states), len(self.inputs))

    @cached_property
    def _by_parameters(self) -> "_CompiledPrograms":
        return self._slopes(len(self.states) + len(self.inputs), len(self.parameters))

    def _slopes(self, begin: int, count: int) -> "_CompiledPrograms":
        """Return the derivatives of all right-hand sides by so many variables from `begin` on."""
        slopes = [derivative(side, variable) for side in self._sides for variable in range(begin, begin + count)]
        return self._function(slopes, (len(self.states), count))

    def _function(self, programs: Sequence[Program], shape: tuple[int, ...]) -> "_CompiledPrograms":
        return _CompiledPrograms(programs, shape, len(self.states) + len(self.inputs) + len(self.parameters))

    def _evaluated(
        self, function: "_CompiledPrograms", x: npt.ArrayLike, u: npt.ArrayLike | None, p: npt.ArrayLike | None
    ) -> FloatArray:
        points = np.asarray(x, dtype=np.float64)
        inputs = np.asarray(() if u is None else u, dtype=np.float64)
        values = self.values_of_parameters if p is None else np.asarray(p, dtype=np.float64)
        self._check_shapes(points, inputs, values)
        if points.ndim == 1 and inputs.ndim == 1:
            return function.at_point([*points.tolist(), *inputs.tolist(), *values.tolist()]).reshape(function.shape)
        rows = max(len(array) for array in (points, inputs) if array.ndim == 2)
        columns = [*points.T, *inputs.T]
        return function.at_points(columns, values.tolist(), rows).reshape(rows, *function.shape)

    def _check_shapes(self, points: FloatArray, inputs: FloatArray, values: FloatArray) -> None:
        for what, array, count in (("state", points, len(self.states)), ("input", inputs, len(self.inputs))):
            if array.ndim not in (1, 2) or array.shape[-1] != count:
                raise UsageError(f"{what}s have the shape {array.shape}, expected ({count},) or (N, {count})")
        if values.shape != (len(self.parameters),):
            raise UsageError(f"parameters have the shape {values.shape}, expected ({len(self.parameters)},)")


def _is_of_second_order(equations: Sequence[Equation]) -> bool:
    """Tell whether all equations are of second order; raises UsageError where one is not differential."""
    for equation in equations:
        side = equation.lhs
        if side == equation.variable or "/" not in side:
            raise UsageError(f"the equation of {side} is not differential; a model of dynamics needs d{side}/dt")
    return all(map(is_acceleration, equations))


def is_acceleration(equation: Equation) -> bool:
    """Tell whether an equation is of second order: d2x/dt2 = …"""
    time = equation.lhs.rpartition("/")[2]
    return equation.lhs == f"d2{equation.variable}/{time}" and time.endswith("2")


def _velocity_of(variable: str, symbols: Mapping[str, str]) -> str:
    """Return the symbol of the velocity of `variable`, named after it, with more _ where that is taken."""
    name = variable + _VELOCITY
    while name in symbols and name + "_" in symbols:
        name += "_"
    if name not in symbols:
        raise UsageError(f"the result has no velocity of '{variable}'; it is not of this version")
    return symbols[name]


class _CompiledPrograms:
    """Programs as two functions, compiled when first used: of plain numbers, fast at one point, and of arrays.

    `shape` is that in which callers want the values of all programs at a point.
    """

    def __init__(self, programs: Sequence[Program], shape: tuple[int, ...], variables: int) -> None:
        self.shape = shape
        self._programs, self._variables = programs, variables

    @cached_property
    def _of_numbers(self) -> Callable[..., Sequence[float]]:
        return function_of(self._programs, self._variables, _OF_NUMBERS)

    @cached_property
    def _of_arrays(self) -> Callable[..., Sequence[FloatArray | float]]:
        return function_of(self._programs, self._variables, _OF_ARRAYS)

    def at_point(self, numbers: Sequence[float]) -> FloatArray:
        """Return the values of all programs; NaN where they have none."""
        try:
            values = np.array(self._of_numbers(*numbers), dtype=np.float64)
        except (ArithmeticError, ValueError):  # a division by zero, log of 0, a root of a negative number
            columns = [np.array([number]) for number in numbers]
            return np.asarray(self.at_points(columns, (), 1)[0])
        if not all(map(math.isfinite, values.tolist())):
            values[~np.isfinite(values)] = np.nan
        return values

    def at_points(self, columns: Sequence[FloatArray], numbers: Sequence[float], rows: int) -> FloatArray:
        """Return the values of all programs at `rows` points, shape (rows, programs); NaN where they have none."""
        values = np.zeros((rows, len(self._programs)))
        with np.errstate(all="ignore"):
            for index, column in enumerate(self._of_arrays(*columns, *map(np.float64, numbers))):
                if not isinstance(column, float) or column != 0.0:
                    values[:, index] = column
        values[~np.isfinite(values)] = np.nan
        return values


@dataclass(frozen=True, eq=False)
class JointErrors:
    """The joint covariance (K, K) of the constants, and the field whose parameters they are.

    `field` has the right-hand sides with factors of one as constants; `columns` (K,) say which of its P parameters the
    constants are.
    """

    field: VectorField
    columns: tuple[int, ...]
    covariance: FloatArray

    @classmethod
    def of(cls, result: Result, field: VectorField) -> "JointErrors | None":
        """Return the errors of a result's model, `field` being its right-hand sides; None where they are not known.

        Constants of a diffusion are left out.
        """
        known = result.covariance
        if known is None or any(None in row for row in known.matrix):
            return None
        rows = [row for row, place in enumerate(known.constants) if place.variable in result.symbols]
        variables = [known.constants[row].variable for row in rows]
        names, programs = (*field.states, *field.inputs), list(field.programs)
        sides: dict[str, int] = {}
        for variable in dict.fromkeys(variables):
            equation = next(equation for equation in result.equations if equation.variable == variable)
            program = _explicit(result, equation, known)
            if program is None:
                return None
            sides[variable] = _place(field, equation, result.symbols[variable])
            programs[sides[variable]] = _over(program, [names.index(name) for name in result.names])
        ends = np.cumsum([0, *(len(constant_places(program)) for program in programs)])
        following = [
            itertools.count(begin) for begin in ends.tolist()
        ]  # parameters stand one after the other in each side
        columns = tuple(next(following[sides[variable]]) for variable in variables)
        matrix = np.array(known.matrix, dtype=np.float64).reshape(len(known.constants), -1)
        return cls(replace(field, programs=tuple(programs)), columns, matrix[np.ix_(rows, rows)])

    def rates(self, x: FloatArray, u: FloatArray | None) -> FloatArray:
        """Return the derivatives (D, K) of the rates by the constants at a point."""
        return self.field.parameter_derivatives(x, u)[:, list(self.columns)]


def _explicit(result: Result, equation: Equation, known: Covariance) -> Program | None:
    """Return a right-hand side whose constants, in node order, are those of the covariance; None without."""
    if equation.program is None:
        return None
    origins = [place.constant for place in known.constants if place.variable == equation.variable]
    program = program_of(equation, result.names)
    explicit = (make_coefficients_explicit(program), as_written(program))
    return next((coefficients.program for coefficients in explicit if [*coefficients.origins] == origins), None)


def _over(program: Program, places: Sequence[int]) -> Program:
    """Return a program over other variables, those at these places; its constants stay in their order."""
    left = [places[index] if code == VARIABLE else index for code, index, _, _ in program.nodes()]
    return replace(program, left=np.array(left, dtype=np.int16))


def _place(field: VectorField, equation: Equation, symbol: str) -> int:
    """Return which right-hand side is the equation of a state: for order 2, behind those of the positions."""
    position = field.states.index(symbol)
    return position + len(field.states) // 2 if is_acceleration(equation) else position
