"""The score by which systems of equations are compared: the length of their description in nats (Rissanen 1978).

A description consists of the errors of the simulated states, minus their log-likelihood, of the structures of the
equations, and of 1/2 ln N for each fitted constant (`model.description_length`). The error model (the size of the
independent errors, correlated errors of a sensor) comes from the smoother at first, later from the residuals of the
best system. A score never changes: `Score.calibrated` returns another one, and lengths by two scores are never
compared.

Doubts: the calibration treats the residuals of the best system so far as errors of measurement. If this system is
wrong, its score is too lenient to others; hence models are calibrated again after each stage that found a better one.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from atoll_coordinator.model.constants.rounding import quadratic_misfit_increase
from atoll_coordinator.model.description_length import (
    TrajectoryMisfit,
    constant_nats_of,
    least_term_length,
    structure_length,
    system_length,
)
from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.residual_noise import ROUGHNESS_VARIANCE, count_pieces, roughness, slow_shares
from atoll_coordinator.model.shooting.system import System
from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit, bounded_covariance
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program, constant_places


@dataclass(frozen=True, eq=False)
class SummarizedFit:
    """A fit of which the summary is known; `complete` integrates it once more for the rest."""

    squares: FloatArray
    complete: Callable[[], TrajectoryFit] = field(repr=False)


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A system fitted to trajectories: its `programs` with fitted constants, the fit, its misfit and length in nats.

    The states and residuals of a fit that was made elsewhere are computed when they are first needed.
    """

    programs: tuple[Program, ...]
    made: TrajectoryFit | SummarizedFit
    misfit: float
    nats: float

    @cached_property
    def fit(self) -> TrajectoryFit:
        """The fit."""
        return self.made.complete() if isinstance(self.made, SummarizedFit) else self.made

    @property
    def squares(self) -> FloatArray:
        """Mean squares (O,) of the fit's residuals."""
        return self.made.squares


def _spread(rows: FloatArray) -> FloatArray:
    """Return the factors (O,) by which variances estimated from the roughness of this many rows may be wrong."""
    return np.asarray(1.0 + 2.0 * np.sqrt(ROUGHNESS_VARIANCE / np.maximum(rows, 1.0)))


