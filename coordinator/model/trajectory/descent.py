"""From one system to a shorter description: its equations reduced, extended and changed in one place, again and again."""

from collections.abc import Collection, Iterator, Sequence
from typing import Final

from common.expression.program import Program
from coordinator.model.extensions import extensions
from coordinator.model.neighbours import neighbours
from coordinator.model.rewrite import reductions
from coordinator.model.trajectory.contest import Contest, Standing

LEAST: Final = 0.01
"""Nats by which a description must get shorter to count."""

_REDUCING: Final = ((2, 8), (12, 2))
_GROWING: Final = ((1, 24), (4, 6), (12, 3))


class Descent:
    """Shortens systems; `scales` are the sizes of the variables, `operators` what may be brought in."""

    def __init__(self, contest: Contest, scales: Sequence[float], operators: Collection[int], budget: int) -> None:
        self._contest = contest
        self._scales = scales
        self._operators = operators
        self._budget = budget

    @property
    def is_exhausted(self) -> bool:
        return self._contest.shooter.integrations > self._budget

    def down(self, standing: Standing) -> Standing:
        """Return the end of the descent from `standing`."""
        equations = range(len(standing.programs))
        waiting = list(equations)
        while waiting and not self.is_exhausted:
            equation = waiting.pop(0)
            following = self._improved(standing, equation)
            if following is not standing:
                waiting = [*(other for other in equations if other != equation), equation]
                standing = following
        return standing

    def reduced(self, standing: Standing, equation: int) -> Standing:
        """Return `standing` with whatever one equation can do without left out."""
        while not self.is_exhausted:
            programs = reductions(standing.programs[equation])
            found = self._contest.halved(standing, equation, programs, _REDUCING)
            if not found or found[0].nats > standing.nats - LEAST:
                return standing
            standing = found[0]
        return standing

    def _improved(self, standing: Standing, equation: int) -> Standing:
        best = self.reduced(standing, equation)
        found = self._contest.halved(best, equation, self._around(best.programs[equation]), _GROWING)
        for each in found:
            end = self.reduced(each, equation)
            if end.nats < best.nats - LEAST:
                best = end
        return best

    def _around(self, program: Program) -> Iterator[Program]:
        yield from extensions(program, self._scales, self._operators)
        yield from neighbours(program, len(self._scales), self._operators)
