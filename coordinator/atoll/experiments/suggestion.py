"""Find the experiments with the largest worth per cost, and present them.

Experiments are tried all over the bounds. The best experiments are improved, one number after another, and the best
distinct experiments are kept. If candidates predict different outcomes, the worth of an experiment is the expected
evidence for the right candidate. Otherwise, or with only one candidate, it is the expected information about the
constants of the displayed equations.

The weights of candidates use the fit alone (Akaike). A result also counts the lengths of the equations. An experiment
should decide even against the simpler equation, so weights ignore simplicity. Therefore the displayed equations may
have a small weight if the data have few rows.

Doubtful: the search is local and starts from about 200 points, so it may miss the best experiment. All numbers assume
that one of the candidates is right.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from itertools import permutations
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar

import numpy as np

from atoll.experiments.alternatives import WeightedSystem, alternatives_of
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
    precision,
    space_of,
    useful_evidence,
)
from atoll.experiments.fits import EncodedData, EquationSetFit, constants_of, fit_displayed, measured_of
from atoll.model.equations import outside_sentence
from atoll.terminal.output import attributes, plain
from atoll_coordinator.model.batches import BatchFunction, Spread
from atoll_coordinator.result.result import Result
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.data.frames import FrameLibrary, frame_of
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.quoting import enumerated, first_lines

if TYPE_CHECKING:
    import polars

SCHEMA: Final = 1

Purpose = Literal["discrimination", "precision"]
"""To distinguish candidates, or to determine the constants of the only candidate."""

UNDECIDED: Final = 3.0
DECIDED: Final = 20.0
"""Data do not decide between two candidates at odds below `UNDECIDED`; they decide at odds of `DECIDED` or more.

