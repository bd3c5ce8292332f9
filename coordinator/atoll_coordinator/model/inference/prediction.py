"""What a model foretells from other initial states inside the measured box, and whether its rivals foretell the same.

Data decide between two equations as far as these describe the measurements unequally well. Where they describe them
about as well and yet foretell something else from initial states that were not measured, the data do not decide what
happens there. So the model, its alternatives and draws of its constants are simulated from such states; what share of
the odds foretells what the model does is the probability that it can be relied upon.

Letters: D states, O measured ones, N rows, P fitted constants, G initial states.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from atoll.data.dataset import FloatArray
from atoll_coordinator.model.inference.attractor import along
from atoll_coordinator.model.refinement import Prediction
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.system import System
from atoll_coordinator.settings import SETTINGS


@dataclass(frozen=True, eq=False)
class Rival:
    """A system that may be right in place of the model: another equation for one variable, or other constants.

    Rivals of one `group` exclude one another; `odds` are those against the model, whose own are one.
    """

    system: System
    group: int
    odds: float


def foretell(
    measurements: Measurements, model: System, rivals: Sequence[Rival], tolerance: float, *, is_near: bool = False
) -> list[Prediction] | None:
    """Return the prediction of each measured state; None where the system has inputs, which are not known elsewhere.

    Args:
        measurements: the trajectories that were measured.
        model: the system that is shown.
        rivals: what else describes the measurements.
        tolerance: error of an integration step over a state's standard deviation.
        is_near: whether initial states are near measured ones: an attractor's box has parts that lead elsewhere.
    """
    if len(measurements.inputs) or measurements.rows < SETTINGS.shooting.lengths[-1] // 4:
        return None
    elsewhere = _Elsewhere(measurements, tolerance, is_near=is_near)
    own = elsewhere.courses(model, range(len(elsewhere.starts)))
    followed = [place for place, course in enumerate(own) if course is not None]
    states = range(len(measurements.observed))
    if not followed:
        return [Prediction(len(own), 0, 0.0, math.inf) for _ in states]
    horizon = elsewhere.horizon(model, own, followed)
    courses = [course[:, :horizon] for course in own if course is not None]
    misses = _Misses(courses, len(states))
    for rival in rivals:
        misses.add(
            rival, [None if its is None else its[:, :horizon] for its in elsewhere.courses(rival.system, followed)]
        )
    distances = elsewhere.distances(courses)
    farthest = int(np.argmax([its.max() for its in distances]))
    novelty = float(np.median(np.concatenate(distances)))

    def predicted(state: int) -> Prediction:
        disputed = misses.unlike(state)
        start = elsewhere.named(followed[farthest if disputed is None else disputed])
        reached = elsewhere.reached(courses, state)
        probability = misses.agreement(state)
        return Prediction(len(own), len(followed), probability, novelty, reached, start, disputed is not None)

    return [predicted(state) for state in states]


_MOST_ROWS: Final = 500
_STRIDE: Final = 4
"""Rows whose distances are measured: so many measured ones at most, and every fourth simulated one."""


class _Elsewhere:
    """Simulates systems from initial states in the measured box, for as long as the longest trajectory."""

    def __init__(self, measurements: Measurements, tolerance: float, *, is_near: bool) -> None:
        self._measurements = measurements
        rows = SETTINGS.shooting.lengths[-1]
        low, high = measurements.smoothed.min(axis=1), measurements.smoothed.max(axis=1)
        self._low, self._width = low, np.maximum(high - low, 1e-300)
        length = max(
            float(measurements.times[end - 1] - measurements.times[first]) for first, end in measurements.bounds
        )
        self._estimator = along(measurements, np.linspace(0.0, length, rows), tolerance)
        self._is_near = is_near

    @cached_property
    def starts(self) -> FloatArray:
        """Initial states (G, D), evenly spread over the box (Halton 1960), or near measured ones over all rows."""
        if self._is_near:
            rows = np.linspace(0, self._measurements.rows - 1, SETTINGS.effort.beam).astype(int)
            moved = SETTINGS.common.negligible * self._measurements.scales
            return np.asarray(self._measurements.smoothed[:, rows].T + moved)
        count, states = SETTINGS.effort.beam, len(self._low)
        unit = np.array([[_radical_inverse(index, base) for base in _primes(states)] for index in range(1, count + 1)])
        return np.asarray(self._low + unit * self._width)

    def courses(self, system: System, places: Sequence[int]) -> list[FloatArray | None]:
        """Return the measured states (O, N) from these of the initial states, None where a simulation fails."""
        return [self._course(system, self.starts[place]) for place in places]

    def horizon(self, model: System, own: Sequence[FloatArray | None], places: Sequence[int]) -> int:
        """Return for how many rows slightly different initial states lead to about the same course: chaos ends it."""
        moved = self.starts + SETTINGS.common.negligible * self._measurements.scales
        others = [self._course(model, moved[place]) for place in places]
        pairs = [(own[place], other) for place, other in zip(places, others, strict=True) if other is not None]
        rows = SETTINGS.shooting.lengths[-1]
        least = 1.0 - SETTINGS.inference.part
        while rows > 8 and not all(
            (_r2([one[:, :rows]], [other[:, :rows]]) > least).all() for one, other in pairs if one is not None
        ):
            rows //= 2
        return rows

    def distances(self, courses: Sequence[FloatArray]) -> list[FloatArray]:
        """Return how far rows of each course are from the nearest measured one, over the widths of the box."""
        observed = self._measurements.observed
        width = self._width[observed]
        known = self._measurements.smoothed[observed].T[:: max(1, self._measurements.rows // _MOST_ROWS)] / width
        return [
            np.array([float(np.abs(known - row).max(axis=1).min()) for row in course[:, ::_STRIDE].T / width])
            for course in courses
        ]

    def reached(self, courses: Sequence[FloatArray], state: int) -> float | None:
        """Return the value farthest beyond the measured range that a state takes, None where it stays about within."""
        index = self._measurements.observed[state]
        low, width = self._low[index], self._width[index]
        values = np.concatenate([course[state] for course in courses])
        lowest, highest = float(values.min()), float(values.max())
        below, above = (low - lowest) / width, (highest - low) / width - 1.0
        if max(below, above) <= SETTINGS.inference.part:
            return None
        return highest if above >= below else lowest

    def named(self, place: int) -> dict[str, float]:
        """Return one of the initial states by name."""
        names = self._measurements.variables[: len(self._low)]
        return dict(zip(names, self.starts[place].tolist(), strict=True))

    def _course(self, system: System, start: FloatArray) -> FloatArray | None:
        simulated = self._estimator.simulate(system, start)
        return None if simulated is None else simulated[self._measurements.observed]


class _Misses:
    """What the rivals of each group foretell otherwise, state by state."""

    def __init__(self, courses: Sequence[FloatArray], states: int) -> None:
        self._courses = courses
        self._odds: dict[int, float] = {}
        self._against: dict[int, FloatArray] = {}
        self._unlike = [(0.0, -1)] * states

    def add(self, rival: Rival, courses: Sequence[FloatArray | None]) -> None:
        """Take in what a rival foretells from the same initial states."""
        states = len(self._unlike)
        is_whole = all(course is not None for course in courses)
        agrees = (
            _r2([course for course in courses if course is not None], self._courses) > 1.0 - SETTINGS.inference.part
            if is_whole
            else np.zeros(states, np.bool_)
        )
        self._odds[rival.group] = self._odds.get(rival.group, 0.0) + rival.odds
        against = self._against.setdefault(rival.group, np.zeros(states))
        against += rival.odds * ~agrees
        for state in np.flatnonzero(~agrees).tolist():
            for place, (course, own) in enumerate(zip(courses, self._courses, strict=True)):
                size = math.inf if course is None else float(np.abs(course[state] - own[state]).max())
                if rival.odds * size > self._unlike[state][0]:
                    self._unlike[state] = (rival.odds * size, place)

    def agreement(self, state: int) -> float:
        """Return the share of the odds that foretells what the model does."""
        shares = [1.0 - self._against[group][state] / (1.0 + odds) for group, odds in self._odds.items()]
        return math.prod(float(share) for share in shares)

    def unlike(self, state: int) -> int | None:
        """Return the place of the initial state from which the course is foretold most differently, None: nowhere."""
        place = self._unlike[state][1]
        return place if place >= 0 else None


def _r2(found: Sequence[FloatArray], true: Sequence[FloatArray]) -> FloatArray:
    """Return R2 (O,) of courses (O, N), all together."""
    found_rows, true_rows = np.concatenate(found, axis=1), np.concatenate(true, axis=1)
    errors = ((found_rows - true_rows) ** 2).sum(axis=1)
    spread = ((true_rows - true_rows.mean(axis=1, keepdims=True)) ** 2).sum(axis=1)
    return np.asarray(1.0 - errors / np.maximum(spread, 1e-300))


def draws(system: System, covariance: FloatArray, group: int) -> Iterator[Rival]:
    """Yield `system` with constants drawn from their distribution, each with an equal part of the odds.

    Args:
        system: with its constants as fitted.
        covariance: theirs (P, P), finite.
        group: of the rivals.
    """
    count = SETTINGS.effort.beam
    if not system.count:
        return
    values, vectors = np.linalg.eigh(covariance)
    scales = vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(0)
    for _ in range(count):
        drawn = system.values + scales @ rng.standard_normal(len(values))
        yield Rival(system.with_values(drawn), group, 1.0)


def _radical_inverse(index: int, base: int) -> float:
    """Return the digits of `index` behind the point, the first digit last."""
    value, factor = 0.0, 1.0
    while index:
        factor /= base
        index, digit = divmod(index, base)
        value += factor * digit
    return value


def _primes(count: int) -> list[int]:
    found: list[int] = []
    candidate = 2
    while len(found) < count:
        if all(candidate % prime for prime in found):
            found.append(candidate)
        candidate += 1
    return found
