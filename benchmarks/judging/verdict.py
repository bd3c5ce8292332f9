"""Is an equation of a result the true one? One verdict per equation, in the terms of ``benchmarks.judging.forms``."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from atoll.terminal.output import error_text
from atoll_core.data.dataset import Dataset, FloatArray
from benchmarks.harness.tables import Columns
from benchmarks.judging.forms import compare
from benchmarks.judging.rules import Rule, right_ones

TOLERANCE: Final = 0.01
"""Largest relative error of a constant."""

SMALL_ERROR: Final = 0.05
"""Function error that is enough where a trajectory passes a singularity."""


@dataclass(frozen=True)
class Verdict:
    """How one equation of one search came out.

    `found` is what counts: exact in form, or, where `is_singular`, a function error of at most `SMALL_ERROR`.
    `exact_on_front` is the complexity of the smallest front member that is exact in form, None when none is (or when
    nobody looked, since the selected one is exact). Errors are normalized by the target's standard deviation.
    """

    case: str
    seed: int
    lhs: str
    found: bool
    exact: bool
    is_singular: bool
    reason: str
    expression: str | None
    complexity: int | None
    constants_error: float | None
    function_error: float | None
    error: float | None
    floor: float
    threshold: float
    converged: bool
    why: str | None
    epoch: int
    generation: int | None
    point_evaluations: int
    equation_seconds: float
    search_seconds: float
    seconds: float
    exact_on_front: int | None
    digest: str

    @property
    def mark(self) -> str:
        """What is said of an equation that is judged by its function."""
        return " (singular)" if self.is_singular else ""

    @property
    def end(self) -> str:
        """Why the search ended."""
        return self.why or "-"


@dataclass(frozen=True, eq=False)
class Question:
    """What a result is judged by: the truths by variable, and the data that the search was given.

    `singular` are the variables whose derivative the sampling does not resolve somewhere.
    """

    case: str
    seed: int
    truths: Mapping[str, str]
    dataset: Dataset
    singular: frozenset[str] = frozenset()


def judged(question: Question, result: Mapping[str, Any]) -> list[Verdict]:
    """Return a verdict for each equation of `result` (the contents of a result.json)."""
    return [_verdict(question, result, equation) for equation in result["equations"]]


def _verdict(question: Question, result: Mapping[str, Any], equation: Mapping[str, Any]) -> Verdict:
    variable = equation["variable"]
    rule = _rule(question, variable)
    form = rule(equation["expression"])
    exact = (int(member["complexity"]) for member in right_ones(rule, equation["front"]))
    is_singular = variable in question.singular
    is_close = form.function_error is not None and form.function_error <= SMALL_ERROR
    return Verdict(
        case=question.case,
        seed=question.seed,
        lhs=equation["lhs"],
        found=is_close if is_singular else form.is_right,
        exact=form.is_right,
        is_singular=is_singular,
        reason=form.reason,
        expression=equation["expression"],
        complexity=equation["complexity"],
        constants_error=form.constants_error,
        function_error=form.function_error,
        error=equation["normalized_error"],
        floor=equation["derivative_floor"],
        threshold=equation["target_error"],
        converged=equation["converged"],
        why=equation["why"],
        epoch=equation["epoch"],
        generation=equation["generation"],
        point_evaluations=equation["point_evaluations"],
        equation_seconds=equation["seconds"],
        search_seconds=result["search_seconds"],
        seconds=result["seconds"],
        exact_on_front=None if form.is_right else next(exact, None),
        digest=result["digest"],
    )


def _rule(question: Question, variable: str) -> Rule:
    dataset = question.dataset
    columns: dict[str, FloatArray] = dict(zip(dataset.names, dataset.inputs, strict=True))
    truth = question.truths[variable]
    return lambda expression: compare(expression, truth, columns, TOLERANCE)


COLUMNS: Final = Columns(
    "case | seed | equation={lhs} | found={found:yes}{mark} | constants={constants_error:error} | "
    "function={function_error:error} | error={error:error} | threshold={threshold:error} | size={complexity!s} | "
    "epochs={epoch} | evaluations={point_evaluations:.2e} | search s={equation_seconds:.2f} | s={seconds:.2f} | "
    "end={end}"
)


def miss(verdict: Verdict) -> str:
    """Return the sentence on an equation that was not found."""
    end = "converged" if verdict.converged else f"not converged ({verdict.why})"
    front = f"; exact at size {verdict.exact_on_front} of the front" if verdict.exact_on_front else ""
    return (
        f"{verdict.case} seed {verdict.seed} {verdict.lhs}: {end}, {verdict.epoch} epochs, {verdict.seconds:.1f} s, "
        f"error {error_text(verdict.error)} (floor {error_text(verdict.floor)}), size {verdict.complexity}: "
        f"{verdict.reason}{front}\n    {verdict.expression}"
    )
