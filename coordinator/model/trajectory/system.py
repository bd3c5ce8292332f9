"""Several equations as one system that can be integrated and whose constants can be fitted. Pure data.

Letters: D equations, N nodes of all of them, P fitted constants.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from common.dataset import FloatArray
from common.expression.kernels import Ints
from common.expression.operators import CONSTANT, VARIABLE
from common.expression.program import Program
from coordinator.model.trajectory.kernels_rates import Tape


@dataclass(frozen=True, eq=False)
class System:
    """D equations on one tape, see `kernels_rates.Tape`.

    `parameters` (N,) numbers the fitted constants; `places` are their nodes, `owners` (P,) their equations.
    """

    code: Ints
    left: Ints
    right: Ints
    constants: FloatArray
    outputs: Ints
    parameters: Ints
    owners: Ints
    places: Ints

    @property
    def tape(self) -> Tape:
        """The nodes, as kernels take them."""
        return self.code, self.left, self.right, self.constants, self.outputs, self.parameters

    @property
    def values(self) -> FloatArray:
        """The fitted constants (P,)."""
        return self.constants[self.places]

    def with_values(self, values: FloatArray) -> "System":
        """Return the system with other values of the fitted constants."""
        constants = self.constants.copy()
        constants[self.places] = values
        return System(
            self.code, self.left, self.right, constants, self.outputs, self.parameters, self.owners, self.places
        )


def system_of(
    programs: Sequence[Program], names: Sequence[str], variables: Sequence[str], fixed: Sequence[Collection[int]] = ()
) -> System:
    """Return the system of `programs`, one for each equation.

    Args:
        programs: over `names`, the variables of the dataset.
        names: what a program's variables are called, by index.
        variables: the numbers of a point by name: states with an equation first, then inputs.
        fixed: for each program the nodes whose constants are not fitted.
    """
    index = {name: place for place, name in enumerate(variables)}
    where = np.array([index.get(name, -1) for name in names], dtype=np.int64)
    code: list[Ints] = []
    left: list[Ints] = []
    right: list[Ints] = []
    constants: list[FloatArray] = []
    parameters: list[Ints] = []
    outputs: list[int] = []
    owners: list[int] = []
    places: list[int] = []
    start = 0
    for equation, program in enumerate(programs):
        is_variable = program.operators == VARIABLE
        is_leaf = is_variable | (program.operators == CONSTANT)
        lefts = np.where(is_variable, where[np.where(is_variable, program.left, 0)], program.left + start)
        numbers = np.full(len(program), -1, dtype=np.int64)
        for node in np.flatnonzero(program.operators == CONSTANT).tolist():
            if not fixed or node not in fixed[equation]:
                numbers[node] = len(places)
                places.append(start + node)
                owners.append(equation)
        code.append(program.operators.astype(np.int64))
        left.append(np.where(is_leaf & ~is_variable, 0, lefts))
        right.append(np.where(is_leaf, 0, program.right + start))
        constants.append(program.constants)
        parameters.append(numbers)
        start += len(program)
        outputs.append(start - 1)
    return System(
        np.concatenate(code), np.concatenate(left).astype(np.int64), np.concatenate(right).astype(np.int64),
        np.concatenate(constants), np.array(outputs, dtype=np.int64), np.concatenate(parameters),
        np.array(owners, dtype=np.int64), np.array(places, dtype=np.int64),
    )  # fmt: skip


def variable_program(index: int) -> Program:
    """Return the program that is the variable of this index."""
    return Program(np.array([VARIABLE], np.int8), np.array([index], np.int16), np.zeros(1, np.int16), np.zeros(1))


def split(system: System, programs: Sequence[Program]) -> list[Program]:
    """Return `programs` with the constants of `system`, which was made of them."""
    found, start = [], 0
    for program in programs:
        constants = system.constants[start : start + len(program)].copy()
        found.append(Program(program.operators, program.left, program.right, constants))
        start += len(program)
    return found
