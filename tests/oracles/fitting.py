"""Slow, obvious versions of what the fit does: least squares by numpy, errors by their definitions."""

import math

import numpy as np
from scipy.optimize import least_squares as minimised

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.operators import CONSTANT
from atoll_core.expression.program import Program
from tests.oracles.tapes import node_values


def errors(output: FloatArray, target: FloatArray) -> tuple[float, float]:
    """Return mean absolute and mean squared error; infinite unless both are finite."""
    differences = [abs(float(a) - float(b)) for a, b in zip(output, target, strict=True)]
    absolute = math.fsum(differences) / len(target) if all(map(math.isfinite, differences)) else math.inf
    squared = [difference * difference for difference in differences]
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


def with_constant(program: Program, node: int, by: float) -> Program:
    """Return `program` with the constant at `node` changed by `by`."""
    constants = program.constants.copy()
    constants[node] += by
    return Program(program.operators, program.left, program.right, constants)


def best(
    program: Program, inputs: FloatArray, target: FloatArray, terms: list[int]
) -> tuple[FloatArray, FloatArray, float]:
    """Return constants, b, a_1, ... and the mean squared error that scipy finds, all of them moved together."""
    nodes = np.flatnonzero(program.operators == CONSTANT)
    start = least_squares(node_values(program, inputs)[terms], target)[0]

    def constants_of(parameters: FloatArray) -> FloatArray:
        constants = program.constants.copy()
        constants[nodes] = parameters[: len(nodes)]
        return constants

    def residual(parameters: FloatArray) -> FloatArray:
        moved = Program(program.operators, program.left, program.right, constants_of(parameters))
        scale = parameters[len(nodes) :]
        return scale[0] + scale[1:] @ node_values(moved, inputs)[terms] - target

    fit = minimised(residual, np.append(program.constants[nodes], start), x_scale="jac", max_nfev=500)
    return constants_of(fit.x), fit.x[len(nodes) :], 2.0 * float(fit.cost) / len(target)
