"""Whether the model and its alternatives predict the same from other initial states within the measured range.

Two equations may fit the measurements about as well, and still predict different values from other initial states. Then
the data do not decide which values are right. So `compare_predictions` simulates three kinds of systems from such
states: the model, its alternatives, and the model with other constants, drawn from their distribution. An alternative
agrees if the R2 of its simulation, with the model's simulation as the truth, is above 0.9. The share of the odds that
agrees is the probability that the predictions can be trusted.

Within the measured range, a short equation is more plausible than a long one. Outside of it, no data support the
structure of an equation. So if a simulation leaves the measured range, the odds of the alternatives follow from the
data alone, without prices of structures. With inputs, or with groups that have their own constants, each initial state
takes the inputs and the group of one measured trajectory.

Doubtful: only the compared alternatives count, so a law that was never a candidate is missing from the odds. About a
dozen initial states represent the measured range. Constants are drawn from a normal distribution, whose covariance
comes from a linearisation.

Letters: D states, O measured states, N rows, P fitted constants, G initial states.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.model.inference.long_run import make_simulator
from atoll_coordinator.model.shooting.integration import Unsimulated
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.points_between import MOST_POINTS, points_between, remove_conserved_directions
from atoll_coordinator.model.shooting.system import OdeSystem
from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.result.equations import Prediction
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints


@dataclass(frozen=True, eq=False)
class AlternativeSystem:
    """A system that may be right instead of the model: it has another equation for one variable, or other constants.

    At most one alternative of a `group` can be right. `odds` are relative to the model, whose odds are one;
    `odds_of_data` are the odds without the price of structures.
    """

    system: OdeSystem
    group: int
    odds: float
    odds_of_data: float


def compare_predictions(
    measurements: TrajectoryMeasurements, model: OdeSystem, alternatives: Sequence[AlternativeSystem], tolerance: float,
    drawn: Iterable[OdeSystem] = (), *, is_near: bool = False,
) -> list[Prediction]:  # fmt: skip
    """Return how well each measured state can be predicted. For states without an equation, the smoothed values are
    used.

    Args:
        measurements: the trajectories that were measured.
        model: the system that is shown.
        alternatives: other systems that describe the measurements.
        tolerance: the allowed error of an integration step, divided by the standard deviation of the state.
        drawn: the model with constants drawn from their distribution, one system after another; the iterator is read
            until the result is decided.
        is_near: whether initial states are near measured states. This is for attractors: parts of the box around an
            attractor lie outside of its basin.
    """
    other_states, own, horizon = _simulate_to_horizon(measurements, model, tolerance, is_near=is_near)
    followed = [place for place, course in enumerate(own) if not isinstance(course, str)]
    unfinished = sum(isinstance(course, str) and course == "out of steps" for course in own)
    states = range(len(measurements.observed))
    if not followed:
        nothing = Prediction(
            starts=len(own), followed=0, unfinished=unfinished, probability=0.0, novelty=math.inf, is_disputed=False
        )
        return [nothing for _ in states]
    courses = [course[:, :horizon] for course in own if not isinstance(course, str)]
    misses, misses_of_data = _Disagreement(len(states)), _Disagreement(len(states))

    def add(alternative: AlternativeSystem) -> None:
        other_courses = other_states.simulate(alternative.system, followed)
        compared = [course if isinstance(course, str) else course[:, :horizon] for course in other_courses]
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
    distances_from_measured = other_states.distances_from_measured(courses)
    farthest = int(np.argmax([course_distances.max() for course_distances in distances_from_measured]))
    novelty = float(np.median(np.concatenate(distances_from_measured)))

    def describe_state(state: int) -> Prediction:
        reached = other_states.farthest_value(courses, state)
        probability, disputed = misses.agreement(state), misses.most_disputed_place(state)
        if reached is not None and misses_of_data.agreement(state) < probability:
            probability, disputed = misses_of_data.agreement(state), misses_of_data.most_disputed_place(state)
        return Prediction(
            starts=len(own),
            followed=len(followed),
            unfinished=unfinished,
            probability=probability,
            novelty=novelty,
            reached=reached,
            is_disputed=disputed is not None,
            measure_from=other_states.initial_state(followed[farthest if disputed is None else disputed]),
        )

    return [describe_state(state) for state in states]


_DRAWN: Final = -1
"""The group of the draws."""
_MOST_DRAWS: Final = SETTINGS.effort.beam**2
"""Most draws of the constants: with this number, a share of 0.95 has a standard error of 0.02."""
_FEWEST_ROWS: Final = 8
"""Fewest rows of a simulation that are compared."""
_STRIDE: Final = 4
"""Every fourth simulated row is compared with the measured rows."""


Flags = npt.NDArray[np.bool_]
Course = FloatArray | Unsimulated
"""The simulated values (O, N) of the measured states, or the reason why the simulation failed."""


def _simulate_to_horizon(
    measurements: TrajectoryMeasurements, model: OdeSystem, tolerance: float, *, is_near: bool
) -> tuple["_OtherInitialStates", list[Course], int]:
    """Return initial states, the model's simulations from them, and the number of rows that can be predicted.

    Of a long chaotic trajectory, chaos may end predictions within the first rows of such a simulation. Then shorter
    simulations with as many rows are compared, until their rows are as close as the measured rows.
    """
    share = 1.0
    while True:
        other_states = _OtherInitialStates(measurements, tolerance, is_near=is_near, share=share)
        own = other_states.simulate_model(model)
        horizon = other_states.horizon(model, own)
        share *= 2.0 * horizon / other_states.rows
        is_too_short = share * other_states.longest < other_states.rows * measurements.step
        if horizon > _FEWEST_ROWS or is_too_short or len(measurements.inputs):
            return other_states, own, horizon


class _OtherInitialStates:
    """Simulates systems from initial states between measured states, for a `share` of the duration of the longest
    trajectory.

    If measured trajectories end at a limit of the measured range, as in growth, other trajectories may leave the range
    on this side. Such a simulation is shortened. The measured state nearest to its initial state determines the length:
    the simulation has as many rows as were measured after this state.
    """

    def __init__(
        self, measurements: TrajectoryMeasurements, tolerance: float, *, is_near: bool, share: float = 1.0
    ) -> None:
        self._measurements = measurements
        low, high = measurements.smoothed.min(axis=1), measurements.smoothed.max(axis=1)
        self._low, self._width = low, np.maximum(high - low, 1e-300)
        self._estimators = _estimators(measurements, tolerance, share)
        self._is_near = is_near
        self._rows: dict[int, int] = {}
        """Number of rows of shortened simulations, by initial state."""

    @cached_property
    def starts(self) -> FloatArray:
        """Initial states (G, D): each between two measured states of one group, or near a measured state.

        States without an equation may be inputs with their measured values. Then each initial state is nearer to the
        start of a trajectory: it is on the line from this start to such a point, after a tenth of the way. Farther
        away, the measured inputs would not match the states.
        """
        measurements = self._measurements
        if self._is_near and not measurements.has_smoothed_inputs:
            rows = np.linspace(0, measurements.rows - 1, SETTINGS.effort.beam).astype(int)
            return np.asarray(measurements.smoothed[:, rows].T + self._shift)
        groups = measurements.groups
        points = points_between(measurements.smoothed) if groups is None else self._starts_of_groups(groups)
        if not measurements.has_smoothed_inputs:
            return points
        trajectory_starts = np.array(
            [self._estimator(place).measurements.smoothed[:, 0] for place in range(len(points))]
        )
        return np.asarray(trajectory_starts + SETTINGS.inference.part * (points - trajectory_starts))

    def _starts_of_groups(self, groups: Ints) -> FloatArray:
        """Return initial states (G, D). Each is between two measured states of one group, and is simulated with the
        constants of this group."""
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
        """A small shift (D,) of an initial state. Sums of states that are constant in the measurements stay
        constant."""
        measurements, noise = self._measurements, np.zeros(len(self._measurements.smoothed))
        noise[measurements.observed] = measurements.noise
        shift = SETTINGS.common.negligible * measurements.scales
        return np.asarray(remove_conserved_directions(shift[None], measurements.smoothed, noise)[0])

    @property
    def rows(self) -> int:
        """The largest number of rows of a simulation."""
        return max(estimator.measurements.rows for estimator in self._estimators)

    @property
    def longest(self) -> float:
        """The duration of the longest trajectory."""
        return _longest(self._measurements)[0]

    def simulate_model(self, model: OdeSystem) -> list[Course]:
        """Return the model's simulations from all initial states. The numbers of their rows are stored, for simulations
        of other systems."""
        courses = []
        for place, start in enumerate(self.starts):
            simulated, why = self._estimator(place).simulate_until_blow_up(model, start)
            if why == "ran away" and self._leaves_as_measured(simulated[:, np.isfinite(simulated).all(axis=0)]):
                self._rows[place] = self._rows_measured_from(start, place)
            courses.append(self._select_rows(simulated, why, self._rows.get(place)))
        return courses

    def simulate(self, system: OdeSystem, places: Sequence[int]) -> list[Course]:
        """Return the simulations of a system from the initial states `places`, by index."""
        return [self._simulate(system, place, self.starts[place], self._rows.get(place)) for place in places]

    def horizon(self, model: OdeSystem, own: Sequence[Course]) -> int:
        """Return the number of rows over which slightly shifted initial states give about the same values; chaos limits
        this number."""
        moved = self.starts + self._shift
        whole = [place for place, course in enumerate(own) if not isinstance(course, str) and place not in self._rows]
        others = ((own[place], self._simulate(model, place, moved[place])) for place in whole)
        pairs = [
            (own_course, moved_course)
            for own_course, moved_course in others
            if not isinstance(own_course, str) and not isinstance(moved_course, str)
        ]
        rows, least = self.rows, 1.0 - SETTINGS.inference.part
        while rows > _FEWEST_ROWS and not all(
            (_r2([own_course[:, :rows]], [moved_course[:, :rows]]) > least).all() for own_course, moved_course in pairs
        ):
            rows //= 2
        return rows

    def distances_from_measured(self, courses: Sequence[FloatArray]) -> list[FloatArray]:
        """Return, for each course, the distances (n,) of some of its rows from the nearest measured row, in units of
        the measured ranges."""
        observed = self._measurements.observed
        width = self._width[observed]
        known = self._measurements.smoothed[observed].T[thinned_places(self._measurements.rows, MOST_POINTS)] / width

        def thinned_rows(course: FloatArray) -> FloatArray:
            count = course.shape[1]
            return np.asarray(course[:, thinned_places(count, max(1, count // _STRIDE))].T / width)

        return [
            np.array([float(np.abs(known - row).max(axis=1).min()) for row in thinned_rows(course)])
            for course in courses
        ]

    def farthest_value(self, courses: Sequence[FloatArray], state: int) -> float | None:
        """Return the value of a state that is farthest outside of its measured range. None if all values are about
        within this range."""
        index = self._measurements.observed[state]
        low, width = self._low[index], self._width[index]
        values = np.concatenate([course[state] for course in courses])
        lowest, highest = float(values.min()), float(values.max())
        below, above = (low - lowest) / width, (highest - low) / width - 1.0
        if max(below, above) <= SETTINGS.inference.part:
            return None
        return highest if above >= below else lowest

    def initial_state(self, place: int) -> dict[str, float]:
        """Return the values of one initial state by the names of the states."""
        names = self._measurements.variables[: len(self._low)]
        return dict(zip(names, self.starts[place].tolist(), strict=True))

    def _estimator(self, place: int) -> MultipleShooting:
        """Return the estimator that simulates systems from one of the initial states."""
        return self._estimators[place % len(self._estimators)]

    def _simulate(self, system: OdeSystem, place: int, start: FloatArray, rows: int | None = None) -> Course:
        return self._select_rows(*self._estimator(place).simulate_until_blow_up(system, start), rows)

    def _select_rows(self, simulated: FloatArray, why: Unsimulated | None, rows: int | None) -> Course:
        """Return the measured states in the first `rows` rows (default: in all rows), or the reason why the simulation
        ended earlier."""
        course = simulated[self._measurements.observed, :rows]
        return course if why is None or (rows is not None and np.isfinite(course).all()) else why

    def _leaves_as_measured(self, simulated: FloatArray) -> bool:
        """Tell whether a course (D, K) leaves the measured range on a side where a measured trajectory ends."""
        if not simulated.shape[1]:
            return False
        beyond = np.array([self._low - simulated[:, -1], simulated[:, -1] - self._low - self._width]) / self._width
        side, state = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        ends = self._measurements.smoothed[state, self._last_rows]
        end = self._low[state] + (self._width[state] if side else 0.0)
        return bool(beyond[side, state] > 0.0 and np.any(ends >= end if side else ends <= end))

    def _rows_measured_from(self, start: FloatArray, place: int = 0) -> int:
        """Return how many rows follow in the measured trajectory after the measured state nearest to `start`."""
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


def _estimators(measurements: TrajectoryMeasurements, tolerance: float, share: float) -> list[MultipleShooting]:
    """Return the estimators that simulate systems; initial states use them in turn.

    Without inputs, a simulation lasts for a `share` of the longest trajectory. With inputs, it follows one of a few
    measured trajectories, for at most `RowSettings.most` rows.
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
            MultipleShooting(_join_pieces(measurements.part([owner]), owner), tolerance) for owner in owners.tolist()
        ]
    length, rows = _longest(measurements)
    times = np.linspace(0.0, share * length, SETTINGS.shooting.lengths[-1])
    return [make_simulator(measurements, times, tolerance, rows, owner) for owner in owners.tolist()]


