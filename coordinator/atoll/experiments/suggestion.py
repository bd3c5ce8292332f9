"""How sure one is which of two equations is right, in words.

The experiments that are worth most, as they are said.

The next experiments that are worth most for their cost.

Experiments are tried all over the bounds, the best improved one number after the other, and of those that are alike the
best is kept. Where candidates differ, an experiment is worth what it is expected to tell about which is right; where
they do not, or there is only one, what it is expected to tell of its constants.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from atoll.experiments.alternatives import WeightedSystem, rivals_of
from atoll.experiments.designs import (
    NONE,
    Cost,
    Design,
    DesignPredictor,
    DesignRequest,
    DesignSpace,
    Gain,
    certainties,
    distance_after,
    distances_of,
    expected_gain,
    needed,
    precision,
    space_of,
)
from atoll.experiments.fits import FittedEquations, constants_of, fit_shown, measured_of
from atoll.model.equations import outside_sentence
from atoll.terminal.output import attributes, plain
from atoll_coordinator.result.result import Result
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.frames import FrameLibrary, frame_of
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from atoll_core.expression.program import Program
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.quoting import enumerated, first_lines

if TYPE_CHECKING:
    import polars

UNDECIDED: Final = 3.0
DECIDED: Final = 20.0
"""Odds below which data do not decide between two, and from which they do.

