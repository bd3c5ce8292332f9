"""Constants and initial states of a system fitted to measured trajectories by multiple shooting.

How it works. A trajectory is cut into segments of rows. Each segment is integrated from its own initial state (Bock
1983), so that an error of the initial state has little time to grow. Constants and initial states are fitted together
by weighted least squares: each squared residual is divided by the variance of its error, and the sum is minimised.
Segments grow from ten rows to whole trajectories (`fit_in_stages`): a fit of short segments converges from almost any
start values, and a fit of whole trajectories uses all information of the data.

1. *A point of the fit* (`_Point`). The system is integrated with its sensitivities, the derivatives of all states by
   the constants and by the initial state of the segment (`integration`). The sensitivities give the normal equations.
   Their matrix has the shape of an arrow: one block for the constants, and for each segment one block for its own
   numbers (initial state and offsets), which is coupled to the constants only. The segments' blocks are eliminated
   first (`kernels.normal_equations.solve_step`).
2. *The errors* (`error_model`). After each step, the variance of each state is estimated again from the residuals. So
   the unit of a state does not change its weight. If errors of a sensor are correlated between neighbouring rows, the
   residuals are whitened before they are squared (`Innovations`). The share of the variance that is correlated is
   constant during a fit. This share is found by calibration (`selection.comparison`): the first good model is fitted
   with independent errors, and the errors of measurement are estimated from its residuals. All later models are fitted
   and compared with this error model.
3. *A step* (`least_squares.minimize`). Nearly half of all steps fail. So if sensitivities take much more work than
   states, a step is first integrated without sensitivities.
4. *Joining* (`MultipleShooting.join`). Before a fit with longer segments, constants and initial states are moved until
   each short segment begins where the previous segment ends. These conditions are linearised and used to eliminate the
   initial states of the inner segments: condensing (`_condense`). Without joining, the fit of a chaotic trajectory
   fails at the next stage: a state that is simulated from the beginning of a long segment is far from the measured
   state.
5. *Offsets, groups and hidden states.* If a state was measured with an unknown offset, each whole trajectory has one
   offset, which is another number of the segment. If groups of trajectories have their own constants, the sensitivities
   have more columns (`system.Sharing`). Initial states may have bounds, or be given (`InitialRanges`). A hidden state
   is integrated like all others; its initial value is fitted because it changes the measured columns.
6. *Ending early.* A caller that needs no fit above a certain misfit gives a `MisfitLimit`. The Gauss-Newton step
   predicts how far the cost can still fall. A fit ends when even twice this decrease would not reach the limit (ADR
   0106).
7. *Equal fits.* Several stages of the choice of equations fit equal systems from equal starts. The numbers that
   determine a fit are kept, and an equal fit is restored by one integration, with the same counted work (ADR 0103).

Doubts. A variance is estimated by its most probable value for the residuals, and not integrated out of the likelihood.
So if a model fits a state exactly, the weight of this state follows from `SmoothingSettings.smallest_noise`. Two rules
were measured on one machine: when a step is first integrated without sensitivities, and the work of an evaluation of
the rates. These rules do not change a fit. They change the counted work, and so the point at which a search stops.
Letters: D states, M columns computed from states, P fitted constants, L numbers of a segment, G segments, N rows, O
measured columns.
"""

import hashlib
import math
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.model.batches import Spread
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.description_length import TrajectoryMisfit
from atoll_coordinator.model.least_squares import LEAST_DAMPING, SETTLED, Fitter, Solver, hold_numbers, minimize
from atoll_coordinator.model.shooting.error_model import ErrorModel, Innovations
from atoll_coordinator.model.shooting.fit_result import NormalBlocks, TrajectoryFit
from atoll_coordinator.model.shooting.integration import OVERHEAD_NUMBERS, STEEPEST, Integrator, Method, Unsimulated
from atoll_coordinator.model.shooting.kernels.normal_equations import LINES, normal_equations, solve_step
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_coordinator.model.shooting.system import OdeSystem
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

_REJECTED: Final = 0.4
"""Share of fit steps that do not lower the cost (measured without noise: 0.5 with 8 states, 0.4 with 40 states). A step
is first integrated without sensitivities if this integration takes less than this share of the work of a complete
step."""


_UNFORESEEN: Final = 2.0
"""A fit may lower its misfit by up to this many times the prediction of a Gauss-Newton step. The prediction is made at
points where it is small: there the residuals are nearly linear in the fitted numbers. Measured: ADR 0106."""


_FIRST_CHECK: Final = 3
"""Steps before the first such prediction. At the first points, residuals are far from linear."""