Kass and Raftery (1995, doi 10.1080/01621459.1995.10476572) call odds below 3 "not worth more than a bare mention", and
odds of 20 or more strong.
"""
_MOST_ODDS: Final = 1e6
_LARGEST_CERTAINTY: Final = 0.999
_NEGLIGIBLE_NATS: Final = 0.01
"""Smallest difference in nats that is not negligible."""
_CERTAIN: Final = 0.95
"""An experiment counts as distinguishing two candidates if the lower bound of its probability of doing so is at least
this number."""
_WEIGHTS: Final = "weights use only the fit to the data (Akaike); the result also counts the lengths of the equations"
_IMPROVED: Final = 6
"""Number of the best distinct experiments that are improved and examined more accurately."""
_ROUNDS: Final = (0.1, 0.1, 0.03, 0.03)
"""Steps of an improvement, in widths of the bounds."""
_REFITTED: Final = 5
"""Number of candidates, with the largest weights, that are fitted to predicted outcomes of the best experiments."""
_MOST_REPETITIONS: Final = 10
"""If this number of equal experiments would not decide between candidates, the purpose becomes precision."""


# ---------------------------------------------------------------------------------------------------------------- odds


def which_of_two(first: str, second: str, nats: float) -> str:
    """Return a sentence that says which of two candidates the data favour, and how strongly.

    Args:
        first: the name of one candidate.
        second: the name of the other candidate.
        nats: the logarithm of the odds for the first candidate; it is negative if the data favour the second one.
    """
    if nats < 0.0:
        return which_of_two(second, first, -nats)
    if nats < _NEGLIGIBLE_NATS:
        return f"{first} and {second} describe the data equally well."
    odds = math.exp(min(nats, 2.0 * math.log(_MOST_ODDS)))
    shares = "" if odds >= 100.0 else f" ({100.0 * odds / (1.0 + odds):.0f} to {100.0 / (1.0 + odds):.0f} %)"
    times = f"{odds:.2g} times" if odds < 100.0 else f"{float(f'{odds:.1g}'):,.0f} times"
    if odds >= _MOST_ODDS:
        times = "more than a million times"
    odds_text = f"{first} is {times} as probable as {second}{shares}"
    if odds < UNDECIDED:
        return f"The data do not decide between {first} and {second}: {odds_text}, if one of them is right."
    if odds < DECIDED:
        return f"The data favour {first}, but do not decide: {odds_text}, if one of them is right."
    return f"The data decide for {first}: {odds_text}, if one of them is right."


def certainty_text_of(certainty: float) -> str:
    """Return the text of a lower bound of a probability; it is never rounded up."""
    if certainty >= _LARGEST_CERTAINTY:
        return f"more than {100.0 * _LARGEST_CERTAINTY:.1f} %"
    return f"at least {math.floor(100.0 * certainty):.0f} %"


def equations_text(equations: Mapping[str, str]) -> str:
    """Return equations (right-hand sides by left-hand side) in one line."""
    return "; ".join(f"{side} = {text}" for side, text in equations.items())


# --------------------------------------------------------------------------------------------------------- suggestions


@dataclass(frozen=True)
class CandidateSystem:
    """A candidate with its fitted constants: `equations` by left-hand side, `origin` of the candidate.

    `weight` is its Akaike weight among all candidates, which uses only the fit to the data. `nats` is the logarithm of
    a ratio: the largest weight divided by this weight. `longer` is its Δ description length relative to the displayed
    equations in nats; jobs choose equations by their description length. `written` are the equations with the constants
    of the result, if these differ from the fitted constants.
    """

    equations: Mapping[str, str]
    origin: str
    weight: float
    nats: float
    longer: float = 0.0
    written: Mapping[str, str] = field(default_factory=dict)

    @property
    def origin_text(self) -> str:
        """The origin, with the Δ description length relative to the displayed equations."""
        if self.origin == "shown":
            return self.origin
        return f"{self.origin}, Δ description length {self.longer:.3g}"


@dataclass(frozen=True)
class Suggestion:
    """An experiment: a trajectory from the `initial` state with constant `inputs`, measured at `times`.

    `information` is the expected information in nats about the right candidate, or about the constants. `evidence` is
    the expected Δ log-likelihood for the right candidate, at most 2,000 nats. `worth` divided by `cost` ranks
    experiments. If candidates are to be distinguished, `worth` is the evidence, limited for each pair of candidates to
    the amount that decides. Otherwise it is the information about constants. `worst` is the constant with the largest
    relative error, with this error before and after the experiment; it is None if the purpose is to distinguish
    candidates. `certainties` has a number for each candidate except the first one: a lower bound of the probability
    that the experiment correctly distinguishes this candidate from the first one, if one of the two is right. It is
    empty if the purpose is to determine constants. `remark` names initial values outside of the measured range; it is
    "" if there are none.
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
        """The distinguished candidates, with the certainty; "" if the purpose is to determine constants."""
        if not self.certainties:
            return ""
        if len(self.certainties) == 1:
            return f"decides between the two with {certainty_text_of(self.certainties[0])} certainty"
        distinguished = [place for place, sure in enumerate(self.certainties, start=2) if sure >= _CERTAIN]
        rest = [place for place, sure in enumerate(self.certainties, start=2) if sure < _CERTAIN]
        parts = []
        if distinguished:
            least = min(self.certainties[place - 2] for place in distinguished)
            each = " each" if len(distinguished) > 1 else ""
            parts.append(
                f"distinguishes 1 from {enumerated([*map(str, distinguished)])} "
                f"with {certainty_text_of(least)} certainty{each}"
            )
        if rest:
            parts.append(f"may fail to distinguish 1 from {enumerated([*map(str, rest)])}")
        return ", ".join(parts)

    @property
    def worth_per_cost(self) -> float:
        """The worth of the experiment in nats per unit of its cost, by which experiments are ranked."""
        return self.worth / self.cost

    @property
    def initial_text(self) -> str:
        """The initial state and the inputs."""
        return ", ".join(f"{name} = {value:.4g}" for name, value in {**self.initial, **self.inputs}.items())

    @property
    def samples_text(self) -> str:
        """The number of samples and their range in time."""
        return f"{len(self.times)} samples from {self.times[0]:.4g} to {self.times[-1]:.4g}"

    def as_dict(self) -> dict[str, object]:
        """Return the experiment as plain data."""
        heads = ("name", "relative_error", "expected_relative_error")
        worst = None if self.worst is None else dict(zip(heads, self.worst, strict=True))
        named = ("initial", "inputs", "times", "cost", "worth", "worth_per_cost", "information", "evidence")
        return plain(attributes(self, *named) | {"worst_constant": worst} | attributes(self, "certainties", "remark"))


