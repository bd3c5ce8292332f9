"""Start values of constants if groups of trajectories have their own constants.

The start values are fitted to the rows of each group before any trajectory is simulated, or taken from a similar
system. Letters: G groups, P fitted constants, Q fitted numbers of all groups together, N nodes.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from atoll_coordinator.model.regression.fit import LeastSquares
from atoll_coordinator.model.shooting.system import OdeSystem
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, Problem
from atoll_core.expression.program import Program, constant_places, structure
from atoll_core.expression.restrictions import NONE, Restrictions


@dataclass(frozen=True, eq=False)
class GroupedRows:
    """The rows of each group, by equation: constants are fitted to these rows before any trajectory is simulated.

    Attributes:
        count: number of groups.
        problems: for each equation, the regression problem of each group; empty for a known equation.
        restrictions: of equations, by index.
    """

    count: int
    problems: Sequence[Sequence[Problem]]
    restrictions: Mapping[int, Restrictions] = field(default_factory=dict)

    @cached_property
    def _fits(self) -> list[list[LeastSquares | None]]:
        return [
            [
                LeastSquares(problem, restrictions=self.restrictions.get(index, NONE))
                if len(problem.target.values)
                else None
                for problem in group_problems
            ]
            for index, group_problems in enumerate(self.problems)
        ]

    @cached_property
    def _known(self) -> dict[tuple[int, bytes], FloatArray]:
        return {}

    def constants(
        self, system: OdeSystem, leading: int, fixed: Sequence[Collection[int]], near: OdeSystem | None
    ) -> FloatArray:
        """Return the constants (G, N) of each group's nodes with which a fit of `system` begins.

        See `ModelComparison.system` for the arguments; the first `leading` equations are the equations of positions.
        """
        own = np.repeat(system.constants[None], self.count, axis=0)
        ends = (system.outputs + 1).tolist()
        for index, program in enumerate(system.equations[leading:]):
            part = slice(ends[index + leading] - len(program), ends[index + leading])
            own[:, part] = self._start_constants(index, program, fixed[index], near, part, leading)
        return own

    def _start_constants(
        self, index: int, program: Program, fixed: Collection[int], near: OdeSystem | None, part: slice, leading: int
    ) -> FloatArray:
        """Return the constants (G, N) of one equation with which its fit begins."""
        if near is not None and near.sharing is not None:
            before = near.equations[index + leading]
            if structure(before) == structure(program):
                first = int(near.outputs[index + leading]) + 1 - len(before)
                constants = near.sharing.constants[:, first : first + len(before)].copy()
                for node in fixed:
                    if program.constants[node] != near.constants[first + node]:
                        constants[:, node] = program.constants[node]
                return constants
        return self._fit_by_group(index, program, fixed)

    def _fit_by_group(self, index: int, program: Program, fixed: Collection[int]) -> FloatArray:
        """Return the constants (G, N) of a program fitted to the rows of each group; unchanged if they cannot be
        fitted."""
        places = [place for place in constant_places(program) if place not in fixed]
        if not places or not self._fits[index]:
            return np.repeat(program.constants[None], self.count, axis=0)
        key = (index, program.to_bytes() + bytes(sorted(fixed)))
        known = self._known.get(key)
        if known is None:
            fits = [
                program.constants
                if least_squares is None  # its rows are all left out
                else least_squares.fit(program, sorted(fixed), steps=SETTINGS.effort.brief_steps).program.constants
                for least_squares in self._fits[index]
            ]
            known = self._known[key] = np.array(fits)
        return known
