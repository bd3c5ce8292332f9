"""Slow, obvious versions of what the fit does: least squares by numpy, errors by their definitions."""

import math

import numpy as np

from common.dataset import FloatArray
from common.expression.program import Program
from tests.oracles.tapes import node_values

UNIT_ROUNDING = 2.3e-16


def errors(output: FloatArray, target: FloatArray) -> tuple[float, float]:
    """Return mean absolute and mean squared error; infinite unless both are finite."""
    differences = [abs(float(a) - float(b)) for a, b in zip(output, target, strict=True)]
    absolute = math.fsum(differences) / len(target) if all(map(math.isfinite, differences)) else math.inf
    squared = [each * each for each in differences]
    mean_square = math.fsum(squared) / len(target) if all(map(math.isfinite, squared)) else math.inf
    return (absolute, mean_square) if math.isfinite(absolute + mean_square) else (math.inf, math.inf)


def least_squares(terms: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the best b, a_1, ... for `terms` (m, R), and b + a_1 t_1 + ... at every row."""
    columns = np.vstack([np.ones(len(target)), terms])
    scale = np.linalg.lstsq(columns.T, target, rcond=None)[0]
    return scale, columns.T @ scale


def combination(program: Program, inputs: FloatArray, terms: set[int]) -> tuple[FloatArray, FloatArray]:
    """Return the output of `program`, and the combination of 1 and `terms` that comes nearest to it."""
    values = node_values(program, inputs)
    return values[-1], least_squares(values[sorted(terms)], values[-1])[1]
