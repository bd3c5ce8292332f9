"""Means, slopes and curvatures of columns over short windows, as cheap as differences, and their noise. Pure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from atoll_coordinator.data.columns.finding import Parts
from atoll_coordinator.data.columns.sums import dot, middle
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, IntArray

LIMITS = SETTINGS.columns
_ROOT_70 = math.sqrt(70.0)
"""Size of the fourth difference of white noise of size one."""


@dataclass(frozen=True, eq=False)
class LocalSlopes:
    """Of n windows: the mean of each column, slopes and curvatures of states, all (n,); `part` the trajectory.

    `bends` are the sizes of curvatures by the row instead of by the time; windows fewer than `apart` places apart share
    rows.
    """

    means: Mapping[str, FloatArray]
    slopes: Mapping[str, FloatArray]
    curvatures: Mapping[str, FloatArray]
    bends: Mapping[str, FloatArray]
    part: IntArray
    apart: int


def local_slopes(times: Parts, values: Mapping[str, Parts], states: Sequence[str]) -> LocalSlopes | None:
    """Return slopes over the shortest windows in which noise does not hide curvatures; None where there are none.

    Slopes are those of least squares in the number of the row; steps of the times are taken as even within a window.
    """
    width = LIMITS.least_window
    noises = {name: _noise(values[name]) for name in states}
    while all(len(part) > width for part in times):
        made = _over(times, values, states, width)
        if made is None:
            return None
        if all(noises[name] * curvature_gain(width) < LIMITS.clear * middle(made.bends[name]) for name in states):
            return made
        width = 2 * width + 1
    return None


def _over(times: Parts, values: Mapping[str, Parts], states: Sequence[str], width: int) -> LocalSlopes | None:
    half = width // 2
    offsets = np.arange(-half, half + 1, dtype=np.float64)
    squares = dot(offsets, offsets)
    bent = offsets * offsets - squares / width
    means: dict[str, list[FloatArray]] = {name: [] for name in values}
    slopes: dict[str, list[FloatArray]] = {name: [] for name in states}
    curvatures: dict[str, list[FloatArray]] = {name: [] for name in states}
    bends: dict[str, list[FloatArray]] = {name: [] for name in states}
    numbers: list[IntArray] = []
    rows = sum(len(part) - width + 1 for part in times)
    every = max(1, rows // LIMITS.most_windows)
    for number, part in enumerate(times):
        firsts = np.arange(0, len(part) - width + 1, every)
        steps = (part[firsts + width - 1] - part[firsts]) / (width - 1)
        numbers.append(np.full(len(firsts), number, np.int64))
        for name, parts in values.items():
            along = parts[number]
            means[name].append(_weighted(along, firsts, np.full(width, 1.0 / width)))
            if name in slopes:
                slopes[name].append(_weighted(along, firsts, offsets / squares) / steps)
                curvature = _weighted(along, firsts, 2.0 * bent / dot(bent, bent))
                bends[name].append(np.abs(curvature))
                curvatures[name].append(curvature / (steps * steps))
    kinds = (means, slopes, curvatures, bends)
    joined = [{name: np.concatenate(parts) for name, parts in kind.items()} for kind in kinds]
    is_there = np.logical_and.reduce([np.isfinite(array) for kind in joined for array in kind.values()])
    kept = np.flatnonzero(is_there)
    if len(kept) < LIMITS.least_rows:
        return None
    a, b, c, d = ({name: array[kept] for name, array in kind.items()} for kind in joined)
    return LocalSlopes(a, b, c, d, np.concatenate(numbers)[kept], max(1, width // every))


def _weighted(values: FloatArray, firsts: IntArray, weights: FloatArray) -> FloatArray:
    """Return the weighted sum over each window, whose rows begin at `firsts`, added from the first row on."""
    total = np.zeros(len(firsts))
    for place, weight in enumerate(weights.tolist()):
        total = total + weight * values[firsts + place]
    return total


def _noise(parts: Parts) -> float:
    """Return the size of the noise of a state by its fourth differences, infinite where there are none."""
    differences = np.concatenate([np.diff(part[: LIMITS.most_rows], 4) for part in parts])
    differences = differences[np.isfinite(differences)]
    return math.sqrt(dot(differences, differences) / len(differences)) / _ROOT_70 if len(differences) else math.inf


def curvature_gain(width: int) -> float:
    """Return the standard deviation of a curvature for noise of size one and steps of one, 720 / w^5 about squared."""
    return math.sqrt(720.0 / (width * (width**2 - 1.0) * (width**2 - 4.0)))
