"""Tables in Markdown of what many jobs came to: by quality, verdicts against the truth, and single equations."""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from benchmarks.corpus.outcomes import EquationOutcome, Outcome

GRADES: Final = ("exact", "good", "doubtful", "no model", "-")
LONGEST: Final = 110


def markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in each) + " |" for each in lines)


def by_quality(outcomes: Sequence[Outcome]) -> str:
    """Return a row for each quality and number of states: forms, extra terms, predictions and seconds.

    ``truth elsewhere`` counts wrong equations whose form is on the front or among the candidates, ``truth shorter``
    those of jobs in which the truth is the shorter description.
    """
    kinds = dict.fromkeys(map(_kind, outcomes))
    rows = [_row(kind, [each for each in outcomes if _kind(each) == kind]) for kind in kinds]
    methods = dict.fromkeys(each.key.method for each in outcomes)
    rows += [_row((each, "all", ""), [its for its in outcomes if its.key.method == each]) for each in methods]
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
    equations = [its for each in outcomes for its in each.equations]
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


def share(part: int, whole: int) -> str:
    """Return a count and the share that it is."""
    return f"{part} of {whole} ({100.0 * part / whole:.0f} %)" if whole else "-"


def _quantiles(values: Sequence[float]) -> str:
    return f"{np.median(values):.1f} / {np.quantile(values, 0.95):.1f}" if values else "-"


def by_grade(outcomes: Sequence[Outcome]) -> str:
    """Return the reliability table: for each verdict, how many equations are right, and how many foretell."""
    rows = []
    equations = [its for each in outcomes for its in each.equations]
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


def equation_rows(outcomes: Sequence[Outcome], *, only_wrong: bool) -> str:
    """Return a row for each equation, or for each that is not right in form."""
    rows = [
        (
            f"{each.key.title} {its.variable}",
            its.truth,
            its.expression
            if its.expression and len(its.expression) <= LONGEST
            else (its.expression or "-")[:LONGEST] + "…",
            its.form + (f" {its.extra}" if its.extra else ""),
            "" if its.elsewhere is None else f"{its.elsewhere}{'' if its.nats is None else f' {its.nats:+.1f} nats'}",
            its.grade or "-",
            "-" if its.r2 is None else f"{its.r2:.3f}",
            "-" if its.t is None else f"{its.t:.2g}",
            "-" if each.excess is None else f"{each.excess:+.1f}",
            f"{each.seconds:.1f} / {each.cpu_seconds:.1f}",
        )
        for each in outcomes
        for its in each.equations
        if not (only_wrong and its.is_right)
    ]
    return markdown(
        ("equation", "truth", "shown", "form", "truth is in", "verdict", "R2", "t", "truth's nats", "wall / cpu s"),
        [tuple(f"`{cell}`" if place in (1, 2) else cell for place, cell in enumerate(row)) for row in rows],
    )