def _longest(measurements: TrajectoryMeasurements) -> tuple[float, int]:
    """Return the duration and the number of rows of the longest trajectory."""
    lengths = np.bincount(measurements.owners_of_rows)
    return max(
        (float(np.ptp(measurements.times[measurements.owners_of_rows == owner])), int(lengths[owner]))
        for owner in np.flatnonzero(lengths).tolist()
    )


def _join_pieces(measurements: TrajectoryMeasurements, owner: int) -> TrajectoryMeasurements:
    """Return the first rows of one trajectory as a single piece, simulated without a break."""
    rows = min(measurements.rows, SETTINGS.rows.most)
    beginning = measurements.pieces([(0, rows, owner)])
    return replace(beginning, resting=None, offset=np.zeros(0, dtype=np.int64))


class _Disagreement:
    """Sums the odds of alternatives that predict something different, by group and state."""

    def __init__(self, states: int) -> None:
        self._odds: dict[int, float] = {}
        self._against: dict[int, FloatArray] = {}
        self._unlike = [(0.0, -1)] * states

    def add(self, group: int, odds: float, agrees: Flags, sizes: FloatArray) -> None:
        """Add an alternative: whether it `agrees` with the model (O,), and its largest differences `sizes` (O, G)."""
        self._odds[group] = self._odds.get(group, 0.0) + odds
        against = self._against.setdefault(group, np.zeros(len(agrees)))
        against += odds * ~agrees
        for state in np.flatnonzero(~agrees).tolist():
            place = int(np.argmax(sizes[state]))
            largest = odds * float(sizes[state, place])
            if largest > self._unlike[state][0]:
                self._unlike[state] = (largest, place)

    def agreement(self, state: int) -> float:
        """Return the share of agreement: the odds of the model and of the alternatives that agree with it, divided by
        the sum of all odds."""
        shares = [1.0 - self._against[group][state] / (1.0 + odds) for group, odds in self._odds.items()]
        return math.prod(float(share) for share in shares)

    def is_decided(self, state: int) -> bool:
        """Tell whether the share of agreeing draws is significantly above or below the limit of a good model.

        The posterior of the share is a beta distribution, with Jeffreys' prior. For example, 38 draws are enough if all
        of them agree.
        """
        from scipy import special

        if _DRAWN not in self._odds:
            return True  # all draws needed too many integration steps
        count, against = self._odds[_DRAWN], float(self._against[_DRAWN][state])
        wrong = math.exp(-SETTINGS.inference.distinct_nats)
        below = float(special.betainc(count - against + 0.5, against + 0.5, 1.0 - wrong))
        return min(below, 1.0 - below) <= wrong

    def most_disputed_place(self, state: int) -> int | None:
        """Return the index of the initial state from which predictions differ most. None if all predictions agree."""
        place = self._unlike[state][1]
        return place if place >= 0 else None


