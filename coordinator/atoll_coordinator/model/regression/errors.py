"""Errors of a program on the rows of a problem. Pure."""

import math

import numpy as np

from atoll.config import Loss
from atoll.data.dataset import Problem
from atoll.expression.evaluation import values_of
from atoll.expression.program import Program
from atoll_coordinator.settings import SETTINGS


def errors_on(problem: Problem, program: Program, loss: Loss) -> tuple[float, float]:
    """Return loss and mean squared error on all rows, infinite when one is not finite; in parts, to save memory."""
    rows = len(problem.target.values)
    total, square = 0.0, 0.0
    for start in range(0, rows, SETTINGS.regression.rows_at_a_time):
        part = slice(start, start + SETTINGS.regression.rows_at_a_time)
        errors = values_of(program, problem.inputs[:, part]) - problem.target.values[part]
        total += float(np.sum(np.abs(errors)))
        square += float(errors @ errors)
    mse = square / rows
    if not math.isfinite(mse):
        return math.inf, math.inf
    return (total / rows if loss == "mae" else math.sqrt(mse)), mse