@dataclass(frozen=True)
class Suggestions:
    """Experiments in descending order of worth per cost.

    `purpose` is the purpose of the experiments, `reason` the reason for this purpose. `entropy` is the entropy of the
    candidate weights in nats: the largest information that an experiment can give about the candidates. `bounds` are
    the searched ranges of initial states and inputs. For the names in `measured`, these are the ranges of the smoothed
    data. `source` names the data.
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
        lines = [f"candidates, with constants fitted again ({self.source}):"]
        for number, candidate in enumerate(self.candidates, start=1):
            origin, texts = candidate.origin_text, equations_text(candidate.equations)
            lines.append(f"  {number}. weight {candidate.weight:.2g} ({origin})  {texts}")
            if candidate.written:
                lines.append(f"     with the constants of the result  {equations_text(candidate.written)}")
        if self.candidates and self.candidates[0].origin != "shown":
            lines.append(_WEIGHTS)
        lines += [*filter(None, [self.verdict]), f"purpose: {self.purpose_text}"]
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

    def _worth(self, experiment: Suggestion) -> str:
        per = "" if self.cost == "trajectory" else f" ({experiment.worth_per_cost:.3g} per unit of {self.cost})"
        if experiment.worst is None:
            doubt = min(experiment.information / self.entropy, 1.0) if self.entropy > 0.0 else 0.0
            return f"{experiment.certainty_text}; resolves {100.0 * doubt:.0f} % of the uncertainty{per}"
        name, before, after = experiment.worst
        shrinks = f"the error of {name} falls from {100 * before:.2g} to {100 * after:.2g} %"
        return f"expected information about the constants: {experiment.information:.3g} nats{per}; {shrinks}"

    def __repr__(self) -> str:
        return first_lines(str(self), "print it")

    @property
    def verdict(self) -> str:
        """Which of the two most probable candidates the data favour, and how strongly; "" if there is only one."""
        if len(self.candidates) < 2:
            return ""
        first, second = self.candidates[:2]
        return which_of_two("candidate 1", "candidate 2", second.nats - first.nats)

    @property
    def purpose_text(self) -> str:
        """The purpose of the experiments, and the reason."""
        purpose = "to distinguish the candidates" if self.purpose == "discrimination" else "to determine constants"
        return f"{purpose}, because {self.reason}"

    def to_frame(self, library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
        """Return a ``"polars"`` or ``"pandas"`` frame with a row for each experiment.

        Its columns are the initial state and the inputs by name, `since`, `until`, `samples`, `cost`, `information` and
        `remark`. Raises UsageError without that library.
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

    def as_dict(self) -> dict[str, object]:
        """Return the suggestions as plain data, as ``coordinator suggest --json`` prints them."""
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


# -------------------------------------------------------------------------------------------------------------- search


def suggest(
    result: Result, request: DesignRequest, table: Table | None = None, spread: Spread | None = None
) -> Suggestions:
    """Return the next experiments for a result, the best first.

    `table` has the data; None stands for the data of the result. `spread` distributes the trials of experiments and the
    fits to their outcomes over workers.

    Raises:
        UsageError: a number or name of the request is invalid, there are no measurements, the model cannot be simulated
            within the bounds, or there is only one candidate and it has no constants.
    """
    request.check()
    if result.unmeasured or result.observations:
        names = ", ".join((*result.unmeasured, *(one.column for one in result.observations)))
        raise UsageError(
            "experiments are only suggested for models whose states are all measured; hidden, by run, or computed from "
            f"states: {names}; `coordinator analyse --identifiability` shows which constants are not determined"
        )
    displayed = fit_displayed(measured_of(result, table), result)
    space = space_of(result, displayed.measured, request)
    # users may call an equation x, dx, or dx/dt as in the result
    sides = {equation.lhs: equation.variable for equation in result.equations}
    sides |= {side.partition("/")[0]: name for side, name in sides.items()}
    given = tuple({sides.get(side, side): text for side, text in rival.items()} for rival in request.rivals)
    candidates = _Candidates.of(space, displayed, alternatives_of(result, displayed, given))
    parts = _CandidatesParts(EncodedData.of(result, table), given, space)
    search = _DesignSearch(candidates, lambda: parts, spread or Spread())
    return _Suggester(result, request, displayed, search).suggestions()