def _differences(courses: Sequence[Course], own: Sequence[FloatArray], states: int) -> tuple[Flags, FloatArray] | None:
    """Return which states (O,) an alternative predicts like the model, and the largest differences (O, G).

    If the simulation of an alternative diverges, the alternative predicts something different. If a simulation needs
    too many steps, its prediction is unknown. The result is None if all predictions are unknown.
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
    """Return R2 (O,) over all courses (O, N) together."""
    predicted_rows, true_rows = np.concatenate(predicted, axis=1), np.concatenate(true, axis=1)
    errors = ((predicted_rows - true_rows) ** 2).sum(axis=1)
    spread = ((true_rows - true_rows.mean(axis=1, keepdims=True)) ** 2).sum(axis=1)
    return np.asarray(1.0 - errors / np.maximum(spread, 1e-300))


def draw_systems(system: OdeSystem, covariance: FloatArray) -> Iterator[OdeSystem]:
    """Yield `system` with constants drawn from their joint normal distribution. The iterator has no end, but it is
    empty if there are no constants.

    Args:
        system: has the fitted constants.
        covariance: the covariance (P, P) of the constants; all its elements are finite.
    """
    if not system.count:
        return
    deviations = np.sqrt(np.diag(covariance))
    deviations = np.where(deviations > 0.0, deviations, 1.0)
    values, vectors = np.linalg.eigh(covariance / deviations[:, None] / deviations)  # independent of units
    scales = deviations[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(0)
    while True:
        yield system.with_values(system.values + scales @ rng.standard_normal(len(values)))
