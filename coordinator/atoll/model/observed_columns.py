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

    def values(self, points: FloatArray) -> dict[str, FloatArray]:
        """Return the values (N,) of the columns at `points` (D + U, N)."""
        points = np.ascontiguousarray(points)
        return {column: values_of(program, points) for column, program in self.programs.items()}

    def standard_errors(
        self, points: FloatArray, sensitivities: FloatArray, own: Mapping[tuple[str, int], FloatArray]
    ) -> dict[str, FloatArray]:
        """Return the standard errors (N,) of the columns.

        Args:
            points: states and inputs (D + U, N).
            sensitivities: changes (D, K, N) of the states along independent directions of unit variance.
            own: changes (K,) of the constants of columns along these directions, by column and number of the constant.
        """
        points, errors = np.ascontiguousarray(points), dict[str, FloatArray]()
        for column, program in self.programs.items():
            constants = constant_places(program)
            is_state = (program.operators == VARIABLE) & (program.left < len(sensitivities))
            leaves = [*np.flatnonzero(is_state).tolist(), *constants]
            slopes = values_and_gradient(program, points, leaves)[1]
            change = np.zeros(sensitivities.shape[1:])
            for leaf, slope in zip(leaves, slopes, strict=True):
                if leaf in constants:
                    direction = own.get((column, constants.index(leaf)))
                    change += 0.0 if direction is None else direction[:, None] * slope
                else:
                    change += slope * sensitivities[int(program.left[leaf])]
            errors[column] = np.sqrt((change**2).sum(axis=0))
        return errors
