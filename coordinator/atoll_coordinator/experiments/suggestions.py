"""The next experiments that are worth most for their cost.

Experiments are tried all over the bounds, the best improved one number after the other, and of those that are alike the
best is kept. Where candidates differ, an experiment is worth what it is expected to tell about which is right; where
they do not, or there is only one, what it is expected to tell of its constants.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from atoll.analysis.box import Box
from atoll.data.dataset import FloatArray
from atoll.data.table import Table
from atoll.errors import AtollError, UsageError
from atoll.experiments.suggestions import COSTS, Candidate, Cost, Suggestion, Suggestions
from atoll_coordinator.experiments.designs import (
    NONE,
    Design,
    Foreteller,
    Foretold,
    Gain,
    distance_after,
    distances_of,
    needed,
    precision,
    told,
)
from atoll_coordinator.experiments.measured import Measured, measured_of
from atoll_coordinator.experiments.rivals import Rival, rivals_of
from atoll_coordinator.experiments.systems import Fitted, constants_of, fit_shown
from atoll_coordinator.settings import SETTINGS

MOST_SAMPLES: Final = 2_000
MOST_SUGGESTIONS: Final = 20
_POINTS: Final = 192
"""Initial states and inputs that are tried, per length of an experiment all over the bounds."""
_SHORTER: Final = (1.0, 0.5, 0.25, 0.125)
"""Shares of the duration, or of the samples, that are tried where these cost something."""
_FEWEST_SAMPLES: Final = 8
_IMPROVED: Final = 6
"""Experiments that are improved, the best of those that differ."""
_ROUNDS: Final = (0.1, 0.03)
"""Steps of an improvement, over the widths of the bounds."""
_REFITTED: Final = 5
"""Candidates, the heaviest, that are fitted to each other's outcomes of the best experiments."""
_APART: Final = 0.25
"""Share of the width by which suggestions differ in at least one number."""
_TOO_MANY: Final = 10
"""Experiments of a kind that would not decide between candidates: then another purpose serves better."""


@dataclass(frozen=True)
class Request:
    """What is asked for.

    `bounds` are of initial states and inputs by name (others are those of the data); `duration` and `samples` are those
    of an experiment (None: as the median trajectory that was measured, and in the most even way); `cost` is what an
    experiment costs, `count` how many are suggested; `rivals` are further systems, right-hand sides by state.
    """

    bounds: Mapping[str, tuple[float, float]]
    duration: float | None = None
    samples: int | None = None
    cost: Cost = "trajectory"
    count: int = 3
    seed: int = 0
    rivals: Sequence[Mapping[str, str]] = ()


def suggest(found: Mapping[str, Any], request: Request, table: Table | None = None) -> Suggestions:
    """Return the experiments to make next for a result (the content of result.json), the best first.

    Raises:
        UsageError: a number or name of the request does not fit, or there are no measurements.
        AtollError: the model cannot be simulated within the bounds.
    """
    _check(request)
    measured = measured_of(found, table)
    shown = fit_shown(measured, found)
    rivals = rivals_of(found, shown.measured, shown, _named(found, request.rivals))
    return _Search(found, shown, rivals, request).suggestions()


def _check(request: Request) -> None:
    if request.cost not in COSTS:
        raise UsageError(f"the cost is {', '.join(COSTS[:-1])} or {COSTS[-1]}, but {request.cost!r} was given")
    if request.duration is not None and not (math.isfinite(request.duration) and request.duration > 0.0):
        raise UsageError(f"the duration of an experiment must be above 0, but {request.duration!r} was given")
    if request.samples is not None and not 2 <= request.samples <= MOST_SAMPLES:
        raise UsageError(f"an experiment has 2 to {MOST_SAMPLES} samples, but {request.samples!r} were given")
    if not 1 <= request.count <= MOST_SUGGESTIONS:
        raise UsageError(f"1 to {MOST_SUGGESTIONS} experiments are suggested, but {request.count!r} were asked for")


def _named(found: Mapping[str, Any], rivals: Sequence[Mapping[str, str]]) -> list[dict[str, str]]:
    """Return the rivals by state, whether left-hand sides were written as x or as the result has them, dx/dt."""
    sides = {str(each["lhs"]): str(each["variable"]) for each in found["equations"]}
    sides |= {side.partition("/")[0]: name for side, name in sides.items()}
    return [{sides.get(side, side): text for side, text in each.items()} for each in rivals]


