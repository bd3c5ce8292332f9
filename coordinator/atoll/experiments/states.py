"""The states of a law along trajectories: its constants are known, and only initial states are fitted.

The constants and their covariance come from a fit to the measurements of the result. The trajectories may be others,
such as newer rows. To first order, a state depends on the constants twice: through the equations, and through its
initial state, which is fitted for given constants. With J and Y, the sensitivities of the state to constants and
initial state, and with the blocks B and C of the normal equations, a change d of the constants moves the state by
K d, K = J - Y C^-1 B'. The state has the covariance K S K' + Y C^-1 Y', where S is the covariance of the constants.
This is the smoother of a linear system without process noise.

Doubtful: new rows do not change the constants. Pieces of a trajectory are independent: a piece does not know the end
of the previous piece. Letters: O measured states, D states, P constants, K offsets, N rows, G pieces.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from atoll.experiments.fits import EquationSetFit, FitData, fit_displayed, measured_of, most_residuals
from atoll_coordinator.model.inference.trajectory_simulation import simulated_standard_errors
from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit
from atoll_coordinator.model.shooting.many_starts import fit_from_many_starts
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements, measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting, fit_in_stages
from atoll_coordinator.result.result import Result
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table

_LEVEL: Final = 0.01
"""Significance level at which one simulation is given up for several shorter ones."""
_SHORTEST: Final = 3
"""Rows of the shortest pieces of a fit. From the measured first state, a law may blow up within a few rows."""


@dataclass(frozen=True, eq=False)
class KnownLaw:
    """A fitted law, and the trajectories along which its states are estimated.

    `fitted` has the constants with their covariance. `target` has the trajectories, and `measurements` all their rows,
    of held-out trajectories too, each trajectory as one piece. `noise` (O,) are the standard deviations of the
    measurement errors.
    """

    fitted: EquationSetFit
    target: FitData
    measurements: TrajectoryMeasurements
    noise: FloatArray

    @classmethod
    def of(cls, result: Result, table: Table | None) -> "KnownLaw":
        """Return the law of a result along its trajectories, or along the trajectories of `table`.

        The constants are fitted to the measurements of the result, if it has them.

        Raises:
            UsageError: the result has no law of trajectories, or there are no measurements.
            DataError: the data have an error.
            AtollError: the law cannot be simulated.
        """
        target = measured_of(result, table)
        fitted = fit_displayed(measured_of(result) if result.recorded else target, result)
        parts = tuple(replace(part, held_out=False) for part in target.recording.trajectories)
        longest = max(len(part.times) for part in parts)
        recording = replace(target.recording, trajectories=parts)
        whole = measurements_of(recording, target.modelled, piece=longest, observed=target.observed)
        measurements = replace(whole, known_limits=whole.limits)  # a few rows have a range as small as their noise
        law = cls(fitted, target, measurements, fitted.errors.sigmas * np.sqrt(fitted.measured.share))
        found = law.fit_states(measurements) if measurements.hidden else None
        return law if found is None else replace(law, measurements=measurements.with_course(found.fit.simulated))

    @property
    def states(self) -> tuple[str, ...]:
        """The names of the D states; velocities follow the positions."""
        return self.measurements.variables[: len(self.measurements.scales)]

    @property
    def shown(self) -> tuple[str, ...]:
        """The names of the states, and then of the measured columns that are computed from states."""
        return (*self.states, *self.target.recording.observed)

    def shown_columns(self, measurements: TrajectoryMeasurements) -> list[str]:
        """Return the names of the O measured columns."""
        return [self.shown[place] for place in measurements.observed.tolist()]

    def times_of(self, measurements: TrajectoryMeasurements) -> FloatArray:
        """Return the times (N,) of rows, as in the data: fits use centred times."""
        return rounded_times(measurements.times + self.target.recording.offset)

    def trajectories(self) -> Iterator[tuple[str, TrajectoryMeasurements]]:
        """Yield each trajectory with its name."""
        for owner in np.unique(self.measurements.owners).tolist():
            yield self.measurements.names[owner], self.measurements.part([owner])

    def fit_states(self, measurements: TrajectoryMeasurements, starts: FloatArray | None = None) -> "StateFit | None":
        """Return the law along trajectories with fitted initial states; None if it cannot be simulated.

        `starts` (G, D or more) are the initial states at which the fit begins; None: the smoothed states, or many
        starts if there are hidden states.
        """
        fitted, steps = self.fitted, SETTINGS.effort.steps
        order = fitted.measured.recording.order
        system = fitted.equations.system(measurements, order).with_values(fitted.values)
        fixed, errors = system.with_fixed_constants(), ErrorModel.independent(self.noise / np.sqrt(self.target.share))
        errors = replace(errors, is_known=True)
        estimator = MultipleShooting(measurements, fitted.fit.estimator.tolerance)
        if measurements.hidden and starts is None:
            found = fit_from_many_starts(estimator, fixed, errors=errors)
            starts = None if found is None else found.fit.starts
        best = estimator.fit(fixed, None, steps, starts, errors, is_stiff=fitted.fit.is_stiff)
        if not measurements.hidden and (best is None or not _is_like_noise(best, measurements)):
            staged = fit_in_stages(estimator, fixed, (_SHORTEST, *SETTINGS.shooting.lengths[:2], None), steps)
            if staged is not None:
                staged = estimator.fit(fixed, None, steps, staged.starts, errors, is_stiff=staged.is_stiff)
            fits = [fit for fit in (best, staged) if fit is not None]
            best = min(fits, key=estimator.cost, default=None)
        if best is None:
            return None
        fit = estimator.complete(system, None, best.starts, errors, is_stiff=best.is_stiff)
        return StateFit(measurements, fit, _is_like_noise(fit, measurements))

    def fit_in_pieces(self, trajectory: TrajectoryMeasurements) -> "StateFit | None":
        """Return the law along one trajectory, from as few initial states as describe it as well as more would.

        With hidden states, it is one initial state. None: the law cannot be simulated.
        """
        if trajectory.hidden:
            return self.fit_states(trajectory)
        fits: list[StateFit] = []
        for rows in (None, SETTINGS.shooting.piece, *reversed(SETTINGS.shooting.lengths)):
            if rows is not None and 2 * rows > trajectory.rows:
                continue
            fit = self.fit_states(cut(trajectory, trajectory.segments(rows).tolist()))
            fits += [] if fit is None else [fit]
        return next((fit for fit in fits if all(self.describes_as_well(fit, [other]) for other in fits)), None)

    def describes_as_well(self, longer: "StateFit", shorter: Sequence["StateFit"]) -> bool:
        """Tell whether a simulation describes its rows as well as simulations of shorter pieces of the same rows.

        The shorter ones have more fitted numbers, k. For the right law, their deviance is smaller by a
        chi-squared variable with k degrees of freedom (Wilks 1938).
        """
        from scipy.special import chdtri

        more = sum(other.fit.starts.size for other in shorter) - longer.fit.starts.size
        if more <= 0:
            return True
        rows_in_row = max(1.0, float(self.target.share.max()))  # errors of a result that lists some of its rows
        return longer.cost - sum(other.cost for other in shorter) <= rows_in_row * float(chdtri(more, _LEVEL))


@dataclass(frozen=True, eq=False)
class EndState:
    """The state at the last row, and the offsets: L = D + K numbers.

    `mean` (L,) are their values, `by_constants` K (L, P) their derivatives by the constants, and `spread` (L, L) is
    their covariance for known constants.
    """

    mean: FloatArray
    by_constants: FloatArray
    spread: FloatArray

    def variances(self, constants: FloatArray) -> FloatArray:
        """Return the variances (L,), with the covariance (P, P) of the constants."""
        return np.asarray(np.diag(self.spread) + ((self.by_constants @ constants) * self.by_constants).sum(axis=1))


@dataclass(frozen=True, eq=False)
class StateFit:
    """The law along pieces of one trajectory. In `fit` the constants are free, so that it has their sensitivities.

    `is_like_noise`: the residuals are as large as the noise.
    """

    measurements: TrajectoryMeasurements
    fit: TrajectoryFit
    is_like_noise: bool

    @property
    def shown_values(self) -> FloatArray:
        """The simulated states (D, N), and then the columns that are computed from states; with the offsets."""
        measurements, fit = self.measurements, self.fit
        states = len(measurements.scales)
        values = np.concatenate([fit.simulated, fit.simulated_columns[measurements.observed >= states]])
        lengths = fit.segments[:, 1] - fit.segments[:, 0]
        for column, offsets in zip(measurements.offset.tolist(), fit.starts[:, states:].T, strict=True):
            values[measurements.observed[column]] += np.repeat(offsets, lengths)
        return values

    def shown_errors(self, constants: FloatArray) -> FloatArray:
        """Return the standard errors of the `shown_values`, with the covariance (P, P) of the constants."""
        states = len(self.measurements.scales)
        computed = self.measurements.observed[self.measurements.observed >= states]
        every = replace(self.measurements, observed=np.append(np.arange(states), computed), hidden=())
        return simulated_standard_errors(every, self.fit, constants, 1.0)

    @property
    def cost(self) -> float:
        """The sum of squared residuals, each divided by the variance of its error."""
        return self.fit.estimator.cost(self.fit)

    @cached_property
    def end(self) -> EndState:
        """The state at the last row of a single piece.

        Before its first row, a state is only known to lie in the measured range: its prior standard deviation is the
        standard deviation of the state.
        """
        fit, states = self.fit, len(self.measurements.scales)
        fitted, local = fit.system.count, fit.starts.shape[1]
        at_end = np.zeros((local, fitted + local))
        at_end[:states, : fitted + states] = fit.integrated_sensitivities()[-1][:states, : fitted + states]
        at_end[states:, fitted + states :] = np.eye(local - states)
        scales = self.measurements.scales
        before = 1.0 / np.append(scales, scales[self.measurements.offset]) ** 2
        own = np.linalg.pinv(fit.blocks.own[0] + np.diag(before), hermitian=True)
        return EndState(
            np.concatenate([fit.simulated[:, -1], fit.starts[0, states:]]),
            at_end[:, :fitted] - at_end[:, fitted:] @ own @ fit.blocks.coupling[0].T,
            at_end[:, fitted:] @ own @ at_end[:, fitted:].T,
        )


def rounded_times(times: FloatArray) -> FloatArray:
    """Return times (N,) without the rounding errors of sums."""
    return np.array([float(f"{time:.12g}") for time in times.tolist()])


def cut(trajectory: TrajectoryMeasurements, ranges: Sequence[Sequence[int]]) -> TrajectoryMeasurements:
    """Return the rows of a trajectory in pieces; `ranges` are their half-open row ranges."""
    owner = int(trajectory.owners[0])
    return trajectory.pieces([(first, end, owner) for first, end in ranges])


def _is_like_noise(fit: TrajectoryFit, measurements: TrajectoryMeasurements) -> bool:
    return bool(np.all(np.sqrt(fit.squares) <= most_residuals(measurements)))