@dataclass(frozen=True, eq=False)
class MisfitLimit:
    """A fit whose misfit cannot fall to `nats` need not converge.

    Attributes:
        nats: the largest misfit that is of use.
        misfit: the function from mean squares of residuals to nats.
        errors: correlated errors by which residuals are whitened before they are squared; None: they are not whitened.
    """

    nats: float
    misfit: TrajectoryMisfit
    errors: ErrorModel | None

    @property
    def arrays(self) -> list[FloatArray]:
        """All numbers of the limit."""
        own = [np.array([self.nats]), *vars(self.misfit).values()]
        return own if self.errors is None else [*own, self.errors.sigmas, self.errors.shares, self.errors.decays]


@dataclass(frozen=True, eq=False)
class _Point:
    """A point of the fit: the system with its constants, the initial states (G, L), the error model, the cost, the
    simulated states and computed columns, and the normal equations. The last point of a fit has no normal equations,
    see `TrajectoryFit.blocks`."""

    system: OdeSystem
    starts: FloatArray
    errors: ErrorModel
    cost: float
    states: FloatArray
    residuals: FloatArray
    blocks: NormalBlocks | None


@dataclass(frozen=True, eq=False)
class _KnownFit:
    """The numbers that determine a fit that was made before, and its work. `constants` are None if the system could not
    be fitted."""

    constants: FloatArray | None
    by_group: FloatArray | None
    starts: FloatArray
    errors: ErrorModel
    is_stiff: bool
    work: int


_Step = tuple[FloatArray, FloatArray]
"""Changes of the constants (P,), and of the segments' own numbers (G, L)."""


