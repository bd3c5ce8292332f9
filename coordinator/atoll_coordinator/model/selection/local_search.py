"""From one system to a shorter description: its equations reduced, extended, changed in one place, again and again."""

import math
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from atoll_coordinator.model.description_length import least_term_length
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.shooting.trajectory_fit import covariance
from atoll_coordinator.model.structure.moves.reductions import multiply_out, reductions
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.program import Program, constant_places, structure, with_constants
from atoll_core.expression.writing.shortest import collected

_NEUTRAL: Final = (0.0, 1.0, -1.0)

Around = Callable[[int, Program], Iterator[Program]]
"""Programs near one of an equation that may take its place."""


class LocalSearch:
    """Shortens systems until nothing near is shorter, or the estimator's `budget` of work is used up.

    A step that has begun is finished, unless it takes more than the overdraft. A descent ends at a system that was
    tried before. Unless it `is_thorough`, systems on the way lose unnecessary constants only.
    """

    def __init__(
        self, comparison: ModelComparison, around: Around, budget: int, leaps: Around = lambda *_: iter(()),
        *, is_thorough: bool = True,
    ) -> None:  # fmt: skip
        self._comparison = comparison
        self._around = around
        self._leaps = leaps
        self._shorten = self.reduce if is_thorough else self.prune
        self._budget = budget
        self._explored: Final[dict[tuple[int, tuple[bytes, ...]], float]] = {}
        self._reduced: Final[dict[tuple[int, tuple[bytes, ...]], float]] = {}
        self._until = budget + SETTINGS.effort.work

    @property
    def is_exhausted(self) -> bool:
        """Whether nothing more is tried."""
        estimator = self._comparison.estimator
        return estimator.deadline.is_over or estimator.work > self._budget

    def improve(self, model: FittedModel, equations: list[int]) -> FittedModel:
        """Return the end of the descent from `model`, by changes of `equations`."""
        waiting = list(equations)
        while waiting and not self.is_exhausted:
            equation = waiting.pop(0)
            following = self._improved(model, equation)
            if following is not model:
                waiting = [*(index for index in equations if index != equation), equation]
                model = following
        return model

    def reduce(self, model: FittedModel, equation: int) -> FittedModel:
        """Return `model` without the unnecessary parts of one equation."""
        while not self.is_exhausted:
            model = self.prune(model, equation)
            if not self._is_new(self._reduced, model, equation):
                break
            programs = reductions(model.programs[equation])
            models = self._comparison.narrow_down(model, equation, programs, SETTINGS.effort.rounds, self._until)
            if not models or models[0].nats > model.nats - SETTINGS.selection.least_gain:
                break
            model = models[0]
        return model

    def prune(self, model: FittedModel, equation: int) -> FittedModel:
        """Make constants of one equation neutral as long as that shortens the description, the least needed first.

        Whether a constant is needed follows from its distance from 0, 1 or -1 in standard errors (Wald's test), so that
        each step takes one or two fits. This is done even when the budget is used up, since constants are few.
        """
        while True:
            following = None
            for program in self._needless(model, equation)[:2]:
                following = self._comparison.fit_exchanged(model, equation, program, SETTINGS.effort.brief_steps)
                if following is not None and following.nats < model.nats - SETTINGS.selection.least_gain:
                    break
                following = None
            if following is None:
                return model
            model = following
        return model

    def _needless(self, model: FittedModel, equation: int) -> list[Program]:
        """Return programs with one constant neutral that promise shorter descriptions, the most promising first.

        Constants that the data do not determine, of infinite variance, are the first; the others by their distance.
        Integration errors do not show how well constants are known: such residuals count at their upper limit.
        """
        program = model.programs[equation]
        fit = model.fit
        own = np.flatnonzero(fit.system.owners == equation + len(self._comparison.leading))
        inflation = self._comparison.score.inflation(model) * self._comparison.score.hidden_errors(model)
        variances = fit.system.by_place(inflation * np.diag(covariance(fit)), 2)[:, own]
        values = fit.system.by_place(fit.system.values)[:, own]
        priced: list[tuple[float, float, int, float]] = []
        for number, place in enumerate(constant_places(program)):
            for neutral in _NEUTRAL:
                away = values[:, number] - neutral
                nats = float((0.5 * away**2 / np.maximum(variances[:, number], 1e-300)).sum())
                priced.append((nats, float(np.abs(away).max()), place, neutral))
        length, programs = self._comparison.score.length(program), []
        for nats, _, place, neutral in sorted(priced):
            shorter = [collected(with_constants(program, {place: neutral}))]
            shorter += multiply_out(program, place) if neutral == 1.0 else ()
            programs += [one for one in shorter if nats < length - self._comparison.score.length(one)]
        return programs

    def _is_new(self, tried: dict[tuple[int, tuple[bytes, ...]], float], model: FittedModel, equation: int) -> bool:
        """Tell whether an equation of a system has not been `tried`, or only with worse constants."""
        system = equation, tuple(map(structure, model.programs))
        if model.nats > tried.get(system, math.inf) - SETTINGS.selection.least_gain:
            return False
        tried[system] = model.nats
        return True

    def _improved(self, model: FittedModel, equation: int) -> FittedModel:
        best = self._shorten(model, equation)
        if not self._is_new(self._explored, best, equation):
            return best
        programs = self._around(equation, best.programs[equation])
        models = self._comparison.narrow_down(best, equation, programs, SETTINGS.effort.rounds, self._until)
        near = [
            neighbour
            for neighbour in models
            if neighbour.nats < best.nats + least_term_length(self._comparison.score.constant_nats)
        ]
        leaps = self._leaps(equation, best.programs[equation])
        near += self._comparison.narrow_down(best, equation, leaps, SETTINGS.effort.rounds[1:], self._until)
        return min(
            [best, *(self._shorten(neighbour, equation) for neighbour in near)],
            key=lambda model: model.nats + SETTINGS.selection.least_gain * (model is not best),
        )
