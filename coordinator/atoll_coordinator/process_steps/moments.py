"""Mean and covariance of one step of a process, to second order in the length of the step; for linear processes, to
higher order.

For dx = f dt + g dW with B = g g', the generator of the process is L = f . grad + 1/2 B : grad grad. In a step h from x

    mean        h f + h^2/2 L f + ... , the motion by f alone to order h^4
    covariance  integral over s from 0 to h of E(h - s) (B + s L B) E(h - s)'

with J the Jacobian of f and E(s) = I + s J + s^2/2 J J + s^3/6 J J J. This is the expansion of the moments in powers of
h (Kessler 1997, section 2; Florens-Zmirou 1989). It is written as a local linearisation (Shoji & Ozaki 1998), so that
the covariance is positive wherever B + s L B is positive. The integral is computed by Gaussian quadrature.

A state may have no noise of its own, but depend on other states with noise (hypoelliptic process). If its drift depends
on a state with noise, its variance over a step is of third order, J B J' h^3 / 3. If its drift depends only on a state
whose variance is of third order, its own variance is of fifth order. Ditlevsen & Samson 2019 expand to these orders;
Melnykova 2020 uses the same linearisation as this module. If a variance is so small, the mean must be accurate. So the
motion by the drift alone is computed by a fourth-order Runge-Kutta step.

A table may also be the output of the Euler-Maruyama method, with one row for each of its steps. Then mean and
covariance of a step are exactly h f and h B: the noise of one state does not reach another state within the step.

Doubtful: the expansion is only valid for short steps. If the drift changes much within a step, the truncated moments
are wrong, and constants are biased. Letters: S states, V variables, R rows.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

import numpy as np

from atoll_coordinator.process_steps import Discretisation
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.derivative import derivative, with_variables
from atoll_core.expression.evaluation import NUMPY, function_of, values_of
from atoll_core.expression.program import Program, constant_places, structure

Pair = tuple[int, int]
"""A component of the diffusion: the indices (i, j) of two states, i <= j."""

_NODES: Final = ((0.5 - 0.5 / math.sqrt(3.0), 0.5), (0.5 + 0.5 / math.sqrt(3.0), 0.5))
_MORE_NODES: Final = ((0.5 - math.sqrt(0.15), 5.0 / 18.0), (0.5, 4.0 / 9.0), (0.5 + math.sqrt(0.15), 5.0 / 18.0))
"""Nodes of Gaussian quadrature on [0, 1], with weights, for hypoelliptic processes. For these processes two nodes are
too few: the covariance of a state that depends on two noisy states would be singular."""


@dataclass(frozen=True, eq=False)
class StepMoments:
    """The moments of a step: `mean` (S, R), `covariance` (S, S, R), and the `jacobian` (S, S, R) of x + mean.

    If the diffusion of a state is negative, its covariance is NaN, even if the noise of other states makes the
    covariance of the step positive.
    """

    mean: FloatArray
    covariance: FloatArray
    jacobian: FloatArray


def predict_step_moments(
    drift: Sequence[Program],
    diffusion: Mapping[Pair, Program],
    points: FloatArray,
    steps: FloatArray,
    discretisation: Discretisation = "local linearisation",
) -> StepMoments:
    """Return the moments of steps.

    Args:
        drift: S programs, f.
        diffusion: the programs of B, by component; missing components are zero.
        points: (V, R), the values at the beginning of each step; states first, then inputs, which are constant in a
            step.
        steps: (R,), the lengths of the steps.
        discretisation: the meaning of a step.
    """
    states = len(drift)
    with np.errstate(all="ignore"):
        value, jacobian, hessian = _expand_programs(drift, points, states)
        tensor, change = _evaluate_diffusion(diffusion, points, value, states)
        if discretisation == "Euler-Maruyama":
            return StepMoments(steps * value, steps * tensor, np.eye(states)[:, :, None] + steps * jacobian)
        curved = 0.25 * np.einsum("jkr,ijkr->ir", tensor, hessian)
        mean = _move_by_drift(drift, value, points, steps) + steps * steps * curved
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
    """Return the Cholesky factors L (S, S, R) of covariances L L'. A factor is zero if there is no noise, and NaN if a
    variance is negative."""
    factor = np.zeros_like(covariance)
    with np.errstate(all="ignore"):
        for i in range(len(covariance)):
            for j in range(i + 1):
                rest = covariance[i, j] - (factor[i, :j] * factor[j, :j]).sum(axis=0)
                factor[i, j] = np.sqrt(rest) if i == j else np.where(rest == 0.0, 0.0, rest / factor[j, j])
    return factor


def _move_by_drift(drift: Sequence[Program], value: FloatArray, points: FloatArray, steps: FloatArray) -> FloatArray:
    """Return the motion of the states by the drift alone in a step (Runge-Kutta); `value` is the drift at `points`."""
    slopes = [value]
    for share in (0.5, 0.5, 1.0):
        moved = np.concatenate([points[: len(drift)] + share * steps * slopes[-1], points[len(drift) :]])
        slopes.append(np.array([values_of(program, moved) for program in drift]))
    return np.asarray(steps / 6.0 * (slopes[0] + 2.0 * slopes[1] + 2.0 * slopes[2] + slopes[3]))


def _propagator(powers: tuple[FloatArray, FloatArray, FloatArray], steps: FloatArray) -> FloatArray:
    """Return E(s) up to the third power of the Jacobian.

    The third power is needed for a state two equations away from the noise. The other states explain all but 1/36 of
    the leading term of its variance, so the next term of the expansion matters.
    """
    one, two, three = powers
    return np.asarray(np.eye(len(one))[:, :, None] + steps * (one + 0.5 * steps * (two + steps / 3.0 * three)))


def _expand_programs(
    programs: Sequence[Program], points: FloatArray, states: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values (N, R), gradients (N, S, R) and Hessians (N, S, S, R) of N programs with respect to the states."""
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
    """A key for a program. Two keys are equal if the programs differ at most in the values of constants."""

    program: Program = field(compare=False)
    key: bytes


@lru_cache(maxsize=256)
def _expansion(of: _Structure, variables: int, states: int) -> Callable[..., Sequence[FloatArray]]:
    """Return a function of variables and constants.

    Its first result is the value. For each state i, the next results are the derivative by i, and the second
    derivatives by i and each of the states 0 to i.
    """
    program = with_variables(of.program, variables)
    parts = [program]
    for i in range(states):
        slope = derivative(program, i)
        parts += [slope, *(derivative(slope, j) for j in range(i + 1))]
    return function_of(parts, variables + len(constant_places(of.program)), NUMPY)


def _evaluate_diffusion(
    diffusion: Mapping[Pair, Program], points: FloatArray, value: FloatArray, states: int
) -> tuple[FloatArray, FloatArray]:
    """Return B and L B, (S, S, R) each."""
    rows, pairs = points.shape[1], list(diffusion)
    tensor, change = np.zeros((states, states, rows)), np.zeros((states, states, rows))
    values, gradients, hessians = _expand_programs([*diffusion.values()], points, states)
    for (i, j), entry in zip(pairs, values, strict=True):
        tensor[i, j] = tensor[j, i] = entry
    changes = np.einsum("jr,njr->nr", value, gradients) + 0.5 * np.einsum("jkr,njkr->nr", tensor, hessians)
    for (i, j), entry in zip(pairs, changes, strict=True):
        change[i, j] = change[j, i] = entry
    return tensor, change
