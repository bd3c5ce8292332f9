"""Mean and covariance of one step of a process, to second order in the step and beyond where the process is linear.

For dx = f dt + g dW with B = g g', the generator of the process is L = f . grad + 1/2 B : grad grad. In a step h from x

    mean        h f + h^2/2 L f + ... , the motion by f alone of order h^4
    covariance  integral over s from 0 to h of E(h - s) (B + s L B) E(h - s)'

with J the Jacobian of f and E(s) = I + s J + s^2/2 J J + s^3/6 J J J. These are the expansion of moments in powers of h
(Kessler 1997, section 2; Florens-Zmirou 1989), written as a local linearisation (Shoji & Ozaki 1998), so that the
covariance is positive wherever B + s L B is; the integral is that of Gauss.

A state without noise of its own is moved by the noise of the states it follows: over a step its variance is of the
third order, J B J' h^3 / 3, or of the fifth where it follows such a state. This is small and not zero (hypoelliptic
processes: Ditlevsen & Samson 2019, who expand to these orders; Melnykova 2020, by the linearisation used here). So
small a variance needs an accurate mean: the motion by the drift alone is a step of Runge and Kutta, of fourth order.

A table may also be the output of Euler and Maruyama's method, a row for each of its steps. Then mean and covariance of
a step are h f and h B, and nothing else: noise of one state does not reach another one within the step.
Letters: S states, V variables, R rows.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

import numpy as np

from atoll_coordinator.stochastic import Discretisation
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.derivative import derivative, with_variables
from atoll_core.expression.evaluation import NUMPY, function_of, values_of
from atoll_core.expression.program import Program, constant_places, structure

Pair = tuple[int, int]
"""Two states by their index, the first not above the second: a component of the diffusion."""

_NODES: Final = ((0.5 - 0.5 / math.sqrt(3.0), 0.5), (0.5 + 0.5 / math.sqrt(3.0), 0.5))
_MORE_NODES: Final = ((0.5 - math.sqrt(0.15), 5.0 / 18.0), (0.5, 4.0 / 9.0), (0.5 + math.sqrt(0.15), 5.0 / 18.0))
"""Nodes of Gauss's rule on [0, 1] and their weights; with two, the covariance that two states
give a third would be singular."""


@dataclass(frozen=True, eq=False)
class StepMoments:
    """The moments of a step: `mean` (S, R), `covariance` (S, S, R), and the `jacobian` (S, S, R) of x + mean.

    The covariance is NaN where the diffusion of a state is negative, even where the covariance of the step is positive:
    noise of other states may outweigh it.
    """

    mean: FloatArray
    covariance: FloatArray
    jacobian: FloatArray


def step_moments(
    drift: Sequence[Program],
    diffusion: Mapping[Pair, Program],
    points: FloatArray,
    steps: FloatArray,
    discretisation: Discretisation = "local linearisation",
) -> StepMoments:
    """Return the moments of steps.

    Args:
        drift: S programs, f.
        diffusion: B, component by component; those that are missing are zero.
        points: (V, R), where steps begin; states first, then inputs, which stay as they are in a step.
        steps: (R,), their lengths.
        discretisation: what a step is.
    """
    states = len(drift)
    with np.errstate(all="ignore"):
        value, jacobian, hessian = _expanded(drift, points, states)
        tensor, change = _diffusion(diffusion, points, value, states)
        if discretisation == "Euler-Maruyama":
            return StepMoments(steps * value, steps * tensor, np.eye(states)[:, :, None] + steps * jacobian)
        curved = 0.25 * np.einsum("jkr,ijkr->ir", tensor, hessian)
        mean = _flow(drift, value, points, steps) + steps * steps * curved
        square = np.einsum("ijr,jkr->ikr", jacobian, jacobian)
        powers = jacobian, square, np.einsum("ijr,jkr->ikr", square, jacobian)
        covariance = np.zeros_like(tensor)
        variances = tensor[range(states), range(states)]
        for node, weight in _NODES if variances.any(axis=1).all() else _MORE_NODES:
            left = _propagator(powers, (1.0 - node) * steps)
            at_node = tensor + node * steps * change
            covariance += weight * steps * np.einsum("ijr,jkr,lkr->ilr", left, at_node, left)
        covariance[:, :, (variances < 0.0).any(axis=0)] = np.nan
        return StepMoments(mean, covariance, _propagator(powers, steps))


def factors_of(covariance: FloatArray) -> FloatArray:
    """Return the factors L of Cholesky (S, S, R) of covariances L L': zero for no noise, NaN for negative variances."""
    factor = np.zeros_like(covariance)
    with np.errstate(all="ignore"):
        for i in range(len(covariance)):
            for j in range(i + 1):
                rest = covariance[i, j] - (factor[i, :j] * factor[j, :j]).sum(axis=0)
                factor[i, j] = np.sqrt(rest) if i == j else np.where(rest == 0.0, 0.0, rest / factor[j, j])
    return factor


