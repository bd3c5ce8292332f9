"""Values at rows where a state was not measured, one row after another: the definition in plain Python."""

import math

import numpy as np

from atoll_core.data.dataset import FloatArray


def fill(
    times: FloatArray, values: FloatArray, is_known: np.ndarray[tuple[int], np.dtype[np.bool_]], pairs: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what `missing_values.fill` does, one row after another."""
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
        best = min(best, (value, step, math.sqrt(square)), key=lambda candidate: candidate[1])
        last = value
    return best


def _lagrange_weight(times: list[float], row: int, node: int, nodes: list[int]) -> float:
    weight = 1.0
    for other in nodes:
        if other != node:
            weight *= (times[row] - times[other]) / (times[node] - times[other])
    return weight
