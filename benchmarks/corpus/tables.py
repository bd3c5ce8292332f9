"""Tables in Markdown of what many jobs came to: by quality, verdicts against the truth, and single equations."""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from benchmarks.corpus.cases import KNOWN_PART, system_of, with_unknown_summand
from benchmarks.corpus.outcomes import EquationOutcome, Outcome
from benchmarks.harness import tables
from benchmarks.harness.tables import Columns, grouped, markdown, share

LONGEST: Final = 110


def by_quality(outcomes: Sequence[Outcome]) -> str:
    """Return a row for each quality and number of states: forms, extra terms, predictions and seconds.

    ``truth elsewhere`` counts wrong equations whose form is on the front or among the candidates, ``truth shorter``
    those of jobs in which the truth is the shorter description.
    """
    rows = [_row(kind, chosen) for kind, chosen in grouped(outcomes, _kind).items()]
    methods = grouped(outcomes, lambda outcome: outcome.key.method)
    rows += [_row((method, "all", ""), chosen) for method, chosen in methods.items()]
    return markdown(
        (
            "method", "quality", "states", "equations", "identifiable", "right, of these", "extra terms", "missing",
            "other", "truth elsewhere", "truth shorter", "R2 > 0.9", "intervals hold",
            "wall s median / 95 %", "cpu s median / 95 %",
        ),
        rows,
    )  # fmt: skip


def _kind(outcome: Outcome) -> tuple[str, str, str]:
    return outcome.key.method, outcome.key.quality, "1-2" if outcome.key.states <= 2 else "3-5"


def _row(kind: tuple[str, str, str], outcomes: Sequence[Outcome]) -> tuple[str, ...]:
    equations = [equation for outcome in outcomes for equation in outcome.equations]
    able = [equation for equation in equations if equation.is_identifiable]
    judged = [equation for equation in equations if equation.is_foretold is not None]

    shorter = [equation for outcome in outcomes if (outcome.excess or 0.0) < 0.0 for equation in outcome.equations]

    def count(condition: Callable[[EquationOutcome], bool]) -> str:
        return str(sum(map(condition, equations)))

    return (
        *kind,
        str(len(equations)),
        str(len(able)),
        share(sum(equation.is_right for equation in able), len(able)),
        count(lambda equation: equation.form == "extra"),
        count(lambda equation: equation.form == "missing"),
        count(lambda equation: equation.form in ("other", "none")),
        count(lambda equation: equation.elsewhere is not None),
        str(sum(not equation.is_right for equation in shorter)),
        share(sum(bool(equation.is_foretold) for equation in judged), len(judged)),
        share(sum(equation.covered for equation in equations), sum(equation.intervals for equation in equations)),
        _quantiles([outcome.seconds for outcome in outcomes]),
        _quantiles([outcome.cpu_seconds for outcome in outcomes]),
    )


def _quantiles(values: Sequence[float]) -> str:
    return f"{np.median(values):.1f} / {np.quantile(values, 0.95):.1f}" if values else "-"


def by_grade(outcomes: Sequence[Outcome]) -> str:
    """Return the reliability table: for each verdict, how many equations are right, and how many foretell.

    Those of single trajectories are counted apart as well: one curve tells least of what is beside it.
    """
    equations = [equation for outcome in outcomes for equation in outcome.equations]
    single = [equation for outcome in outcomes if outcome.key.trajectories == 1 for equation in outcome.equations]
    graded, graded_single = (tables.by_grade(those, lambda equation: equation.grade) for those in (equations, single))
    rows = [(grade, *_reliability(graded[grade]), *_reliability(graded_single.get(grade, ()))) for grade in graded]
    heads = ("equations", "right in form", "R2 > 0.9 from fresh states")
    return markdown(("verdict", *heads, "of single trajectories", *heads[1:]), rows)


def by_unknown_summand(outcomes: Sequence[Outcome]) -> str:
    """Return, by method, how the equation came out of which `KNOWN_PART` leaves one summand out; "" without it."""
    if not any(outcome.key.method == KNOWN_PART for outcome in outcomes):
        return ""
    rows = []
    for method, chosen in grouped(outcomes, lambda outcome: outcome.key.method).items():
        equations = [
            equation for outcome in chosen for equation in outcome.equations if _has_unknown(outcome, equation)
        ]
        able = [equation for equation in equations if equation.is_identifiable]
        good = [equation for equation in equations if equation.grade in ("exact", "good")]
        rows.append((
            method, str(len(equations)), share(sum(equation.is_right for equation in able), len(able)),
            share(sum(equation.is_right for equation in good), len(good)),
            share(sum(equation.covered for equation in equations), sum(equation.intervals for equation in equations)),
            _quantiles([outcome.seconds for outcome in chosen]),
        ))  # fmt: skip
    heads = (
        "method",
        "equations",
        "right, of identifiable",
        "good and right",
        "intervals hold",
        "wall s median / 95 %",
    )
    return markdown(heads, rows)


def _has_unknown(outcome: Outcome, equation: EquationOutcome) -> bool:
    key = outcome.key
    return with_unknown_summand(system_of(key), key.seed)[0] == equation.variable


def _reliability(equations: Sequence[EquationOutcome]) -> tuple[str, str, str]:
    """Return how many equations there are and are right, and how many of those that were judged foretell."""
    judged = [equation.is_foretold for equation in equations if equation.is_foretold is not None]
    right = sum(equation.is_right for equation in equations)
    return str(len(equations)), share(right, len(equations)), share(sum(judged), len(judged))


EQUATION: Final = Columns("form={shown_form} | truth is in={place} | verdict={grade} | R2={r2:.3f} | t={t:.2g}")
JOB: Final = Columns("truth's nats={excess:+.1f} | wall / cpu s={seconds:.1f} / {cpu_seconds:.1f}")


def equation_rows(outcomes: Sequence[Outcome], *, only_wrong: bool) -> str:
    """Return a row for each equation, or for each that is not right in form."""
    rows = [
        (
            f"{outcome.key.title} {equation.variable}",
            f"`{equation.truth}`",
            f"`{_clipped(equation.expression)}`",
            *EQUATION.row(equation),
            *JOB.row(outcome),
        )
        for outcome in outcomes
        for equation in outcome.equations
        if not (only_wrong and equation.is_right)
    ]
    return markdown(("equation", "truth", "shown", *EQUATION.heads, *JOB.heads), rows)


def _clipped(expression: str | None) -> str:
    return expression if expression and len(expression) <= LONGEST else (expression or "-")[:LONGEST] + "…"
