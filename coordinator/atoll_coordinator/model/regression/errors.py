"""Errors of a program on the rows of a problem. Pure. This module loads no compiled kernels."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from atoll_core.config import Loss
from atoll_core.data.dataset import Problem
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program

_ROWS_AT_A_TIME: Final = 100_000
"""Rows evaluated at a time, to save memory."""


def measure_errors(problem: Problem, program: Program, loss: Loss) -> tuple[float, float]:
    """Return loss and mean squared error on all rows; both are infinite if a value is not finite."""
    rows = len(problem.target.values)
    total, square = 0.0, 0.0
    for start in range(0, rows, _ROWS_AT_A_TIME):
        part = slice(start, start + _ROWS_AT_A_TIME)
        errors = values_of(program, problem.inputs[:, part]) - problem.target.values[part]
        total += float(np.sum(np.abs(errors)))
        square += float(errors @ errors)
    mse = square / rows
    if not math.isfinite(mse):
        return math.inf, math.inf
    return (total / rows if loss == "mae" else math.sqrt(mse)), mse


def measure_grouped_errors(problem: Problem, programs: Sequence[Program], loss: Loss) -> tuple[float, float]:
    """Return loss and mean squared error of an equation. It has one program for each group of rows, or a single program
    for all rows."""
    if len(programs) == 1:
        return measure_errors(problem, programs[0], loss)
    parts = [problem.of_group(group) for group in range(len(programs))]
    part_errors = [measure_errors(part, program, loss) for part, program in zip(parts, programs, strict=True)]
    shares = [len(part.target.values) / len(problem.target.values) for part in parts]
    mse = sum(share * part_mse for share, (_, part_mse) in zip(shares, part_errors, strict=True))
    error = sum(share * part_error for share, (part_error, _) in zip(shares, part_errors, strict=True))
    return (error if loss == "mae" else math.sqrt(mse)), mse