@dataclass(frozen=True, eq=False)
class _Tried:
    """An experiment with what is expected of it; `worth`, information and evidence per cost rank it, one by one."""

    design: Design
    cost: float
    gain: Gain

    @property
    def worth(self) -> tuple[float, float, float]:
        its = self.gain
        return its.worth / self.cost, its.information / self.cost, its.evidence / self.cost


class _Search:
    def __init__(self, found: Mapping[str, Any], shown: Fitted, rivals: Sequence[Rival], request: Request) -> None:
        self._found, self._shown, self._rivals, self._request = found, shown, tuple(rivals), request
        its = shown.measured.measurements
        self._states, self._inputs = its.variables[: len(its.scales)], its.variables[len(its.scales) :]
        time = (found.get("system") or {}).get("time")
        symbol = (found.get("symbols") or {}).get(time)
        self._clock = tuple(index for index, name in enumerate(self._inputs) if name == symbol)
        self._free = [name for index, name in enumerate(self._inputs) if index not in self._clock]
        self._box = self._bounded(its.smoothed, its.inputs)
        self._begin = float(np.median(its.times[its.bounds[:, 0]])) if self._clock else 0.0
        self._duration, self._samples = self._lengths(shown.measured)
        low, high = self._box.lower[: len(self._states)], self._box.upper[: len(self._states)]
        widths = high - low
        low, high = np.minimum(low, its.smoothed.min(axis=1)), np.maximum(high, its.smoothed.max(axis=1))
        reach = SETTINGS.shooting.blow_up_widths * np.maximum(high - low, 1e-300)
        limits = np.stack([low - reach, high + reach], axis=1)
        sigmas = shown.errors.sigmas * np.sqrt(np.maximum(shown.measured.share, 1.0))
        self._sigmas = sigmas
        self._foretellers = [Foreteller(each.fitted, widths, limits, sigmas) for each in self._rivals]
        self._of_shown = Foreteller(shown, widths, limits, sigmas)
        self._weights = [each.weight for each in self._rivals]
        self._useful = needed([each.length for each in self._rivals])

    def _bounded(self, states: FloatArray, inputs: FloatArray) -> Box:
        """Return the bounds of initial states and inputs: those that were given, else the range of the data."""
        symbols = self._found["symbols"]
        given = {symbols.get(name, name): its for name, its in self._request.bounds.items()}
        known = dict(
            zip(self._states, zip(states.min(axis=1).tolist(), states.max(axis=1).tolist(), strict=True), strict=True)
        )
        for name in self._free:
            values = inputs[self._inputs.index(name)]
            known[name] = (float(values.min()), float(values.max()))
        for name in given:
            if name not in known:
                raise UsageError(f"there is no '{name}' to bound; an experiment has {', '.join(known)}")
        bounds = {**known, **given}
        ends = np.array([bounds[name] for name in known], dtype=np.float64)
        for name, (low, high) in bounds.items():
            if (
                not (math.isfinite(low) and math.isfinite(high))
                or low > high
                or (name in given and low == high and name in self._states)
            ):
                raise UsageError(f"the bounds {low:g}:{high:g} of '{name}' are no interval; give LOWER:UPPER")
        return Box(ends[:, 0].copy(), ends[:, 1].copy())

    def _lengths(self, measured: Measured) -> tuple[float, int]:
        """Return the duration and the number of samples of an experiment."""
        its = measured.measurements
        whole = [its.times[its.owners_of_rows == owner] for owner in np.unique(its.owners)]
        lasted = float(np.median([times[-1] - times[0] for times in whole]))
        rows = float(np.median([len(times) for times in whole])) * measured.rows / its.rows
        samples = self._request.samples or min(max(round(rows), 2), MOST_SAMPLES)
        return self._request.duration or lasted, samples

    # ------------------------------------------------------------------------------------------- what is found

    def suggestions(self) -> Suggestions:
        """Return what is suggested, and for which purpose."""
        entropy = -sum(weight * math.log(weight) for weight in self._weights if weight > 0.0)
        chosen = self._best(self._discrimination, self._looked_at) if len(self._rivals) > 1 else []
        reason = self._reason(chosen)
        if reason is None:
            return self._said("discrimination", entropy, chosen, f"{len(self._rivals)} candidates differ")
        if not len(self._shown.values):
            raise AtollError(f"{reason}, and the model has no constants, so no experiment tells more")
        precise = self._best(self._precision)
        if not precise:
            raise AtollError("the model cannot be simulated from any initial state within the bounds; give others")
        return self._said("precision", entropy, precise, reason)

    def _reason(self, chosen: Sequence[_Tried]) -> str | None:
        """Return why experiments do not serve to tell candidates apart; None where they do."""
        if len(self._rivals) < 2:
            return "there is only one candidate"
        best = max((each.gain.evidence for each in chosen), default=0.0)
        if best * _TOO_MANY < SETTINGS.inference.distinct_nats:
            return f"all {len(self._rivals)} candidates foretell the same within the bounds"
        return None

    def _discrimination(self, design: Design) -> Gain:
        return self._told([each.at(design) for each in self._foretellers])

    def _told(self, foretold: Sequence[Foretold]) -> Gain:
        return told(distances_of(foretold, self._weights), self._weights, self._useful)

    def _looked_at(self, its: _Tried) -> _Tried:
        """Return an experiment with what is expected of it, the heaviest candidates fitted to its outcomes."""
        foretold = [each.at(its.design) for each in self._foretellers]
        distances = distances_of(foretold, self._weights)
        heaviest = sorted(range(len(foretold)), key=lambda place: -self._weights[place])[:_REFITTED]
        for i in heaviest:
            if foretold[i].reached < len(its.design.times):
                continue
            for j in heaviest:
                if i != j:
                    pair = self._rivals[i].fitted, self._rivals[j].fitted
                    distances[i, j] = distance_after(*pair, its.design, foretold[i], self._sigmas)
        return replace(its, gain=told(distances, self._weights, self._useful))

    def _precision(self, design: Design) -> Gain:
        return precision(self._of_shown.at(design), len(self._shown.values))[0]

    def _said(self, purpose: str, entropy: float, chosen: Sequence[_Tried], reason: str) -> Suggestions:
        names = [*self._states, *self._free]
        ends = zip(self._box.lower.tolist(), self._box.upper.tolist(), strict=True)
        symbols = self._found["symbols"]
        given = {symbols.get(name, name) for name in self._request.bounds}
        return Suggestions(
            "discrimination" if purpose == "discrimination" else "precision",
            reason,
            entropy,
            tuple(self._candidate(each) for each in self._rivals),
            tuple(self._suggestion(each, is_precise=purpose == "precision") for each in chosen),
            dict(zip(names, ends, strict=True)),
            tuple(name for name in names if name not in given),
            self._request.cost,
            self._shown.measured.source,
        )

    def _candidate(self, its: Rival) -> Candidate:
        fitted = its.fitted
        programs = fitted.fit.system.programs[-len(fitted.equations.programs) :]
        from atoll.expression.text.infix import to_infix

        sides = {str(each["variable"]): str(each["lhs"]) for each in self._found["equations"]}
        texts = {
            sides[name]: to_infix(program, fitted.equations.names, digits=4)
            for name, program in zip(fitted.equations.variables, programs, strict=True)
        }
        return Candidate(texts, its.origin, its.weight, its.nats)

    def _suggestion(self, its: _Tried, *, is_precise: bool) -> Suggestion:
        design = its.design
        held = {name: float(design.inputs[self._inputs.index(name)]) for name in self._free}
        worst = self._worst(design) if is_precise else None
        return Suggestion(
            dict(zip(self._states, design.initial.tolist(), strict=True)), held, tuple(design.times.tolist()),
            its.cost, its.gain.worth, its.gain.information, its.gain.evidence, worst,
        )  # fmt: skip

    def _worst(self, design: Design) -> tuple[str, float, float]:
        """Return the constant whose relative error is largest, and that error before and after an experiment."""
        count = len(self._shown.values)
        before = self._of_shown.covariance
        root = np.linalg.cholesky(before)
        after = root @ precision(self._of_shown.at(design), count)[1] @ root.T
        sizes = np.maximum(np.abs(self._shown.values), 1e-300)
        relative = np.sqrt(np.diag(before)) / sizes
        index = int(np.argmax(relative))
        name = constants_of(self._shown.equations, self._found)[index].name
        return name, float(relative[index]), float(math.sqrt(max(after[index, index], 0.0)) / sizes[index])

    # ------------------------------------------------------------------------------------------- the search

    def _best(
        self, gain: Callable[[Design], Gain], looked_at: Callable[[_Tried], _Tried] = lambda tried: tried
    ) -> list[_Tried]:
        """Return the experiments of most worth, each other than the ones before; the best are looked at closely."""
        tried = [self._tried(point, share, gain) for share in self._shares for point in self._points()]
        count = max(_IMPROVED, self._request.count)
        improved = [self._improved(each, gain) for each in self._apart(tried, count)]
        return self._apart([looked_at(each) for each in self._apart([*improved, *tried], count)], self._request.count)

    @property
    def _shares(self) -> tuple[float, ...]:
        return (1.0,) if self._request.cost == "trajectory" else _SHORTER

    def _points(self) -> FloatArray:
        """Return points all over the bounds, and their corners where these are few."""
        count = max(_POINTS // len(self._shares), 32)
        inner = self._box.points(count, self._request.seed)
        size = len(self._box.lower)
        if size > 5:
            return inner
        corners = np.array(np.meshgrid(*([(0.02, 0.98)] * size), indexing="ij")).reshape(size, -1).T
        return np.concatenate([inner, self._box.lower + corners * self._box.widths])

    def _tried(self, point: FloatArray, share: float, gain: Callable[[Design], Gain]) -> _Tried:
        design = self._design(point, share)
        cost = {"trajectory": 1.0, "duration": float(design.times[-1] - design.times[0]), "samples": len(design.times)}
        found = gain(design)
        is_finite = math.isfinite(found.worth) and math.isfinite(found.information)
        return _Tried(design, float(cost[self._request.cost]), found if is_finite else NONE)

    def _design(self, point: FloatArray, share: float) -> Design:
        duration = self._duration * (share if self._request.cost == "duration" else 1.0)
        least = min(_FEWEST_SAMPLES, self._samples)
        samples = max(round(self._samples * share), least) if self._request.cost == "samples" else self._samples
        inputs = np.zeros(len(self._inputs))
        for name, value in zip(self._free, point[len(self._states) :].tolist(), strict=True):
            inputs[self._inputs.index(name)] = value
        times = self._begin + np.linspace(0.0, duration, samples)
        return Design(np.array(point[: len(self._states)]), inputs, times, self._clock)

    def _point(self, design: Design) -> FloatArray:
        free = [float(design.inputs[self._inputs.index(name)]) for name in self._free]
        return np.concatenate([design.initial, np.array(free)])

    def _share(self, design: Design) -> float:
        if self._request.cost == "duration":
            return float(design.times[-1] - design.times[0]) / self._duration
        return len(design.times) / self._samples if self._request.cost == "samples" else 1.0

    def _improved(self, begun: _Tried, gain: Callable[[Design], Gain]) -> _Tried:
        """Return an experiment moved to more worth, one number after the other."""
        best = begun
        for step in _ROUNDS:
            for _ in range(2):
                before = best
                for moved in self._moved(best, step):
                    there = self._tried(moved, self._share(best.design), gain)
                    best = there if there.worth > best.worth else best
                if best is before:
                    break
        return best

    def _moved(self, its: _Tried, step: float) -> Iterator[FloatArray]:
        point = self._point(its.design)
        for index, width in enumerate(self._box.widths.tolist()):
            for sign in (-1.0, 1.0):
                moved = point.copy()
                moved[index] = min(
                    max(moved[index] + sign * step * width, self._box.lower[index]), self._box.upper[index]
                )
                yield moved

    def _apart(self, tried: Sequence[_Tried], count: int) -> list[_Tried]:
        """Return the best of experiments that differ in at least one number, without those that are worth nothing."""
        kept: list[_Tried] = []
        widths = np.maximum(self._box.widths, 1e-300)
        for each in sorted(tried, key=lambda its: its.worth, reverse=True):
            here = self._point(each.design) / widths
            far = all(np.abs(here - self._point(other.design) / widths).max() >= _APART for other in kept)
            if far and each.gain.worth > 0.0:
                kept.append(each)
                if len(kept) == count:
                    break
        return kept
