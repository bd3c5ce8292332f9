"""The joint errors of the constants of a model.

Letters: D states, P constants of a vector field, K constants whose joint covariance is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from atoll.model.equations import program_of
from atoll.model.vector_field import VectorField, is_acceleration
from atoll_coordinator.result.equations import Equation
from atoll_coordinator.result.findings import Covariance
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.operators import VARIABLE
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.unit_coefficients import as_written, make_coefficients_explicit


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
        following = [count(begin) for begin in ends.tolist()]  # parameters stand one after the other in each side
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
