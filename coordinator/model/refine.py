"""After the search: the front's members polished, reduced and snapped; the shortest model is the equation."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from common.dataset import Problem
from common.expression.program import Program
from coordinator.model.criterion import NODE_NATS, Criterion
from coordinator.model.polish import Fitted, Polisher
from coordinator.model.neighbours import neighbours
from coordinator.model.rewrite import reductions, structure, tidied
from coordinator.model.snap import Model, snapped

MARGIN: Final = 40.0
MOST_MEMBERS: Final = 10
NEARLY: Final = 6.0
AROUND: Final = 12


class Refiner:
    def __init__(self, problem: Problem, operators: Sequence[int] = (2, 3, 4, 5, 6, 7)) -> None:
        self._operators = operators
        self._variables = len(problem.names)
        self.criterion = Criterion.of(problem.target)
        self.polisher = Polisher(problem)
        self._known: dict[bytes, tuple[Fitted, float]] = {}
        self._reduced: dict[bytes, Fitted] = {}

    def polished(self, program: Program, enough: float = 0.0) -> Fitted:
        key = structure(program)
        fit, asked = self._known.get(key, (None, 0.0))
        if fit is None or (asked > 0.0 and fit.mse > asked and not 0.0 < enough <= asked):
            fit = self.polisher.fit(program, enough=enough, steps=25 if enough else 40)
            self._known[key] = (fit, enough)
        return fit

    def candidates(self, programs: Sequence[Program]) -> list[Fitted]:
        fits = {structure(p): self.polished(p) for p in map(tidied, programs)}
        lengths = {key: self.criterion.length(fit) for key, fit in fits.items()}
        order = sorted(fits, key=lambda key: (lengths[key], key))
        least = lengths[order[0]]
        return [fits[key] for key in order[:MOST_MEMBERS] if lengths[key] <= least + MARGIN]

    def reduced(self, fitted: Fitted) -> Fitted:
        """Follow the best reduction until none is shorter."""
        path = []
        while True:
            key = structure(fitted.program)
            if key in self._reduced:
                fitted = self._reduced[key]
                break
            path.append(key)
            following = self._step(fitted)
            if following is None:
                break
            fitted = following
        for key in path:
            self._reduced[key] = fitted
        return fitted

    def _step(self, fitted: Fitted) -> Fitted | None:
        length = self.criterion.length(fitted)
        best = None
        for program in reductions(fitted.program):
            enough = self.criterion.enough(length - NODE_NATS * len(program))
            fit = self.polished(program, enough)
            its = self.criterion.length(fit)
            if its < length:
                best, length = fit, its
        return best

    def refine(self, programs: Sequence[Program], climb: bool = True) -> list[Model]:
        ends = {structure(fit.program): fit for fit in map(self.reduced, self.candidates(programs))}
        models = {key: snapped(fit, self.criterion, self.polisher) for key, fit in ends.items()}
        best = min(models, key=lambda key: models[key].length)
        while climb and ends[best].mse > self.criterion.limit:
            for fit in self._around(ends[best]):
                key = structure(fit.program)
                if key not in models:
                    ends[key] = fit
                    models[key] = snapped(fit, self.criterion, self.polisher)
            following = min(models, key=lambda key: models[key].length)
            if following == best:
                break
            best = following
        return sorted(models.values(), key=lambda m: m.length)

    def _around(self, fitted: Fitted) -> list[Fitted]:
        length = self.criterion.length(fitted) + NEARLY
        found: dict[str, tuple[float, Fitted]] = {}
        for program in neighbours(fitted.program, self._variables, self._operators):
            fit = self.polished(program, self.criterion.enough(length - NODE_NATS * len(program)))
            its = self.criterion.length(fit)
            key = f"{fit.mse:.6g}"
            if its < length and its < found.get(key, (length, fit))[0]:
                found[key] = (its, fit)
        best = sorted(found.values(), key=lambda each: (each[0], structure(each[1].program)))[:AROUND]
        return list({structure(end.program): end for end in (self.reduced(fit) for _, fit in best)}.values())
