"""Values of a state at rows where it was not measured although another state was, from its own rows (pure).

Between its own rows a state is interpolated; before the first and after the last of them it is not known.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.differentiation.kernels.stencils import HALF_WIDTHS
from atoll_coordinator.data.differentiation.smoothing import Signal
from atoll_core.data.dataset import FloatArray

Rows = npt.NDArray[np.intp]
"""Indices of rows."""


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
        return Filled(signal, *np.zeros((2, len(signal.times))))
    values, steps, gains = fill(signal.times, signal.values, signal.measured_rows, HALF_WIDTHS)
    return Filled(replace(signal, values=values, is_measured=None), steps, gains)


def fill(
    times: FloatArray, values: FloatArray, is_known: np.ndarray[tuple[int], np.dtype[np.bool_]], pairs: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values without holes, steps and gains, see `Filled`.

    A row between known ones takes the polynomial through 1 to `pairs` of them on either side whose step from the next
    smaller one is least. Elsewhere the nearest known value is held, 0 where there is none.
    """
    filled, steps, gains = values.copy(), np.zeros(len(times)), np.zeros(len(times))
    known, missing = np.flatnonzero(is_known), np.flatnonzero(~is_known)
    following = np.searchsorted(known, missing)
    counts = np.minimum(np.minimum(following, len(known) - following), pairs)
    for count in range(1, pairs + 1):
        rows, after = missing[counts == count], following[counts == count, None] + np.arange(count)
        before = following[counts == count, None] - 1 - np.arange(count)
        nodes = known[np.stack([before, after], axis=2).reshape(len(rows), 2 * count)]
        filled[rows], steps[rows], gains[rows] = _interpolate(times, values, rows, nodes)
    beyond = missing[counts == 0]
    steps[beyond] = math.inf
    filled[beyond] = values[known[np.maximum(following[counts == 0] - 1, 0)]] if len(known) else 0.0
    return filled, steps, gains


def _interpolate(
    times: FloatArray, values: FloatArray, rows: Rows, nodes: Rows
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values, steps and gains (M,) at `rows` (M,) by the best of the polynomials through 2, 4, … `nodes` (M, P).

    One number after another, in the order of the nodes: the same bits everywhere.
    """
    nearest = values[nodes[:, 0]]
    best, least, gains, last = nearest, np.full(len(rows), math.inf), np.ones(len(rows)), nearest
    for count in range(2, nodes.shape[1] + 1, 2):
        value, square = nearest, np.zeros(len(rows))
        for place in range(count):
            weight = _lagrange_weights(times, rows, nodes[:, :count], place)
            value = value + weight * (values[nodes[:, place]] - nearest)
            square += weight * weight
        step = np.abs(value - last)
        is_better = step < least
        best, least = np.where(is_better, value, best), np.where(is_better, step, least)
        gains = np.where(is_better, np.sqrt(square), gains)
        last = value
    return best, least, gains


def _lagrange_weights(times: FloatArray, rows: Rows, nodes: Rows, place: int) -> FloatArray:
    weights, own = np.ones(len(rows)), times[nodes[:, place]]
    for other in range(nodes.shape[1]):
        if other != place:
            beside = times[nodes[:, other]]
            weights *= (times[rows] - beside) / (own - beside)
    return weights
