"""Integration of systems along the rows of measurements, with sensitivities.

Each segment of rows is integrated from its own initial state, together with the derivatives of the states by constants
and initial states (variational equations). There are two methods: an explicit Runge-Kutta method (with a quick and a
precise table of coefficients), and an implicit method for stiff systems. A caller tries the implicit method if the
explicit method has used all its allowed steps. Segments do not depend on each other, so a long integration is divided
into groups of segments; threads of a `Spread` integrate them at the same time, and kernels release the interpreter's
lock. Doubt: the limits on the number of steps were tuned on one machine; they can reject a correct system that is very
stiff. If measured columns are computed from states (`OdeSystem.observations`), their values and sensitivities follow
the states as further rows. Letters: D states, M columns computed from states, P fitted numbers, L numbers of one
segment (D initial states, then offsets), G segments, N rows, O measured columns.
"""

import itertools
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from atoll_coordinator.model.batches import Spread
from atoll_coordinator.model.shooting.kernels.implicit import STIFF
from atoll_coordinator.model.shooting.kernels.integrate import PRECISE, QUICK, integrate_segments, largest_sizes
from atoll_coordinator.model.shooting.kernels.rates import Table
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_coordinator.model.shooting.system import OdeSystem
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_and_gradient
from atoll_core.expression.kernels.tape import Ints
from atoll_core.expression.operators import VARIABLE

STEPS_PER_ROW: Final = 40
"""Most integration steps for each row, on average. A system that needs more steps is stiff or blows up."""
OVERHEAD_NUMBERS: Final = 20
"""Fixed work for an evaluation of the rates, in addition to the work for the states and sensitivities. The unit is the
work for one integrated number. Measured: `benchmarks.operations.counted_work`."""
STEEPEST: Final = 1e60
"""Guard: systems with larger sensitivities (of a scaled state to a scaled constant) are rejected, since squares of such
sensitivities overflow."""
_EVALUATIONS: Final = (3, 6, 14)
"""Evaluations of the rates in a step: quick, precise and implicit method. An implicit step counts with its Newton
iterations and its linear systems (measured: `benchmarks.operations.counted_work`)."""
_QUICK_STEPS: Final = 8
"""Steps for each row above which the implicit method takes less time than the quick method."""
_FINEST_IMPLICIT: Final = 1e-6
"""Least tolerated error of an implicit step, divided by the standard deviation of the state. For a smaller error, a
method of low order needs too many steps."""

_NUMBERS_OF_A_PART: Final = 10_000
"""Fewest numbers (rows times integrated numbers) of a part of a divided integration. Another thread begins its part
after about 0.1 ms; in this time about 1,000 numbers are integrated. So waiting for a thread takes at most a tenth of a
part."""
_PARTS_OF_A_THREAD: Final = 2
"""Parts for each thread: some parts need more steps for each row than others."""

Unsimulated = Literal["ran away", "out of steps"]
"""The reason why a simulation ended early: states left their range, or all allowed steps were used."""


@dataclass(frozen=True, eq=False)
class Method:
    """An integration method: its table of coefficients, the most steps for each row, the evaluations of the rates in a
    step, and the tolerated error (D,) of a step."""

    table: Table
    steps: int
    evaluations: int
    tolerance: FloatArray

    def work(self, steps: int, rows: int, numbers: int) -> int:
        """Return the work of `steps` steps along `rows` rows, at least one step for each row, in which `numbers` states
        and sensitivities are integrated. The unit is the work for one number in one evaluation of the rates: about 6 ns
        (`benchmarks.operations.counted_work`)."""
        return max(rows, steps) * self.evaluations * (OVERHEAD_NUMBERS + numbers)


@dataclass(frozen=True, eq=False)
class Integration:
    """States and computed columns (D + M, N) along segments, and their sensitivities (N, D + M, P + L), which have the
    shape (0, D + M, P + L) if they were not requested.

    `done` is the number of finished segments; it is negative if all allowed steps were used. `steps` is the number of
    steps.
    """

    done: int
    steps: int
    states: FloatArray
    sensitivities: FloatArray