class MultipleShooting:
    """Fits systems to `measurements`. `work` is the sum, over all integrations, of the evaluations of the rates
    times the integrated numbers, see `Method.work`.

    Several threads may fit at the same time.
    """

    def __init__(
        self,
        measurements: TrajectoryMeasurements,
        tolerance: float,
        deadline: Deadline | None = None,
        measured_rows: int = 0,
        spread: Spread | None = None,
    ) -> None:
        """A fit takes no more steps after the `deadline`. See `Integrator` for the other arguments."""
        self.integrator: Final = Integrator(measurements, tolerance, measured_rows, spread)
        self.measurements: Final = measurements
        self.tolerance: Final = tolerance
        self.measured_rows: Final = measured_rows
        self.deadline: Final = deadline or Deadline()
        self.measured: Final = np.where(measurements.weights > 0.0, measurements.measured, 0.0)
        self._smallest = np.maximum(SETTINGS.smoothing.smallest_noise * measurements.observed_scales, 1e-300)
        totals = measurements.weights.sum(axis=1)
        self._totals: Final = np.where(totals > 0.0, totals, 1.0)
        self._row_steps: Final = relative_steps(measurements)
        self._layouts: Final[dict[int | None, Innovations]] = {}
        self._known_fits: Final[dict[bytes, _KnownFit]] = {}
        self.work = 0
        self._of_thread = threading.local()
        self._lock = threading.Lock()

    # -------------------------------------------------------------------------------------------------- fits

    def fit(  # noqa: PLR0913, all numbers on which a fit depends
        self, system: OdeSystem, length: int | None, steps: int, starts: FloatArray | None = None,
        errors: ErrorModel | None = None, *, is_stiff: bool = False, limit: MisfitLimit | None = None,
    ) -> TrajectoryFit | None:  # fmt: skip
        """Return `system` fitted to segments of about `length` rows; None if it cannot be integrated from `starts`.

        Args:
            system: the system, with start values of the constants.
            length: rows of a segment; None for whole trajectories.
            steps: most steps; successful and failed steps count.
            starts: initial states (G, D), or with offsets (G, D + K); None: the smoothed states.
            errors: the first error model; None: errors are independent and as large as the smoother estimates them.
            is_stiff: whether similar systems are stiff. If similar systems are not stiff, a fit of few steps must not
                use the implicit method, since most candidates that seem stiff are wrong.
            limit: the fit ends when its misfit cannot fall to this limit.
        """
        may_be_stiff = is_stiff or steps > SETTINGS.effort.brief_steps
        key = _key_of_fit(system, length, steps, starts, errors, limit, may_be_stiff=may_be_stiff)
        known = self._known_fits.get(key)
        if known is not None:
            self.add_work(known.work)
            return self._fit_again(known, system, length)
        fitter = _Shooting(self, system, length, starts, errors, may_be_stiff=may_be_stiff)
        fitter.steps_left, fitter.limit = steps, limit
        fit = minimize(fitter, steps)
        self.add_work(fitter.work)
        if not self.deadline.is_over:  # a deadline may have ended the fit early
            self._known_fits[key] = _known_fit(fit, fitter.work)
        return fit

    def _fit_again(self, known: _KnownFit, system: OdeSystem, length: int | None) -> TrajectoryFit | None:
        """Return the fit that was made before of an equal system, equal bit by bit; it costs one integration."""
        if known.constants is None:
            return None
        system = replace(system, constants=known.constants)
        if system.sharing is not None and known.by_group is not None:
            system = replace(system, sharing=replace(system.sharing, constants=known.by_group))
        return self.complete(system, length, known.starts, known.errors, is_stiff=known.is_stiff)

    def add_work(self, work: int) -> None:
        """Add to the counted work. This method is also called for fits that workers have made."""
        self._of_thread.counted = self.work_of_thread + work
        with self._lock:
            self.work += work

    @property
    def work_of_thread(self) -> int:
        """The work counted by the calling thread."""
        return getattr(self._of_thread, "counted", 0)

    def complete(
        self, system: OdeSystem, length: int | None, starts: FloatArray, errors: ErrorModel, *, is_stiff: bool
    ) -> TrajectoryFit:
        """Return the complete fit with these constants, initial states and errors. It is equal to the original fit, bit
        by bit. No work is counted."""
        fitter = _Shooting(self, system, length, starts, errors, may_be_stiff=is_stiff)
        fitter.method = self.integrator.methods[is_stiff]
        point, _ = fitter.point(system, starts, errors, is_last=True)
        fit = fitter.result(point)
        assert fit is not None, "a fitted system can be integrated"
        return fit

    def join(self, fit: TrajectoryFit, before: int | None, after: int | None) -> tuple[OdeSystem, FloatArray] | None:
        """Return a system and the initial states (G, D) of longer segments. With these, the short segments of a fit
        become continuous.

        In a chaotic trajectory, the end of a long segment cannot be predicted from its beginning. So Gauss-Newton steps
        close the gaps between the short segments of each longer segment: each short segment then begins at the end of
        the previous short segment (Bock 1983).

        Args:
            fit: a fit of segments of about `before` rows.
            before: rows of these segments.
            after: rows of the longer segments; None: whole trajectories.

        Returns:
            None if the gaps do not close.
        """
        segments, first_rows = self.layout(before).segments, self.layout(after).segments[:, 0]
        states, fitted = len(fit.system.outputs), fit.system.count
        is_inner = ~np.isin(segments[:, 0], first_rows)
        last = np.flatnonzero(is_inner) - 1
        if not is_inner.any():
            return None
        method, system = self.integrator.methods[fit.is_stiff], fit.system
        starts, pieces = fit.starts[:, :states].copy(), np.cumsum(~is_inner) - 1
        for _ in range(SETTINGS.effort.brief_steps):
            carried = self._integrate_to_next(method, system, segments, starts, last)
            if carried is None or self.deadline.is_over:
                return None
            simulated, sensitivities, ends, reached = carried
            gaps = np.zeros_like(starts)
            gaps[last] = reached[last] - starts[last + 1]
            if np.all(np.abs(gaps) <= method.tolerance):
                return system, np.ascontiguousarray(simulated[:states, first_rows].T)
            residuals = self.residuals(simulated, starts, segments)
            blocks = self.blocks(segments, sensitivities, residuals, fit.errors, fitted)
            with np.errstate(all="ignore"):  # overflows if a trajectory blows up; then no step is solved
                condensed, moves = _condense(blocks, ends, gaps, pieces)
            change, its_own = np.empty(fitted), np.empty((len(condensed.own), states))
            if not solve_step(*condensed, LEAST_DAMPING, change, its_own):
                return None
            system = system.with_values(system.values + change)
            numbers = np.concatenate([np.tile(change, (len(its_own), 1)), its_own, np.ones((len(its_own), 1))], axis=1)
            starts = starts + (moves * numbers[pieces][:, None]).sum(axis=2)
        return None

    def _integrate_to_next(
        self, method: Method, system: OdeSystem, segments: Ints, starts: FloatArray, last: Ints
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
        """Return states (D + M, N), sensitivities (N, D + M, P + D), and the sensitivities and states at the ends of
        segments.

        The segments with the numbers `last` are integrated to the first row of the next segment. None if a segment
        cannot be integrated.
        """
        owners = np.repeat(np.arange(len(segments)), segments[:, 1] - segments[:, 0])
        longer = segments.copy()
        longer[last, 1] += 1
        ends = np.zeros((len(segments), starts.shape[1], system.count + starts.shape[1]))
        reached, parts = np.zeros_like(starts), []
        numbers = starts.shape[1] * (1 + system.count + starts.shape[1])
        for parity in (0, 1):  # neighbouring segments share a row, and would overwrite it
            chosen = np.arange(parity, len(segments), 2)
            course = self.integrator.integrate(method, system, longer[chosen], np.ascontiguousarray(starts[chosen]))
            self.add_work(method.work(course.steps, self.measurements.rows // 2, numbers))
            steepest = self.integrator.steepest(course.sensitivities[np.isin(owners, chosen)], system)
            if course.done < len(chosen) or not steepest < STEEPEST:
                return None
            inner = np.intersect1d(chosen, last)
            ends[inner] = course.sensitivities[segments[inner, 1], : starts.shape[1]]
            reached[inner] = course.states[: starts.shape[1], segments[inner, 1]].T
            parts.append(course)
        even, odd = parts
        is_odd = owners % 2 == 1
        even.states[:, is_odd], even.sensitivities[is_odd] = odd.states[:, is_odd], odd.sensitivities[is_odd]
        return even.states, even.sensitivities, ends, reached

    def estimator_of_trajectory(self, owner: int, fit: TrajectoryFit) -> tuple["MultipleShooting", FloatArray]:
        """Return an estimator for one trajectory (`owner`, an index of `names`), and the initial states of `fit` along
        this trajectory."""
        measurements = self.measurements
        is_own = measurements.owners_of_rows[fit.segments[:, 0]] == owner
        spread = self.integrator.spread
        estimator = MultipleShooting(measurements.part([owner]), self.tolerance, self.deadline, spread=spread)
        return estimator, fit.starts[is_own]

    # ------------------------------------------------------------------------------------------ residuals and errors

    def layout(self, length: int | None) -> Innovations:
        """Return the `Innovations` for segments of about `length` rows."""
        known = self._layouts.get(length)
        if known is None:
            layout = Innovations(self.measurements.segments(length), self._row_steps, self.measurements.weights)
            known = self._layouts.setdefault(length, layout)
        return known

    def residuals(self, simulated: FloatArray, starts: FloatArray, segments: Ints) -> FloatArray:
        """Return residuals (O, N): measured columns, minus `simulated` (D + M, N), minus the offsets in the last
        columns of `starts`."""
        measurements, states = self.measurements, len(self.measurements.scales)
        residuals = np.asarray(self.measured - simulated[measurements.observed])
        for place, state in enumerate(measurements.offset.tolist() if starts.shape[1] > states else []):
            residuals[state] -= np.repeat(starts[:, states + place], segments[:, 1] - segments[:, 0])
        return residuals

    def blocks(
        self, segments: Ints, sensitivities: FloatArray, residuals: FloatArray, errors: ErrorModel, fitted: int
    ) -> NormalBlocks:
        """Return the normal equations of segments, weighted by the error model."""
        local, groups, columns = sensitivities.shape[2] - fitted, len(segments), sensitivities.shape[2] + 1
        weights = self.measurements.weights / (errors.sigmas * errors.sigmas)[:, None]
        blocks = NormalBlocks(
            np.zeros((fitted, fitted)), np.zeros((groups, fitted, local)), np.zeros((groups, local, local)),
            np.zeros(fitted), np.zeros((groups, local)),
        )  # fmt: skip
        normal_equations(
            segments, self.measurements.observed, self._row_steps, residuals, weights, errors.shares, errors.decays,
            sensitivities, fitted, *blocks, np.empty((LINES, columns)), np.empty(columns), np.empty((columns, columns)),
        )  # fmt: skip
        return blocks

    def squares(self, residuals: FloatArray) -> FloatArray:
        """Return the mean squares (O,) of residuals. They are corrected because robustness weights reduce large
        errors."""
        return self._correct_for_robustness(
            (self.measurements.weights * residuals * residuals).sum(axis=1) / self._totals
        )

    def _correct_for_robustness(self, squares: FloatArray) -> FloatArray:
        consistency = self.measurements.consistency
        return np.asarray(squares if consistency is None else squares / consistency)

    def update_variances(self, residuals: FloatArray, layout: Innovations, errors: ErrorModel) -> ErrorModel:
        """Return the error model with variances estimated from these residuals."""
        if errors.is_known:
            return errors
        squares, _ = layout.squares(residuals, errors)
        sigmas = np.maximum(np.sqrt(self._correct_for_robustness(squares / self._totals)), self._smallest)
        return errors if np.all(np.abs(sigmas / errors.sigmas - 1.0) < 1e-3) else replace(errors, sigmas=sigmas)

    def sensor_errors(self, fit: TrajectoryFit, turns: FloatArray) -> ErrorModel:
        """Return `Innovations.sensor_errors` of a fit of whole trajectories; `turns` (O,) are the correlation lengths
        in rows."""
        fitted = (fit.system.count + fit.starts.size) / len(fit.residuals)
        return self.layout(None).sensor_errors(fit.residuals, np.sqrt(fit.squares), fitted, turns)

    def whiten(self, residuals: FloatArray, errors: ErrorModel) -> FloatArray:
        """Return residuals (O, N) of whole trajectories without their correlated part, according to the error model
        `errors`."""
        return self.layout(None).whiten(residuals, errors)

    def squared_innovations(self, residuals: FloatArray, errors: ErrorModel) -> FloatArray:
        """Return equivalent sums of squared innovations (O,) of residuals (O, N) of whole trajectories.

        The variances of innovations differ. The result is the sum of squares that as many innovations would have if
        their variances were equal and their likelihood unchanged.
        """
        squares, logarithms = self.layout(None).squares(residuals, errors)
        counts = np.maximum((self.measurements.weights > 0.0).sum(axis=1), 1)
        return np.asarray(squares * np.exp(logarithms / counts))

    def cost(self, fit: TrajectoryFit) -> float:
        """Return the cost of a fit of whole trajectories: each squared residual is divided by the variance of its
        error, and the sum is returned."""
        return _cost(self.layout(None), fit.residuals, fit.errors)

    # --------------------------------------------------------------------------------------------------- simulations

    def simulate(self, system: OdeSystem, start: FloatArray) -> FloatArray | Unsimulated:
        """Return the states (D, N) of whole trajectories from one initial state (D,), or the reason why the simulation
        ended early."""
        simulated, why = self.simulate_until_blow_up(system, start)
        return simulated if why is None else why

    def simulate_until_blow_up(self, system: OdeSystem, start: FloatArray) -> tuple[FloatArray, Unsimulated | None]:
        """Return `Integrator.simulate` of whole trajectories."""
        return self.integrator.simulate(system, self.layout(None).segments, start)

    def blocks_of(self, fit: TrajectoryFit) -> NormalBlocks:
        """Return the normal equations at the end of a fit of this estimator."""
        return self.blocks(fit.segments, self.sensitivities(fit), fit.residuals, fit.errors, fit.system.count)

    def sensitivities(self, fit: TrajectoryFit) -> FloatArray:
        """Return `TrajectoryFit.integrated_sensitivities` of a fit of this estimator."""
        method = self.integrator.methods[fit.is_stiff]
        return self.integrator.integrate(method, fit.system, fit.segments, fit.starts).sensitivities


class _Shooting(Fitter[_Point, _Step, TrajectoryFit | None]):
    """The fit of one system to segments of one length. `work` is its work so far, `steps_left` limits its steps, and
    `limit` is the largest misfit that is of use."""

    def __init__(
        self, estimator: MultipleShooting, system: OdeSystem, length: int | None, starts: FloatArray | None,
        errors: ErrorModel | None, *, may_be_stiff: bool,
    ) -> None:  # fmt: skip
        self._estimator, self._measurements = estimator, estimator.measurements
        self._layout = estimator.layout(length)
        self._segments = self._layout.segments
        self._is_whole = length is None
        self._ranges = self._measurements.start_ranges(self._segments)
        self._system, self._starts, self._errors = system, starts, errors
        self._may_be_stiff = may_be_stiff
        self.steps_left = 0
        self.limit: MisfitLimit | None = None
        self.method: Method = estimator.integrator.methods[0]
        self.work = 0

    def init(self) -> _Point | None:
        """Return the first point; None if the system cannot be integrated from any of the tried initial states.

        If the explicit method takes too many steps and the implicit method is allowed, the implicit method is used.
        """
        measurements = self._measurements
        system = self._system.with_values(self._system.values)  # within their bounds
        errors = self._errors or ErrorModel.independent(
            np.maximum(measurements.noise, 1e-4 * measurements.observed_scales)
        )
        explicit, implicit = self._estimator.integrator.methods
        for beginning in self._starting_states():
            starts = self._held_starts(self._with_offsets(beginning, len(system.outputs)))
            self.method = explicit
            point, is_out_of_steps = self.point(system, starts, errors)
            if is_out_of_steps and self._may_be_stiff:
                self.method = implicit
                point, _ = self.point(system, starts, errors)
            if point is not None:
                return point
        return None

    def equations(self, point: _Point) -> Solver[_Step]:
        """Return the solver for steps of the constants (P,), within their bounds, and of initial states (G, D).

        The predicted decrease is twice the decrease by an undamped step; this is an upper limit for damped steps.
        """
        assert point.blocks is not None, "only the last point has no normal equations"
        normal, coupling, own, gradient, own_gradient = point.blocks
        if point.system.has_prior:
            _, pull, curvature = point.system.penalty()
            normal, gradient = normal + np.diag(curvature), gradient + pull
        held = point.system.blocked_by_bounds(gradient)
        if held is not None and held.any():
            normal, gradient = hold_numbers(normal, gradient, held)
            coupling = coupling.copy()
            coupling[:, held, :] = 0.0
        if self._ranges is not None:
            free = self._free_starts(point.starts, own_gradient)
            own, own_gradient = own * (free[:, :, None] & free[:, None, :]), own_gradient * free
            coupling = coupling * free[:, None, :]

        def solve(damping: float) -> tuple[_Step, float] | None:
            change, moves = np.empty_like(gradient), np.empty_like(own_gradient)
            if not solve_step(normal, coupling, own, gradient, own_gradient, damping, change, moves):
                return None
            return (change, moves), 2.0 * float((gradient * change).sum() + (own_gradient * moves).sum())

        return solve

    def step(self, point: _Point, step: _Step) -> tuple[_Point, float] | None:
        """Return the point after a step, with variances estimated at this point, and the decrease of the cost, computed
        with the old variances."""
        system, starts = point.system.moved(step[0]), self._within_ranges(point.starts + step[1])
        self.steps_left -= 1
        least = self.least_gain(point)
        there, _ = self.point(system, starts, point.errors, point.cost, least, is_last=not self.steps_left)
        return None if there is None else (there, point.cost - self._cost(there.system, there.residuals, point.errors))

    def _cost(self, system: OdeSystem, residuals: FloatArray, errors: ErrorModel) -> float:
        """Return the cost of residuals, and the penalty of the fitted numbers if they have a prior distribution."""
        cost = _cost(self._layout, residuals, errors)
        return cost + system.penalty()[0] if system.has_prior else cost

    def least_gain(self, point: _Point) -> float:
        """Return the least decrease that counts: a share of the cost, or the cost of rounding errors if this cost is
        larger.

        If the data are a solution in closed form, the residuals are rounding errors, and a fit would need many steps to
        follow them.
        """
        return max(SETTLED * point.cost, float((self._rounding / point.errors.sigmas**2).sum()))

    @cached_property
    def _rounding(self) -> FloatArray:
        """The sum of squared rounding errors (O,). With each row of a segment, a state gets one more rounding error."""
        segments, measurements = self._segments, self._measurements
        since = np.arange(measurements.rows) - np.repeat(segments[:, 0], segments[:, 1] - segments[:, 0])
        squares = (np.finfo(np.float64).eps * self._estimator.measured) ** 2 * (1 + since)
        return np.asarray((measurements.weights * squares).sum(axis=1))

    def done(self, point: _Point, promise: float, taken: int) -> bool:
        """Tell whether the time is over, or whether the fit cannot reach its limit."""
        return self._estimator.deadline.is_over or (taken >= _FIRST_CHECK and self._is_out_of_reach(point))

    def _is_out_of_reach(self, point: _Point) -> bool:
        """Tell whether the misfit would stay above the limit even after a decrease that is `_UNFORESEEN` times the
        prediction.

        The undamped step predicts the largest decrease. It tells which share of the cost remains, and thus by how many
        nats the likelihood of N rows with a fitted variance can grow.
        """
        limit, estimator = self.limit, self._estimator
        solved = None if limit is None else self.equations(point)(LEAST_DAMPING)
        if limit is None or solved is None:
            return False
        remaining = 1.0 - 0.5 * solved[1] / point.cost  # `equations` predicts twice the decrease
        if not remaining > 0.0:
            return False
        rows = np.count_nonzero(self._measurements.weights)
        possible = -0.5 * rows * math.log(min(remaining, 1.0))
        residuals = point.residuals if limit.errors is None else estimator.whiten(point.residuals, limit.errors)
        return bool(limit.misfit.total(estimator.squares(residuals)) - _UNFORESEEN * possible > limit.nats)

    def result(self, point: _Point | None) -> TrajectoryFit | None:
        if point is None:
            return None
        estimator = self._estimator
        states = point.states[: len(point.system.outputs)]
        return TrajectoryFit(
            point.system, self._segments, point.starts, states, point.residuals, point.errors,
            estimator.squares(point.residuals), estimator, self.method is estimator.integrator.methods[1], point.blocks,
        )  # fmt: skip

    def point(
        self, system: OdeSystem, starts: FloatArray, errors: ErrorModel, below: float = math.inf,
        least: float = -math.inf, *, is_last: bool = False,
    ) -> tuple[_Point | None, bool]:  # fmt: skip
        """Return the point of a system and its initial states, and whether the method took too many steps.

        The point is None if the system cannot be integrated or if the cost is not below `below`. With a finite `below`
        (after a step), the error model gets the variances of the new residuals.

        A fit ends at a point that `is_last`, or whose cost is less than `least` below `below`. No step is taken from
        such a point, so it is integrated without sensitivities.
        """
        estimator, integrator = self._estimator, self._estimator.integrator
        states, fitted, local = len(system.outputs), system.count, starts.shape[1]
        numbers, point, blocks = states * (1 + fitted + local), None, None
        is_step = below < math.inf
        is_tried = is_last or (is_step and OVERHEAD_NUMBERS + states < _REJECTED * (OVERHEAD_NUMBERS + numbers))
        for has_sensitivities in (False, True) if is_tried else (True,):
            course = integrator.integrate(
                self.method, system, self._segments, starts, has_sensitivities=has_sensitivities
            )
            self.work += self.method.work(
                course.steps, self._measurements.rows, numbers if has_sensitivities else states
            )
            is_steep = not integrator.steepest(course.sensitivities, system) < STEEPEST
            if course.done < len(self._segments) or is_steep:
                break
            residuals = estimator.residuals(course.states, starts, self._segments)
            cost = self._cost(system, residuals, errors)
            if not cost < below:
                break
            is_last = is_last or below - cost <= least
            if has_sensitivities or is_last:
                weighed = estimator.update_variances(residuals, self._layout, errors) if is_step else errors
                if has_sensitivities:
                    blocks = estimator.blocks(self._segments, course.sensitivities, residuals, weighed, fitted)
                cost = self._cost(system, residuals, weighed)
                point = _Point(system, starts, weighed, cost, course.states, residuals, blocks)
                break
        return point, course.done < 0

    def _starting_states(self) -> Iterator[FloatArray]:
        """Yield initial states (G, D or more) that are tried until a system can be integrated.

        Noise may change the sign of the first value of a state, and many laws, for example laws of growth, blow up from
        a value with the wrong sign. So a second set of initial states is tried. If the first value of a state has
        another sign than its values from a certain row to the end of its piece, the second set contains the smoothed
        value in the first such row.
        """
        measurements, segments = self._measurements, self._segments
        smoothed = np.ascontiguousarray(measurements.smoothed[:, segments[:, 0]].T)
        starts = smoothed if self._starts is None else self._starts
        yield starts
        signed, bounds = starts.copy(), measurements.bounds
        pieces = np.searchsorted(bounds[:, 0], segments[:, 0], "right") - 1
        for group, (first, end) in enumerate(zip(segments[:, 0].tolist(), bounds[pieces, 1].tolist(), strict=True)):
            for state, values in enumerate(measurements.smoothed[:, first:end]):
                lasting = int(np.flatnonzero(values * values[-1] <= 0.0).max(initial=-1)) + 1
                if lasting < len(values) and starts[group, state] * values[-1] <= 0.0:
                    signed[group, state] = values[lasting]
        if not np.array_equal(signed, starts):
            yield signed

    def _with_offsets(self, starts: FloatArray, states: int) -> FloatArray:
        """Return initial states with offsets; missing offsets are zero. Only fits of whole trajectories determine
        offsets."""
        count = len(self._measurements.offset) if self._is_whole else 0
        missing = states + count - starts.shape[1]
        if missing <= 0:
            return np.ascontiguousarray(starts[:, : states + count])
        return np.concatenate([starts, np.zeros((len(starts), missing))], axis=1)

    def _held_starts(self, starts: FloatArray) -> FloatArray:
        """Return the initial states within their bounds, with 0 for each state that was 0 along the whole
        trajectory."""
        measurements, states = self._measurements, len(self._measurements.scales)
        starts = self._within_ranges(starts)
        if measurements.resting is None:
            return starts
        starts = starts.copy()
        for resting, state in zip(measurements.resting, measurements.observed.tolist(), strict=True):
            if state < states:
                starts[resting[self._segments[:, 0]], state] = 0.0
        return starts

    def _within_ranges(self, starts: FloatArray) -> FloatArray:
        """Return the initial states within their bounds."""
        if self._ranges is None:
            return starts
        states = len(self._measurements.scales)
        return np.concatenate([np.clip(starts[:, :states], *self._ranges), starts[:, states:]], axis=1)

    def _free_starts(self, starts: FloatArray, gradient: FloatArray) -> npt.NDArray[np.bool_]:
        """Return a mask (G, L). It is False for initial values that lie on a bound, and would cross this bound in a
        step along the `gradient` (G, L)."""
        assert self._ranges is not None
        lower, upper = (
            np.pad(bounds, ((0, 0), (0, starts.shape[1] - bounds.shape[1])), constant_values=end)
            for bounds, end in zip(self._ranges, (-np.inf, np.inf), strict=True)
        )
        return ~(((starts <= lower) & (gradient <= 0.0)) | ((starts >= upper) & (gradient >= 0.0)))


def _key_of_fit(  # noqa: PLR0913, as many as `MultipleShooting.fit` has
    system: OdeSystem, length: int | None, steps: int, starts: FloatArray | None, errors: ErrorModel | None,
    limit: MisfitLimit | None, *, may_be_stiff: bool,
) -> bytes:  # fmt: skip
    """Return a digest of all numbers on which a fit to given measurements depends."""
    digest = hashlib.blake2b(repr((length, steps, may_be_stiff, system.count)).encode())
    arrays = [*system.arrays, starts]
    if errors is not None:
        arrays += [errors.sigmas, errors.shares, errors.decays, np.array(errors.is_known)]
    if limit is not None:
        arrays += limit.arrays
    for array in arrays:
        digest.update(b"-" if array is None else repr(array.shape).encode() + array.tobytes())
    return digest.digest()


def _known_fit(fit: TrajectoryFit | None, work: int) -> _KnownFit:
    if fit is None:
        nothing = np.zeros(0)
        return _KnownFit(None, None, nothing, ErrorModel.independent(nothing), False, work)
    by_group = None if fit.system.sharing is None else fit.system.sharing.constants
    return _KnownFit(fit.system.constants, by_group, fit.starts, fit.errors, fit.is_stiff, work)


def _cost(layout: Innovations, residuals: FloatArray, errors: ErrorModel) -> float:
    """Return the weighted sum of squares of whitened residuals."""
    squares, _ = layout.squares(residuals, errors)
    return float((squares / (errors.sigmas * errors.sigmas)).sum())


def _condense(
    blocks: NormalBlocks, ends: FloatArray, gaps: FloatArray, pieces: Ints
) -> tuple[NormalBlocks, FloatArray]:
    """Return the normal equations of pieces with continuous segments, and how the initial states of segments move.

    Let s be the move of the initial state of a piece, and p the step of the constants. Then the initial state of a
    segment of this piece moves by A s + B p + c. From one segment to the next, A, B and c become S A, S B + T and S c +
    h. S and T are the sensitivities of the end of the first segment to its initial state and to the constants; h is the
    gap between the two segments (Bock 1983, section 3; Albersmeyer & Diehl 2010, SIAM Journal on Optimization 20:1655).

    Args:
        blocks: the normal equations of the segments.
        ends: T and S (G, D, P + D).
        gaps: h (G, D), the end of a segment minus the initial state of the next segment.
        pieces: (G,), the piece that each segment belongs to, ascending.

    Returns:
        Blocks of the pieces, and B, A and c (G, D, P + D + 1).
    """
    normal, coupling, own, gradient, own_gradient = blocks
    groups, fitted, states = coupling.shape
    moves = np.zeros((groups, states, fitted + states + 1))
    sums = np.zeros((int(pieces[-1]) + 1, fitted + states + 1, fitted + states + 1))
    crossed = np.zeros((fitted, fitted))
    for g, piece in enumerate(pieces.tolist()):
        move = moves[g]
        if g and piece == pieces[g - 1]:
            move += ends[g - 1, :, fitted:] @ moves[g - 1]
            move[:, :fitted] += ends[g - 1, :, :fitted]
            move[:, -1] += gaps[g - 1]
        else:
            move[:, fitted:-1] = np.eye(states)
        costs = own[g] @ move
        costs[:, -1] -= own_gradient[g]
        sums[piece] += move.T @ costs
        sums[piece, :fitted] += coupling[g] @ move
        crossed += coupling[g] @ move[:, :fitted]
    normal = normal + crossed.T + sums[:, :fitted, :fitted].sum(axis=0)
    gradient = gradient - sums[:, :fitted, -1].sum(axis=0)
    parts = (sums[:, :fitted, fitted:-1], sums[:, fitted:-1, fitted:-1], -sums[:, fitted:-1, -1])
    coupling, own, own_gradient = map(np.ascontiguousarray, parts)
    return NormalBlocks(normal, coupling, own, gradient, own_gradient), moves


def relative_steps(measurements: TrajectoryMeasurements) -> FloatArray:
    """Return the time step (N,) from the previous row to each row, divided by the median step. It is 1 for evenly
    spaced rows."""
    steps = np.diff(measurements.times, prepend=measurements.times[0]) / measurements.step
    steps[measurements.bounds[:, 0]] = 1.0
    steps[np.abs(steps - 1.0) < 1e-6] = 1.0
    return steps


def fit_in_stages(
    estimator: MultipleShooting, system: OdeSystem, lengths: Sequence[int | None], steps: int
) -> TrajectoryFit | None:
    """Return `system` fitted to segments of growing `lengths`; each fit starts from the result of the previous fit."""
    fit: TrajectoryFit | None = None
    before: int | None = None
    for length in _intermediate_lengths(lengths, estimator.measurements):
        starts, errors = None, None
        if fit is not None:
            firsts = estimator.measurements.segments(length)[:, 0]
            joined = estimator.join(fit, before, length)
            system, starts = fit.system, np.ascontiguousarray(fit.simulated[:, firsts].T)
            errors = fit.errors
            fit = None if joined is None else estimator.fit(joined[0], length, steps, joined[1], errors)
        fit = fit or estimator.fit(system, length, steps, starts, errors)
        if fit is None:
            return None
        before = length
    return fit


def _intermediate_lengths(lengths: Sequence[int | None], measurements: TrajectoryMeasurements) -> Iterator[int | None]:
    """Yield `lengths`, and intermediate lengths if the ratio of two successive lengths is too large.

    Errors may grow so much along a trajectory that a fit of long segments fails if it starts from the fit of much
    shorter segments.
    """
    longest = int((measurements.bounds[:, 1] - measurements.bounds[:, 0]).max())
    before: int | None = None
    for length in lengths:
        rows = longest if length is None else length
        while before is not None and rows > SETTINGS.shooting.segment_growth * before:
            before *= SETTINGS.shooting.segment_growth
            yield before
        yield length
        before = rows