@dataclass(frozen=True, eq=False)
class _EvaluatedDesign:
    """An experiment with its expected gain; it is ranked by worth, then information, then evidence, each per cost."""

    design: Design
    cost: float
    gain: Gain
    certainties: tuple[float, ...] = ()

    @property
    def worth(self) -> tuple[float, float, float]:
        gain = self.gain
        return gain.worth / self.cost, gain.information / self.cost, gain.evidence / self.cost


@dataclass(frozen=True, eq=False)
class _Trial:
    """An experiment that is tried for a purpose."""

    purpose: Purpose
    design: Design


@dataclass(frozen=True, eq=False)
class _Improvement:
    """An experiment that is improved for a purpose."""

    purpose: Purpose
    best: _EvaluatedDesign


@dataclass(frozen=True, eq=False)
class _Outcome:
    """An outcome of an experiment that candidate `ahead` (an index) predicts, and to which `fitted` is fitted."""

    design: Design
    ahead: int
    fitted: int


@dataclass(frozen=True, eq=False)
class _Candidates:
    """The candidates `systems` in a `space` of experiments, with their predictors.

    `displayed` predicts for the displayed equations. `sigmas` (O,) are the measurement errors.
    """

    space: DesignSpace
    systems: tuple[WeightedSystem, ...]
    predictors: tuple[DesignPredictor, ...]
    displayed: DesignPredictor
    sigmas: FloatArray

    @classmethod
    def of(cls, space: DesignSpace, displayed: EquationSetFit, systems: Sequence[WeightedSystem]) -> "_Candidates":
        limits = space.limits(displayed.measured.measurements.smoothed)
        sigmas = displayed.errors.sigmas * np.sqrt(np.maximum(displayed.measured.share, 1.0))
        predictors = tuple(DesignPredictor(known.fitted, space.widths, limits, sigmas) for known in systems)
        return cls(space, tuple(systems), predictors, DesignPredictor(displayed, space.widths, limits, sigmas), sigmas)

    @cached_property
    def weights(self) -> list[float]:
        """The weights of the candidates."""
        return [known.weight for known in self.systems]

    @cached_property
    def _useful_evidence(self) -> FloatArray:
        return useful_evidence([known.length for known in self.systems])

    def gain_of(self, distances: FloatArray) -> Gain:
        """Return the gain of an experiment that gives the candidates these distances."""
        return expected_gain(distances, self.weights, self._useful_evidence)

    def try_design(self, trial: _Trial) -> _EvaluatedDesign:
        """Return an experiment with its gain."""
        design = trial.design
        if trial.purpose == "precision":
            gain = precision(self.displayed.at(design), len(self.displayed.fitted.values))[0]
        else:
            gain = self.gain_of(distances_of([predictor.at(design) for predictor in self.predictors], self.weights))
        is_finite = math.isfinite(gain.worth) and math.isfinite(gain.information)
        return _EvaluatedDesign(design, self.space.price(design), gain if is_finite else NONE)

    def improve(self, improvement: _Improvement) -> _EvaluatedDesign:
        """Return the best experiment that is found by changes of one number after another."""
        best = improvement.best
        for step in _ROUNDS:
            for moved in self.space.around(self.space.point(best.design), step):
                design = self.space.design(moved, self.space.share(best.design))
                neighbour = self.try_design(_Trial(improvement.purpose, design))
                best = neighbour if neighbour.worth > best.worth else best
        return best

    def fit_outcome(self, outcome: _Outcome) -> float:
        """Return the distance of two candidates after an outcome."""
        pair = self.systems[outcome.ahead].fitted, self.systems[outcome.fitted].fitted
        prediction = self.predictors[outcome.ahead].at(outcome.design)
        return distance_after(*pair, outcome.design, prediction, self.sigmas)