By Kass and Raftery (1995, doi 10.1080/01621459.1995.10476572) odds below 3 are "not worth more than a bare mention",
and those from 20 on strong.
"""
_MOST_ODDS: Final = 1e6
_SUREST: Final = 0.999
_NOTHING: Final = 0.01
"""Nats that are no difference."""


def odds_text(odds: float) -> str:
    """Return odds of at least 1 as a number of times, bounded."""
    if odds >= _MOST_ODDS:
        return "more than a million times"
    return f"{odds:.2g} times" if odds < 100.0 else f"{float(f'{odds:.1g}'):,.0f} times"


def which_of_two(first: str, second: str, nats: float) -> str:
    """Return which of two candidates the data favour, and how strongly, in a sentence.

    Args:
        first: what one candidate is called.
        second: what the other is called.
        nats: logarithm of the odds for the first; negative where the data favour the second.
    """
    if nats < 0.0:
        return which_of_two(second, first, -nats)
    if nats < _NOTHING:
        return f"{first} and {second} describe the data equally well."
    odds = math.exp(min(nats, 2.0 * math.log(_MOST_ODDS)))
    shares = "" if odds >= 100.0 else f" ({100.0 * odds / (1.0 + odds):.0f} to {100.0 / (1.0 + odds):.0f} %)"
    by = f"{first} is {odds_text(odds)} as probable as {second}{shares}"
    if odds < UNDECIDED:
        return f"The data do not decide between {first} and {second}: {by}, if one of them is right."
    strongly = "decide for" if odds >= DECIDED else "favour, without deciding for it,"
    return f"The data {strongly} {first}: {by}, if one of them is right."


def certainty_text(certainty: float) -> str:
    """Return a lower bound of a probability, never rounded up."""
    if certainty >= _SUREST:
        return f"more than {100.0 * _SUREST:.1f} %"
    return f"at least {math.floor(100.0 * certainty):.0f} %"


SCHEMA: Final = 1

Purpose = Literal["discrimination", "precision"]
"""To tell candidates apart, or to determine the constants of the only one."""


_SURE: Final = 0.95
"""From which probability on an experiment counts as telling two candidates apart."""
_WEIGHTS: Final = (
    "weights are by how well the data are described alone (Akaike); the result also counts how long equations are"
)


def equations_text(equations: Mapping[str, str]) -> str:
    """Return equations, right-hand sides by left-hand side, in a line."""
    return "; ".join(f"{side} = {text}" for side, text in equations.items())


@dataclass(frozen=True)
class CandidateSystem:
    """A candidate with its fitted constants: `equations` by left-hand side, `origin` where it comes from.

    Its `weight` among all candidates is Akaike's, by how well it describes the data alone; `nats` how far it is behind
    the best one: ln of the ratio of weights. `longer` is how many nats more than the shown one its description has,
    which is what results choose by: it also counts what the equations are made of. `written` are the equations with the
    constants of the result, where these are others; empty where not.
    """

    equations: Mapping[str, str]
    origin: str
    weight: float
    nats: float
    longer: float = 0.0
    written: Mapping[str, str] = field(default_factory=dict)

    @property
    def origin_text(self) -> str:
        """Where it comes from, and how much longer its description is than that of the equations shown."""
        if self.origin == "shown":
            return self.origin
        return f"{self.origin}, Δ description length {self.longer:.3g}"


@dataclass(frozen=True)
class Suggestion:
    """An experiment: a trajectory from the `initial` state with constant `inputs`, measured at `times`.

    `information` in nats is what its outcome is expected to tell, about which candidate is right or of the constants;
    `evidence` how many nats the right candidate is expected to gain on the others, 2,000 at most. `worth` is what
    experiments are ranked by, over their cost: the evidence, of each pair of candidates as much as decides, or the
    information about constants. `worst` is the constant of largest relative error, with that error before and after
    the experiment (None where candidates are told apart). `certainties` are the probabilities, at least, of telling the
    first candidate from each other one rightly after the experiment, if one of the two is right; empty where constants
    are determined. `remark` says where the start lies outside of what was measured, "" where it does not.
    """

    initial: Mapping[str, float]
    inputs: Mapping[str, float]
    times: tuple[float, ...] = field(repr=False)
    cost: float
    worth: float
    information: float
    evidence: float
    worst: tuple[str, float, float] | None = None
    certainties: tuple[float, ...] = ()
    remark: str = ""

    @property
    def certainty_text(self) -> str:
        """Which candidates are told apart, and how surely; "" where constants are determined."""
        if not self.certainties:
            return ""
        if len(self.certainties) == 1:
            return f"which of the two is right is known then with {certainty_text(self.certainties[0])} certainty"
        apart = [place for place, sure in enumerate(self.certainties, start=2) if sure >= _SURE]
        rest = [place for place, sure in enumerate(self.certainties, start=2) if sure < _SURE]
        parts = []
        if apart:
            least = min(self.certainties[place - 2] for place in apart)
            each = " each" if len(apart) > 1 else ""
            named = enumerated([*map(str, apart)])
            parts.append(f"tells 1 from {named} with {certainty_text(least)} certainty{each}")
        if rest:
            parts.append(f"does not surely tell 1 from {enumerated([*map(str, rest)])}")
        return ", ".join(parts)

    @property
    def worth_per_cost(self) -> float:
        """What it is ranked by, nats per unit of its cost."""
        return self.worth / self.cost

    @property
    def initial_text(self) -> str:
        """Where it begins, and with which inputs."""
        return ", ".join(f"{name} = {value:.4g}" for name, value in {**self.initial, **self.inputs}.items())

    @property
    def samples_text(self) -> str:
        """How often and how long is measured."""
        return f"{len(self.times)} samples from {self.times[0]:.4g} to {self.times[-1]:.4g}"

    def as_dict(self) -> dict[str, object]:
        """Return it as plain data."""
        of_trajectory = attributes(self, "initial", "inputs", "times", "cost")
        gain = attributes(self, "worth", "worth_per_cost", "information", "evidence")
        heads = ("name", "relative_error", "expected_relative_error")
        worst = None if self.worst is None else dict(zip(heads, self.worst, strict=True))
        told_apart = attributes(self, "certainties", "remark")
        return plain(of_trajectory | gain | {"worst_constant": worst} | told_apart)


@dataclass(frozen=True)
class Suggestions:
    """Experiments in the order of what they tell per cost.

    `purpose` and `reason` say what for and why; `entropy` in nats is how undecided the candidates are, the most that an
    experiment can tell about them. `bounds` are what is searched of initial states and inputs; of `measured` the
    range of the smoothed data. `source` says which data.
    """

    purpose: Purpose
    reason: str
    entropy: float
    candidates: tuple[CandidateSystem, ...]
    experiments: tuple[Suggestion, ...]
    bounds: Mapping[str, tuple[float, float]]
    measured: tuple[str, ...]
    cost: Cost
    source: str

    def __str__(self) -> str:
        lines = [*self._candidate_lines(), f"purpose: {self.purpose_text}"]
        parts = [
            f"{name} {low:.4g} to {high:.4g} ({'of the data, smoothed' if name in self.measured else 'given'})"
            for name, (low, high) in self.bounds.items()
        ]
        lines.append("searched: " + ", ".join(parts))
        for number, experiment in enumerate(self.experiments, start=1):
            where, samples = experiment.initial_text, experiment.samples_text
            lines.append(f"experiment {number}: {where}; {samples}; {self._worth(experiment)}")
            lines += [f"  warning: {experiment.remark}"] if experiment.remark else []
        return "\n".join(lines)

    def __repr__(self) -> str:
        return first_lines(str(self), "print it")

    @property
    def verdict(self) -> str:
        """Which of the two likeliest candidates the data favour so far, and how strongly; "" of one alone."""
        if len(self.candidates) < 2:
            return ""
        first, second = self.candidates[:2]
        return which_of_two("candidate 1", "candidate 2", second.nats - first.nats)

    def to_frame(self, library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
        """Return the experiments, a row each: initial state and inputs by name, `since`, `until`, `samples`, `cost`, …

        As a frame of ``"polars"`` or ``"pandas"``; raises UsageError if it is missing.
        """
        experiments = self.experiments
        names = [*experiments[0].initial, *experiments[0].inputs] if experiments else []
        columns: dict[str, list[object]] = {
            name: [{**each.initial, **each.inputs}[name] for each in experiments] for name in names
        }
        columns["since"] = [each.times[0] for each in experiments]
        columns["until"] = [each.times[-1] for each in experiments]
        columns["samples"] = [len(each.times) for each in experiments]
        for name in ("cost", "information", "remark"):
            columns[name] = [getattr(each, name) for each in experiments]
        return frame_of(columns, library)

    @property
    def purpose_text(self) -> str:
        """What the experiments are for, and why."""
        purpose = "to tell them apart" if self.purpose == "discrimination" else "to determine constants"
        return f"{purpose}, since {self.reason}"

    def _candidate_lines(self) -> list[str]:
        lines = [f"candidates, their constants fitted again ({self.source}):"]
        for number, candidate in enumerate(self.candidates, start=1):
            origin, texts = candidate.origin_text, equations_text(candidate.equations)
            lines.append(f"  {number}. weight {candidate.weight:.2g} ({origin})  {texts}")
            if candidate.written:
                lines.append(f"     with the constants of the result  {equations_text(candidate.written)}")
        if self.candidates and self.candidates[0].origin != "shown":
            lines.append(_WEIGHTS)
        return [*lines, *filter(None, [self.verdict])]

    def _worth(self, experiment: Suggestion) -> str:
        per = "" if self.cost == "trajectory" else f" ({experiment.worth_per_cost:.3g} per unit of {self.cost})"
        if experiment.worst is None:
            doubt = min(experiment.information / self.entropy, 1.0) if self.entropy > 0.0 else 0.0
            return f"{experiment.certainty_text}; resolves {100.0 * doubt:.0f} % of the doubt{per}"
        name, before, after = experiment.worst
        shrinks = f"the error of {name} from {100 * before:.2g} to {100 * after:.2g} %"
        return f"{experiment.information:.3g} nats about the constants expected{per}, {shrinks}"

    def as_dict(self) -> dict[str, object]:
        """Return all of it as plain data, as ``coordinator suggest --json`` prints it."""
        about = {
            "schema": SCHEMA,
            **attributes(self, "purpose", "reason", "entropy"),
            "candidates": [asdict(candidate) for candidate in self.candidates],
            "bounds": self.bounds,
            "bounds_of_data": self.measured,
            "cost": self.cost,
            "data": self.source,
            "experiments": [experiment.as_dict() for experiment in self.experiments],
        }
        return plain(about)


_IMPROVED: Final = 6
"""Experiments that are improved, the best of those that differ, and looked at closely."""
_ROUNDS: Final = (0.1, 0.1, 0.03, 0.03)
"""Steps of an improvement, over the widths of the bounds."""
_REFITTED: Final = 5
"""Candidates, the heaviest, that are fitted to each other's outcomes of the best experiments."""
_TOO_MANY: Final = 10
"""Experiments of a kind that would not decide between candidates: then another purpose serves better."""


