"""Tables in Markdown of what many jobs came to: by quality, verdicts against the truth, and single equations."""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from benchmarks.corpus.outcomes import EquationOutcome, Outcome
from benchmarks.harness.tables import Columns, markdown, share

GRADES: Final = ("exact", "good", "doubtful", "no model", "-")
LONGEST: Final = 110


def by_quality(outcomes: Sequence[Outcome]) -> str:
    """Return a row for each quality and number of states: forms, extra terms, predictions and seconds.

    ``truth elsewhere`` counts wrong equations whose form is on the front or among the candidates, ``truth shorter``
    those of jobs in which the truth is the shorter description.
    """
    kinds = dict.fromkeys(map(_kind, outcomes))
    rows = [_row(kind, [each for each in outcomes if _kind(each) == kind]) for kind in kinds]
    methods = dict.fromkeys(outcome.key.method for outcome in outcomes)
    rows += [_row((method, "all", ""), [its for its in outcomes if its.key.method == method]) for method in methods]
    return markdown(
        (
            "method", "quality", "states", "equations", "identifiable", "right, of these", "extra terms", "missing",
            "other", "truth elsewhere", "truth shorter", "R2 > 0.9", "wall s median / 95 %", "cpu s median / 95 %",
        ),
        rows,
    )  # fmt: skip


def _kind(outcome: Outcome) -> tuple[str, str, str]:
    return outcome.key.method, outcome.key.quality, "1-2" if outcome.key.states <= 2 else "3-5"


def _row(kind: tuple[str, str, str], outcomes: Sequence[Outcome]) -> tuple[str, ...]:
    equations = [equation for outcome in outcomes for equation in outcome.equations]
    able = [its for its in equations if its.is_identifiable]
    judged = [its for its in equations if its.is_foretold is not None]

    def count(condition: Callable[[EquationOutcome], bool]) -> str:
        return str(sum(map(condition, equations)))

    return (
        *kind,
        str(len(equations)),
        str(len(able)),
        share(sum(its.is_right for its in able), len(able)),
        count(lambda its: its.form == "extra"),
        count(lambda its: its.form == "missing"),
        count(lambda its: its.form in ("other", "none")),
        count(lambda its: its.elsewhere is not None),
        str(sum(not its.is_right for each in outcomes if (each.excess or 0.0) < 0.0 for its in each.equations)),
        share(sum(bool(its.is_foretold) for its in judged), len(judged)),
        _quantiles([each.seconds for each in outcomes]),
        _quantiles([each.cpu_seconds for each in outcomes]),
    )


def _quantiles(values: Sequence[float]) -> str:
    return f"{np.median(values):.1f} / {np.quantile(values, 0.95):.1f}" if values else "-"


def by_grade(outcomes: Sequence[Outcome]) -> str:
    """Return the reliability table: for each verdict, how many equations are right, and how many foretell."""
    rows = []
    equations = [equation for outcome in outcomes for equation in outcome.equations]
    for grade in GRADES:
        its = [each for each in equations if (each.grade or "-") == grade]
        if its:
            judged = [each for each in its if each.is_foretold is not None]
            rows.append(
                (
                    grade,
                    str(len(its)),
                    share(sum(each.is_right for each in its), len(its)),
                    share(sum(bool(each.is_foretold) for each in judged), len(judged)),
                )
            )
    return markdown(("verdict", "equations", "right in form", "R2 > 0.9 from fresh states"), rows)


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