def _flow(drift: Sequence[Program], value: FloatArray, points: FloatArray, steps: FloatArray) -> FloatArray:
    """Return how far the drift, whose `value` at `points` is known, moves the states in a step: Runge and Kutta."""
    slopes = [value]
    for share in (0.5, 0.5, 1.0):
        moved = np.concatenate([points[: len(drift)] + share * steps * slopes[-1], points[len(drift) :]])
        slopes.append(np.array([values_of(program, moved) for program in drift]))
    return np.asarray(steps / 6.0 * (slopes[0] + 2.0 * slopes[1] + 2.0 * slopes[2] + slopes[3]))


def _propagator(powers: tuple[FloatArray, FloatArray, FloatArray], steps: FloatArray) -> FloatArray:
    """Return E(s) of the first three powers of the Jacobian.

    The variance of a state two equations away from noise needs the term next to the leading one in the third power:
    the part that other states do not explain is a thirty-sixth of the leading one.
    """
    one, two, three = powers
    return np.asarray(np.eye(len(one))[:, :, None] + steps * (one + 0.5 * steps * (two + steps / 3.0 * three)))


def _expanded(
    programs: Sequence[Program], points: FloatArray, states: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values (N, R), gradients (N, S, R) and Hessians (N, S, S, R) of N programs by the states."""
    count, (variables, rows) = len(programs), points.shape
    values, gradients = np.zeros((count, rows)), np.zeros((count, states, rows))
    hessians = np.zeros((count, states, states, rows))
    for number, program in enumerate(programs):
        constants = program.constants[constant_places(program)]
        parts = _expansion(_Structure(program, structure(program)), variables, states)(*points, *constants)
        values[number] = parts[0]
        slopes = iter(parts[1:])
        for i in range(states):
            gradients[number, i] = next(slopes)
            for j in range(i + 1):
                hessians[number, i, j] = hessians[number, j, i] = next(slopes)
    return values, gradients, hessians


@dataclass(frozen=True)
class _Structure:
    """A program, equal to others that differ from it in the values of constants only."""

    program: Program = field(compare=False)
    key: bytes


@lru_cache(maxsize=256)
def _expansion(of: _Structure, variables: int, states: int) -> Callable[..., Sequence[FloatArray]]:
    """Return a function of variables and constants: the value, and by states the slope and its slopes up to there."""
    program = with_variables(of.program, variables)
    parts = [program]
    for i in range(states):
        slope = derivative(program, i)
        parts += [slope, *(derivative(slope, j) for j in range(i + 1))]
    return function_of(parts, variables + len(constant_places(of.program)), NUMPY)


def _diffusion(
    diffusion: Mapping[Pair, Program], points: FloatArray, value: FloatArray, states: int
) -> tuple[FloatArray, FloatArray]:
    """Return B and L B, (S, S, R) each."""
    rows, pairs = points.shape[1], list(diffusion)
    tensor, change = np.zeros((states, states, rows)), np.zeros((states, states, rows))
    values, gradients, hessians = _expanded([*diffusion.values()], points, states)
    for (i, j), entry in zip(pairs, values, strict=True):
        tensor[i, j] = tensor[j, i] = entry
    changes = np.einsum("jr,njr->nr", value, gradients) + 0.5 * np.einsum("jkr,njkr->nr", tensor, hessians)
    for (i, j), entry in zip(pairs, changes, strict=True):
        change[i, j] = change[j, i] = entry
    return tensor, change
