"""Mean and covariance of what a process moves in one step, to second order in the step and beyond where it is linear.

For dx = f dt + g dW with B = g g', the generator of the process is L = f . grad + 1/2 B : grad grad. In a step h from x

    mean        h f + h^2/2 L f + h^3/6 J J f
    covariance  integral over s from 0 to h of E(h - s) (B + s L B) E(h - s)'

with J the Jacobian of f and E(s) = I + s J + s^2/2 J J. These are the expansion of moments in powers of h (Kessler
1997, section 2; Florens-Zmirou 1989), written as a local linearisation (Shoji & Ozaki 1998), so that the covariance is
positive wherever B + s L B is; the integral is that of Gauss by two nodes. Letters: S states, V variables, R rows.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll.data.dataset import FloatArray
from atoll.expression.program import Program
from atoll_coordinator.model.stochastic.jets import Jet, jet_of

Pair = tuple[int, int]
"""Two states by their index, the first not above the second: a component of the diffusion."""

_NODES: Final = (0.5 - 0.5 / math.sqrt(3.0), 0.5 + 0.5 / math.sqrt(3.0))
"""Nodes of Gauss's rule on [0, 1], each of weight one half."""


@dataclass(frozen=True, eq=False)
class StepMoments:
    """What a step moves: `mean` (S, R), `covariance` (S, S, R), and its `jacobian` (S, S, R), that of x + mean."""

    mean: FloatArray
    covariance: FloatArray
    jacobian: FloatArray


def step_moments(
    drift: Sequence[Program], diffusion: Mapping[Pair, Program], points: FloatArray, steps: FloatArray
) -> StepMoments:
    """Return the moments of steps.

    Args:
        drift: S programs, f.
        diffusion: B, component by component; those that are missing are zero.
        points: (V, R), where steps begin; states first, then inputs, which stay as they are in a step.
        steps: (R,), their lengths.
    """
    states = len(drift)
    with np.errstate(all="ignore"):
        value, jacobian, hessian = _stacked([jet_of(program, points, states) for program in drift], states)
        tensor, its_change = _diffusion(diffusion, points, value, states)
        twice = np.einsum("ijr,jr->ir", jacobian, value)
        generated = twice + 0.5 * np.einsum("jkr,ijkr->ir", tensor, hessian)
        thrice = np.einsum("ijr,jr->ir", jacobian, twice)
        mean = steps * (value + 0.5 * steps * (generated + steps / 3.0 * thrice))
        square = np.einsum("ijr,jkr->ikr", jacobian, jacobian)
        covariance = np.zeros_like(tensor)
        for node in _NODES:
            left = _propagator(jacobian, square, (1.0 - node) * steps)
            its = tensor + node * steps * its_change
            covariance += 0.5 * steps * np.einsum("ijr,jkr,lkr->ilr", left, its, left)
        return StepMoments(mean, covariance, _propagator(jacobian, square, steps))


def _propagator(jacobian: FloatArray, square: FloatArray, steps: FloatArray) -> FloatArray:
    return np.asarray(np.eye(len(jacobian))[:, :, None] + steps * (jacobian + 0.5 * steps * square))


def _stacked(jets: Sequence[Jet], states: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values (N, R), gradients (N, S, R) and Hessians (N, S, S, R) of N jets."""
    rows = len(jets[0].value)
    return (
        np.array([jet.value for jet in jets]),
        np.array([np.broadcast_to(jet.gradient, (states, rows)) for jet in jets]),
        np.array([np.broadcast_to(jet.hessian, (states, states, rows)) for jet in jets]),
    )


def _diffusion(
    diffusion: Mapping[Pair, Program], points: FloatArray, value: FloatArray, states: int
) -> tuple[FloatArray, FloatArray]:
    """Return B and L B, (S, S, R) each."""
    rows, pairs = points.shape[1], list(diffusion)
    tensor, its_change = np.zeros((states, states, rows)), np.zeros((states, states, rows))
    values, gradients, hessians = _stacked([jet_of(diffusion[pair], points, states) for pair in pairs], states)
    for (i, j), its in zip(pairs, values, strict=True):
        tensor[i, j] = tensor[j, i] = its
    changes = np.einsum("jr,njr->nr", value, gradients) + 0.5 * np.einsum("jkr,njkr->nr", tensor, hessians)
    for (i, j), its in zip(pairs, changes, strict=True):
        its_change[i, j] = its_change[j, i] = its
    return tensor, its_change
