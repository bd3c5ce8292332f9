"""From one system to a shorter description: its equations reduced, extended, changed in one place, again and again."""

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from atoll.expression.program import Program, constant_places
from atoll_coordinator.model.selection.comparison import Contest, Standing
from atoll_coordinator.model.settings import SETTINGS
from atoll_coordinator.model.shooting.covariance import covariance
from atoll_coordinator.model.structure.algebra import tidied
from atoll_coordinator.model.structure.moves.reductions import reductions

_NEUTRAL: Final = (0.0, 1.0, -1.0)

Around = Callable[[int, Program], Iterator[Program]]
"""Programs near one of an equation that may take its place."""


class Descent:
    """Shortens systems until nothing near is shorter, or the shooter's `budget` of work is used up.

    What was begun then is finished, unless that takes more than the overdraft beyond.
    """

    def __init__(self, contest: Contest, around: Around, budget: int, leaps: Around = lambda *_: iter(())) -> None:
        self._contest = contest
        self._around = around
        self._leaps = leaps
        self._budget = budget
        self._until = budget + SETTINGS.selection.overdraft

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
            standing = self._pruned(standing, equation)
            programs = reductions(standing.programs[equation])
            found = self._contest.halved(standing, equation, programs, SETTINGS.selection.reduction_rounds, self._until)
            if not found or found[0].nats > standing.nats - SETTINGS.selection.least_gain:
                break
            standing = found[0]
        return standing

    def _pruned(self, standing: Standing, equation: int) -> Standing:
        """Make constants of one equation neutral as long as that shortens the description, the least needed first.

        What a constant is needed for is told by its distance from 0, 1 or -1 in standard errors (Wald's test), so that
        each step takes one or two fits. This is done even when the budget is
        used up: there are but so many constants.
        """
        while True:
            following = None
            for program in self._needless(standing, equation)[:2]:
                following = self._contest.exchanged(standing, equation, program, SETTINGS.selection.pruning_steps)
                if following is not None and following.nats < standing.nats - SETTINGS.selection.least_gain:
                    break
                following = None
            if following is None:
                return standing
            standing = following
        return standing

    def _needless(self, standing: Standing, equation: int) -> list[Program]:
        """Return programs with one constant neutral that promise shorter descriptions, the most promising first.

        Constants that the data do not determine, of infinite variance, are the first; by what is nearest.
        """
        program = standing.programs[equation]
        shot = standing.shot
        own = np.flatnonzero(shot.system.owners == equation + len(self._contest.leading))
        variances = np.diag(covariance(shot))[own]
        priced: list[tuple[float, float, int, float]] = []
        for place, value, variance in zip(
            constant_places(program), shot.system.values[own].tolist(), variances.tolist(), strict=True
        ):
            for neutral in _NEUTRAL:
                nats = 0.5 * (value - neutral) ** 2 / max(variance, 1e-300)
                if nats < SETTINGS.selection.most_saved:
                    priced.append((nats, abs(value - neutral), place, neutral))
        return [tidied(program, {place: neutral}) for _, _, place, neutral in sorted(priced)]

    def _improved(self, standing: Standing, equation: int) -> Standing:
        best = self.reduced(standing, equation)
        programs = self._around(equation, best.programs[equation])
        found = self._contest.halved(best, equation, programs, SETTINGS.selection.extension_rounds, self._until)
        near = [each for each in found if each.nats < best.nats + SETTINGS.selection.far]
        leaps = self._leaps(equation, best.programs[equation])
        near += self._contest.halved(best, equation, leaps, SETTINGS.selection.leap_rounds, self._until)
        return min(
            [best, *(self.reduced(each, equation) for each in near)],
            key=lambda its: its.nats + SETTINGS.selection.least_gain * (its is not best),
        )
