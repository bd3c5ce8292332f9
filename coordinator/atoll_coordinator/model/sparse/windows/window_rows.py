"""Windows along trajectories for the equation of one state, with errors of its variables and of quadrature.

A window is as short as the sampling asks for: between rows, products are interpolated by cubics and the test function
is integrated exactly. The difference to straight lines is taken for the error.

Letters: K terms, W windows of L rows, N rows of all trajectories, V variables.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from atoll_coordinator.data.differentiation.interpolation import estimate_value_noise, predict_left_out
from atoll_coordinator.data.differentiation.smoothing import Signal
from atoll_coordinator.data.recording import Recording
from atoll_coordinator.model.sparse.kernels.robust import NORMAL_DEVIATION
from atoll_coordinator.model.sparse.weak_form import Measured, measured_of, window_integrals
from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

_CUBIC, _LINE = 3, 1


@dataclass(frozen=True, eq=False)
class WindowRows:
    """Windows of the equation of variable `target`.

    `inputs` (V, N) are the variables as measured, of a long table on the rows of the windows alone, `noise` (V,) the
    deviations of their errors; `first` (W,) is the first row of each window, `owners` (W,) its trajectory. `bumps` and
    `slopes` (2, W, L) are the test functions and minus their derivatives as weights of rows, by cubics and by straight
    lines; `sides` (2, W) the left sides.
    """

    inputs: FloatArray
    noise: FloatArray
    target: int
    first: Ints
    owners: Ints
    bumps: FloatArray
    slopes: FloatArray
    sides: FloatArray

    @cached_property
    def independent(self) -> float:
        """How many windows there are that do not overlap."""
        return float(len(self.apart().first))

    @property
    def own(self) -> FloatArray:
        """The variances (W,) of the left sides."""
        return np.asarray((self.slopes[0] ** 2).sum(axis=1) * self.noise[self.target] ** 2)

    @cached_property
    def typical(self) -> float:
        """The typical square of a left side, by the median, at least that of its errors."""
        median = float(np.median(np.abs(self.sides[0])))
        return float(max((NORMAL_DEVIATION * median) ** 2, np.median(self.own), 1e-300))

    def integrals(self, values: FloatArray) -> FloatArray:
        """Return the integrals (K, W) of functions with these `values` (K, N)."""
        return window_integrals(self.first, self.bumps[0], values)

    def integrals_by_lines(self, values: FloatArray) -> FloatArray:
        """Return the same by straight lines."""
        return window_integrals(self.first, self.bumps[1], values)

    def apart(self) -> "WindowRows":
        """Return the windows that do not overlap."""
        reach, kept, last = self.bumps.shape[2] - 1, list[int](), -self.bumps.shape[2]
        for place, row in enumerate(self.first.tolist()):
            if row - last >= reach:
                kept.append(place)
                last = row
        return replace(
            self,
            first=self.first[kept],
            owners=self.owners[kept],
            bumps=np.ascontiguousarray(self.bumps[:, kept]),
            slopes=np.ascontiguousarray(self.slopes[:, kept]),
            sides=np.ascontiguousarray(self.sides[:, kept]),
        )

    def spread(self, errors: FloatArray) -> FloatArray:
        """Return for each window the largest of the `errors` (W,) of it and its neighbours."""
        largest = np.abs(errors)
        is_next = self.owners[1:] == self.owners[:-1]
        sizes = largest.copy()
        largest[1:] = np.where(is_next, np.maximum(largest[1:], sizes[:-1]), largest[1:])
        largest[:-1] = np.where(is_next, np.maximum(largest[:-1], sizes[1:]), largest[:-1])
        return largest


def window_rows(recording: Recording, names: Sequence[str], variable: str) -> WindowRows | None:
    """Return the windows for the equation of `variable`, a state; `names` (V,) are symbols of states and inputs.

    None where trajectories are too short for any.
    """
    measured = measured_of(recording, names)
    noise = np.array(
        [_noise(measured, place) if size > 0.0 else 0.0 for place, size in enumerate(measured.noise.tolist())]
    )
    target = names.index(recording.state_symbols[recording.states.index(variable)])
    rows, half = None, SETTINGS.windows.least_half
    widest = max(end - start for start, end in measured.ranges) // SETTINGS.sparse.least_windows
    while half <= widest and (wider := _windows(measured, noise, target, half)) is not None:
        if rows is not None and not _is_resolved(wider):
            break
        rows, half = wider, math.ceil(half * SETTINGS.windows.half_ratio)
    return rows


def _noise(measured: Measured, place: int) -> float:
    """Return the deviation of the errors of a variable by how well rows are predicted from their neighbours."""
    signals = [
        Signal(measured.times[start:end], measured.values[place, start:end].copy()) for start, end in measured.ranges
    ]
    return estimate_value_noise(*predict_left_out(signals))


def _is_resolved(rows: WindowRows) -> bool:
    """Tell whether lines between rows serve each state as well as cubics, by its noise, in enough of the windows."""
    cubics, lines = (window_integrals(rows.first, slope, rows.inputs) for slope in rows.slopes)
    own = np.outer(rows.noise**2, (rows.slopes[0] ** 2).sum(axis=1))
    shares = [
        np.mean(rows.spread(cubic - line) ** 2 <= variance)
        for cubic, line, variance in zip(cubics, lines, own, strict=True)
    ]
    return all(share >= SETTINGS.windows.resolved_share for share in np.array(shares)[rows.noise > 0.0])


def _windows(measured: Measured, noise: FloatArray, target: int, half: int) -> WindowRows | None:
    """Return windows, each beginning where the middle of the one before is; None where there are next to none."""
    length = 2 * half + 1
    places = [(row, owner) for owner, (start, end) in enumerate(measured.ranges)
              for row in range(start, end - length + 1, half)]  # fmt: skip
    if len(places) < SETTINGS.sparse.least_windows:
        return None
    first, owners = np.array(places, np.int64)[thinned_places(len(places), SETTINGS.windows.most)].T.copy()
    times = measured.times[first[:, None] + np.arange(length)]
    weights = [_weights(times, order) for order in (_CUBIC, _LINE)]
    bumps, slopes = np.array([pair[0] for pair in weights]), np.array([pair[1] for pair in weights])
    values = np.ascontiguousarray(measured.values[target : target + 1])
    sides = np.array([-window_integrals(first, slope, values)[0] for slope in slopes])
    inputs = np.ascontiguousarray(measured.values)
    if len(first) < len(places):
        inputs, first = _within(inputs, first, length)
    return WindowRows(inputs, noise, target, first, owners, bumps, slopes, sides)


def _within(inputs: FloatArray, first: Ints, length: int) -> tuple[FloatArray, Ints]:
    """Return the rows of `inputs` (V, N) that lie in windows of this length, and where these begin among them.

    Terms are computed on all rows there are: of a long table, on no more than the windows have.
    """
    rows = np.unique(first[:, None] + np.arange(length))
    return np.ascontiguousarray(inputs[:, rows]), np.searchsorted(rows, first)


def _weights(times: FloatArray, order: int) -> tuple[FloatArray, FloatArray]:
    """Return weights (W, L) of rows at `times` (W, L) that integrate a function times the test function, or its slope.

    Between two rows the function is the polynomial of this order through the nearest rows of the window.
    """
    nodes, shares = np.polynomial.legendre.leggauss(SETTINGS.windows.smoothness + _CUBIC)
    middle, width = 0.5 * (times[:, :1] + times[:, -1:]), 0.5 * (times[:, -1:] - times[:, :1])
    bump, slope = np.zeros_like(times), np.zeros_like(times)
    exponent, length = SETTINGS.windows.smoothness, times.shape[1]
    for gap in range(length - 1):
        low = min(max(gap - order // 2, 0), length - order - 1)
        near = times[:, low : low + order + 1]
        size = 0.5 * (times[:, gap + 1] - times[:, gap])[:, None]
        places = times[:, gap : gap + 1] + size * (nodes + 1.0)
        unit = (places - middle) / width
        inside = np.maximum(1.0 - unit * unit, 0.0)
        value = inside**exponent * shares * size
        change = -2.0 * exponent * unit * inside ** (exponent - 1) / width * shares * size
        for place in range(order + 1):
            basis = np.ones_like(places)
            for neighbour in range(order + 1):
                if neighbour != place:
                    basis = basis * (places - near[:, neighbour, None]) / (near[:, place] - near[:, neighbour])[:, None]
            bump[:, low + place] += (value * basis).sum(axis=1)
            slope[:, low + place] += (change * basis).sum(axis=1)
    return bump, slope
