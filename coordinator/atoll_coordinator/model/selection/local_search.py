"""Local search: shortens the description of a system by changes of one equation at one node.

How it works. `improve` takes one equation after another. It removes unnecessary parts, and fits programs that differ
from the equation at one node. `narrow_down` fits many of these programs with few steps, and the best with more steps.
If the description of such a program is about as short, its unnecessary parts are removed. The search continues from the
shortest description. The search ends when no equation changes, or when the work budget is used up.

Doubts. Only one equation changes at a time, at one node. `prune` uses standard errors from the normal equations. These
standard errors are too small if the residuals have a pattern, so each removal is confirmed by a fit."""

import math
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Final

import numpy as np

from atoll_coordinator.model.description_length import least_term_length
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.shooting.fit_result import covariance
from atoll_coordinator.model.structure.moves.reductions import multiply_out, reductions
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.program import Program, constant_places, structure, with_constants
from atoll_core.expression.writing.shortest import collected

_NEUTRAL: Final = (0.0, 1.0, -1.0)

ProgramsNearby = Callable[[int, Program], Iterator[Program]]
"""A function of an equation (its index, its program). It returns similar programs that may replace this program."""


class LocalSearch:
    """Shortens systems until no similar system is shorter, or until the estimator's `budget` of work is used up.

    A step that has begun is finished, unless it exceeds the budget by more than `SETTINGS.effort.work`. A descent ends
    at a system that was tried before. If the search is not `is_thorough`, only unnecessary constants are removed from
    intermediate systems, and no other parts.
    """

    def __init__(
        self, comparison: ModelComparison, around: ProgramsNearby, budget: int,
        leaps: ProgramsNearby = lambda *_: iter(()), *, is_thorough: bool = True,
    ) -> None:  # fmt: skip
        self._comparison = comparison
        self._neighbours = around
        self._leaps = leaps
        self._shorten = self.reduce if is_thorough else self.prune
        self._budget = budget
        self._explored: Final[dict[tuple[int, tuple[bytes, ...]], float]] = {}
        self._reduced: Final[dict[tuple[int, tuple[bytes, ...]], float]] = {}
        self._until = budget + SETTINGS.effort.work

    @property
    def is_exhausted(self) -> bool:
        """Whether the budget or the time is used up."""
        estimator = self._comparison.estimator
        return estimator.deadline.is_over or estimator.work > self._budget

    def improve(self, model: FittedModel, equations: list[int]) -> FittedModel:
        """Return the result of the descent that begins with `model` and changes `equations`."""
        waiting = list(equations)
        while waiting and not self.is_exhausted:
            equation = waiting.pop(0)
            following = self._improve_equation(model, equation)
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
        """Set constants of one equation to 0, 1 or -1, as long as such a step shortens the description.

        The constants are tried in the order of their distance from 0, 1 or -1, in standard errors (Wald's test). So
        each step takes one or two fits. There are few constants, so this is done even if the budget is used up.
        """
        while True:
            following = None
            for program in islice(self._with_one_neutral_constant(model, equation), 2):
                following = self._comparison.fit_replacement(model, equation, program, SETTINGS.effort.brief_steps)
                if following is not None and following.nats < model.nats - SETTINGS.selection.least_gain:
                    break
                following = None
            if following is None:
                return model
            model = following
        return model

    def _with_one_neutral_constant(self, model: FittedModel, equation: int) -> Iterator[Program]:
        """Yield programs with one constant set to 0, 1 or -1, the most promising first.

        Constants of infinite variance, which the data do not determine, come first. The other constants are sorted by
        their distance. If the residuals are integration errors, they do not show the uncertainty of constants. Then the
        upper limit of integration errors is used instead of the residuals.
        """
        program = model.programs[equation]
        fit = model.fit
        own = np.flatnonzero(fit.system.owners == equation + len(self._comparison.leading))
        inflation = self._comparison.score.inflation(model) * self._comparison.score.integration_error_factor(model)
        variances = fit.system.by_place(inflation * np.diag(covariance(fit)), 2)[:, own]
        values = fit.system.by_place(fit.system.values)[:, own]
        priced: list[tuple[float, float, int, float]] = []
        for number, place in enumerate(constant_places(program)):
            for neutral in _NEUTRAL:
                away = values[:, number] - neutral
                nats = float((0.5 * away**2 / np.maximum(variances[:, number], 1e-300)).sum())
                priced.append((nats, float(np.abs(away).max()), place, neutral))
        length = self._comparison.score.length(program)
        for nats, _, place, neutral in sorted(priced):
            shorter = [collected(with_constants(program, {place: neutral}))]
            shorter += multiply_out(program, place) if neutral == 1.0 else ()
            yield from (one for one in shorter if nats < length - self._comparison.score.length(one))

    def _is_new(
        self, known_lengths: dict[tuple[int, tuple[bytes, ...]], float], model: FittedModel, equation: int
    ) -> bool:
        """Tell whether this change of a system is new: the system and `equation` are not in `known_lengths`, or only
        with a longer description. A new one is added."""
        system = equation, tuple(map(structure, model.programs))
        if model.nats > known_lengths.get(system, math.inf) - SETTINGS.selection.least_gain:
            return False
        known_lengths[system] = model.nats
        return True

    def _improve_equation(self, model: FittedModel, equation: int) -> FittedModel:
        best = self._shorten(model, equation)
        if not self._is_new(self._explored, best, equation):
            return best
        programs = self._neighbours(equation, best.programs[equation])
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
