"""Constants and initial states fitted to the measured states: multiple shooting by Levenberg's and Marquardt's method.

Every segment of rows is integrated from an initial state of its own. Segments grow from a few rows to whole
trajectories: short ones fit well from anywhere, whole ones use all that the data say (Bock 1983). Errors of different
states are weighted by their variances, which are fitted as well. Letters as in `kernels_integrate`.
"""

import math
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from atoll_coordinator.model.batches import BatchFunction, Spread
from atoll_coordinator.model.criteria import TrajectoryMisfit
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.least_squares import LEAST_DAMPING, Solver, minimize, without
from atoll_coordinator.model.shooting.error_model import ErrorModel, Innovations
from atoll_coordinator.model.shooting.fit_cache import FitCache, key_of
from atoll_coordinator.model.shooting.kernels.condensing import condense
from atoll_coordinator.model.shooting.kernels.implicit import STIFF
from atoll_coordinator.model.shooting.kernels.integrate import PRECISE, QUICK, integrate_segments
from atoll_coordinator.model.shooting.kernels.normal_equations import LINES, normal_equations, solve_step
from atoll_coordinator.model.shooting.kernels.rates import Table
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.segment_batches import (
    Blocks,
    EstimatorParts,
    SegmentBatch,
    SegmentOutcome,
    SegmentTask,
)
from atoll_coordinator.model.shooting.system import System
from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints
from atoll_core.wire.values import decode_value, encode_value

_FREE_STEPS: Final = (4.0, 12.0, 1.0)
"""Steps for each row that do not count as more work, by the quick, the precise and the implicit method."""
_QUICK_STEPS: Final = 8
"""Steps for each row beyond which implicit ones take less time than quick ones."""
_FINEST_IMPLICIT: Final = 1e-6
"""Errors of an implicit step, over a state's standard deviation, are not made smaller: its order is low."""
_REJECTED: Final = 0.4
"""Share of the steps of fits that do not lower the cost: of data without noise 0.5 with 8 states, 0.4 with 40. States
are integrated alone first where that takes less than this share of the work."""
_OVERHEAD_NUMBERS: Final = 10
"""Numbers whose carrying along takes as long as everything else about a row."""
_FIT_BYTES: Final = 8_000
"""What a remembered fit takes beside its states and residuals."""
Unsimulated = Literal["ran away", "out of steps"]
"""Why there is no simulation: it left the range where states may be, or ended before it was known whether it does."""

_STEEPEST: Final = 1e60
"""Guard: sensitivities beyond this, of a state in its scale to a constant in its size, have no squares to compute
with."""


@dataclass(frozen=True, eq=False)
class _Equations:
    """The misfit and its normal equations at one point, by the errors there."""

    cost: float
    errors: ErrorModel
    simulated: FloatArray
    residuals: FloatArray
    normal: FloatArray
    coupling: FloatArray
    own: FloatArray
    gradient: FloatArray
    own_gradient: FloatArray


@dataclass(frozen=True, eq=False)
class _Course:
    """States (D, N) along segments, of which so many were `done`, less than zero if the steps `taken` were too many.

    There are sensitivities (N, D, P + L), or the `blocks` that they give by the errors that were known.
    """

    done: int
    taken: int
    simulated: FloatArray
    steepest: float
    gradients: FloatArray | None = None
    blocks: Blocks | None = None


_NONE: Final = np.zeros(0, np.int64)

_Step = tuple[FloatArray, FloatArray]
"""Of the constants (P,), and of the initial states (G, D)."""


@dataclass(frozen=True, slots=True, eq=False)
class _Point:
    """Where a fit is: constants, initial states, and the equations there."""

    system: System
    starts: FloatArray
    here: _Equations

    @property
    def errors(self) -> ErrorModel:
        """The errors by which the equations are weighed."""
        return self.here.errors


@dataclass(frozen=True, slots=True, eq=False)
class _Done:
    """What a fit came to, None when the system cannot be integrated, and the work that it took."""

    fit: TrajectoryFit | None
    work: int


@dataclass(frozen=True, eq=False)
class Goal:
    """What a fit has to come to, to be of use: a `misfit` of at most so many nats."""

    misfit: TrajectoryMisfit
    most: float

    def to_bytes(self) -> bytes:
        """Return what tells this goal from others."""
        misfit = self.misfit
        parts = (misfit.low, misfit.high, misfit.pieces, misfit.below, np.float64(self.most))
        return b"".join(part.tobytes() for part in parts)

    def is_beyond(self, squares: FloatArray, promise: float, steps: int) -> bool:
        """Tell whether errors of these mean squares (O,) are too large for `steps` that gain as much as the next.

        Steps gain less towards the end of a fit. What the next one promises, see `_solver`, is twice its gain in
        squares over variances, of which two are a nat: half of that is taken, as if each step gained twice as much.
        """
        return self.misfit.total(squares) - 0.5 * promise * steps > self.most


@dataclass(frozen=True, eq=False)
class _Method:
    """How to integrate: most steps for each row, how many of them are free, the error (D,) allowed in one."""

    table: Table
    steps: int
    free: float
    tolerance: FloatArray

    def work(self, steps: int, rows: int) -> int:
        """Return what so many steps along so many rows count, one for each row or more."""
        return max(rows, int(steps / self.free))