@dataclass(frozen=True)
class _CandidatesParts:
    """The form in which `_Candidates` are sent to workers, which repeat the fits."""

    data: EncodedData
    given: tuple[Mapping[str, str], ...]
    space: DesignSpace

    def candidates(self) -> _Candidates:
        result, table = self.data.decode()
        displayed = fit_displayed(measured_of(result, table), result)
        return _Candidates.of(self.space, displayed, alternatives_of(result, displayed, self.given))


_TRIALS: Final = BatchFunction(
    "trials", _CandidatesParts, _Trial, _EvaluatedDesign, _Candidates.try_design, _CandidatesParts.candidates
)
_IMPROVEMENTS: Final = BatchFunction(
    "improvements", _CandidatesParts, _Improvement, _EvaluatedDesign, _Candidates.improve, _CandidatesParts.candidates
)
_OUTCOMES: Final = BatchFunction(
    "outcomes", _CandidatesParts, _Outcome, float, _Candidates.fit_outcome, _CandidatesParts.candidates
)
_TRIALS_OF_A_BATCH: Final = 64
"""Most trials of a batch: a trial takes some milliseconds, which is about the time for sending a batch."""

ItemT = TypeVar("ItemT")
OutcomeT = TypeVar("OutcomeT")


@dataclass(frozen=True)
class _DesignSearch:
    """Finds the experiments with the largest worth; `spread` distributes the work, and `parts` are sent for it."""

    candidates: _Candidates
    parts: Callable[[], _CandidatesParts]
    spread: Spread

    def best(self, purpose: Purpose, count: int, seed: int) -> list[_EvaluatedDesign]:
        """Return up to `count` distinct experiments with a positive worth, the best first."""
        space, most = self.candidates.space, max(_IMPROVED, count)
        points = space.points(seed)
        designs = [space.design(point, share) for share in space.shares for point in points]
        tried = self._map(_TRIALS, [_Trial(purpose, design) for design in designs], _TRIALS_OF_A_BATCH)
        improved = self._map(_IMPROVEMENTS, [_Improvement(purpose, best) for best in self._distinct(tried, most)])
        finalists = self._distinct([*improved, *tried], most)
        return self._distinct(finalists if purpose == "precision" else self._examine(finalists), count)

    def _map(
        self, function: BatchFunction[_Candidates, ItemT, OutcomeT], items: Sequence[ItemT], size: int = 1
    ) -> list[OutcomeT]:
        computed = self.spread.map(function, lambda: self.candidates, items, size, self.parts)
        return [one for one in computed if one is not None]  # analyses have no deadline, so none is left out

    def _examine(self, finalists: Sequence[_EvaluatedDesign]) -> list[_EvaluatedDesign]:
        """Return experiments with a more accurate gain: the candidates with the largest weights are fitted again.

        Each of them is fitted to the data together with the outcome that another one predicts.
        """
        candidates = self.candidates
        weights = candidates.weights
        heaviest = sorted(range(len(weights)), key=lambda place: -weights[place])[:_REFITTED]
        predicted = [[predictor.at(tried.design) for predictor in candidates.predictors] for tried in finalists]
        places = [
            (number, i, j)
            for number, tried in enumerate(finalists)
            for i, j in permutations(heaviest, 2)
            if predicted[number][i].reached == len(tried.design.times)
        ]
        outcomes = self._map(_OUTCOMES, [_Outcome(finalists[number].design, i, j) for number, i, j in places])
        all_distances = [distances_of(predictions, weights) for predictions in predicted]
        for (number, i, j), distance in zip(places, outcomes, strict=True):
            all_distances[number][i, j] = distance
        return [
            replace(tried, gain=candidates.gain_of(distances), certainties=certainties(distances, weights))
            for tried, distances in zip(finalists, all_distances, strict=True)
        ]

    def _distinct(self, tried: Sequence[_EvaluatedDesign], count: int) -> list[_EvaluatedDesign]:
        kept: list[_EvaluatedDesign] = []
        for experiment in sorted(tried, key=lambda experiment: experiment.worth, reverse=True):
            is_other = all(self.candidates.space.are_distinct(experiment.design, other.design) for other in kept)
            if is_other and experiment.gain.worth > 0.0 and len(kept) < count:
                kept.append(experiment)
        return kept


