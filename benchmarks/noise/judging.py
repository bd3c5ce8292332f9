"""How one search on noisy data came out, equation by equation: form, constants, intervals, and what it foretells.

An equation is found when it is exact in form (`benchmarks.judging.forms`), its constants being free to differ by up to
their own size; without noise they must be right as well. Bacterial respiration, whose constants noise leaves
undetermined, is found when its function error on fresh points is small.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from atoll_core.errors import UsageError
from benchmarks.harness.campaign import Answer, attempt
from benchmarks.harness.jobs import configured
from benchmarks.harness.service import Searches
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.judging.coverage import Covered, covered
from benchmarks.judging.errors import finite
from benchmarks.judging.forms import compare
from benchmarks.judging.generalisation import foretold, is_foretold
from benchmarks.judging.rules import Form, Rule, right_ones
from benchmarks.noise.data import Case, Key

FREE: Final = 1.0
"""Largest relative error of a constant of an equation that is exact in form: it has the truth's sign."""

EXACT_CONSTANTS: Final = 1e-4
"""Largest relative error of a constant where there is no noise."""

BY_FUNCTION: Final = frozenset({"bacterial_respiration"})
"""Systems whose equations are judged by their function error at any noise."""

SMALL_ERROR: Final = 0.05
"""Function error that is enough for these."""

MOST_CONTENDERS: Final = 100
"""So many equations of a front and of the contenders are looked at for the truth."""


@dataclass(frozen=True)
class EquationOutcome:
    """How one equation came out.

    `found` is what counts, `in_form` whether it is exact in form. `constants_error` is the largest relative error of a
    constant of the normal form that the truth and the equation have in common (None when their terms differ),
    `function_error` the error on fresh points in the range of the data over the target's deviation there. `elsewhere`
    says where the true form is when it is not the one shown: "front", "contenders" (and how much longer the description
    of the data is with it), or None. `constants` are those whose true values are known (None: the structure has none).
    `r2` is that of the state's simulation from fresh initial conditions.
    """

    variable: str
    expression: str | None
    found: bool
    in_form: bool
    reason: str
    constants_error: float | None
    function_error: float | None
    elsewhere: str | None
    constants: tuple[Covered, ...] | None
    r2: float | None
    grade: str | None = None
    grade_reason: str | None = None

    @property
    def is_foretold(self) -> bool:
        """Whether the state is foretold from fresh initial conditions."""
        return is_foretold(self.r2)


@dataclass(frozen=True)
class Outcome:
    """How one search came out. `seconds` are those of the whole job, `phases` those of its states as they were seen."""

    key: Key
    equations: tuple[EquationOutcome, ...]
    seconds: float
    phases: Mapping[str, float]
    digest: str | None = None
    failure: str | None = None


def outcome(key: Key, case: Case, result: Mapping[str, Any], phases: Mapping[str, float]) -> Outcome:
    """Judge `result`, the contents of a result.json (parts that a version does not have may be missing)."""
    equations = {equation["variable"]: equation for equation in result["equations"]}
    texts = {name: equations.get(name, {}).get("expression") for name in case.truths}
    r2 = foretold(texts, case.fresh) if case.fresh else dict.fromkeys(case.truths)
    outcomes = tuple(_equation(key, case, name, equations.get(name, {}), r2[name]) for name in case.truths)
    seconds = float(result.get("seconds") or 0.0)
    return Outcome(key, outcomes, seconds, phases, result.get("digest"), result.get("reason"))


def search(searches: Searches, key: Key, case: Case, max_time: float | None) -> tuple[Outcome, Answer]:
    """Search one case and judge it; raises AtollError where the coordinator or a worker has ended."""
    stopwatch = Stopwatch()
    config = configured(key.seed, budget={"max_time": max_time})
    job = attempt(searches, key.title, case.table, config, stopwatch)
    if job.failure is not None:
        return failed(key, case, job.failure, job.seconds), None
    return outcome(key, case, job.result, stopwatch.seconds), job.result


def failed(key: Key, case: Case, failure: str, seconds: float) -> Outcome:
    """Return the outcome of a search that gave nothing, with the sentence that says why."""
    nothing = tuple(_equation(key, case, name, {"reason": failure}, None) for name in case.truths)
    return Outcome(key, nothing, seconds, {}, failure=failure)


def _equation(key: Key, case: Case, name: str, equation: Mapping[str, Any], r2: float | None) -> EquationOutcome:
    text = equation.get("expression")
    rule = _rule(case, name)
    form = rule(text)
    constants = _constants(case, name, equation) if form.is_right and key.system not in BY_FUNCTION else None
    return EquationOutcome(
        variable=name,
        expression=text,
        found=_is_found(key, form),
        in_form=form.is_right,
        reason=form.reason,
        constants_error=finite(form.constants_error),
        function_error=form.function_error,
        elsewhere=None if form.is_right else _elsewhere(rule, equation),
        constants=constants,
        r2=finite(r2),
        grade=equation.get("verdict"),
        grade_reason=equation.get("reason"),
    )


def _is_found(key: Key, form: Form) -> bool:
    if key.level == 0.0:
        return form.is_right and form.constants_error is not None and form.constants_error <= EXACT_CONSTANTS
    if key.system in BY_FUNCTION:
        return form.function_error is not None and form.function_error < SMALL_ERROR
    return form.is_right


def _rule(case: Case, name: str) -> Rule:
    def rule(text: str | None) -> Form:
        try:
            return compare(text, case.truths[name], case.clean, FREE)
        except UsageError as error:
            return Form("other", reason=str(error))

    return rule


def _constants(case: Case, name: str, equation: Mapping[str, Any]) -> tuple[Covered, ...] | None:
    listed = [constant for constant in equation.get("constants") or [] if constant.get("value") is not None]
    try:
        constants = covered(equation["expression"], listed, case.clean, case.slope(name))
    except UsageError:  # too long to be read back with constants that are all different
        return None
    return None if constants is None else tuple(constants)


def _elsewhere(rule: Rule, equation: Mapping[str, Any]) -> str | None:
    """Say where the true form is among what was not shown."""
    for place, key in (("contenders", "candidates"), ("front", "front")):
        for member in right_ones(rule, (equation.get(key) or [])[:MOST_CONTENDERS]):
            nats = member.get("nats")
            return place if nats is None else f"{place} ({nats:+.1f} nats)"
    return None
