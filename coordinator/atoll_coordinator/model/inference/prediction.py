"""What a model predicts from other initial states within the measured range, and whether alternatives predict it, too.

Where there are inputs, or groups of trajectories with constants of their own, each initial state takes the inputs and
the group of one of the measured trajectories.

Data decide between two equations only if these describe the measurements unequally well. If two equations describe them
about as well but predict different values from other initial states, the data do not decide which values are right. So
the model, its alternatives and draws of its constants are simulated from such states. The share of the odds that
predicts the same as the model is the probability that its predictions can be trusted.

Within the measured range a short equation is more plausible. Outside of it nothing supports its structure, so that the
odds of other structures there follow from the data alone, without prices of structures.

Letters: D states, O measured ones, N rows, P fitted constants, G initial states.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.model.inference.long_run import along
from atoll_coordinator.model.shooting.integration import Unsimulated
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.points_between import MOST_POINTS, points_between, remove_conserved_directions
from atoll_coordinator.model.shooting.system import System
from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.result.equations import Prediction
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints


@dataclass(frozen=True, eq=False)
class AlternativeSystem:
    """A system that may be right in place of the model: another equation for one variable, or other constants.

    Alternatives of one `group` exclude one another; `odds` are the odds against the model, whose own are one,
    `odds_of_data` the same without the price of structures.
    """

    system: System
    group: int
    odds: float
    odds_of_data: float


def predict(
    measurements: Measurements, model: System, alternatives: Sequence[AlternativeSystem], tolerance: float,
    drawn: Iterable[System] = (), *, is_near: bool = False,
) -> list[Prediction]:  # fmt: skip
    """Return the prediction of each measured state; states without an equation are inputs as smoothed.

    Args:
        measurements: the trajectories that were measured.
        model: the system that is shown.
        alternatives: other systems that describe the measurements.
        tolerance: error of an integration step over a state's standard deviation.
        drawn: the model with constants drawn from their distribution, of which as many are taken as decide.
        is_near: whether initial states are near measured ones: an attractor's box has parts that lead elsewhere.
    """
    elsewhere = _Elsewhere(measurements, tolerance, is_near=is_near)
    own = elsewhere.own_courses(model)
    followed = [place for place, course in enumerate(own) if not isinstance(course, str)]
    unfinished = sum(isinstance(course, str) and course == "out of steps" for course in own)
    states = range(len(measurements.observed))
    if not followed:
        nothing = Prediction(
            starts=len(own), followed=0, unfinished=unfinished, probability=0.0, novelty=math.inf, is_disputed=False
        )
        return [nothing for _ in states]
    horizon = elsewhere.horizon(model, own)
    courses = [course[:, :horizon] for course in own if not isinstance(course, str)]
    misses, misses_of_data = _Misses(len(states)), _Misses(len(states))

    def add(alternative: AlternativeSystem) -> None:
        rival_courses = elsewhere.courses(alternative.system, followed)
        compared = [course if isinstance(course, str) else course[:, :horizon] for course in rival_courses]
        differences = _differences(compared, courses, len(states))
        if differences is not None:
            misses.add(alternative.group, alternative.odds, *differences)
            misses_of_data.add(alternative.group, alternative.odds_of_data, *differences)

    for alternative in alternatives:
        add(alternative)
    for count, system in enumerate(islice(drawn, _MOST_DRAWS), 1):
        add(AlternativeSystem(system, _DRAWN, 1.0, 1.0))
        if count >= SETTINGS.effort.beam and all(misses.is_decided(state) for state in states):
            break
    distances = elsewhere.distances(courses)
    farthest = int(np.argmax([course_distances.max() for course_distances in distances]))
    novelty = float(np.median(np.concatenate(distances)))

    def predicted(state: int) -> Prediction:
        reached = elsewhere.reached(courses, state)
        probability, disputed = misses.agreement(state), misses.unlike(state)
        if reached is not None and misses_of_data.agreement(state) < probability:
            probability, disputed = misses_of_data.agreement(state), misses_of_data.unlike(state)
        return Prediction(
            starts=len(own),
            followed=len(followed),
            unfinished=unfinished,
            probability=probability,
            novelty=novelty,
            reached=reached,
            is_disputed=disputed is not None,
            measure_from=elsewhere.named(followed[farthest if disputed is None else disputed]),
        )

    return [predicted(state) for state in states]


_DRAWN: Final = -1
"""The group of what is drawn."""
_MOST_DRAWS: Final = SETTINGS.effort.beam**2
"""Number of draws: a share of 0.95 has a standard error of 0.02."""
_STRIDE: Final = 4
"""One in this many simulated rows is compared with the measured rows."""


Flags = npt.NDArray[np.bool_]
Course = FloatArray | Unsimulated
"""The measured states (O, N) from an initial state, or why there are none."""


class _Elsewhere:
    """Simulates systems from initial states among measured ones, for as long as the longest trajectory.

    If measured trajectories end on their way out of the measured range, as in growth, other trajectories may leave it,
    too: simulations that leave it on the same side are followed for as long as a measured trajectory lasts from about
    there.
    """

    def __init__(self, measurements: Measurements, tolerance: float, *, is_near: bool) -> None:
        self._measurements = measurements
        low, high = measurements.smoothed.min(axis=1), measurements.smoothed.max(axis=1)
        self._low, self._width = low, np.maximum(high - low, 1e-300)
        self._estimators = _estimators(measurements, tolerance)
        self._is_near = is_near
        self._rows: dict[int, int] = {}
        """Of the courses that are not followed to their end, by initial state."""

    @cached_property
    def starts(self) -> FloatArray:
        """Initial states (G, D): between two measured ones of one group, or near measured ones.

        Where states without an equation are inputs as they were measured, initial states are a tenth of the way from
        initial states of trajectories to others: farther away, these inputs would not be as they are.
        """
        measurements = self._measurements
        if self._is_near and not measurements.has_smoothed_inputs:
            rows = np.linspace(0, measurements.rows - 1, SETTINGS.effort.beam).astype(int)
            return np.asarray(measurements.smoothed[:, rows].T + self._shift)
        groups = measurements.groups
        points = points_between(measurements.smoothed) if groups is None else self._starts_of_groups(groups)
        if not measurements.has_smoothed_inputs:
            return points
        begun = np.array([self._estimator(place).measurements.smoothed[:, 0] for place in range(len(points))])
        return np.asarray(begun + SETTINGS.inference.part * (points - begun))

    def _starts_of_groups(self, groups: Ints) -> FloatArray:
        """Return initial states (G, D), each between two measured states of the group whose constants it takes."""
        measurements, points = self._measurements, []
        between: dict[int, FloatArray] = {}
        for place in range(SETTINGS.effort.beam):
            group = int(groups[self._estimator(place).measurements.owners[0]])
            if group not in between:
                is_own = groups[measurements.owners_of_rows] == group
                between[group] = points_between(np.ascontiguousarray(measurements.smoothed[:, is_own]))
            points.append(between[group][place % len(between[group])])
        return np.array(points)

    @cached_property
    def _shift(self) -> FloatArray:
        """Moves an initial state (D,) a little, without changing sums that are constant in the measured states."""
        measurements, noise = self._measurements, np.zeros(len(self._measurements.smoothed))
        noise[measurements.observed] = measurements.noise
        shift = SETTINGS.common.negligible * measurements.scales
        return np.asarray(remove_conserved_directions(shift[None], measurements.smoothed, noise)[0])

    def own_courses(self, model: System) -> list[Course]:
        """Return the model's courses from all initial states; from now on all are followed for as long as these."""
        courses = []
        for place, start in enumerate(self.starts):
            simulated, why = self._estimator(place).simulate_until_blow_up(model, start)
            if why == "ran away" and self._leaves_as_measured(simulated[:, np.isfinite(simulated).all(axis=0)]):
                self._rows[place] = self._rows_measured_from(start, place)
            courses.append(self._followed(simulated, why, self._rows.get(place)))
        return courses

    def courses(self, system: System, places: Sequence[int]) -> list[Course]:
        """Return the courses from these of the initial states."""
        return [self._course(system, place, self.starts[place], self._rows.get(place)) for place in places]

    def horizon(self, model: System, own: Sequence[Course]) -> int:
        """Return for how many rows slightly different initial states lead to about the same course: chaos ends it."""
        moved = self.starts + self._shift
        whole = [place for place, course in enumerate(own) if not isinstance(course, str) and place not in self._rows]
        others = ((own[place], self._course(model, place, moved[place])) for place in whole)
        pairs = [
            (own_course, moved_course)
            for own_course, moved_course in others
            if not isinstance(own_course, str) and not isinstance(moved_course, str)
        ]
        rows = max(estimator.measurements.rows for estimator in self._estimators)
        least = 1.0 - SETTINGS.inference.part
        while rows > 8 and not all(
            (_r2([own_course[:, :rows]], [moved_course[:, :rows]]) > least).all() for own_course, moved_course in pairs
        ):
            rows //= 2
        return rows

    def distances(self, courses: Sequence[FloatArray]) -> list[FloatArray]:
        """Return how far rows of each course are from the nearest measured one, over the widths of the box."""
        observed = self._measurements.observed
        width = self._width[observed]
        known = self._measurements.smoothed[observed].T[thinned_places(self._measurements.rows, MOST_POINTS)] / width

        def looked_at(course: FloatArray) -> FloatArray:
            count = course.shape[1]
            return np.asarray(course[:, thinned_places(count, max(1, count // _STRIDE))].T / width)

        return [
            np.array([float(np.abs(known - row).max(axis=1).min()) for row in looked_at(course)]) for course in courses
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

    def _estimator(self, place: int) -> MultipleShooting:
        """Return the function that simulates systems from one of the initial states."""
        return self._estimators[place % len(self._estimators)]

    def _course(self, system: System, place: int, start: FloatArray, rows: int | None = None) -> Course:
        return self._followed(*self._estimator(place).simulate_until_blow_up(system, start), rows)

    def _followed(self, simulated: FloatArray, why: Unsimulated | None, rows: int | None) -> Course:
        """Return the measured states of this many rows, all by default, or why the simulation ended earlier."""
        course = simulated[self._measurements.observed, :rows]
        return course if why is None or (rows is not None and np.isfinite(course).all()) else why

    def _leaves_as_measured(self, simulated: FloatArray) -> bool:
        """Tell whether a course (D, K) leaves the measured range where a measured trajectory ends."""
        if not simulated.shape[1]:
            return False
        beyond = np.array([self._low - simulated[:, -1], simulated[:, -1] - self._low - self._width]) / self._width
        side, state = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        ends = self._measurements.smoothed[state, self._last_rows]
        end = self._low[state] + (self._width[state] if side else 0.0)
        return bool(beyond[side, state] > 0.0 and np.any(ends >= end if side else ends <= end))

    def _rows_measured_from(self, start: FloatArray, place: int = 0) -> int:
        """Return for how many rows the trajectory was measured that has the state nearest to this one."""
        measurements, times = self._measurements, self._estimator(place).measurements.times
        nearest = int(np.argmin(np.abs((measurements.smoothed.T - start) / self._width).max(axis=1)))
        last = self._last_rows[np.searchsorted(self._last_rows, nearest)]
        left = float(measurements.times[last] - measurements.times[nearest])
        return int(np.searchsorted(times - times[0], left, side="right"))

    @cached_property
    def _last_rows(self) -> Ints:
        """The last row of each trajectory."""
        owners = self._measurements.owners_of_rows
        return np.flatnonzero(np.append(owners[1:] != owners[:-1], True))


def _estimators(measurements: Measurements, tolerance: float) -> list[MultipleShooting]:
    """Return the function that simulates systems from initial states, which take these in turn.

    Without inputs that is for as long as the longest trajectory. With inputs it is along a few of the trajectories, up
    to as many rows as a search is given.
    """
    lengths = np.bincount(measurements.owners_of_rows)
    owners = np.flatnonzero(lengths)
    has_inputs = len(measurements.inputs) > 0
    if has_inputs or measurements.groups is not None:
        owners = owners[np.linspace(0, len(owners) - 1, min(len(owners), SETTINGS.effort.beam)).astype(int)]
    else:
        owners = owners[:1]
    if has_inputs:
        return [
            MultipleShooting(_in_one_piece(measurements.part([owner]), owner), tolerance) for owner in owners.tolist()
        ]
    length, rows = max(
        (float(np.ptp(measurements.times[measurements.owners_of_rows == owner])), int(lengths[owner]))
        for owner in np.flatnonzero(lengths).tolist()
    )
    times = np.linspace(0.0, length, SETTINGS.shooting.lengths[-1])
    return [along(measurements, times, tolerance, rows, owner) for owner in owners.tolist()]


def _in_one_piece(measurements: Measurements, owner: int) -> Measurements:
    """Return the beginning of one trajectory, simulated without a break."""
    rows = min(measurements.rows, SETTINGS.rows.most)
    beginning = measurements.pieces([(0, rows, owner)])
    return replace(beginning, resting=None, offset=np.zeros(0, dtype=np.int64))


class _Misses:
    """The odds of alternatives that predict something different, by group and state."""

    def __init__(self, states: int) -> None:
        self._odds: dict[int, float] = {}
        self._against: dict[int, FloatArray] = {}
        self._unlike = [(0.0, -1)] * states

    def add(self, group: int, odds: float, agrees: Flags, sizes: FloatArray) -> None:
        """Add an alternative, by its differences from the model."""
        self._odds[group] = self._odds.get(group, 0.0) + odds
        against = self._against.setdefault(group, np.zeros(len(agrees)))
        against += odds * ~agrees
        for state in np.flatnonzero(~agrees).tolist():
            place = int(np.argmax(sizes[state]))
            largest = odds * float(sizes[state, place])
            if largest > self._unlike[state][0]:
                self._unlike[state] = (largest, place)

    def agreement(self, state: int) -> float:
        """Return the share of the odds that predicts the same as the model."""
        shares = [1.0 - self._against[group][state] / (1.0 + odds) for group, odds in self._odds.items()]
        return math.prod(float(share) for share in shares)

    def is_decided(self, state: int) -> bool:
        """Tell whether the share of agreeing draws is significantly above or below the limit of a good model.

        It is beta distributed, from Jeffreys' prior on; 38 draws that all agree are enough.
        """
        from scipy import special

        if _DRAWN not in self._odds:
            return True  # all draws take too many steps
        count, against = self._odds[_DRAWN], float(self._against[_DRAWN][state])
        wrong = math.exp(-SETTINGS.inference.distinct_nats)
        below = float(special.betainc(count - against + 0.5, against + 0.5, 1.0 - wrong))
        return min(below, 1.0 - below) <= wrong

    def unlike(self, state: int) -> int | None:
        """Return the place of the initial state from which predictions differ most, None: nowhere."""
        place = self._unlike[state][1]
        return place if place >= 0 else None


def _differences(courses: Sequence[Course], own: Sequence[FloatArray], states: int) -> tuple[Flags, FloatArray] | None:
    """Return which states (O,) an alternative predicts as the model does, and the largest differences (O, G).

    An alternative that diverges predicts something different; where it needs too many steps, its prediction is not
    known: None if it is known from no initial state.
    """
    sizes = np.zeros((states, len(own)))
    pairs = []
    for place, (course, own_course) in enumerate(zip(courses, own, strict=True)):
        if not isinstance(course, str):
            sizes[:, place] = np.abs(course - own_course).max(axis=1)
            pairs.append((course, own_course))
        elif course == "ran away":
            sizes[:, place] = math.inf
    if any(isinstance(course, str) and course == "ran away" for course in courses):
        return np.zeros(states, np.bool_), sizes
    if not pairs:
        return None
    r2 = _r2([course for course, _ in pairs], [own_course for _, own_course in pairs])
    return r2 > 1.0 - SETTINGS.inference.part, sizes


def _r2(predicted: Sequence[FloatArray], true: Sequence[FloatArray]) -> FloatArray:
    """Return R2 (O,) of courses (O, N), all together."""
    predicted_rows, true_rows = np.concatenate(predicted, axis=1), np.concatenate(true, axis=1)
    errors = ((predicted_rows - true_rows) ** 2).sum(axis=1)
    spread = ((true_rows - true_rows.mean(axis=1, keepdims=True)) ** 2).sum(axis=1)
    return np.asarray(1.0 - errors / np.maximum(spread, 1e-300))


def draws(system: System, covariance: FloatArray) -> Iterator[System]:
    """Yield `system` with all its constants drawn together from their distribution, without end; nothing without any.

    Args:
        system: with its constants as fitted.
        covariance: theirs (P, P), finite.
    """
    if not system.count:
        return
    deviations = np.sqrt(np.diag(covariance))
    deviations = np.where(deviations > 0.0, deviations, 1.0)
    values, vectors = np.linalg.eigh(covariance / deviations[:, None] / deviations)  # in any units
    scales = deviations[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(0)
    while True:
        yield system.with_values(system.values + scales @ rng.standard_normal(len(values)))
