"""How far the equation of a variable can be trusted: a grade, and one sentence with the reason. Pure.

The grade follows from the table of checks (`checks.RULES`). Nothing that was not tested counts as passed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from atoll_coordinator.model.inference.checks import Evidence, failures, make_checks, outside_of_range
from atoll_coordinator.model.refinement import Check, CheckOutcome, Grade
from atoll_coordinator.settings import SETTINGS


@dataclass(frozen=True)
class Verdict:
    """The `grade` of an equation, the `reason` as a sentence, and the `checks` that it follows from."""

    grade: Grade
    reason: str
    checks: tuple[Check, ...]


def judge(evidence: Evidence) -> Verdict:
    """Return the verdict on an equation.

    `no model`: it explains next to nothing. `doubtful`: a check that applies has failed, was not made, or would not
    have seen a departure that matters. `exact`: checks of exactness have passed as well. `good`: all others.
    """
    checks, exactness = make_checks(evidence), make_checks(evidence, of_exactness=True)
    explained = next((check for check in checks if check.name == "explained variance"), None)
    if explained is not None and explained.outcome == "failed":
        return Verdict("no model", sentence([explained.reason]), checks)
    against = list(failures(checks))
    if against:
        return Verdict("doubtful", sentence(against), checks)
    precise, *others = exactness
    if precise.outcome == "passed":
        unsure = [check.reason for check in others if check.outcome not in ("passed", "not applicable")]
        return Verdict("good" if unsure else "exact", sentence([precise.reason, *unsure]), (*checks, *exactness))
    return Verdict("good", sentence(_merits(evidence, checks)), checks)


def with_objection(verdict: Verdict, name: str, outcome: CheckOutcome, reason: str) -> Verdict:
    """Return a verdict with a further check, which has failed or was not made: it is doubtful at best then."""
    checks = (*verdict.checks, Check(name, outcome, reason))
    if verdict.grade in ("no model", "doubtful"):
        return Verdict(verdict.grade, verdict.reason, checks)
    return Verdict("doubtful", sentence([reason]), checks)


def sentence(clauses: Sequence[str]) -> str:
    """Return at most two clauses as a sentence; a third is worth no more reading."""
    text = ", and ".join(clauses[:2])
    return text[0].upper() + text[1:] + "."


def _merits(evidence: Evidence, checks: Sequence[Check]) -> list[str]:
    """Return why an equation is good: its residuals; what it predicts is in the same clause, behind semicolons."""
    reasons = {check.name: check.reason for check in checks if check.outcome != "not applicable"}
    size = next((reasons[name] for name in ("residual size", "rows left out") if name in reasons), "")
    pattern = reasons.get("residual pattern", "")
    if pattern.startswith("a term"):
        has_told = evidence.solver is not None or evidence.left <= SETTINGS.inference.exact
        size, pattern = size if has_told else f"{size}; {pattern}", ""
    if size.startswith("the residuals"):
        pattern = pattern.removeprefix("the residuals ")
    merits = [" and ".join(filter(None, (size, pattern)))] if size or pattern else []
    merits += [reasons[name] for name in ("held-out trajectories", "long run") if name in reasons]
    beyond = outside_of_range(evidence.prediction)
    return ["; ".join([*merits, *([beyond] if beyond else [])]) or "all checks have passed"]
