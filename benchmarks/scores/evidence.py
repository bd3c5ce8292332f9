"""The price of a system's constants in its evidence: Laplace's method with priors on derivatives. Pure."""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from atoll_coordinator.model.shooting.system import System
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import constant_places

_REDUNDANT: Final = 1e-11
"""Numerics: squared effects below this share are differences' rounding."""


def occam(information: FloatArray, system: System, inputs: FloatArray) -> float:
    """Return the nats that the constants of a system cost, by Laplace's method (MacKay 1992).

    With the information H and the mean products G of effects (`effects_of`) that is 1/2 ln det(H + G) - 1/2 ln det G,
    the same for other constants of the same function, and the prior of the effect e of each constant alone, which is
    not: 2/pi e^2/(1 + e^2)^2 vanishes at 0, since a term of next to no effect is no term (non-local priors: Johnson &
    Rossell 2010, Journal of the Royal Statistical Society B 72:143). It is taken at the estimate: by 5 nats too much
    where that is a tenth of its error.

    Args:
        information: second derivatives (P, P) of minus the log-likelihood.
        system: with the constants (P,) of greatest likelihood.
        inputs: of its programs, (V, R).
    """
    if not system.count:
        return 0.0
    effects = effects_of(system, inputs)
    widths = 1.0 / np.maximum(np.sqrt(np.diag(effects)), 1e-300)
    metric = effects * np.outer(widths, widths) + _REDUNDANT * np.eye(system.count)
    unit = information * np.outer(widths, widths)
    gained = np.linalg.slogdet(metric + unit)[1] - np.linalg.slogdet(metric)[1]
    sizes = np.maximum(np.abs(system.values / widths), 1e-300)
    priors = math.log(0.5 * math.pi) + 2.0 * np.log1p(sizes**2) - 2.0 * np.log(sizes)
    return float(0.5 * gained + (priors - 0.5 * math.log(2.0 * math.pi)).sum())


def effects_of(system: System, inputs: FloatArray) -> FloatArray:
    """Return the mean products (P, P) of what constants change in their derivatives, over these derivatives' variance.

    Those of different equations are 0.
    """
    effects = np.zeros((system.count, system.count))
    first = 0
    for program in system.programs:
        before, slopes = values_of(program, inputs), []
        for place in constant_places(program):
            constants = program.constants.copy()
            step = 1e-6 * (abs(constants[place]) or 1.0)
            constants[place] += step
            slopes.append((values_of(replace(program, constants=constants), inputs) - before) / step)
        known = np.isfinite([before, *slopes]).all(axis=0)
        matrix = np.array(slopes).reshape(-1, len(before))[:, known] / (float(np.std(before[known])) or 1.0)
        end = first + len(matrix)
        effects[first:end, first:end] = matrix @ matrix.T / max(int(known.sum()), 1)
        first = end
    return effects
