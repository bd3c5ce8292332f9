"""Fits from many starts, for systems whose constants or hidden states are known only within wide bounds. Pure.

A misfit of whole trajectories has many minima: an oscillation that is fitted with a wrong period is such a minimum.

How it works. Start values of the fitted numbers, and initial values of hidden states, are drawn within their bounds.
Positive bounds are drawn from, and steps are made, in logarithms (`OdeSystem.moved`). Each start is fitted to growing
horizons: to the first rows of each trajectory, then to half as many rows more, up to all rows. So a fit follows the
phase of an oscillation. These fits use the bounds as a prior distribution (`OdeSystem.penalty`): a few rows do not
determine all numbers, and numbers that are not determined stay near the middle of their bounds. Segments in the middle
of a trajectory, as in `fit_in_stages`, need initial values of all states; for hidden states these would be as many
unknown numbers as there are segments. Starts come in batches of equal size. The best fits of a batch are continued
without the prior until they converge. The search ends when the best minimum was reached several times, or when the work
is spent. All choices depend on misfits in a fixed order, so the result is equal bit by bit on any number of threads and
workers.

Doubts. There is no guarantee that the best minimum was met. A minimum that as many starts lead to as to the best one is
missed with a probability of 2^-5. Start values of a number without finite bounds do not vary. Letters: Q fitted
numbers, D states, G trajectories, O measured columns.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from atoll_coordinator.model.batches import BatchFunction, Spread
from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.points_between import latin_hypercube
from atoll_coordinator.model.shooting.system import OdeSystem, exponentials, logarithms
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

_GROWTH: Final = 1.5
"""Ratio of the rows of successive horizons. Measured with glycolysis without noise and without prior: 28 of 64 starts
reach the best minimum with this ratio, 18 with 2, in the same time."""
_FAR: Final = 0.1
"""Relative difference of a number above which brief fits may lead to another minimum."""
_REACHED: Final = 5
"""Number of starts that reach the best minimum before the search ends. A better minimum that as many starts lead to is
then missed with a probability of 2^-5, 3 %."""
_BATCHES: Final = 40
"""Most batches of starts. If no minimum was reached twice in 480 starts, more starts are unlikely to help."""


def _horizon_steps() -> int:
    """Return the most steps of a fit to one horizon: the next horizon continues it."""
    return SETTINGS.effort.steps // 2


def _last_steps() -> int:
    """Return the most steps of the fits that are continued. Nearly undetermined numbers move slowly in curved
    valleys: measured with glycolysis, up to 150 steps."""
    return 5 * SETTINGS.effort.steps


@dataclass(frozen=True, eq=False)
class StartPoint:
    """Where a fit starts: fitted numbers `values` (Q,) and initial states `starts` (G, D). `is_last` fits are made to
    all rows until they converge; other fits are made to growing horizons, with the prior of the bounds."""

    values: FloatArray
    starts: FloatArray
    is_last: bool = False


@dataclass(frozen=True, eq=False)
class ReachedPoint:
    """Where a fit ended: numbers `values` (Q,), initial states `starts` (G, L), the error model, the mean `squares`
    (O,) of the residuals, and whether the implicit method was used."""

    values: FloatArray
    starts: FloatArray
    errors: ErrorModel
    squares: FloatArray
    is_stiff: bool


@dataclass(frozen=True, eq=False)
class StartsProblem:
    """What all starts share: the measurements, the solver's `tolerance` and `measured_rows` (see `MultipleShooting`),
    the system, and the error model of all fits. If the error model is None, its variances are fitted."""

    measurements: TrajectoryMeasurements
    tolerance: float
    measured_rows: int
    system: OdeSystem
    errors: ErrorModel | None

    @cached_property
    def estimators(self) -> list[MultipleShooting]:
        """An estimator for each horizon; the last one has all rows."""
        whole = self.measurements
        longest = int((whole.bounds[:, 1] - whole.bounds[:, 0]).max())
        estimators = []
        for rows in _horizons(longest):
            part = whole if rows == longest else whole.first_rows(rows)
            measured_rows = -(-self.measured_rows * part.rows // whole.rows)
            estimators.append(MultipleShooting(part, self.tolerance, measured_rows=measured_rows))
        return estimators

    def fit(self, start: StartPoint) -> tuple[ReachedPoint | None, int]:
        """Return where the fit from one start ends (None if the system cannot be integrated there), and its work."""
        has_prior = self.system.has_prior or not start.is_last
        system, starts = replace(self.system.with_values(start.values), has_prior=has_prior), start.starts
        estimators, steps = self.estimators, _horizon_steps()
        if start.is_last:
            estimators, steps = estimators[-1:], _last_steps()
        before, fit = sum(estimator.work_of_thread for estimator in estimators), None
        for estimator in estimators:
            fit = estimator.fit(system, None, steps, starts, self.errors)
            if fit is None:
                break
            system, starts = fit.system, fit.starts[:, : starts.shape[1]]
        work = sum(estimator.work_of_thread for estimator in estimators) - before
        if fit is None:
            return None, work
        return ReachedPoint(system.values, fit.starts, fit.errors, fit.squares, fit.is_stiff), work


_FITS: Final[BatchFunction[StartsProblem, StartPoint, tuple[ReachedPoint | None, int]]] = BatchFunction(
    "trajectory starts", StartsProblem, StartPoint, tuple[ReachedPoint | None, int], StartsProblem.fit
)


@dataclass(frozen=True, eq=False)
class Minimum:
    """A local minimum: the point of its best fit, the misfit in nats (with a prior: and half the penalty), and the
    number of continued fits that ended there.

    `others` are the points of the other fits. They have about the same misfit, but may have other values: then the data
    do not distinguish them.
    """

    point: ReachedPoint
    misfit: float
    reached: int
    others: tuple[ReachedPoint, ...] = ()


@dataclass(frozen=True, eq=False)
class StartsFit:
    """The result of fits from many starts: the best fit, all minima (the best one first), and the number of starts.

    The scales of the hidden states follow from the best fit, so `fit.estimator` is a new estimator.
    """

    fit: TrajectoryFit
    minima: tuple[Minimum, ...]
    starts: int


def fit_from_many_starts(
    estimator: MultipleShooting, system: OdeSystem, seed: int = 0, errors: ErrorModel | None = None
) -> StartsFit | None:
    """Return the best fit of `system` to whole trajectories from many starts; None if no start can be integrated.

    The first start has the values of the system and the smoothed initial states.

    Args:
        estimator: has the measurements, whose `initial` bounds limit the initial values of hidden states. Its work
            grows by the work of the fits. After its deadline no batch of starts is fitted.
        system: the system. Its bounds limit the start values; numbers without finite bounds keep their values. With
            `has_prior`, the best fit has the prior, too.
        seed: seed of the start values.
        errors: the error model of all fits; None: variances are fitted.
    """
    problem = StartsProblem(estimator.measurements, estimator.tolerance, estimator.measured_rows, system, errors)
    spread = estimator.integrator.spread
    misfit = _misfit_of(estimator.measurements)

    def total(point: ReachedPoint) -> float:
        return misfit(point.squares) + 0.5 * system.with_values(point.values).penalty()[0]

    def continue_fits(points: Sequence[ReachedPoint], minima: list[Minimum]) -> list[Minimum]:
        states = len(estimator.measurements.scales)
        continued = [StartPoint(point.values, point.starts[:, :states], is_last=True) for point in points]
        for point in _fit_all(problem, estimator, spread, continued):
            minima = _with_point(minima, point, total(point), least)
        return minima

    minima, elsewhere = list[Minimum](), list[ReachedPoint]()
    count, least = 0, SETTINGS.selection.least_gain
    limit, most = estimator.work + SETTINGS.effort.beam * SETTINGS.effort.work, SETTINGS.effort.beam // 3
    for batch in _draw_starts(estimator.measurements, system, seed):
        if count and (estimator.work >= limit or estimator.deadline.is_over):
            break
        count += len(batch)
        points = _fit_all(problem, estimator, spread, batch)
        points.sort(key=total)
        minima = continue_fits(points[:most], minima)
        elsewhere += points[most:]
        if minima and minima[0].reached >= _REACHED:
            break
    # another solution may describe the rows as well: the best fits that ended at other values are continued, too
    far = [point for point in elsewhere if all(_are_far(point, minimum.point) for minimum in minima)]
    minima = continue_fits(sorted(far, key=total)[:most], minima)
    return StartsFit(_complete(estimator, system, minima[0].point), tuple(minima), count) if minima else None


def _fit_all(
    problem: StartsProblem, estimator: MultipleShooting, spread: Spread, starts: Sequence[StartPoint]
) -> list[ReachedPoint]:
    """Return where the fits end, in the order of `starts`, and count their work; failed fits are left out."""
    ends = [end for end in spread.map(_FITS, lambda: problem, starts) if end is not None]
    estimator.add_work(sum(work for _, work in ends))
    return [point for point, _ in ends if point is not None and np.isfinite(point.squares).all()]


def _are_far(first: ReachedPoint, second: ReachedPoint) -> bool:
    """Tell whether a number of two points differs by more than `_FAR`, relative to its size."""
    sizes = np.maximum(np.maximum(np.abs(first.values), np.abs(second.values)), 1e-300)
    return bool((np.abs(first.values - second.values) > _FAR * sizes).any())


def _with_point(minima: list[Minimum], point: ReachedPoint, misfit: float, least: float) -> list[Minimum]:
    """Return the minima, sorted by misfit, with one more point. Points whose misfits differ by less than `least` nats
    are one minimum."""
    for place, minimum in enumerate(minima):
        if abs(misfit - minimum.misfit) < least:
            is_better = misfit < minimum.misfit
            best, other = (point, minimum.point) if is_better else (minimum.point, point)
            same = Minimum(best, min(misfit, minimum.misfit), minimum.reached + 1, (*minimum.others, other))
            return sorted([*minima[:place], same, *minima[place + 1 :]], key=lambda one: one.misfit)
    return sorted([*minima, Minimum(point, misfit, 1)], key=lambda one: one.misfit)


def _complete(estimator: MultipleShooting, system: OdeSystem, point: ReachedPoint) -> TrajectoryFit:
    """Return the complete fit of a point. If there are hidden states, it is fitted again with their scales."""
    system = system.with_values(point.values)
    fit = estimator.complete(system, None, point.starts, point.errors, is_stiff=point.is_stiff)
    if not estimator.measurements.hidden:
        return fit
    rescaled = MultipleShooting(
        estimator.measurements.with_course(fit.simulated), estimator.tolerance, estimator.deadline,
        estimator.measured_rows, estimator.integrator.spread,
    )  # fmt: skip
    again = rescaled.fit(system, None, SETTINGS.effort.steps, point.starts, point.errors, is_stiff=point.is_stiff)
    return again or fit


def _misfit_of(measurements: TrajectoryMeasurements) -> Callable[[FloatArray], float]:
    """Return n/2 ln s, summed over the measured columns with n values and the mean square s. Mean squares below the
    errors of an integration are equal."""
    counts = (measurements.weights > 0.0).sum(axis=1)
    least = (SETTINGS.shooting.exact * measurements.observed_scales) ** 2
    return lambda squares: 0.5 * math.fsum((counts * logarithms(np.maximum(squares, least))).tolist())


def _horizons(longest: int) -> list[int]:
    """Return the rows of the growing horizons, up to the rows of the longest trajectory."""
    rows, horizons = SETTINGS.shooting.lengths[0], list[int]()
    while rows * _GROWTH <= longest:
        horizons.append(rows)
        rows = round(rows * _GROWTH)
    return [*horizons, longest]


def _draw_starts(measurements: TrajectoryMeasurements, system: OdeSystem, seed: int) -> Iterator[list[StartPoint]]:
    """Yield batches of starts: the start values of the caller, and values within the bounds (Latin hypercubes)."""
    firsts = measurements.bounds[:, 0]
    starts = np.ascontiguousarray(measurements.smoothed[:, firsts].T)
    nothing = np.full(system.count, np.nan)
    lower, upper = (nothing if bound is None else bound for bound in (system.lower, system.upper))
    ranges = measurements.start_ranges(measurements.bounds)
    hidden = [] if ranges is None else list(measurements.hidden)
    if not (_may_vary(lower, upper) or (ranges is not None and _may_vary(*(of[:, hidden] for of in ranges)))):
        yield [StartPoint(system.values, starts)]
        return
    for number in range(_BATCHES):
        batch = [] if number else [StartPoint(system.values, starts)]
        count = SETTINGS.effort.beam - len(batch)
        for shares in latin_hypercube(count, system.count + len(hidden), seed * _BATCHES + number):
            values, its_own = values_between(lower, upper, shares[: system.count], system.values), starts.copy()
            if ranges is not None:
                at = shares[system.count :]
                its_own[:, hidden] = values_between(ranges[0][:, hidden], ranges[1][:, hidden], at, starts[:, hidden])
            batch.append(StartPoint(values, its_own))
        yield batch


def _may_vary(lower: FloatArray, upper: FloatArray) -> bool:
    """Tell whether start values may be drawn between some of these bounds."""
    return bool((np.isfinite(lower) & np.isfinite(upper) & (lower < upper)).any())


def values_between(lower: FloatArray, upper: FloatArray, shares: FloatArray, others: FloatArray) -> FloatArray:
    """Return the values between bounds at these shares of the way, in logarithms if both bounds have the same sign;
    `others` where a bound is infinite."""
    with np.errstate(all="ignore"):
        low, high = logarithms(np.abs(np.nan_to_num(lower))), logarithms(np.abs(np.nan_to_num(upper)))
        logarithmic = np.sign(lower) * exponentials(low + shares * (high - low))
        values = np.where(lower * upper > 0.0, logarithmic, lower + shares * (upper - lower))
    values = np.where(np.isfinite(lower) & np.isfinite(upper), values, others)
    return np.where(lower == upper, lower, values)
