"""Measured columns that are computed from the states of a model: values and standard errors along simulations.

The standard errors are first-order: of the states, and of the constants of the observation itself, which are fitted
together. Letters: D states, U inputs, M columns, K independent directions of the constants, N times.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from atoll.model.given_sides import over_variables, program_of
from atoll.model.vector_field import VectorField
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_and_gradient, values_of
from atoll_core.expression.operators import VARIABLE
from atoll_core.expression.program import Program, constant_places, with_constants


class ColumnCurve(NamedTuple):
    """A computed column along a simulation: values, standard errors and the 95 % band (N,); None: not known."""

    values: FloatArray
    stderr: FloatArray | None = None
    lower: FloatArray | None = None
    upper: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class ObservedColumns:
    """The M columns of a model: `programs` over its states, then its inputs, by name of the column.

    `nodes` has, by the name of each parameter in an observation, the columns and nodes at which it stands.
    """

    programs: Mapping[str, Program]
    nodes: Mapping[str, tuple[tuple[str, int], ...]]

    @classmethod
    def of(cls, result: Result, field: VectorField) -> Self:
        """Return the observed columns of a result; none without observations."""
        variables = (*field.states, *field.inputs)
        places = [variables.index(name) if name in variables else -1 for name in result.names]
        programs, nodes = dict[str, Program](), dict[str, tuple[tuple[str, int], ...]]()
        for one in result.observations:
            programs[one.column] = program = over_variables(program_of(one, result.names), places)
            constants = constant_places(program)
            for name, number in one.given.parameters.items():
                nodes[name] = (*nodes.get(name, ()), (one.column, constants[number]))
        return cls(programs, nodes)

    def with_values(self, values: Mapping[str, float]) -> Self:
        """Return the columns with other values of their parameters, by name; other names are ignored."""
        changes: dict[str, dict[int, float]] = {}
        for name, value in values.items():
            for column, node in self.nodes.get(name, ()):
                changes.setdefault(column, {})[node] = value
        programs = {
            column: with_constants(program, changes[column]) if column in changes else program
            for column, program in self.programs.items()
        }
        return replace(self, programs=programs)

    def curves(self, points: FloatArray, errors: "ColumnErrors | None") -> dict[str, ColumnCurve]:
        """Return the columns at `points`, which are states and inputs (D + U, N)."""
        points, curves = np.ascontiguousarray(points), dict[str, ColumnCurve]()
        for column, program in self.programs.items():
            values = values_of(program, points)
            error = None if errors is None else errors.of_column(column, program, points)
            reach = None if errors is None or error is None else errors.width * error
            ends = (None, None) if reach is None else (values - reach, values + reach)
            curves[column] = ColumnCurve(values, error, *ends)
        return curves


@dataclass(frozen=True, eq=False)
class ColumnErrors:
    """What the standard errors of columns follow from.

    `sensitivities` (D, K, N) are the changes of the states along independent directions of unit variance. `own` has the
    changes (K,) of the constants of columns along these directions, by column and number of the constant. `width` is
    half the width of a band, in standard errors.
    """

    sensitivities: FloatArray
    own: Mapping[tuple[str, int], FloatArray]
    width: float

    def of_column(self, column: str, program: Program, points: FloatArray) -> FloatArray:
        """Return the standard errors (N,) of a column."""
        constants = constant_places(program)
        is_state = (program.operators == VARIABLE) & (program.left < len(self.sensitivities))
        leaves = [*np.flatnonzero(is_state).tolist(), *constants]
        change = np.zeros(self.sensitivities.shape[1:])
        for leaf, slope in zip(leaves, values_and_gradient(program, points, leaves)[1], strict=True):
            if leaf not in constants:
                change += slope * self.sensitivities[int(program.left[leaf])]
            elif (column, constants.index(leaf)) in self.own:
                change += self.own[column, constants.index(leaf)][:, None] * slope
        return np.asarray(np.sqrt((change**2).sum(axis=0)))