class Integrator:
    """Integrates systems along the segments of `measurements`."""

    def __init__(
        self,
        measurements: TrajectoryMeasurements,
        tolerance: float,
        measured_rows: int = 0,
        spread: Spread | None = None,
    ) -> None:
        """`tolerance` is the error of a step, divided by the standard deviation of the state.

        Threads of `spread` integrate parts of the segments; None: this thread integrates all segments.

        The number of allowed steps is proportional to the number of rows. The rows may represent a larger number of
        measured rows of the same time span. Then the number of allowed steps is proportional to this larger number,
        `measured_rows`.
        """
        self.measurements: Final = measurements
        self.tolerance: Final = tolerance
        self.measured_rows: Final = measured_rows
        self.spread: Final = spread or Spread()
        self._rows_in_row: Final = max(1.0, measured_rows / measurements.rows)
        quick, precise, implicit = _EVALUATIONS
        most, scales = STEPS_PER_ROW, measurements.scales
        is_quick = tolerance >= SETTINGS.common.clean
        explicit = (QUICK, _QUICK_STEPS, quick) if is_quick else (PRECISE, most, precise)
        self.methods: Final = (
            Method(*explicit, tolerance * scales),
            Method(STIFF, most, implicit, max(tolerance, _FINEST_IMPLICIT) * scales),
        )

    def integrate(
        self, method: Method, system: OdeSystem, segments: Ints, starts: FloatArray, *, has_sensitivities: bool = True
    ) -> Integration:
        """Integrate `segments` (G, 2) from their `starts` (G, L)."""
        measurements = self.measurements
        states, fitted, local = len(system.outputs), system.count, starts.shape[1]
        lines = states + len(system.observations)
        simulated = np.full((lines, measurements.rows), np.nan)
        sensitivities = np.zeros((measurements.rows if has_sensitivities else 0, lines, fitted + local))
        is_plain = system.sharing is None and system.integrated == len(system.places)
        integrate = self._integrate if is_plain else self._integrate_groups
        done, steps = integrate(method, system, segments, starts, simulated, sensitivities)
        if has_sensitivities:
            self._hold_initial_states(segments, sensitivities, fitted, states)
        if lines > states:
            self._observe(system, simulated, sensitivities)
        if has_sensitivities:
            for place, state in enumerate(measurements.offset.tolist() if local > states else []):
                sensitivities[:, measurements.observed[state], fitted + states + place] = 1.0
        return Integration(done, steps, simulated, sensitivities)

    def _hold_initial_states(self, segments: Ints, sensitivities: FloatArray, fitted: int, states: int) -> None:
        """Set the sensitivities to initial values that are not fitted to 0: given values, and the value 0 of resting
        states."""
        measurements = self.measurements
        if measurements.resting is not None:
            for resting, state in zip(measurements.resting, measurements.observed.tolist(), strict=True):
                if state < states:
                    sensitivities[resting, :, fitted + state] = 0.0
        ranges = measurements.start_ranges(segments)
        if ranges is not None:
            is_given = ranges[0] == ranges[1]
            for group in np.flatnonzero(is_given.any(axis=1)).tolist():
                rows = slice(*segments[group].tolist())
                sensitivities[rows, :, fitted + np.flatnonzero(is_given[group])] = 0.0

    def _observe(self, system: OdeSystem, simulated: FloatArray, sensitivities: FloatArray) -> None:
        """Write the columns that are computed from states, and their sensitivities, after the rows of the states."""
        states, groups = len(system.outputs), self.measurements.groups
        for group, columns in enumerate(system.columns):
            rows = np.arange(self.measurements.rows)
            if groups is not None and system.sharing is not None:
                rows = np.flatnonzero(groups[self.measurements.owners_of_rows] == group)
            own, points = system.of_group(group), np.concatenate([simulated[:states], self.measurements.inputs])
            for line, program in enumerate(own.observation_programs, start=states):
                first, owner = own.firsts[line], own.owners == line
                fitted = dict(zip((own.places[owner] - first).tolist(), np.flatnonzero(owner).tolist(), strict=True))
                is_state = (program.operators == VARIABLE) & (program.left < states)
                leaves = [*np.flatnonzero(is_state).tolist(), *fitted]
                simulated[line, rows], slopes = values_and_gradient(program, points[:, rows], leaves)
                if not len(sensitivities):
                    continue
                for leaf, slope in zip(leaves, slopes, strict=True):
                    if leaf in fitted:
                        place = fitted[leaf]
                        sensitivities[rows, line, columns[place]] += slope * system.multiples[place]
                    else:
                        sensitivities[rows, line] += slope[:, None] * sensitivities[rows, program.left[leaf]]

    def _integrate(
        self, method: Method, system: OdeSystem, segments: Ints, starts: FloatArray, simulated: FloatArray,
        sensitivities: FloatArray,
    ) -> tuple[int, int]:  # fmt: skip
        """Write states and sensitivities in place; return the result of `integrate_segments` and the number of steps.

        Threads integrate parts of the segments. The allowed number of steps belongs to all segments together. So if a
        part fails, or if the parts take more steps together, all segments are integrated once more, one after another.
        """
        parts = self._parts(segments, len(system.outputs) * (1 + (sensitivities.shape[2] if len(sensitivities) else 0)))
        if len(parts) > 1:
            failed: list[bool] = []

            def integrate(part: slice) -> int:
                if failed:
                    return 0
                done, steps = self._integrate_part(
                    method, system, segments[part], starts[part], simulated, sensitivities
                )
                if done < len(segments[part]):
                    failed.append(True)
                return steps

            steps = sum(self.spread.divide(integrate, parts))
            if not failed and steps <= self._budget(method, segments):
                return len(segments), steps
            for first, end in segments.tolist():
                simulated[:, first:end], sensitivities[first:end] = np.nan, 0.0
        return self._integrate_part(method, system, segments, starts, simulated, sensitivities)

    def _parts(self, segments: Ints, numbers: int) -> list[slice]:
        """Return parts of the segments with about the same number of rows; `numbers` are integrated along each row."""
        if self.spread.threads < 2 or len(segments) < 2:
            return []
        rows = np.cumsum(segments[:, 1] - segments[:, 0])
        most = int(rows[-1]) * (OVERHEAD_NUMBERS + numbers) // _NUMBERS_OF_A_PART
        count = min(_PARTS_OF_A_THREAD * self.spread.threads, most, len(segments))
        ends = np.unique(np.searchsorted(rows, rows[-1] * np.arange(1, count) / count) + 1)
        bounds = [0, *ends[ends < len(segments)].tolist(), len(segments)]
        return [slice(*bound) for bound in itertools.pairwise(bounds)]

    def _budget(self, method: Method, segments: Ints) -> int:
        """Return the most steps of all segments together."""
        rows = int((segments[:, 1] - segments[:, 0]).sum())
        return 200 + int(method.steps * (self._rows_in_row * rows))

    def _integrate_part(
        self, method: Method, system: OdeSystem, segments: Ints, starts: FloatArray, simulated: FloatArray,
        sensitivities: FloatArray,
    ) -> tuple[int, int]:  # fmt: skip
        measurements, taken = self.measurements, np.zeros(1, dtype=np.int64)
        done = integrate_segments(
            method.table, system.tape, system.owners[: system.integrated],
            (measurements.times, measurements.inputs, measurements.input_slopes), segments, starts,
            method.tolerance, measurements.limits, self._budget(method, segments), len(sensitivities) > 0, simulated,
            sensitivities, taken,
        )  # fmt: skip
        return done, int(taken[0])

    def _integrate_groups(
        self, method: Method, system: OdeSystem, segments: Ints, starts: FloatArray, simulated: FloatArray,
        sensitivities: FloatArray,
    ) -> tuple[int, int]:  # fmt: skip
        """Integrate each segment with the constants of its group; see `_integrate`. The constants are multiples of
        fitted numbers. Without groups, there is one group."""
        states, places = len(system.outputs), system.integrated
        own_sensitivities = np.zeros((len(sensitivities), states, places + states))
        groups, all_done, all_steps = self.measurements.groups_of(segments), 0, 0
        for group, columns in enumerate(system.columns[:, :places]):
            chosen = groups == group
            own = np.ascontiguousarray(segments[chosen])
            done, steps = self._integrate(
                method, system.of_group(group), own, np.ascontiguousarray(starts[chosen]), simulated, own_sensitivities
            )
            all_steps += steps
            if done < len(own):
                return done, all_steps
            all_done += done
            if not len(sensitivities) or not len(own):
                continue
            rows = np.concatenate([np.arange(first, end) for first, end in own.tolist()])
            for place, (column, multiple) in enumerate(zip(columns, system.multiples[:places], strict=True)):
                sensitivities[rows, :states, column] += multiple * own_sensitivities[rows, :, place]
        sensitivities[:, :states, system.count : system.count + states] = own_sensitivities[:, :, places:]
        return all_done, all_steps

    def columns(self, system: OdeSystem, simulated: FloatArray) -> FloatArray:
        """Return the values (O, N) of the measured columns at simulated states (D, N)."""
        measurements, lines = self.measurements, np.full((len(system.observations), simulated.shape[1]), np.nan)
        rows = np.concatenate([simulated, lines])
        self._observe(system, rows, np.zeros((0, len(rows), 0)))
        return rows[measurements.observed]

    def steepest(self, sensitivities: FloatArray, system: OdeSystem) -> float:
        """Return the largest absolute value of `sensitivities` (N, D, P + L), in units of the scale of the state and
        the size of the constant."""
        scales, sizes = self.measurements.scales, np.abs(system.values)
        offsets = sensitivities.shape[2] - len(sizes) - len(scales)
        units = np.concatenate([np.where(sizes > 0.0, sizes, 1.0), scales, np.ones(offsets)])
        steepest = np.empty(sensitivities.shape[1:])
        largest_sizes(sensitivities, steepest)
        return float(np.max(steepest[: len(scales)] / scales[:, None] * units, initial=0.0))

    def simulate(self, system: OdeSystem, segments: Ints, start: FloatArray) -> tuple[FloatArray, Unsimulated | None]:
        """Return the states (D, N) of segments that all begin at `start` (D,), and the reason if the integration ended
        early.

        After an early end, states are NaN. Without an early end, the reason is None. If the explicit method takes too
        many steps, the implicit method is used.
        """
        starts = np.repeat(start[None], len(segments), axis=0)
        for method in self.methods:
            course = self.integrate(method, system, segments, starts, has_sensitivities=False)
            if course.done >= 0:
                states = course.states[: len(start)]
                is_whole = course.done == len(segments) and np.isfinite(states).all()
                return states, None if is_whole else "ran away"
        return course.states[: len(start)], "out of steps"
