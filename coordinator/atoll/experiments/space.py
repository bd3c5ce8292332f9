"""The experiments that can be made: what is asked for, and where and how long can be measured.

Letters: D states, U inputs, n points of D numbers and one for each input that can be chosen.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll.analysis.box import Box
from atoll.experiments.designs import Design
from atoll.experiments.measured import Measured
from atoll.experiments.suggestion import COSTS, Cost
from atoll_coordinator.result.result import Result
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError

MOST_SAMPLES: Final = 2_000
MOST_SUGGESTIONS: Final = 20
_POINTS: Final = 192
"""Points that are tried all over the bounds, for experiments of all lengths together."""
_FEWEST_POINTS: Final = 32
_MOST_CORNERS: Final = 32
_CORNER: Final = 0.02
"""How far from its corners a box is tried, over its widths: at the very corner a state may have no rates."""
_SHORTER: Final = (1.0, 0.5, 0.25, 0.125)
"""Shares of the duration, or of the samples, that are tried where these cost something."""
_FEWEST_SAMPLES: Final = 8
_APART: Final = 0.25
"""Share of the width by which suggestions differ in at least one number."""


@dataclass(frozen=True)
class Request:
    """What is asked for.

    `bounds` are of initial states and inputs by name (others are those of the data); `duration` and `samples` are those
    of an experiment (None: as of the median trajectory that was measured); `cost` is what an experiment costs, `count`
    how many are suggested; `rivals` are further systems, right-hand sides by state.
    """

    bounds: Mapping[str, tuple[float, float]]
    duration: float | None = None
    samples: int | None = None
    cost: Cost = "trajectory"
    count: int = 3
    seed: int = 0
    rivals: Sequence[Mapping[str, str]] = ()

    def check(self) -> None:
        """Raise UsageError where a number is out of range."""
        if self.cost not in COSTS:
            raise UsageError(f"the cost is {', '.join(COSTS[:-1])} or {COSTS[-1]}, but {self.cost!r} was given")
        if self.duration is not None and not (math.isfinite(self.duration) and self.duration > 0.0):
            raise UsageError(f"the duration of an experiment must be above 0, but {self.duration!r} was given")
        if self.samples is not None and not 2 <= self.samples <= MOST_SAMPLES:
            raise UsageError(f"an experiment has 2 to {MOST_SAMPLES} samples, but {self.samples!r} were given")
        if not 1 <= self.count <= MOST_SUGGESTIONS:
            raise UsageError(f"1 to {MOST_SUGGESTIONS} experiments are suggested, but {self.count!r} were asked for")


@dataclass(frozen=True, eq=False)
class DesignSpace:
    """Experiments from initial states of `states`, with constant `inputs`, both within `box`.

    `clock` are the inputs (by index) that are the time, which cannot be chosen; `begin` is the first time, `duration`
    and `samples` those of the longest experiment. `measured` is the box of what was measured, smoothed.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    clock: tuple[int, ...]
    box: Box
    begin: float
    duration: float
    samples: int
    cost: Cost
    measured: Box

    @property
    def free(self) -> tuple[int, ...]:
        """The inputs (by index) that can be chosen."""
        return tuple(index for index in range(len(self.inputs)) if index not in self.clock)

    @property
    def names(self) -> tuple[str, ...]:
        """The states and the inputs that can be chosen, in the order of a point."""
        return (*self.states, *(self.inputs[index] for index in self.free))

    @property
    def widths(self) -> FloatArray:
        """The widths (D,) of the bounds of initial states."""
        return np.asarray(self.box.widths[: len(self.states)])

    def limits(self, measured: FloatArray) -> FloatArray:
        """Return the range (D, 2) outside of which a state has blown up, by measured states (D, N) and bounds."""
        low = np.minimum(self.box.lower[: len(self.states)], measured.min(axis=1))
        high = np.maximum(self.box.upper[: len(self.states)], measured.max(axis=1))
        reach = SETTINGS.shooting.blow_up_widths * np.maximum(high - low, 1e-300)
        return np.ascontiguousarray(np.stack([low - reach, high + reach], axis=1))

    @property
    def shares(self) -> tuple[float, ...]:
        """Shares of the longest experiment that are tried."""
        return (1.0,) if self.cost == "trajectory" else _SHORTER

    def points(self, seed: int) -> FloatArray:
        """Return points (n, D + inputs) all over the bounds, and near their corners where these are few."""
        size, inner = len(self.box.lower), self.box.points(max(_POINTS // len(self.shares), _FEWEST_POINTS), seed)
        if 2**size > _MOST_CORNERS:
            return inner
        sides = np.meshgrid(*([(_CORNER, 1.0 - _CORNER)] * size), indexing="ij")
        corners = np.array(sides).reshape(size, -1).T
        return np.concatenate([inner, self.box.lower + corners * self.box.widths])

    def design(self, point: FloatArray, share: float) -> Design:
        """Return the experiment at a point, of a share of the longest one."""
        duration = self.duration * (share if self.cost == "duration" else 1.0)
        fewest = min(_FEWEST_SAMPLES, self.samples)
        samples = max(round(self.samples * share), fewest) if self.cost == "samples" else self.samples
        inputs = np.zeros(len(self.inputs))
        inputs[list(self.free)] = point[len(self.states) :]
        times = self.begin + np.linspace(0.0, duration, samples)
        return Design(np.array(point[: len(self.states)]), inputs, times, self.clock)

    def point(self, design: Design) -> FloatArray:
        """Return the point of an experiment."""
        return np.concatenate([design.initial, design.inputs[list(self.free)]])

    def share(self, design: Design) -> float:
        """Return which share of the longest experiment one is."""
        return self.price(design) / {"trajectory": 1.0, "duration": self.duration, "samples": self.samples}[self.cost]

    def price(self, design: Design) -> float:
        """Return what an experiment costs."""
        lasts, samples = float(design.times[-1] - design.times[0]), float(len(design.times))
        return {"trajectory": 1.0, "duration": lasts, "samples": samples}[self.cost]

    def around(self, point: FloatArray, step: float) -> Iterator[FloatArray]:
        """Yield the points that differ in one number by a step over the widths, within the bounds."""
        for index, width in enumerate(self.box.widths.tolist()):
            for moved_by in (-step * width, step * width):
                moved = point.copy()
                moved[index] = np.clip(moved[index] + moved_by, self.box.lower[index], self.box.upper[index])
                yield moved

    def are_apart(self, first: Design, second: Design) -> bool:
        """Tell whether two experiments differ in a number by a quarter of its bounds."""
        apart = np.abs(self.point(first) - self.point(second)) / np.maximum(self.box.widths, 1e-300)
        return bool(apart.max() >= _APART)


def space_of(result: Result, measured: Measured, request: Request) -> DesignSpace:
    """Return the experiments that a request allows; raises UsageError where its bounds do not fit the result."""
    measurements, symbols = measured.measurements, result.symbols
    count = len(measurements.scales)
    states, inputs = measurements.variables[:count], measurements.variables[count:]
    time = symbols.get(result.columns.time or "")
    clock = tuple(index for index, name in enumerate(inputs) if name == time)
    free = [index for index in range(len(inputs)) if index not in clock]
    names = [*states, *(inputs[index] for index in free)]
    given = {symbols.get(name, name): ends for name, ends in request.bounds.items()}
    for name, (low, high) in given.items():
        if name not in names:
            raise UsageError(f"there is no '{name}' to bound; an experiment has {', '.join(names)}")
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise UsageError(f"the bounds {low:g}:{high:g} of '{name}' are no interval; give LOWER:UPPER")
    values = np.concatenate([measurements.smoothed, measurements.inputs[free]])
    measured_box = Box(values.min(axis=1), values.max(axis=1))
    ranges = zip(names, measured_box.lower.tolist(), measured_box.upper.tolist(), strict=True)
    lower, upper = np.array([given.get(name, (low, high)) for name, low, high in ranges]).T.copy()
    box = Box(lower, upper)
    begin = float(np.median(measurements.inputs[clock[0]][measurements.bounds[:, 0]])) if clock else 0.0
    whole = [measurements.times[measurements.owners_of_rows == owner] for owner in np.unique(measurements.owners)]
    lasted = float(np.median([times[-1] - times[0] for times in whole]))
    rows = float(np.median([len(times) for times in whole])) * measured.rows / measurements.rows
    samples = request.samples or min(max(round(rows), 2), MOST_SAMPLES)
    lasts = request.duration or lasted
    return DesignSpace(states, inputs, clock, box, begin, lasts, samples, request.cost, measured_box)
