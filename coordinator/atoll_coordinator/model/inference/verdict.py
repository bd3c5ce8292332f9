"""The table of checks, and the verdict that follows from them. Pure.

`RULES` is the table: the name of each check, the quantity it measures, its limit, and the kinds of job to which it
applies. The check is the method `check_` with this name, of `checks`, `trajectory_checks`, `target_checks` or
`stochastic.checks`: it measures the quantity and returns a `Finding` with a clause for the sentence. A check has
passed, has failed, does not apply to this table, or was not made. The clause gives the reason; it may also give advice.

`judge` decides: an equation is `good` or `exact` only if every check that applies was made, could detect a relevant
departure, and passed. A departure is relevant if it causes more than 0.1 of the variance of a state, since predictions
of a good equation have an R2 above 0.9. A test that was not made never counts as passed.

Doubtful: a good grade only says that no check found a fault. Limits are conventions, and a wrong equation can pass all
checks if it fits and no tried alternative fits as well.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from atoll_coordinator.model.inference.checks import (
    UNSIMULATED,
    EquationChecks,
    Finding,
    describe_initial_state,
    format_percent,
)
from atoll_coordinator.model.refinement import CheckOutcome, Grade, JobKind
from atoll_coordinator.result.equations import Check
from atoll_coordinator.settings import SETTINGS


@dataclass(frozen=True)
class Rule:
    """A check: its `name`, the quantity that it `measures`, its `limit` in words, and the `kinds` of job to which it
    applies.

    If `is_exactness`, the check is needed only for the grade `exact`.
    """

    name: str
    measures: str
    limit: str
    kinds: Sequence[JobKind]
    is_exactness: bool = False

    def apply(self, equation: EquationChecks) -> Finding:
        """Return the finding. If a check passed, but could not have detected a relevant departure, it counts as not
        made."""
        finding: Finding = getattr(equation, "check_" + re.sub(r"\W", "_", self.name))() or equation.default_finding
        power = finding.power
        if finding.outcome != "passed" or power is None or not power > SETTINGS.inference.part:
            return finding
        least = f"below {format_percent(power)} of the variance" if math.isfinite(power) else "of any size"
        reason = f"the check of {self.name} cannot detect errors of the model {least}"
        return finding._replace(outcome="not made", reason=reason, advice="measure more rows, or with less noise")


_SIMULATED: Final[Sequence[JobKind]] = ("trajectories", "template")
_TEMPLATE: Final[Sequence[JobKind]] = ("template",)
_TARGET: Final[Sequence[JobKind]] = ("target",)
_PROCESS: Final[Sequence[JobKind]] = ("process",)
_FITTED: Final = (*_SIMULATED, *_TARGET)
_ALL: Final = (*_FITTED, *_PROCESS)

# name, quantity measured, limit, kinds of job; the most important checks come first, here and in the sentence
RULES: Final[Sequence[Rule]] = (
    Rule("explained variance", "R2 of the simulation, or on the target", "0.1", _FITTED),
    Rule("simulation", "whether the trajectories could be simulated", "all", _SIMULATED),
    Rule("time", "stages that the time limit stopped", "nothing", _ALL),
    Rule("degrees of freedom", "rows minus the numbers fitted to them", "1", _FITTED),
    Rule("distinct rows", "rows that differ by more than rounding", "5", _FITTED),
    Rule("inputs between rows", "share of the variance of a rate that is not known", "0.1", _SIMULATED),
    Rule("no equation", "Δ log-likelihood over a constant and a random walk", "4.6", _FITTED),
    Rule("unknown part", "Δ description length without it, or with a constant", "4.6", _TEMPLATE),
    Rule("hidden state", "share of its variance that is error", "0.1", _TEMPLATE),
    Rule("starting values", "fits from other starts that end elsewhere, as well", "none", _TEMPLATE),
    Rule("held-out trajectories", "R2 of trajectories left out", "0.9 minus the noise", _SIMULATED),
    Rule("rows left out", "R2 of rows left out one at a time", "0.9", _TARGET),
    Rule("target uncertainty", "uncertainty of the target", "0.01", _TARGET),
    Rule("residual size", "residuals over the noise", "1.25, p < 0.01", _SIMULATED),
    Rule("residual pattern", "correlation of neighbouring residuals", "0.1, p < 0.01", _FITTED),
    Rule("whole trajectories", "whether whole trajectories are described", "all", _SIMULATED),
    Rule("long run", "means and variances of a chaotic model", "p < 0.01", _SIMULATED),
    Rule("other initial states", "odds of models that predict the same", "0.95", _SIMULATED),
    Rule("poles", "poles that the simulation passes", "none", _SIMULATED),
    Rule("noise", "noise of the states", "1e-4 of a step", _PROCESS),
    Rule("pattern of steps", "means of steps in bins of the states", "p < 0.01", _PROCESS),
    Rule("serial correlation", "correlation of steps with the steps before them", "p < 0.01", _PROCESS),
    Rule("size of steps", "variance of the steps of a state without noise of its own", "p < 0.01", _PROCESS),
    Rule("correlation of states", "correlation of the steps of two states", "p < 0.01", _PROCESS),
    Rule("pattern of squared steps", "means of squared steps in bins of the states", "p < 0.01", _PROCESS),
    Rule("normal steps", "fourth moment of the steps", "p < 0.01", _PROCESS),
    Rule("alternative equations", "Δ description length of the next best equation", "3", _ALL),
    Rule("constants", "constants that the data do not determine", "none", _ALL),
    Rule("precision", "residuals without noise", "1e-6, or rounding", _FITTED, is_exactness=True),
    Rule("odds against chance", "Δ log-likelihood over no equation", "5.3", _FITTED, is_exactness=True),
    Rule("precision of constants", "standard error over estimate", "1e-3", _FITTED, is_exactness=True),
    Rule("digits of constants", "digits of constants and values", "as many", _TARGET, is_exactness=True),
    Rule(
        "coordinates", "states that are determined up to a change of coordinates", "none", _TEMPLATE, is_exactness=True
    ),
    Rule("other laws", "odds of other equations", "1/200", _SIMULATED, is_exactness=True),
)


@dataclass(frozen=True)
class Verdict:
    """The `grade` of an equation, the `reason` as a sentence, and the `checks` from which the grade follows."""

    grade: Grade
    reason: str
    checks: tuple[Check, ...]


def judge(equation: EquationChecks) -> Verdict:
    """Return the verdict on an equation.

    `no model`: the equation explains less than 0.1 of the variance. `doubtful`: a check that applies has failed, was
    not made, or could not detect a relevant departure. `exact`: the checks of exactness have also passed. `good`: in
    all other cases.
    """
    findings, exactness = make_checks(equation), make_checks(equation, of_exactness=True)
    checks = list_checks(findings)
    explained = findings.get("explained variance")
    if explained is not None and explained.outcome == "failed":
        return Verdict("no model", format_sentence([explained]), checks)
    against = list_failures(findings.values())
    if against:
        return Verdict("doubtful", format_sentence(against), checks)
    precise = exactness.get("precision")
    if precise is not None and precise.outcome == "passed":
        unsure = [finding for finding in exactness.values() if finding.outcome not in ("passed", "not applicable")]
        return Verdict(
            "good" if unsure else "exact", format_sentence([precise, *unsure]), (*checks, *list_checks(exactness))
        )
    return Verdict("good", _capitalise(_describe_merits(equation, findings)), checks)


def make_checks(equation: EquationChecks, *, of_exactness: bool = False) -> dict[str, Finding]:
    """Return, by name, the findings of the checks that apply to this kind of job, the most important check first."""
    return {
        rule.name: rule.apply(equation)
        for rule in RULES
        if rule.is_exactness == of_exactness and equation.kind in rule.kinds
    }


def list_checks(findings: Mapping[str, Finding]) -> tuple[Check, ...]:
    """Return the findings as checks of a result."""
    return tuple(
        Check(
            name=name, outcome=finding.outcome, reason=finding.clause, value=finding.value, limit=finding.limit,
            power=finding.power,
        )
        for name, finding in findings.items()
    )  # fmt: skip


def add_objection(verdict: Verdict, name: str, outcome: CheckOutcome, reason: str) -> Verdict:
    """Return a verdict with a further check, which has failed or was not made. The grade becomes `doubtful`, unless it
    is `no model`."""
    checks = (*verdict.checks, Check(name=name, outcome=outcome, reason=reason))
    if verdict.grade in ("no model", "doubtful"):
        return Verdict(verdict.grade, verdict.reason, checks)
    return Verdict("doubtful", _capitalise(reason), checks)


def list_failures(findings: Iterable[Finding]) -> list[Finding]:
    """Return the findings against an equation: failed checks, then checks that were not made."""
    listed = [*findings]
    failed = [finding for finding in listed if finding.outcome == "failed"]
    not_made = {finding.clause: finding for finding in listed if finding.outcome == "not made"}
    if failed:
        not_made.pop(UNSIMULATED.clause, None)  # the failed check of the simulation has this reason
    return [*failed, *not_made.values()]


def format_sentence(findings: Sequence[Finding]) -> str:
    """Return the first two clauses as one sentence. If there are two clauses, their advice follows in separate
    sentences."""
    if len(findings) == 1:
        return _capitalise(findings[0].clause)
    advice = dict.fromkeys(finding.advice for finding in findings[:2] if finding.advice)
    return " ".join(map(_capitalise, [", and ".join(finding.reason for finding in findings[:2]), *advice]))


def _capitalise(clause: str) -> str:
    return clause[0].upper() + clause[1:] + "."


def _describe_merits(equation: EquationChecks, findings: Mapping[str, Finding]) -> str:
    """Return why an equation is good, as one clause: residuals, then predictions, separated by semicolons."""
    reasons = {name: finding.clause for name, finding in findings.items() if finding.outcome != "not applicable"}
    size = next((reasons[name] for name in ("residual size", "rows left out") if name in reasons), "")
    pattern = reasons.get("residual pattern", "")
    if pattern and equation.are_integration_errors:
        is_explained = equation.solver is not None or equation.relative_residuals <= SETTINGS.inference.exact
        size, pattern = size if is_explained else f"{size}; {pattern}", ""
    if size.startswith("the residuals") and pattern:
        size, pattern = f"{size} and {pattern.removeprefix('the residuals ')}", ""
    merits = [merit for merit in (size, pattern) if merit]
    merits += [reasons[name] for name in ("held-out trajectories", "long run") if name in reasons]
    known = equation.prediction
    if known is not None and known.reached is not None:
        merits.append(
            f"from other initial states within the measured range it reaches {known.reached:.3g}, outside of this "
            f"range: measure from {describe_initial_state(known)} to test this"
        )
    return "; ".join(merits) or equation.merit
