"""From one system to a shorter description: its equations reduced, extended, changed in one place, again and again."""

from collections.abc import Callable, Iterator
from typing import Final

from common.expression.program import Program
from coordinator.model.rewrite import reductions
from coordinator.model.trajectory.contest import Contest, Standing

LEAST: Final = 0.01
"""Nats by which a description must get shorter to count."""

FAR: Final = 10.0
"""Systems whose description is longer than the best by more nats are not reduced."""

_REDUCING: Final = ((2, 4), (10, 1))
_GROWING: Final = ((1, 24), (4, 6), (12, 3))

Around = Callable[[int, Program], Iterator[Program]]
"""Programs near one of an equation that may take its place."""


class Descent:
    """Shortens systems until nothing near is shorter, or the shooter's `budget` of work is used up."""

    def __init__(self, contest: Contest, around: Around, budget: int) -> None:
        self._contest = contest
        self._around = around
        self._budget = budget

    @property
    def is_exhausted(self) -> bool:
        """Whether nothing more is tried."""
        return self._contest.shooter.work > self._budget

    def down(self, standing: Standing, equations: list[int]) -> Standing:
        """Return the end of the descent from `standing`, by changes of `equations`."""
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
                break
            standing = found[0]
        return standing

    def _improved(self, standing: Standing, equation: int) -> Standing:
        best = self.reduced(standing, equation)
        programs = self._around(equation, best.programs[equation])
        for each in self._contest.halved(best, equation, programs, _GROWING):
            end = self.reduced(each, equation) if each.nats < best.nats + FAR else each
            if end.nats < best.nats - LEAST:
                best = end
        return best
