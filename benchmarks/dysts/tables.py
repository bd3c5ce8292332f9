"""What is printed: each search beside the published errors, and how many are below each limit."""

import csv
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from atoll.terminal.output import table
from benchmarks.dysts.judging import EXACT_ERROR, SMALL_ERROR, Outcome
from benchmarks.dysts.making import POLYNOMIAL
from benchmarks.harness.tables import Columns

LIMITS: Final = (0.001, 0.01, 0.05, 0.1)
METHODS: Final = ("weak STLSQ", "STLSQ", "MIOSR")

Published = Mapping[str, Mapping[str, float]]


def published(path: Path | None) -> Published:
    """Return the published errors by flow and column; none without a file."""
    if path is None:
        return {}
    with path.open(newline="") as stream:
        rows = csv.DictReader(stream)
        return {row.pop("system"): {key: float(value) for key, value in row.items()} for row in rows}


def line(outcome: Outcome) -> str:
    """Return one search in a line."""
    return " | ".join(
        [*COLUMNS.row(outcome), *(equation for equation in outcome.equations if equation and not outcome.is_exact)]
    )


def by_system(outcomes: Sequence[Outcome], path: Path | None) -> str:
    """Return a table with a row for each search."""
    known = published(path)
    heads = (*COLUMNS.heads, *METHODS)
    return table(heads, [(*COLUMNS.row(outcome), *_theirs(known, outcome)) for outcome in outcomes])


def summary(outcomes: Sequence[Outcome], path: Path | None) -> str:
    """Return for each noise how many of the polynomial flows err by less than each limit, ours and published."""
    known = published(path)
    rows = []
    for noise in sorted({outcome.noise for outcome in outcomes}):
        here = [outcome for outcome in outcomes if outcome.noise == noise and outcome.system in POLYNOMIAL]
        errors = [outcome.error for outcome in here]
        seconds = statistics.median([outcome.seconds for outcome in here] or [0.0])
        exact = sum(outcome.is_exact for outcome in here)
        rows.append(_counted("atoll", noise, errors, f"{exact}", f"{seconds:.0f}"))
        for method in METHODS if known else ():
            theirs = [known.get(outcome.system, {}).get(f"{method} at {noise:.2f} %") for outcome in here]
            rows.append(_counted(method, noise, theirs, "", ""))
        others = [outcome for outcome in outcomes if outcome.noise == noise and outcome.system not in POLYNOMIAL]
        if others:
            right = sum(is_right(other) for other in others)
            seconds = statistics.median(outcome.seconds for outcome in others)
            rows.append(
                ("atoll, others", f"{noise:g}", f"{len(others)}", "", "", "", "", f"{right} right", f"{seconds:.0f}")
            )
    return table(("method", "noise %", "flows", *(f"< {limit:g}" for limit in LIMITS), "exact form", "median s"), rows)


def is_right(outcome: Outcome) -> bool:
    """Tell whether a flow that is no polynomial counts as found: by its rates on the test trajectories."""
    limit = EXACT_ERROR if outcome.noise == 0.0 else SMALL_ERROR
    return outcome.rate_error is not None and outcome.rate_error < limit


def _counted(method: str, noise: float, errors: Sequence[float | None], exact: str, seconds: str) -> tuple[str, ...]:
    counts = (str(sum(error is not None and error < limit for error in errors)) for limit in LIMITS)
    return (method, f"{noise:g}", str(len(errors)), *counts, exact, seconds)


COLUMNS: Final = Columns(
    "system | noise %={noise:g} | error={error:.2g} | form={right}/{states} | rates={rate_error:.2g} | "
    "verdicts={verdict_words} | s={seconds:.1f}"
)


def _theirs(known: Published, outcome: Outcome) -> tuple[str, ...]:
    errors = known.get(outcome.system, {})
    return tuple(_number(errors.get(f"{method} at {outcome.noise:.2f} %")) for method in METHODS)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}"
