"""Values of a state at rows where it was not measured although another state was, from its own rows (pure).

Between its own rows a state is interpolated; before the first and after the last of them it is not known.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from atoll.data.dataset import FloatArray
from atoll_coordinator.data.differentiation.kernels.stencils import HALF_WIDTHS
from atoll_coordinator.data.differentiation.smoothing import Signal


@dataclass(frozen=True, eq=False)
class Filled:
    """A signal without holes: `signal`, and the error of what was filled in, all (R,) and 0 where it was measured.

    `steps` are differences between two orders of interpolation, infinite where the value is not known; `gains` the
    standard errors over that of the measurements.
    """

    signal: Signal
    steps: FloatArray
    gains: FloatArray


def make_signal(times: FloatArray, values: FloatArray, inverse_variances: FloatArray | None = None) -> Signal:
    """Return the signal of `values` (R,), NaN where they are missing; there the neighbours' line stands in."""
    is_known = np.isfinite(values)
    if is_known.all():
        return Signal(times, values, inverse_variances=inverse_variances)
    return Signal(times, fill(times, values, is_known, 1)[0], None, inverse_variances, is_known.astype(np.float64))


def fill_holes(signal: Signal) -> Filled:
    """Return `signal` with what is missing interpolated as well as its own rows allow."""
    if signal.is_measured is None:
        zeros = np.zeros(len(signal.times))
        return Filled(signal, zeros, zeros)
    values, steps, gains = fill(signal.times, signal.values, signal.is_measured > 0.0, HALF_WIDTHS)
    return Filled(replace(signal, values=values, is_measured=None), steps, gains)


def fill(
    times: FloatArray, values: FloatArray, is_known: np.ndarray[tuple[int], np.dtype[np.bool_]], pairs: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values without holes, steps and gains, see `Filled`.

    A row between known ones takes the polynomial through 1 to `pairs` of them on either side whose step from the next
    smaller one is least. Elsewhere the nearest known value is held, 0 where there is none.
    """
    filled, steps, gains = values.copy(), np.zeros(len(times)), np.zeros(len(times))
    known = np.flatnonzero(is_known).tolist()
    at, of = times.tolist(), values.tolist()
    for row in np.flatnonzero(~is_known).tolist():
        following = int(np.searchsorted(known, row))
        before, after = known[:following][::-1][:pairs], known[following:][:pairs]
        if before and after:
            nodes = [node for pair in zip(before, after, strict=False) for node in pair]
            filled[row], steps[row], gains[row] = _interpolate(at, of, row, nodes)
        else:
            filled[row] = of[(before or after)[0]] if known else 0.0
            steps[row] = math.inf
    return filled, steps, gains


def _interpolate(times: list[float], values: list[float], row: int, nodes: list[int]) -> tuple[float, float, float]:
    """Return value, step and gain at `row` by the best of the polynomials through the first 2, 4, … `nodes`."""
    best, last = (values[nodes[0]], math.inf, 1.0), values[nodes[0]]
    for count in range(2, len(nodes) + 1, 2):
        weights = [_lagrange_weight(times, row, node, nodes[:count]) for node in nodes[:count]]
        value, square = values[nodes[0]], 0.0
        for weight, node in zip(weights, nodes, strict=False):
            value += weight * (values[node] - values[nodes[0]])
            square += weight * weight
        step = abs(value - last)
        best = min(best, (value, step, math.sqrt(square)), key=lambda each: each[1])
        last = value
    return best


def _lagrange_weight(times: list[float], row: int, node: int, nodes: list[int]) -> float:
    weight = 1.0
    for other in nodes:
        if other != node:
            weight *= (times[row] - times[other]) / (times[node] - times[other])
    return weight
