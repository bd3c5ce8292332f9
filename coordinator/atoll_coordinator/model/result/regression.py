"""What a result says of y = f(X): measured beside fitted values of the target."""

from typing import Final

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.result.numbers import curve, thinned
from atoll_coordinator.result.findings import Regression
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program

MOST_ROWS: Final = 1_000
"""Rows that are listed; of more, rows spread evenly."""


def regression(given: Preparation, program: Program | None) -> Regression | None:
    """Return some of the rows with the fitted values of `program`; None where no target was given, or no equation."""
    if given.source is None or given.source.target is None or program is None:
        return None
    problem = (given.counted or given.dataset).problem(given.dataset.variables[0])
    rows = thinned(len(problem.target.values), MOST_ROWS)
    variables = zip(given.dataset.symbols, problem.inputs, strict=True)
    return Regression(
        rows=len(problem.target.values),
        listed=len(rows),
        variables={name: curve(values[rows]) for name, values in variables},
        measured=curve(problem.target.values[rows]),
        fitted=curve(values_of(program, problem.inputs)[rows]),
    )