@dataclass(frozen=True, eq=False)
class Score:
    """Scores the systems that an `estimator` fits to its measurements of O states. It is immutable.

    Attributes:
        estimator: fits systems to the measurements.
        leading: how many equations of positions come before the equations that are sought (order 2); not scored.
        fixed: equations, by index, whose constants are given.
        groups: groups of trajectories that may have their own constants; 1 without groups.
        roughness: standard deviations (O,) of independent errors.
        rows: how many independent rows (O,) these were estimated from.
        errors: errors that are correlated between neighbouring rows; None if all are independent.
    """

    estimator: MultipleShooting
    leading: int
    fixed: frozenset[int]
    groups: int
    roughness: FloatArray
    rows: FloatArray
    errors: ErrorModel | None = None

    @classmethod
    def of_smoother(cls, estimator: MultipleShooting, leading: int, fixed: frozenset[int], groups: int) -> "Score":
        """Return the score whose errors have the size that the smoother found."""
        measurements = estimator.measurements
        return cls(estimator, leading, fixed, groups, measurements.noise, measurements.weights.sum(axis=1))

    @cached_property
    def counts(self) -> FloatArray:
        """How many values were measured of each state (O,)."""
        return np.asarray(self.estimator.measurements.weights.sum(axis=1))

    @property
    def _scales(self) -> FloatArray:
        measurements = self.estimator.measurements
        return measurements.scales[measurements.observed]

    @cached_property
    def least_errors(self) -> FloatArray:
        """Standard deviations (O,) below which errors are integration errors."""
        return max(SETTINGS.shooting.exact, self.estimator.measurements.input_error) * self._scales

    @cached_property
    def pieces(self) -> FloatArray:
        """How many independent numbers systematic errors of each state (O,) consist of."""
        least = SETTINGS.selection.systematic_numbers
        return np.minimum(np.maximum(count_pieces(self.estimator.measurements), least), self.counts)

    @cached_property
    def is_noisy(self) -> npt.NDArray[np.bool_]:
        """Which states (O,) the smoother found independent errors of, large enough to hide a term."""
        return self.estimator.measurements.noise >= SETTINGS.selection.least_noise * self._scales

    @cached_property
    def misfit(self) -> TrajectoryMisfit:
        """Turns mean squares of residuals into nats: their independent part has about the size of `roughness`."""
        smallest, spread = SETTINGS.selection.least_noise * self._scales, _spread(self.rows)
        is_noisy, variances = self.roughness >= smallest, np.maximum(self.roughness, smallest) ** 2
        return TrajectoryMisfit(
            np.where(is_noisy, variances / spread, variances),
            np.where(is_noisy, variances * spread, variances),
            self.least_errors**2,
            np.where(is_noisy, self.counts, self.pieces),
            self.pieces,
            np.where(is_noisy, self.pieces, SETTINGS.selection.systematic_numbers),
            self.counts,
        )

    @cached_property
    def constant_nats(self) -> float:
        """Nats of a constant that each group has of its own, for all groups together."""
        return self._own_nats * self.groups

    @cached_property
    def _own_nats(self) -> float:
        return constant_nats_of(self.estimator.measurements.rows / self.groups)

    @cached_property
    def _shared_nats(self) -> float:
        return constant_nats_of(self.estimator.measurements.rows)

    @cached_property
    def _initial_values(self) -> int:
        measurements = self.estimator.measurements
        return len(measurements.bounds) * (len(measurements.scales) + len(measurements.offset))

    def model_of(self, fit: TrajectoryFit) -> FittedModel:
        """Return the model that a fit gives."""
        misfit = self._misfit_of(fit.system).total(self.squares(fit)) + self._drift(fit)
        return FittedModel(fit.system.programs[self.leading :], fit, misfit, self._length(misfit, fit.system))

    def calibrated(self, fit: TrajectoryFit) -> tuple["Score", TrajectoryFit]:
        """Return the score with the errors that the residuals of a fit show, and the fit made again with these.

        Errors that are correlated between neighbouring rows, such as errors of a sensor, are estimated first; the size
        of the independent errors follows from the roughness of the whitened residuals.
        """
        if fit.errors.shares.any():
            fit = self.with_errors(fit, None) or fit
        free = self.counts - self._fitted_numbers(fit.system)
        score, residuals = replace(self, errors=None), fit.residuals
        correlated = score._with_roughness(residuals, free)._with_sensor_errors(fit)
        if correlated is not None:
            fit, score = correlated, replace(self, errors=correlated.errors)
            residuals = score.whitened(fit)
        return score._with_roughness(residuals, free), fit

    def _with_roughness(self, residuals: FloatArray, free: FloatArray) -> "Score":
        noise = self._independent_noise(roughness(self.estimator.measurements, residuals), free)
        return replace(self, roughness=noise, rows=free)

    def _length(self, misfit: float, system: System) -> float:
        """Return the nats of a system with this misfit."""
        return system_length(misfit, system.programs[self.leading :], 1, self._constants_length(system))

    def _misfit_of(self, system: System) -> TrajectoryMisfit:
        """Return the misfit of systems with as many fitted numbers."""
        return self.misfit.with_fitted(self._fitted_numbers(system))

    def _fitted_numbers(self, system: System) -> float:
        """Return how many numbers are fitted for each measured state: constants, also where they are held for a while,
        and initial states."""
        programs = system.programs[self.leading :]
        sought = (program for index, program in enumerate(programs) if index not in self.fixed)
        constants = max(system.count, sum(len(constant_places(program)) for program in sought))
        return (constants + self._initial_values) / len(self.counts)

    def _constants_length(self, system: System) -> float:
        """Return the nats of all fitted numbers: constants of one group are known from its rows alone."""
        own = 0 if system.sharing is None else system.sharing.own_numbers
        return self._own_nats * own + self._shared_nats * (system.count - own)

    def _drift(self, fit: TrajectoryFit) -> float:
        """Return the misfit of states that rest at 0, n/2 ln(s / least^2): only integration may err there."""
        measurements = self.estimator.measurements
        total = 0.0
        for resting, state, least in zip(
            measurements.resting if measurements.resting is not None else (),
            measurements.observed.tolist(),
            self.least_errors,
            strict=False,
        ):
            if resting.any():
                square = float(np.mean(fit.simulated[state, resting] ** 2))
                total += 0.5 * int(resting.sum()) * math.log(max(square / float(least) ** 2, 1.0))
        return total

    def _independent_noise(self, deviations: FloatArray, free: FloatArray) -> FloatArray:
        """Return the standard deviations (O,) of independent errors, by the roughness of residuals.

        Only `free` rows count, since numbers were fitted to the rows, and the smoother's noise counts as one row more:
        residuals of a system with as many numbers as rows have no information.
        """
        squares, smoother = self.counts * deviations**2, self.estimator.measurements.noise**2
        return np.asarray(np.sqrt((squares * (free > 0.0) + smoother) / (np.maximum(free, 0.0) + 1.0)))

    def with_errors(self, fit: TrajectoryFit, errors: ErrorModel | None) -> TrajectoryFit | None:
        """Return a fit begun again with these errors, independent ones unless given."""
        errors = errors or ErrorModel.independent(np.sqrt(fit.squares))
        return self.estimator.fit(fit.system, None, SETTINGS.effort.steps, fit.starts, errors, is_stiff=fit.is_stiff)

    def _with_sensor_errors(self, fit: TrajectoryFit) -> TrajectoryFit | None:
        """Return a fit to independent errors refitted with errors of a sensor; None without such errors or if refuted.

        See `Innovations.sensor_errors`, and `_is_refuted`. Nearly clean states have no errors of a sensor.
        """
        if not self.is_noisy.any():
            return None
        errors = self.estimator.sensor_errors(fit, self.counts / np.maximum(self.pieces, 1.0))
        shares = np.where(self.is_noisy, errors.shares, 0.0)
        correlated = self.with_errors(fit, replace(errors, shares=shares)) if shares.any() else None
        return None if correlated is None or self._is_refuted(fit, correlated) else correlated

    def whitened(self, fit: TrajectoryFit) -> FloatArray:
        """Return the residuals (O, N) without the correlated part of the errors of measurement."""
        return fit.residuals if self.errors is None else self.estimator.whitened(fit.residuals, self.errors)

    def squares(self, fit: TrajectoryFit) -> FloatArray:
        """Return the mean squares (O,) of `whitened`."""
        return fit.squares if self.errors is None else self.estimator.squares(self.whitened(fit))

    @property
    def has_independent_errors(self) -> npt.NDArray[np.bool_]:
        """Whether the errors of measurement of each state (O,) are treated as independent between rows, and not
        zero."""
        return self.is_noisy & (self.errors is None)

    def inflation(self, model: FittedModel) -> float:
        """Return how many rows count as one in the covariance of constants: 1 where errors are independent."""
        return self._inflation(model.fit)

    def _inflation(self, fit: TrajectoryFit) -> float:
        rows = self.misfit.effective_rows(self.squares(fit))
        return float(self.counts.sum() / min(rows.sum(), self.counts.sum()))

    def hidden_errors(self, model: FittedModel) -> float:
        """Return how many times the mean square of the residuals may be that the integration hides, at least 1."""
        return float(max(1.0, (self.least_errors**2 / np.maximum(model.fit.squares, 1e-300)).max()))

    def length(self, program: Program) -> float:
        """Return the nats of a program, its constants fitted."""
        return structure_length(program) + self.constant_nats * len(constant_places(program))

    def has_room(self, model: FittedModel) -> bool:
        """Tell whether a longer system could be a shorter description than `model`, which calibrated the errors."""
        return self.room(model) >= least_term_length(self.constant_nats)

    def room(self, model: FittedModel) -> float:
        """Return how many nats the misfit of `model`, by which the errors are calibrated, could be less.

        The misfit of a nearly clean state could fall to the noise, or to the residuals of an exact model. If the
        residuals of a state are as small as the smoother's noise, a longer system could at most explain their slow
        part, as far as it exceeds the slow part of independent errors. If they are larger than the noise, there is no
        limit.
        """
        measurements, squares = self.estimator.measurements, self.squares(model.fit)
        misfit = self._misfit_of(model.fit.system)
        is_clean = self.misfit.low == self.misfit.high
        if not np.all(is_clean | self._is_like_noise(model)):
            return math.inf
        noise = np.minimum(measurements.noise, self.roughness)
        least = np.minimum(np.maximum(noise, SETTINGS.inference.exact * self._scales) ** 2, squares)
        shares, expected = slow_shares(measurements, self.whitened(model.fit), self.pieces)
        left = np.minimum((1.0 - shares) / np.maximum(1.0 - expected, 1e-12), 1.0)
        return misfit.total(squares) - misfit.total(np.where(is_clean, least, left * squares))

    def _noise(self, errors: ErrorModel | None) -> FloatArray:
        """Return the standard deviations (O,) of errors: the smoother's noise, which is the size of independent
        errors, or the size of the correlated `errors`."""
        noise = self.estimator.measurements.noise
        return noise if errors is None else np.where(errors.shares > 0.0, np.maximum(errors.sigmas, noise), noise)

    def affordable(self, model: FittedModel, equation: int, room: float | None = None) -> float:
        """Return the length from which on no program in one equation's place is a description about as short.

        It gains at most the `room`, which is computed unless given.
        """
        room = self.room(model) if room is None else room
        return self.length(model.programs[equation]) + room + SETTINGS.inference.distinct_nats

    def _is_like_noise(self, model: FittedModel) -> npt.NDArray[np.bool_]:
        """Tell for which states (O,) the residuals are at most a sensor's errors, or the smoother's noise.

        Independent errors may be of uneven size, such as outliers: n errors with the kurtosis k give their variance as
        precisely as 2 n/(k - 1) normal ones.
        """
        measurements, rows, squares = self.estimator.measurements, self.counts, model.fit.squares
        errors = measurements.weights * model.fit.residuals**2
        kurtosis = rows * (errors**2).sum(axis=1) / np.maximum(errors.sum(axis=1) ** 2, 1e-300)
        uneven = _spread(rows * 2.0 / np.maximum(kurtosis - 1.0, 2.0)) * measurements.noise**2
        is_independent = squares <= _spread(rows) * self.roughness**2
        is_noise = (squares <= _spread(rows) * measurements.noise**2) | (is_independent & (squares <= uneven))
        return is_noise if self.errors is None else is_noise | (self.errors.shares > 0.0)

    def is_exact(self, model: FittedModel) -> bool:
        """Tell whether all residuals are integration errors."""
        return bool(np.all(model.fit.squares <= self.least_errors * self.least_errors))

    def excess(self, model: FittedModel) -> float:
        """Return how many times as large as the noise the residuals are, of the state that is fitted worst.

        Errors of smoothed states that are inputs are assumed to add residuals as large as the noise.
        """
        measurements, residuals = self.estimator.measurements, np.sqrt(model.fit.squares)
        least = SETTINGS.common.negligible * self._scales
        errors = self.errors

        def ratio() -> float:
            allowed = np.maximum(self._noise(errors), least) * (2.0 if measurements.has_smoothed_inputs else 1.0)
            return float(np.max(residuals / allowed))

        if errors is None and ratio() > SETTINGS.inference.excess:
            correlated = self._with_sensor_errors(model.fit)
            errors = None if correlated is None else correlated.errors
        return ratio()

    def _is_refuted(self, begun: TrajectoryFit, fit: TrajectoryFit) -> bool:
        """Tell whether constants differ by more than chance from the constants that the fit began with.

        Then the correlated part of the residuals is not errors of measurement, but an error of the equations (Hausman
        1978, Econometrica 46:1251).
        """
        from scipy import special

        moved = fit.system.values - begun.system.values
        if not moved.any():
            return False
        distance = 2.0 * quadratic_misfit_increase(moved, self._inflation(begun) * bounded_covariance(begun))
        return bool(special.chdtrc(len(moved), distance) < SETTINGS.inference.improbable)
