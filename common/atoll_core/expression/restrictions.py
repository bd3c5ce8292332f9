"""What an equation must keep to, whatever it is made of: bounds on its constants, variables that it must have."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.bounds import EquationBounds, equation_bounds
from atoll_core.expression.program import Program, constant_places, variables_of


@dataclass(frozen=True, eq=False)
class Restrictions:
    """`bounds` on the constants of an equation, None without; `required` are indices of variables that it must have."""

    bounds: EquationBounds | None = None
    required: frozenset[int] = frozenset()

    @property
    def are_none(self) -> bool:
        """Whether any program will do."""
        return self.bounds is None and not self.required

    def admitted(self, program: Program) -> Program | None:
        """Return `program` as it may be fitted, laid out for the bounds; None when it may not."""
        if not self.has_required(program):
            return None
        return program if self.bounds is None else self.bounds.laid_out(program)

    def are_kept(self, program: Program) -> bool:
        """Tell whether a program, with its constants as they stand, keeps to everything."""
        return self.has_required(program) and (self.bounds is None or self.bounds.are_kept(program))

    def ranges(self, program: Program, fixed: Collection[int] = ()) -> FloatArray:
        """Return the least and largest values (2, K) of the constants of a program that was admitted.

        Of those at the nodes `fixed` there are none; without bounds the others are infinite.
        """
        places = constant_places(program)
        found = None if self.bounds is None else self.bounds.ranges(program)
        ranges = np.repeat([[-np.inf], [np.inf]], len(places), axis=1) if found is None else np.array(found)
        return ranges[:, np.array([place not in fixed for place in places], np.bool_)]

    def has_required(self, program: Program) -> bool:
        """Tell whether all variables that an equation must have are in `program`."""
        return self.required <= variables_of(program)


NONE = Restrictions()


def restrictions_of(config: JobConfig, variable: str, names: Sequence[str]) -> Restrictions:
    """Return the restrictions of the equation of `variable`, which may use the variables of these symbols."""
    required = frozenset(map(names.index, config.space.required_of.get(variable, ())))
    return Restrictions(equation_bounds(config.prior.bounds, variable, names), required)