class _Suggester:
    """Chooses the purpose of experiments for a result, and writes the suggestions."""

    def __init__(
        self, result: Result, request: DesignRequest, displayed: EquationSetFit, search: _DesignSearch
    ) -> None:
        self._result, self._request, self._displayed, self._search = result, request, displayed, search
        candidates = search.candidates
        self._space, self._systems, self._weights = candidates.space, candidates.systems, candidates.weights
        self._displayed_predictor = candidates.displayed

    def suggestions(self) -> Suggestions:
        count, seed = self._request.count, self._request.seed
        chosen: list[_EvaluatedDesign] = []
        if len(self._systems) > 1:
            chosen = self._search.best("discrimination", count, seed)
        reason = self._reason(chosen)
        if reason is None:
            return self._collect("discrimination", chosen, f"{len(self._systems)} candidates differ")
        if not len(self._displayed.values):
            raise UsageError(f"{reason}, and the model has no constants, so an experiment gives no information")
        chosen = self._search.best("precision", count, seed)
        if not chosen:
            raise UsageError("the model cannot be simulated from any initial state in the bounds; give other bounds")
        return self._collect("precision", chosen, reason)

    def _reason(self, chosen: Sequence[_EvaluatedDesign]) -> str | None:
        """Return why experiments cannot distinguish candidates; None if they can."""
        if len(self._systems) < 2:
            return "there is only one candidate"
        if sum(weight > 0.0 for weight in self._weights) < 2:
            return f"the data already exclude all but one of {len(self._systems)} candidates"
        best = max((experiment.gain.evidence for experiment in chosen), default=0.0)
        if best * _MOST_REPETITIONS < SETTINGS.inference.distinct_nats:
            return f"all {len(self._systems)} candidates predict the same outcomes within the bounds"
        return None

    def _collect(self, purpose: Purpose, chosen: Sequence[_EvaluatedDesign], reason: str) -> Suggestions:
        box, symbols = self._space.box, self._result.symbols
        given = {symbols.get(name, name) for name in self._request.bounds}
        ends = zip(box.lower.tolist(), box.upper.tolist(), strict=True)
        return Suggestions(
            purpose,
            reason,
            -sum(weight * math.log(weight) for weight in self._weights if weight > 0.0),
            tuple(self._candidate(known) for known in self._systems),
            tuple(self._suggestion(tried, is_precise=purpose == "precision") for tried in chosen),
            dict(zip(self._space.names, ends, strict=True)),
            tuple(name for name in self._space.names if name not in given),
            self._request.cost,
            self._displayed.measured.source,
        )

    def _candidate(self, system: WeightedSystem) -> CandidateSystem:
        displayed = self._result.equations
        length = next(other.length for other in self._systems if other.origin == "shown")
        fitted, written = system.fitted.texts(self._result), {}
        if system.origin == "shown":
            names = system.fitted.equations.names
            written = {
                equation.lhs: to_infix(
                    from_infix(equation.expression or "", names), names, digits=4, is_given=equation.given is not None
                )
                for equation in displayed
            }
        others = {} if written == fitted else written
        return CandidateSystem(fitted, system.origin, system.weight, system.nats, system.length - length, others)

    def _suggestion(self, tried: _EvaluatedDesign, *, is_precise: bool) -> Suggestion:
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
        """Return the constant with the largest relative error, and this error before and after an experiment."""
        root = self._displayed.root
        before, after = root @ root.T, root @ precision(self._displayed_predictor.at(design), len(root))[1] @ root.T
        sizes = np.maximum(np.abs(self._displayed.values), 1e-300)
        errors = [np.sqrt(np.maximum(np.diag(covariance), 0.0)) / sizes for covariance in (before, after)]
        index = int(np.argmax(errors[0]))
        name = constants_of(self._displayed.equations, self._result)[index].name
        return name, float(errors[0][index]), float(errors[1][index])