def suggest(result: Result, request: DesignRequest, table: Table | None = None) -> Suggestions:
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
    return _Suggester(result, request, space, shown, rivals_of(result, shown, given)).suggestions()


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
class _DesignSearch:
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


class _Suggester:
    """What is suggested for a result, and for which purpose."""

    def __init__(
        self,
        result: Result,
        request: DesignRequest,
        space: DesignSpace,
        shown: FittedEquations,
        rivals: Sequence[WeightedSystem],
    ) -> None:
        self._result, self._request, self._space = result, request, space
        self._shown, self._rivals = shown, tuple(rivals)
        limits = space.limits(shown.measured.measurements.smoothed)
        self._sigmas = shown.errors.sigmas * np.sqrt(np.maximum(shown.measured.share, 1.0))
        self._candidates = [DesignPredictor(rival.fitted, space.widths, limits, self._sigmas) for rival in self._rivals]
        self._of_shown = DesignPredictor(shown, space.widths, limits, self._sigmas)
        self._weights = [rival.weight for rival in self._rivals]
        self._useful = needed([rival.length for rival in self._rivals])

    def suggestions(self) -> Suggestions:
        """Return all of it."""
        count, seed = self._request.count, self._request.seed
        chosen: list[_Tried] = []
        if len(self._rivals) > 1:
            chosen = _DesignSearch(self._space, self._discrimination, self._looked_at).best(count, seed)
        reason = self._reason(chosen)
        if reason is None:
            return self._said("discrimination", chosen, f"{len(self._rivals)} candidates differ")
        if not len(self._shown.values):
            raise UsageError(f"{reason}, and the model has no constants, so no experiment tells more")
        precise = _DesignSearch(self._space, self._precision).best(count, seed)
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

    def _candidate(self, rival: WeightedSystem) -> CandidateSystem:
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
        return CandidateSystem(fitted, rival.origin, rival.weight, rival.nats, rival.length - length, others)

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
