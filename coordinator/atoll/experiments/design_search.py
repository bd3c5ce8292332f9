"""The next experiments that are worth most for their cost.

Experiments are tried all over the bounds, the best improved one number after the other, and of those that are alike the
best is kept. Where candidates differ, an experiment is worth what it is expected to tell about which is right; where
they do not, or there is only one, what it is expected to tell of its constants.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll.experiments.designs import (
    NONE,
    Design,
    Foreteller,
    Gain,
    certainties,
    distance_after,
    distances_of,
    expected_gain,
    needed,
    precision,
)
from atoll.experiments.measured import measured_of
from atoll.experiments.rivals import Rival, rivals_of
from atoll.experiments.space import DesignSpace, Request, space_of
from atoll.experiments.suggestion import Candidate, Purpose, Suggestion, Suggestions
from atoll.experiments.systems import Fitted, constants_of, fit_shown
from atoll.model.ranges import outside_sentence
from atoll_coordinator.result.result import Result
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from atoll_core.expression.program import Program
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix

_IMPROVED: Final = 6
"""Experiments that are improved, the best of those that differ, and looked at closely."""
_ROUNDS: Final = (0.1, 0.1, 0.03, 0.03)
"""Steps of an improvement, over the widths of the bounds."""
_REFITTED: Final = 5
"""Candidates, the heaviest, that are fitted to each other's outcomes of the best experiments."""
_TOO_MANY: Final = 10
"""Experiments of a kind that would not decide between candidates: then another purpose serves better."""


def suggest(result: Result, request: Request, table: Table | None = None) -> Suggestions:
    """Return the experiments to make next for a result, the best first.

    Raises:
        UsageError: a number or name of the request does not fit, there are no measurements, the model cannot be
            simulated within the bounds, or it has neither candidates nor constants that an experiment could tell of.
    """
    request.check()
    shown = fit_shown(measured_of(result, table), result)
    space = space_of(result, shown.measured, request)
    # left-hand sides of rivals are written as x, as the result has them (dx/dt), or dx
    sides = {equation.lhs: equation.variable for equation in result.equations}
    sides |= {side.partition("/")[0]: name for side, name in sides.items()}
    given = [{sides.get(side, side): text for side, text in rival.items()} for rival in request.rivals]
    return _Report(result, request, space, shown, rivals_of(result, shown, given)).suggestions()


@dataclass(frozen=True, eq=False)
class _Tried:
    """An experiment with what is expected of it; `worth`, information and evidence per cost rank it, one by one."""

    design: Design
    cost: float
    gain: Gain
    certainties: tuple[float, ...] = ()

    @property
    def worth(self) -> tuple[float, float, float]:
        gain = self.gain
        return gain.worth / self.cost, gain.information / self.cost, gain.evidence / self.cost


@dataclass(frozen=True)
class _Search:
    """Finds the experiments of most worth by what `value` says of each, the best looked at again by `look`."""

    space: DesignSpace
    value: Callable[[Design], Gain]
    look: Callable[[_Tried], _Tried] = lambda tried: tried

    def best(self, count: int, seed: int) -> list[_Tried]:
        """Return `count` experiments that differ, the best first; fewer where others are worth nothing."""
        space, most = self.space, max(_IMPROVED, count)
        points = space.points(seed)
        tried = [self._tried(space.design(point, share)) for share in space.shares for point in points]
        improved = [self._improved(experiment) for experiment in self._apart(tried, most)]
        return self._apart([self.look(experiment) for experiment in self._apart([*improved, *tried], most)], count)

    def _tried(self, design: Design) -> _Tried:
        gain = self.value(design)
        is_finite = math.isfinite(gain.worth) and math.isfinite(gain.information)
        return _Tried(design, self.space.price(design), gain if is_finite else NONE)

    def _improved(self, best: _Tried) -> _Tried:
        """Return an experiment moved to more worth, one number after the other."""
        for step in _ROUNDS:
            for moved in self.space.around(self.space.point(best.design), step):
                neighbour = self._tried(self.space.design(moved, self.space.share(best.design)))
                best = neighbour if neighbour.worth > best.worth else best
        return best

    def _apart(self, tried: Sequence[_Tried], count: int) -> list[_Tried]:
        """Return the best of experiments that differ, without those that are worth nothing."""
        kept: list[_Tried] = []
        for experiment in sorted(tried, key=lambda experiment: experiment.worth, reverse=True):
            is_other = all(self.space.are_apart(experiment.design, other.design) for other in kept)
            if is_other and experiment.gain.worth > 0.0 and len(kept) < count:
                kept.append(experiment)
        return kept


