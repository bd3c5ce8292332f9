"""Several equations as one system that can be integrated and whose constants can be fitted. Pure data.

Letters: D equations, N nodes of all of them, P fitted constants.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from atoll.data.dataset import FloatArray
from atoll.expression.kernels.tape import Ints
from atoll.expression.operators import CONSTANT, VARIABLE
from atoll.expression.program import Program
from atoll_coordinator.model.shooting.kernels.rates import Tape


@dataclass(frozen=True, eq=False)
class System:
    """D equations on one tape, see `kernels.rates.Tape`; `equations` are the programs that it was made of.

    `parameters` (N,) numbers the fitted constants; `places` are their nodes, `owners` (P,) their equations.
    """

    equations: tuple[Program, ...]
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
        return replace(self, constants=constants)

    def with_fixed_constants(self) -> "System":
        """Return the system with no constant to be fitted, all as they are."""
        none = np.zeros(0, dtype=np.int64)
        return replace(self, parameters=np.full_like(self.parameters, -1), owners=none, places=none)

    @property
    def programs(self) -> tuple[Program, ...]:
        """The equations with the constants of the system."""
        ends = self.outputs + 1
        parts = np.split(self.constants, ends[:-1])
        return tuple(replace(each, constants=part) for each, part in zip(self.equations, parts, strict=True))


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
    where = [index.get(name, -1) for name in names]
    code: list[int] = []
    left: list[int] = []
    right: list[int] = []
    parameters: list[int] = []
    outputs: list[int] = []
    owners: list[int] = []
    places: list[int] = []
    start = 0
    for equation, program in enumerate(programs):
        held = fixed[equation] if fixed else ()
        columns = (program.operators.tolist(), program.left.tolist(), program.right.tolist())
        for node, (its, first, second) in enumerate(zip(*columns, strict=True)):
            code.append(its)
            is_operator = its not in (VARIABLE, CONSTANT)
            left.append(first + start if is_operator else where[first] if its == VARIABLE else 0)
            right.append(second + start if is_operator else 0)
            is_fitted = its == CONSTANT and node not in held
            parameters.append(len(places) if is_fitted else -1)
            if is_fitted:
                places.append(start + node)
                owners.append(equation)
        start += len(program)
        outputs.append(start - 1)
    constants = np.concatenate([program.constants for program in programs])
    ints = [np.array(each, dtype=np.int64) for each in (code, left, right, outputs, parameters, owners, places)]
    return System(tuple(programs), ints[0], ints[1], ints[2], constants, *ints[3:])


def variable_program(index: int) -> Program:
    """Return the program that is the variable of this index."""
    return Program(np.array([VARIABLE], np.int8), np.array([index], np.int16), np.zeros(1, np.int16), np.zeros(1))