class _OfThread(threading.local):
    """What one thread has done: the work of the fit that it is at, and all that it has counted."""

    work = 0
    counted = 0


class MultipleShooting:
    """Fits systems to `measurements`; `work` counts rows times numbers carried along, of all integrations."""

    def __init__(
        self, measurements: Measurements, tolerance: float, deadline: Deadline | None = None, measured_rows: int = 0,
        spread: Spread | None = None,
    ) -> None:  # fmt: skip
        """`tolerance` is the error of a step over a state's standard deviation.

        After the `deadline` a fit takes no more steps. Where that is much work, segments are integrated wherever
        `spread` has it done. Steps are allowed for each row; where rows stand for more
        `measured_rows` of the same time altogether, for each of these.
        """
        self.measured_rows: Final = measured_rows
        self._rows_in_row: Final = max(1.0, measured_rows / measurements.rows)
        self.deadline: Final = deadline or Deadline()
        self.tolerance: Final = tolerance
        quick, precise, implicit = _FREE_STEPS
        is_quick = tolerance >= SETTINGS.common.clean
        explicit = (QUICK, _QUICK_STEPS, quick) if is_quick else (PRECISE, SETTINGS.shooting.steps_per_row, precise)
        self._methods: Final = (
            _Method(*explicit, tolerance * measurements.scales),
            _Method(
                STIFF,
                SETTINGS.shooting.steps_per_row,
                implicit,
                max(tolerance, _FINEST_IMPLICIT) * measurements.scales,
            ),
        )
        self.measurements: Final = measurements
        self._measured = np.where(measurements.weights > 0.0, measurements.measured, 0.0)
        self._smallest = np.maximum(
            SETTINGS.interpolation.smallest_noise * measurements.scales[measurements.observed], 1e-300
        )
        totals = measurements.weights.sum(axis=1)
        self._totals: Final = np.where(totals > 0.0, totals, 1.0)
        self._layouts: Final[dict[int | None, Innovations]] = {}
        self._row_steps: Final = row_steps(measurements)
        self._spread: Final = spread or Spread()
        self._encoded: bytes | None = None
        self._steps_of_row = 1.0
        self.work = 0
        self._lock = threading.Lock()
        self._own = _OfThread()
        self._cache: Final = FitCache[_Done](_FIT_BYTES + 8 * 2 * measurements.smoothed.size)

    def fit(  # noqa: PLR0913, where a fit begins, how far it goes, and what it is for
        self, system: System, length: int | None, steps: int, starts: FloatArray | None = None,
        errors: ErrorModel | None = None, *, is_stiff: bool = False, goal: Goal | None = None,
    ) -> TrajectoryFit | None:  # fmt: skip
        """Return `system` fitted to segments of about `length` rows, None when it cannot be integrated from `starts`.

        Args:
            system: where the fit begins.
            length: rows of a segment; None for whole trajectories.
            steps: most steps, successful or not.
            starts: initial states (G, D), or with offsets (G, D + K); the smoothed ones unless given.
            errors: what they are taken to be at first; independent, of the smoother's noise, unless given.
            is_stiff: whether similar systems are; in a fit of few steps no other is taken for stiff, since most
                candidates that seem so are bad ones.
            goal: a fit ends where it is told that it does not come to this.
        """
        key = key_of(system, starts, errors, length, steps, is_stiff, None if goal is None else goal.to_bytes())
        done = self._cache.get(key)
        if done is None:
            self._own.work = 0
            fit = self._fitted(system, length, steps, starts, errors, is_stiff=is_stiff, goal=goal)
            done = _Done(fit, self._own.work)
            if not self.deadline.is_over:  # one that time has cut short is to be fitted again
                self._cache.put(key, done)
        self.count(done.work)
        return done.fit

    def count(self, work: int) -> None:
        """Add to the work, whoever has done it."""
        self._own.counted += work
        with self._lock:
            self.work += work

    @property
    def counted(self) -> int:
        """What the calling thread has added to the work."""
        return self._own.counted

    def whole(
        self, system: System, length: int | None, starts: FloatArray, errors: ErrorModel, *, is_stiff: bool
    ) -> TrajectoryFit:
        """Return the fit that has come to these constants, initial states and errors, to the bit; it counts no work."""
        layout, method = self._layout(length), self._methods[is_stiff]
        here, _ = self._equations(method, system, layout, starts, errors)
        assert here is not None, "what was fitted can be integrated"
        return self._fit_at(_Point(system, starts, here), layout, method)

    def _fit_at(self, end: _Point, layout: Innovations, method: _Method) -> TrajectoryFit:
        here = end.here
        return TrajectoryFit(
            end.system, layout.segments, end.starts, here.simulated, here.residuals, end.errors,
            self.squares(here.residuals), here.normal, here.coupling, here.own, self, method is self._methods[1],
            here.gradient,
        )  # fmt: skip

    def join(self, fit: TrajectoryFit, before: int | None, after: int | None) -> tuple[System, FloatArray] | None:
        """Return the system, and the initial states (G, D) of longer segments, that make those of a fit continuous.

        The state at the end of a segment tells more of a chaotic trajectory than can be carried there from its
        beginning. So the fit is moved, by steps of Gauss and Newton, to where each segment begins at the end of the one
        before, as far as they are parts of a longer one (Bock 1983).

        Args:
            fit: of segments of about `before` rows.
            before: what they were called.
            after: about how many rows the longer ones have; None: whole trajectories.

        Returns:
            None where the gaps do not close.
        """
        layout, begun = self._layout(before), self._layout(after).segments[:, 0]
        segments, states, fitted = layout.segments, len(fit.system.outputs), fit.system.count
        is_inner = ~np.isin(segments[:, 0], begun)
        last = np.flatnonzero(is_inner) - 1
        if not is_inner.any():
            return None
        method, system = self._methods[1 if fit.is_stiff else 0], fit.system
        starts, pieces = fit.starts[:, :states].copy(), np.cumsum(~is_inner) - 1
        for _ in range(SETTINGS.effort.brief_steps):
            carried = self._carried(method, system, segments, starts, last, fit.errors)
            if carried is None or self.deadline.is_over:
                return None
            simulated, blocks, ends, reached = carried
            gaps = np.zeros_like(starts)
            gaps[last] = reached[last] - starts[last + 1]
            if np.all(np.abs(gaps) <= method.tolerance):
                return system, np.ascontiguousarray(simulated[:, begun].T)
            normal, coupling, own, gradient, own_gradient = blocks
            size = fitted + states
            sums, moves = np.zeros((pieces[-1] + 1, size + 1, size + 1)), np.zeros((len(segments), states, size + 1))
            condense(coupling, own, own_gradient, ends, gaps, pieces, normal, gradient, sums, moves)
            change, its_own = np.empty(fitted), np.empty((len(sums), states))
            parts = (sums[:, :fitted, fitted:-1], sums[:, fitted:-1, fitted:-1])
            coupling, own = map(np.ascontiguousarray, parts)
            own_gradient = np.ascontiguousarray(-sums[:, fitted:-1, -1])
            if not solve_step(normal, coupling, own, gradient, own_gradient, LEAST_DAMPING, change, its_own):
                return None
            system = system.with_values(system.values + change)
            numbers = np.concatenate([np.tile(change, (len(sums), 1)), its_own, np.ones((len(sums), 1))], axis=1)
            starts = starts + (moves * numbers[pieces][:, None]).sum(axis=2)
        return None

    def _carried(
        self, method: _Method, system: System, segments: Ints, starts: FloatArray, last: Ints, errors: ErrorModel
    ) -> tuple[FloatArray, Blocks, FloatArray, FloatArray] | None:
        """Return states (D, N), the blocks of the normal equations, and what `_beyond_ends` has where segments end."""
        is_shared = self._is_shared(system, segments, starts.shape[1])
        outcomes = self._elsewhere(method, system, segments, starts, errors, last) if is_shared else None
        if outcomes is None:
            taken, carried = self._beyond_ends(method, system, segments, starts, last)
        else:
            taken, carried = _taken(outcomes), None
        for steps in taken:
            numbers = _OVERHEAD_NUMBERS + starts.shape[1] * (system.count + starts.shape[1])
            self.count(method.work(steps, self.measurements.rows // 2) * numbers)
        if outcomes is not None:
            ends, reached = (np.concatenate([getattr(one, name) for one in outcomes]) for name in ("ends", "reached"))
            return np.concatenate([one.simulated for one in outcomes], axis=1), _joined(outcomes), ends, reached
        if carried is None:
            return None
        simulated, gradients, ends, reached = carried
        residuals = self._residuals(simulated, starts, segments)
        return simulated, self._blocks(segments, gradients, residuals, errors, system.count), ends, reached

    def _beyond_ends(
        self, method: _Method, system: System, segments: Ints, starts: FloatArray, last: Ints
    ) -> tuple[list[int], tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None]:
        """Return the steps, and states (D, N) with their sensitivities (N, D, P + D) and both where segments end.

        Those that are the `last` before another one are carried on to the first row of that; None where one cannot be.
        """
        owners = np.full(self.measurements.rows, len(segments))
        owners[_rows(segments)] = np.repeat(np.arange(len(segments)), segments[:, 1] - segments[:, 0])
        ends = np.zeros((len(segments), starts.shape[1], system.count + starts.shape[1]))
        reached, parts, steps = np.zeros_like(starts), [], []
        for parity in (0, 1):  # a segment that ends in the first row of the next would be overwritten by that
            chosen = np.arange(parity, len(segments), 2)
            longer, inner = _longer(segments, last)[chosen], np.intersect1d(chosen, last)
            done, taken, along, slopes = self._integrated(method, system, longer, np.ascontiguousarray(starts[chosen]))
            steps.append(taken)
            if done < len(longer) or not self._steepest(slopes[np.isin(owners, chosen)], system) < _STEEPEST:
                return steps, None
            ends[inner], reached[inner] = slopes[segments[inner, 1]], along[:, segments[inner, 1]].T
            parts.append((along, slopes))
        (even, even_slopes), (odd, odd_slopes) = parts
        is_odd = owners % 2 == 1
        even[:, is_odd], even_slopes[is_odd] = odd[:, is_odd], odd_slopes[is_odd]
        return steps, (even, even_slopes, ends, reached)

    def of_trajectory(self, owner: int, fit: TrajectoryFit) -> tuple["MultipleShooting", FloatArray]:
        """Return an estimator over one trajectory (an index of `names`), and the initial states there of a `fit`."""
        measurements = self.measurements
        is_own = measurements.owners_of_rows[fit.segments[:, 0]] == owner
        return MultipleShooting(measurements.part([owner]), self.tolerance, self.deadline), fit.starts[is_own]

    def sensor_errors(self, fit: TrajectoryFit, turns: FloatArray) -> ErrorModel:
        """Return `Innovations.sensor_errors` of a fit of whole trajectories, whose derivatives turn in `turns` rows."""
        fitted = (fit.system.count + fit.starts.size) / len(fit.residuals)
        return self._layout(None).sensor_errors(fit.residuals, np.sqrt(fit.squares), fitted, turns)

    def whitened(self, residuals: FloatArray, errors: ErrorModel) -> FloatArray:
        """Return residuals (O, N) of whole trajectories, what goes together in these errors taken out."""
        return self._layout(None).whitened(residuals, errors)

    def squared_innovations(self, residuals: FloatArray, errors: ErrorModel) -> FloatArray:
        """Return the sums of squared innovations (O,) of residuals (O, N) of whole trajectories, by their likelihood.

        Each innovation has a variance of its own; the sum is the one of as many of one variance that are as likely.
        """
        squares, logarithms = self._layout(None).squares(residuals, errors)
        counts = np.maximum((self.measurements.weights > 0.0).sum(axis=1), 1)
        return np.asarray(squares * np.exp(logarithms / counts))

    def cost(self, fit: TrajectoryFit) -> float:
        """Return the sum of squared residuals of a fit of whole trajectories, over the variances of its errors."""
        return _cost(self._layout(None), fit.residuals, fit.errors)

    def _fitted(  # noqa: PLR0913, see `fit`
        self, system: System, length: int | None, steps: int, starts: FloatArray | None, errors: ErrorModel | None,
        *, is_stiff: bool, goal: Goal | None,
    ) -> TrajectoryFit | None:  # fmt: skip
        """Return what `fit` does, and add what it takes to the work of this thread."""
        measurements = self.measurements
        layout = self._layout(length)
        segments = layout.segments
        first = np.ascontiguousarray(measurements.smoothed[:, segments[:, 0]].T) if starts is None else starts
        system = system.with_values(system.values)  # within their bounds
        if errors is None:
            errors = ErrorModel.independent(
                np.maximum(measurements.noise, 1e-4 * measurements.scales[measurements.observed])
            )
        may_be_stiff = is_stiff or steps > SETTINGS.effort.brief_steps
        here: _Equations | None = None
        for beginning in self._beginnings(first, segments):
            with_offsets = self._with_offsets(beginning, len(system.outputs), in_whole=length is None)
            starts = self._at_rest(with_offsets, segments)
            here, method = self._begun(system, layout, starts, errors, may_be_stiff=may_be_stiff)
            if here is not None:
                break
        if here is None or starts is None:
            return None
        rounding = self._rounding(segments)

        def move(at: _Point, step: _Step) -> tuple[_Point, float] | None:
            moved, moved_starts = at.system.with_values(at.system.values + step[0]), at.starts + step[1]
            there, _ = self._equations(method, moved, layout, moved_starts, at.errors, at.here.cost)
            if there is None:
                return None
            gain = at.here.cost - _cost(layout, there.residuals, at.errors)
            return _Point(moved, moved_starts, there), gain

        def settled(at: _Point) -> float:
            return max(SETTINGS.effort.settled * at.here.cost, float((rounding / at.errors.sigmas**2).sum()))

        def is_over(at: _Point, promise: float, taken: int) -> bool:
            if goal is None or self.deadline.is_over:
                return self.deadline.is_over
            residuals = layout.whitened(at.here.residuals, at.errors) if at.errors.shares.any() else at.here.residuals
            return goal.is_beyond(self.squares(residuals), promise, SETTINGS.effort.steps - taken)

        begun = _Point(system, starts, here)
        return self._fit_at(minimize(begun, _solver, move, settled, steps, is_over), layout, method)

    def _layout(self, length: int | None) -> Innovations:
        """Return the segments of about `length` rows, along which residuals are whitened."""
        known = self._layouts.get(length)
        if known is None:
            made = Innovations(self.measurements.segments(length), self._row_steps, self.measurements.weights)
            known = self._layouts.setdefault(length, made)
        return known

    def _beginnings(self, starts: FloatArray, segments: Ints) -> Iterator[FloatArray]:
        """Yield initial states to begin from until a system can be integrated: `starts` (G, D or more), then others.

        Noise may carry a first value below zero, where many laws blow up, growth among them. So a state that has one
        sign from some row of its piece to the end has that sign in the second beginning, where it is as in that row.
        """
        yield starts
        signed, bounds = starts.copy(), self.measurements.bounds
        pieces = np.searchsorted(bounds[:, 0], segments[:, 0], "right") - 1
        for group, (first, end) in enumerate(zip(segments[:, 0].tolist(), bounds[pieces, 1].tolist(), strict=True)):
            for state, values in enumerate(self.measurements.smoothed[:, first:end]):
                lasting = int(np.flatnonzero(values * values[-1] <= 0.0).max(initial=-1)) + 1
                if lasting < len(values) and starts[group, state] * values[-1] <= 0.0:
                    signed[group, state] = values[lasting]
        if not np.array_equal(signed, starts):
            yield signed

    def _at_rest(self, starts: FloatArray, segments: Ints) -> FloatArray:
        """Return initial states, 0 of the states that rest."""
        measurements = self.measurements
        if measurements.resting is None:
            return starts
        starts = starts.copy()
        for resting, state in zip(measurements.resting, measurements.observed.tolist(), strict=True):
            starts[resting[segments[:, 0]], state] = 0.0
        return starts

    def _with_offsets(self, starts: FloatArray, states: int, *, in_whole: bool) -> FloatArray:
        """Return initial states with offsets, which whole trajectories alone determine; as zero if they have none."""
        count = len(self.measurements.offset) if in_whole else 0
        missing = states + count - starts.shape[1]
        if missing <= 0:
            return np.ascontiguousarray(starts[:, : states + count])
        return np.concatenate([starts, np.zeros((len(starts), missing))], axis=1)

    def squares(self, residuals: FloatArray) -> FloatArray:
        """Return the mean squares (O,) of residuals, those of normal errors whatever the robustness weights."""
        return self._consistent((self.measurements.weights * residuals * residuals).sum(axis=1) / self._totals)

    def _consistent(self, squares: FloatArray) -> FloatArray:
        consistency = self.measurements.consistency
        return np.asarray(squares if consistency is None else squares / consistency)

    def _rounding(self, segments: Ints) -> FloatArray:
        """Return the sum of squares (O,) that rounding leaves, of which the simulated states have some more each row.

        No step is worth less: a solution in closed form leaves nothing else, and its fit would follow that for long.
        """
        since = np.arange(self.measurements.rows) - np.repeat(segments[:, 0], segments[:, 1] - segments[:, 0])
        squares = (np.finfo(np.float64).eps * self._measured) ** 2 * (1 + since)
        return np.asarray((self.measurements.weights * squares).sum(axis=1))

    def _reweighed(self, residuals: FloatArray, layout: Innovations, errors: ErrorModel) -> ErrorModel:
        """Return the errors as these residuals have them: those of states may be of very different size."""
        if errors.is_known:
            return errors
        squares, _ = layout.squares(residuals, errors)
        sigmas = np.maximum(np.sqrt(self._consistent(squares / self._totals)), self._smallest)
        return errors if np.all(np.abs(sigmas / errors.sigmas - 1.0) < 1e-3) else replace(errors, sigmas=sigmas)

    def _begun(
        self, system: System, layout: Innovations, starts: FloatArray, errors: ErrorModel,
        *, may_be_stiff: bool,
    ) -> tuple[_Equations | None, _Method]:  # fmt: skip
        """Return the equations where a fit begins, see `_equations`, and the method to go on with.

        That is the one for stiff systems if the other took too many steps.
        """
        explicit, implicit = self._methods
        equations, is_stiff = self._equations(explicit, system, layout, starts, errors)
        if not is_stiff or not may_be_stiff:
            return equations, explicit
        return self._equations(implicit, system, layout, starts, errors)[0], implicit

    def _equations(
        self, method: _Method, system: System, layout: Innovations, starts: FloatArray,
        errors: ErrorModel, below: float = math.inf,
    ) -> tuple[_Equations | None, bool]:  # fmt: skip
        """Return the equations at a point, and whether the method took too many steps.

        None where it cannot be integrated or the cost is not below `below`. After a step, errors are those that
        residuals have there.
        """
        segments, states, fitted, local = layout.segments, len(system.outputs), system.count, starts.shape[1]
        numbers, equations, weighed = _OVERHEAD_NUMBERS + states * (1 + fitted + local), None, errors
        is_step, is_shared = below < math.inf, self._is_shared(system, segments, local)
        is_tried = is_step and (is_shared or _OVERHEAD_NUMBERS + states < _REJECTED * numbers)
        for is_trial in (True, False) if is_tried else (False,):
            course = self._course(method, system, segments, starts, None if is_trial else weighed, is_shared=is_shared)
            if course.done < len(segments) or not course.steepest < _STEEPEST:
                break
            residuals = self._residuals(course.simulated, starts, segments)
            if not _cost(layout, residuals, errors) < below:
                break
            weighed = self._reweighed(residuals, layout, errors) if is_step else errors
        else:
            cost, blocks = _cost(layout, residuals, weighed), course.blocks
            if course.gradients is not None:
                blocks = self._blocks(segments, course.gradients, residuals, weighed, fitted)
            assert blocks is not None, "there are sensitivities here or blocks from elsewhere"
            equations = _Equations(cost, weighed, course.simulated, residuals, *blocks)
        self._own.work += method.work(course.taken, self.measurements.rows) * numbers
        return equations, course.done < 0

    def _course(
        self, method: _Method, system: System, segments: Ints, starts: FloatArray, errors: ErrorModel | None,
        *, is_shared: bool,
    ) -> _Course:  # fmt: skip
        """Return what comes of integrating segments, with sensitivities if `errors` are given.

        Where it `is_shared`, they are weighed by these.
        """
        outcomes = self._elsewhere(method, system, segments, starts, errors) if is_shared else None
        if outcomes is not None:
            simulated = np.concatenate([one.simulated for one in outcomes], axis=1)
            steepest, (taken,) = float(np.max([one.steepest for one in outcomes])), _taken(outcomes)
            has = errors is not None and steepest < _STEEPEST
            return _Course(len(segments), taken, simulated, steepest, blocks=_joined(outcomes) if has else None)
        has = errors is not None
        done, taken, simulated, gradients = self._integrated(method, system, segments, starts, has_sensitivities=has)
        self._steps_of_row = taken / self.measurements.rows
        return _Course(done, taken, simulated, self._steepest(gradients, system), gradients if has else None)

    # ------------------------------------------------------------------------------------------ segments elsewhere

    @property
    def encoded(self) -> bytes:
        """The bytes of what this estimator is made of."""
        if self._encoded is None:
            self._encoded = encode_value(EstimatorParts(self.measurements, self.tolerance, self.measured_rows))
        return self._encoded

    @classmethod
    def of_parts(cls, parts: EstimatorParts) -> "MultipleShooting":
        """Return the estimator that is made of these."""
        return cls(parts.measurements, parts.tolerance, measured_rows=parts.measured_rows)

    def _expected_work(self, system: System, local: int, *, has_sensitivities: bool = True) -> float:
        """Return nodes and numbers of all steps if these are as many as they were before."""
        carried = system.count + local if has_sensitivities else 0
        return self._steps_of_row * self.measurements.rows * (len(system.code) + len(system.outputs) * (1 + carried))

    def _is_shared(self, system: System, segments: Ints, local: int) -> bool:
        """Tell whether segments are integrated by others, too: it is more work than that of a batch."""
        is_one = system.sharing is None or system.sharing.groups == 1
        is_many = is_one and len(segments) > 1 and self._expected_work(system, local) > SETTINGS.spread.batch
        return is_many and self._spread.is_shared

    def _elsewhere(
        self, method: _Method, system: System, segments: Ints, starts: FloatArray, errors: ErrorModel | None,
        last: Ints = _NONE,
    ) -> list[SegmentOutcome] | None:  # fmt: skip
        """Return what comes of segments, batch by batch, integrated by whoever takes them.

        None where they are to be integrated here: where one cannot be integrated or all together take more steps than
        are allowed, which is found out in their order.
        """
        work = self._expected_work(system, starts.shape[1], has_sensitivities=errors is not None) / len(segments)
        size = self._spread.batch_size(len(segments), int(SETTINGS.spread.batch / work))
        size = max(size, math.ceil(SETTINGS.spread.least / work))
        size += size % 2  # see `_beyond_ends`: which segments are odd is the same everywhere
        task = encode_value(SegmentTask(replace(system, equations=()), errors, method is self._methods[1]))
        batches = []
        for first in range(0, len(segments), size):
            group, here = slice(first, first + size), (last >= first) & (last < first + size)
            batches.append(SegmentBatch(task, segments[group], starts[group], last[here] - first))
        made = self._spread.share(SEGMENTS, self.encoded, batches, 1)
        outcomes = [one for one in made if one is not None]
        if len(outcomes) < len(batches):
            return None
        longer = _longer(segments, last)
        allowed = [self._budget(method, part) for part in ((longer[::2], longer[1::2]) if len(last) else (longer,))]
        taken = _taken(outcomes)
        return None if any(steps > most for steps, most in zip(taken, allowed, strict=True)) else outcomes

    def outcome(self, batch: SegmentBatch) -> SegmentOutcome | None:
        """Return what comes of the segments of a batch, as it travels; None if one of them cannot be integrated."""
        task, segments, starts = decode_value(batch.task, SegmentTask), batch.segments, batch.starts
        system, errors, method, has = task.system, task.errors, self._methods[task.is_stiff], task.errors is not None
        rows, reached, ends = _rows(segments), np.zeros((0, 0)), np.zeros((0, 0, 0))
        if len(batch.last):
            taken, carried = self._beyond_ends(method, system, segments, starts, batch.last)
            if carried is None:
                return None
            simulated, gradients, ends, reached = carried
        else:
            done, steps, simulated, gradients = self._integrated(
                method, system, segments, starts, has_sensitivities=has
            )
            taken = [steps]
            if done < len(segments):
                return None
        steepest, blocks = self._steepest(gradients[rows] if has else gradients, system), None
        if errors is not None and steepest < _STEEPEST:
            residuals = self._residuals(simulated, starts, segments)
            alone = [self._blocks(one[None], gradients, residuals, errors, system.count) for one in segments]
            normal, coupling, own, gradient, own_gradient = map(np.stack, zip(*alone, strict=True))
            blocks = normal, coupling, own, gradient, own_gradient
        return SegmentOutcome(tuple(taken), simulated[:, rows], steepest, blocks, reached, ends)

    # ------------------------------------------------------------------------------------------- along the rows

    def _steepest(self, gradients: FloatArray, system: System) -> float:
        """Return the largest of sensitivities (N, D, P + L), of states in their scales to constants in their sizes."""
        scales, sizes = self.measurements.scales, np.abs(system.values)
        offsets = gradients.shape[2] - len(sizes) - len(scales)
        units = np.concatenate([np.where(sizes > 0.0, sizes, 1.0), scales, np.ones(offsets)])
        steepest = np.maximum(gradients.max(axis=0, initial=0.0), -gradients.min(axis=0, initial=0.0))
        return float(np.max(steepest / scales[:, None] * units, initial=0.0))

    def _residuals(self, simulated: FloatArray, starts: FloatArray, segments: Ints) -> FloatArray:
        """Return what simulated states, and the offsets behind initial states, leave of what was measured (O, N)."""
        measurements, states = self.measurements, len(simulated)
        residuals = np.asarray(self._measured - simulated[measurements.observed])
        for place, state in enumerate(measurements.offset.tolist() if starts.shape[1] > states else []):
            offsets = np.repeat(starts[:, states + place], segments[:, 1] - segments[:, 0])
            residuals[state, _rows(segments)] -= offsets
        return residuals

    def simulate(self, system: System, start: FloatArray) -> FloatArray | Unsimulated:
        """Return the states (D, N) of whole trajectories from one initial state (D,), or why there are none.

        A system that the method for others takes too many steps for is integrated as a stiff one.
        """
        simulated, why = self.simulate_as_far(system, start)
        return simulated if why is None else why

    def simulate_as_far(self, system: System, start: FloatArray) -> tuple[FloatArray, Unsimulated | None]:
        """Return what `simulate` does, with NaN from where it ended early, and why it did; None where it did not."""
        segments = self._layout(None).segments
        starts = np.repeat(start[None], len(segments), axis=0)
        for method in self._methods:
            done, _, simulated, _ = self._integrated(method, system, segments, starts, has_sensitivities=False)
            if done >= 0:
                break
        if done < 0:
            return simulated, "out of steps"
        return simulated, None if done == len(segments) and np.isfinite(simulated).all() else "ran away"

    def sensitivities(self, fit: TrajectoryFit) -> FloatArray:
        """Return `TrajectoryFit.integrated_sensitivities` of a fit of this estimator's."""
        method = self._methods[1 if fit.is_stiff else 0]
        return self._integrated(method, fit.system, fit.segments, fit.starts)[3]

    def _integrated(
        self, method: _Method, system: System, segments: Ints, starts: FloatArray, *, has_sensitivities: bool = True
    ) -> tuple[int, int, FloatArray, FloatArray]:
        """Return what `integrate_segments` does, the steps, the states (D, N) and their sensitivities (N, D, P + L).

        Of these there are no rows unless it `has_sensitivities`.
        """
        measurements = self.measurements
        states, fitted, local = len(system.outputs), system.count, starts.shape[1]
        simulated = np.full((states, measurements.rows), np.nan)
        gradients = np.zeros((measurements.rows if has_sensitivities else 0, states, fitted + local))
        if system.sharing is None:
            done, taken = self._integrate(method, system, segments, starts, simulated, gradients)
        else:
            done, taken = self._integrate_shared(method, system, segments, starts, simulated, gradients)
        if not has_sensitivities:
            return done, taken, simulated, gradients
        for place, state in enumerate(measurements.offset.tolist() if local > states else []):
            gradients[:, measurements.observed[state], fitted + states + place] = 1.0
        for resting, state in zip(
            measurements.resting if measurements.resting is not None else (),
            measurements.observed.tolist(),
            strict=False,
        ):
            gradients[resting, :, fitted + state] = 0.0
        return done, taken, simulated, gradients

    def _integrate(
        self, method: _Method, system: System, segments: Ints, starts: FloatArray, simulated: FloatArray,
        gradients: FloatArray,
    ) -> tuple[int, int]:  # fmt: skip
        """Write states and sensitivities of these segments; return what `integrate_segments` does, and the steps."""
        measurements, taken = self.measurements, np.zeros(1, dtype=np.int64)
        done = integrate_segments(
            method.table, system.tape, system.owners,
            (measurements.times, measurements.inputs, measurements.input_slopes), segments, starts,
            method.tolerance, measurements.limits, self._budget(method, segments), len(gradients) > 0, simulated,
            gradients, taken,
        )  # fmt: skip
        return done, int(taken[0])

    def _budget(self, method: _Method, segments: Ints) -> int:
        """Return how many steps segments may take together."""
        return 200 + int(method.steps * (self._rows_in_row * int((segments[:, 1] - segments[:, 0]).sum())))

    def _integrate_shared(
        self, method: _Method, system: System, segments: Ints, starts: FloatArray, simulated: FloatArray,
        gradients: FloatArray,
    ) -> tuple[int, int]:  # fmt: skip
        """Do as `_integrate`, each segment with the constants of its group, which are multiples of fitted numbers."""
        assert system.sharing is not None
        states, places = len(system.outputs), len(system.places)
        narrow = np.zeros((len(gradients), states, places + states))
        groups, all_done, all_taken = self.measurements.groups_of(segments), 0, 0
        for group, columns in enumerate(system.sharing.columns):
            chosen = groups == group
            own = np.ascontiguousarray(segments[chosen])
            done, taken = self._integrate(
                method, system.of_group(group), own, np.ascontiguousarray(starts[chosen]), simulated, narrow
            )
            all_taken += taken
            if done < len(own):
                return done, all_taken
            all_done += done
            if not len(gradients) or not len(own):
                continue
            rows = np.concatenate([np.arange(first, end) for first, end in own.tolist()])
            for place, (column, multiple) in enumerate(zip(columns, system.sharing.multiples, strict=True)):
                gradients[rows, :, column] += multiple * narrow[rows, :, place]
        gradients[:, :, system.count : system.count + states] = narrow[:, :, places:]
        return all_done, all_taken

    def _blocks(
        self, segments: Ints, gradients: FloatArray, residuals: FloatArray, errors: ErrorModel, fitted: int
    ) -> Blocks:
        """Return the blocks of the normal equations of segments, weighed by these errors."""
        local, groups, columns = gradients.shape[2] - fitted, len(segments), gradients.shape[2] + 1
        weights = self.measurements.weights / (errors.sigmas * errors.sigmas)[:, None]
        blocks = (
            np.zeros((fitted, fitted)), np.zeros((groups, fitted, local)), np.zeros((groups, local, local)),
            np.zeros(fitted), np.zeros((groups, local)),
        )  # fmt: skip
        normal_equations(
            segments, self.measurements.observed, self._row_steps, residuals, weights, errors.shares, errors.decays,
            gradients, fitted, *blocks, np.empty((LINES, columns)), np.empty(columns), np.empty((columns, columns)),
        )  # fmt: skip
        return blocks


def _taken(outcomes: Sequence[SegmentOutcome]) -> list[int]:
    """Return the steps of all batches, of each of the integrations that one takes."""
    return [sum(steps) for steps in zip(*(one.taken for one in outcomes), strict=True)]


def _joined(outcomes: Sequence[SegmentOutcome]) -> Blocks:
    """Return the blocks of all segments: what belongs to the constants is added up in their order."""
    travelled = [one.blocks for one in outcomes if one.blocks is not None]
    normals, coupling, own, gradients, own_gradient = map(np.concatenate, zip(*travelled, strict=True))
    normal, gradient = (sum(parts, np.zeros(parts.shape[1:])) for parts in (normals, gradients))
    return normal, coupling[:, 0], own[:, 0], gradient, own_gradient[:, 0]


def _rows(segments: Ints) -> slice:
    """Return the rows of neighbouring segments."""
    return slice(int(segments[0, 0]), int(segments[-1, 1]))


def _longer(segments: Ints, last: Ints) -> Ints:
    """Return segments of which those that are `last` go on for a row."""
    longer = segments.copy()
    longer[last, 1] += 1
    return longer


def _cost(layout: Innovations, residuals: FloatArray, errors: ErrorModel) -> float:
    """Return the weighted sum of squares, errors that go together made independent."""
    squares, _ = layout.squares(residuals, errors)
    return float((squares / (errors.sigmas * errors.sigmas)).sum())


def row_steps(measurements: Measurements) -> FloatArray:
    """Return the step (N,) to each row from the one before over the median of all; 1 where rows are even."""
    steps = np.diff(measurements.times, prepend=measurements.times[0]) / measurements.step
    steps[measurements.bounds[:, 0]] = 1.0
    steps[np.abs(steps - 1.0) < 1e-6] = 1.0
    return steps


def _solver(at: _Point) -> Solver[_Step]:
    """Return what solves for steps of the constants (P,), which keep to their bounds, and of initial states (G, D)."""
    here, held = at.here, at.system.held(at.here.gradient)
    normal, gradient, coupling = here.normal, here.gradient, here.coupling
    if held is not None and held.any():
        normal, gradient = without(normal, gradient, held)
        coupling = coupling.copy()
        coupling[:, held, :] = 0.0

    def solve(damping: float) -> tuple[_Step, float] | None:
        change, moves = np.empty_like(gradient), np.empty_like(here.own_gradient)
        if not solve_step(normal, coupling, here.own, gradient, here.own_gradient, damping, change, moves):
            return None
        # twice as much as steps without damping would lower it, and the most that damped ones do
        return (change, moves), 2.0 * float((gradient * change).sum() + (here.own_gradient * moves).sum())

    return solve


def fit_in_stages(
    estimator: MultipleShooting, system: System, lengths: Sequence[int | None], steps: int
) -> TrajectoryFit | None:
    """Return `system` fitted to segments of growing `lengths`, each fit begun where the one before ended."""
    fit: TrajectoryFit | None = None
    before: int | None = None
    for length in _gradual(lengths, estimator.measurements):
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


def _gradual(lengths: Sequence[int | None], measurements: Measurements) -> Iterator[int | None]:
    """Yield `lengths`, and between any two those that it takes for none to be too many times as long as the one before.

    Errors may grow so much along a trajectory that a fit of short segments is no beginning for one of long ones.
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


SEGMENTS: Final[BatchFunction[MultipleShooting, SegmentBatch, SegmentOutcome | None]] = BatchFunction(
    "segments", EstimatorParts, SegmentBatch, SegmentOutcome | None, MultipleShooting.outcome, MultipleShooting.of_parts
)
"""Segments of a fit, integrated."""