class _Report:
    """What is suggested for a result, and for which purpose."""

    def __init__(
        self, result: Result, request: Request, space: DesignSpace, shown: Fitted, rivals: Sequence[Rival]
    ) -> None:
        self._result, self._request, self._space = result, request, space
        self._shown, self._rivals = shown, tuple(rivals)
        limits = space.limits(shown.measured.measurements.smoothed)
        self._sigmas = shown.errors.sigmas * np.sqrt(np.maximum(shown.measured.share, 1.0))
        self._candidates = [Foreteller(rival.fitted, space.widths, limits, self._sigmas) for rival in self._rivals]
        self._of_shown = Foreteller(shown, space.widths, limits, self._sigmas)
        self._weights = [rival.weight for rival in self._rivals]
        self._useful = needed([rival.length for rival in self._rivals])

    def suggestions(self) -> Suggestions:
        """Return all of it."""
        count, seed = self._request.count, self._request.seed
        chosen: list[_Tried] = []
        if len(self._rivals) > 1:
            chosen = _Search(self._space, self._discrimination, self._looked_at).best(count, seed)
        reason = self._reason(chosen)
        if reason is None:
            return self._said("discrimination", chosen, f"{len(self._rivals)} candidates differ")
        if not len(self._shown.values):
            raise UsageError(f"{reason}, and the model has no constants, so no experiment tells more")
        precise = _Search(self._space, self._precision).best(count, seed)
        if not precise:
            raise UsageError("the model cannot be simulated from any initial state within the bounds; give others")
        return self._said("precision", precise, reason)

    def _reason(self, chosen: Sequence[_Tried]) -> str | None:
        """Return why experiments do not serve to tell candidates apart; None where they do."""
        if len(self._rivals) < 2:
            return "there is only one candidate"
        if sum(weight > 0.0 for weight in self._weights) < 2:
            return f"the data have excluded all but one of {len(self._rivals)} candidates already"
        best = max((experiment.gain.evidence for experiment in chosen), default=0.0)
        if best * _TOO_MANY < SETTINGS.inference.distinct_nats:
            return f"all {len(self._rivals)} candidates predict the same within the bounds"
        return None

    def _discrimination(self, design: Design) -> Gain:
        foretold = [candidate.at(design) for candidate in self._candidates]
        return expected_gain(distances_of(foretold, self._weights), self._weights, self._useful)

    def _looked_at(self, tried: _Tried) -> _Tried:
        """Return an experiment with what is expected of it, the heaviest candidates fitted to its outcomes."""
        foretold = [candidate.at(tried.design) for candidate in self._candidates]
        distances = distances_of(foretold, self._weights)
        heaviest = sorted(range(len(foretold)), key=lambda place: -self._weights[place])[:_REFITTED]
        for i in heaviest:
            for j in heaviest:
                if i != j and foretold[i].reached == len(tried.design.times):
                    pair = self._rivals[i].fitted, self._rivals[j].fitted
                    distances[i, j] = distance_after(*pair, tried.design, foretold[i], self._sigmas)
        sure = certainties(distances, self._weights)
        return replace(tried, gain=expected_gain(distances, self._weights, self._useful), certainties=sure)

    def _precision(self, design: Design) -> Gain:
        return precision(self._of_shown.at(design), len(self._shown.values))[0]

    def _said(self, purpose: Purpose, chosen: Sequence[_Tried], reason: str) -> Suggestions:
        box, symbols = self._space.box, self._result.symbols
        given = {symbols.get(name, name) for name in self._request.bounds}
        ends = zip(box.lower.tolist(), box.upper.tolist(), strict=True)
        return Suggestions(
            purpose,
            reason,
            -sum(weight * math.log(weight) for weight in self._weights if weight > 0.0),
            tuple(self._candidate(rival) for rival in self._rivals),
            tuple(self._suggestion(tried, is_precise=purpose == "precision") for tried in chosen),
            dict(zip(self._space.names, ends, strict=True)),
            tuple(name for name in self._space.names if name not in given),
            self._request.cost,
            self._shown.measured.source,
        )

    def _candidate(self, rival: Rival) -> Candidate:
        equations = rival.fitted.equations
        programs = rival.fitted.fit.system.programs[-len(equations.programs) :]
        shown, length = self._result.equations, next(other.length for other in self._rivals if other.origin == "shown")

        def texts(programs: Iterable[Program]) -> dict[str, str]:
            sides = zip(shown, programs, strict=True)
            return {equation.lhs: to_infix(program, equations.names, digits=4) for equation, program in sides}

        fitted, written = texts(programs), {}
        if rival.origin == "shown":
            written = texts(from_infix(equation.expression or "", equations.names) for equation in shown)
        others = {} if written == fitted else written
        return Candidate(fitted, rival.origin, rival.weight, rival.nats, rival.length - length, others)

    def _suggestion(self, tried: _Tried, *, is_precise: bool) -> Suggestion:
        space, design = self._space, tried.design
        initial = dict(zip(space.states, design.initial.tolist(), strict=True))
        inputs = {space.inputs[index]: float(design.inputs[index]) for index in space.free}
        ends = zip(space.measured.lower.tolist(), space.measured.upper.tolist(), strict=True)
        return Suggestion(
            initial,
            inputs,
            tuple(design.times.tolist()),
            tried.cost,
            tried.gain.worth,
            tried.gain.information,
            tried.gain.evidence,
            self._worst(design) if is_precise else None,
            () if is_precise else tried.certainties,
            outside_sentence(initial | inputs, dict(zip(space.names, ends, strict=True))),
        )

    def _worst(self, design: Design) -> tuple[str, float, float]:
        """Return the constant whose relative error is largest, and that error before and after an experiment."""
        root = self._of_shown.root
        before, after = root @ root.T, root @ precision(self._of_shown.at(design), len(root))[1] @ root.T
        sizes = np.maximum(np.abs(self._shown.values), 1e-300)
        errors = [np.sqrt(np.maximum(np.diag(covariance), 0.0)) / sizes for covariance in (before, after)]
        index = int(np.argmax(errors[0]))
        name = constants_of(self._shown.equations, self._result)[index].name
        return name, float(errors[0][index]), float(errors[1][index])
