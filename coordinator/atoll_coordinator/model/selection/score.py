"""The score by which systems of equations are compared: the length of their description in nats (Rissanen 1978).

How it works. A description consists of three parts: the residuals of the simulated states (minus their log-likelihood),
the structures of the equations, and 1/2 ln N for each fitted constant (`model.description_length`). The error model
consists of the size of the independent errors and of correlated errors of a sensor. At first the error model comes from
the smoother, later from the residuals of the best system. A score never changes: `Score.calibrate` returns another
score. The length of a system by one score is never compared with a length by another score.

Doubts: the calibration uses the best system found so far, and treats its residuals as errors of measurement. If this
system is wrong, the errors are overestimated, and other wrong systems may seem to fit. So the errors are calibrated
again after each stage that found a better system.
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
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit, bounded_covariance
from atoll_coordinator.model.shooting.multiple_shooting import MisfitLimit, MultipleShooting
from atoll_coordinator.model.shooting.residual_noise import ROUGHNESS_VARIANCE, count_pieces, roughness, slow_shares
from atoll_coordinator.model.shooting.system import OdeSystem
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program, constant_places


@dataclass(frozen=True, eq=False)
class SummarizedFit:
    """The mean squares (O,) of the residuals of a fit that a worker has made. `complete` integrates the system again
    and returns the complete fit."""

    squares: FloatArray
    complete: Callable[[], TrajectoryFit] = field(repr=False)


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A system fitted to trajectories: its `programs` with fitted constants, the fit, its misfit and length in nats.

    The states and residuals of a fit from a worker are computed when they are first needed.
    """

    programs: tuple[Program, ...]
    fit_or_summary: TrajectoryFit | SummarizedFit
    misfit: float
    nats: float

    @cached_property
    def fit(self) -> TrajectoryFit:
        """The fit."""
        return self.fit_or_summary.complete() if isinstance(self.fit_or_summary, SummarizedFit) else self.fit_or_summary

    @property
    def squares(self) -> FloatArray:
        """Mean squares (O,) of the fit's residuals."""
        return self.fit_or_summary.squares


def _variance_factors(rows: FloatArray) -> FloatArray:
    """Return upper limits (O,) of the relative error of variances that are estimated from the roughness of `rows` rows
    (O,)."""
    return np.asarray(1.0 + 2.0 * np.sqrt(ROUGHNESS_VARIANCE / np.maximum(rows, 1.0)))


@dataclass(frozen=True, eq=False)
class Score:
    """Scores the systems that an `estimator` fits to its measurements of O states. It is immutable.

    Attributes:
        estimator: fits systems to the measurements.
        leading: number of equations of positions, which come before the other equations (order 2) and are not scored.
        fixed: equations, by index, whose form is given.
        groups: number of groups of trajectories that may have their own constants; 1 if there are no groups.
        roughness: standard deviations (O,) of independent errors.
        rows: number of independent rows (O,) from which `roughness` was estimated.
        errors: errors that are correlated between neighbouring rows; None if all errors are independent.
    """

    estimator: MultipleShooting
    leading: int
    fixed: frozenset[int]
    groups: int
    roughness: FloatArray
    rows: FloatArray
    errors: ErrorModel | None = None

    @classmethod
    def from_smoother(cls, estimator: MultipleShooting, leading: int, fixed: frozenset[int], groups: int) -> "Score":
        """Return the score with the error sizes that the smoother estimated."""
        measurements = estimator.measurements
        return cls(estimator, leading, fixed, groups, measurements.noise, measurements.weights.sum(axis=1))

    @cached_property
    def counts(self) -> FloatArray:
        """Number of measured values of each state (O,), as the sum of weights."""
        return np.asarray(self.estimator.measurements.weights.sum(axis=1))

    @property
    def _scales(self) -> FloatArray:
        return self.estimator.measurements.observed_scales

    @cached_property
    def least_errors(self) -> FloatArray:
        """Standard deviations (O,) below which errors are integration errors."""
        return max(SETTINGS.shooting.exact, self.estimator.measurements.input_error) * self._scales

    @property
    def _least_squares(self) -> FloatArray:
        """Lower limits (O,) of the mean squares of residuals: smaller residuals do not shorten the description. The
        limits are the mean squares of integration errors. For rounded values, the limits are at least the smallest mean
        squares that rounding errors have by chance. So a function that follows the steps of rounded values has no
        advantage."""
        rounding, least = self.estimator.measurements.rounding, self.least_errors**2
        return least if rounding is None else np.maximum(least, rounding**2 / _variance_factors(self.counts))

    @cached_property
    def pieces(self) -> FloatArray:
        """How many independent numbers the systematic errors of each state (O,) have."""
        least = SETTINGS.selection.systematic_numbers
        return np.minimum(np.maximum(count_pieces(self.estimator.measurements), least), self.counts)

    @cached_property
    def is_noisy(self) -> npt.NDArray[np.bool_]:
        """For each state (O,), whether its independent errors are large enough to hide a term. The smoother has
        estimated these errors."""
        return self.estimator.measurements.noise >= SETTINGS.selection.least_noise * self._scales

    @cached_property
    def misfit(self) -> TrajectoryMisfit:
        """The function from mean squares of residuals to nats. It assumes that independent errors have about the
        standard deviations `roughness`."""
        smallest, spread = SETTINGS.selection.least_noise * self._scales, _variance_factors(self.rows)
        is_noisy, variances = self.roughness >= smallest, np.maximum(self.roughness, smallest) ** 2
        return TrajectoryMisfit(
            np.where(is_noisy, variances / spread, variances),
            np.where(is_noisy, variances * spread, variances),
            self._least_squares,
            np.where(is_noisy, self.counts, self.pieces),
            self.pieces,
            np.where(is_noisy, self.pieces, SETTINGS.selection.systematic_numbers),
            self.counts,
        )

    @cached_property
    def constant_nats(self) -> float:
        """Nats of a constant that has a value for each group; the sum over all groups."""
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
        whole = len(measurements.bounds) * (len(measurements.scales) + len(measurements.offset))
        ranges = measurements.start_ranges(measurements.bounds)
        return whole - (0 if ranges is None else int(np.count_nonzero(ranges[0] == ranges[1])))  # given values

    def score_fit(self, fit: TrajectoryFit) -> FittedModel:
        """Return the model of a fit, with its misfit and length in nats."""
        misfit = self._misfit_of(fit.system).total(self.squares(fit)) + self._resting_misfit(fit)
        return FittedModel(fit.system.searched(self.leading), fit, misfit, self._add_prices(misfit, fit.system))

    def misfit_limit(self, system: OdeSystem, nats: float) -> MisfitLimit:
        """Return the misfit above which a system has a longer description than `nats`."""
        return MisfitLimit(nats - self._add_prices(0.0, system), self._misfit_of(system), self.errors)

    def calibrate(self, fit: TrajectoryFit) -> tuple["Score", TrajectoryFit]:
        """Return the score with errors estimated from the residuals of a fit, and the fit repeated with these errors.

        Errors that are correlated between neighbouring rows, such as errors of a sensor, are estimated first; the size
        of the independent errors follows from the roughness of the whitened residuals.
        """
        if fit.errors.shares.any():
            fit = self.refit_with_errors(fit, None) or fit
        free = self.counts - self._fitted_numbers(fit.system)
        score, residuals = replace(self, errors=None), fit.residuals
        correlated = score._set_roughness(residuals, free)._refit_with_sensor_errors(fit)
        if correlated is not None:
            fit, score = correlated, replace(self, errors=correlated.errors)
            residuals = score.whiten(fit)
        return score._set_roughness(residuals, free), fit

    def _set_roughness(self, residuals: FloatArray, free: FloatArray) -> "Score":
        noise = self._independent_noise(roughness(self.estimator.measurements, residuals), free)
        return replace(self, roughness=noise, rows=free)

    def _add_prices(self, misfit: float, system: OdeSystem) -> float:
        """Return the nats of a system with this misfit."""
        return system_length(misfit, system.searched(self.leading), 1, self._constants_length(system))

    def _misfit_of(self, system: OdeSystem) -> TrajectoryMisfit:
        """Return the misfit function for systems that have as many fitted numbers as `system`."""
        return self.misfit.with_fitted(self._fitted_numbers(system))

    def _fitted_numbers(self, system: OdeSystem) -> float:
        """Return the number of fitted numbers per measured state: constants (also the temporarily fixed constants) and
        initial states."""
        searched = (program for index, program in enumerate(system.searched(self.leading)) if index not in self.fixed)
        parameters = 0 if system.parts is None else int(np.count_nonzero(system.parts.parameters >= 0))
        constants = max(system.count, parameters + sum(len(constant_places(program)) for program in searched))
        return (constants + self._initial_values) / len(self.counts)

    def _constants_length(self, system: OdeSystem) -> float:
        """Return the nats of all fitted constants; a constant that belongs to one group is determined by the rows of
        this group only, so it costs less."""
        own = 0 if system.sharing is None else system.sharing.own_numbers
        return self._own_nats * own + self._shared_nats * (system.count - own)

    def _resting_misfit(self, fit: TrajectoryFit) -> float:
        """Return the misfit of simulations of states that rest at 0. It is n/2 ln(s / least^2) with n rows, the mean
        square s and the size `least` of integration errors: only these errors are expected there."""
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
        """Return the standard deviations (O,) of independent errors, computed from the roughness `deviations` (O,) of
        residuals.

        Only `free` rows (O,) count: rows minus fitted numbers. The smoother's noise counts as one more row, because
        residuals of a system with as many fitted numbers as rows have no information.
        """
        squares, smoother = self.counts * deviations**2, self.estimator.measurements.noise**2
        return np.asarray(np.sqrt((squares * (free > 0.0) + smoother) / (np.maximum(free, 0.0) + 1.0)))

    def refit_with_errors(self, fit: TrajectoryFit, errors: ErrorModel | None) -> TrajectoryFit | None:
        """Return the fit repeated with the error model `errors`; None: with independent errors."""
        errors = errors or ErrorModel.independent(np.sqrt(fit.squares))
        return self.estimator.fit(fit.system, None, SETTINGS.effort.steps, fit.starts, errors, is_stiff=fit.is_stiff)

    def _refit_with_sensor_errors(self, fit: TrajectoryFit) -> TrajectoryFit | None:
        """Return a fit repeated with correlated errors of a sensor. None if there are no such errors, or if they are
        refuted.

        See `Innovations.sensor_errors` and `_is_refuted`. Nearly noise-free states have no errors of a sensor.
        """
        if not self.is_noisy.any():
            return None
        errors = self.estimator.sensor_errors(fit, self.counts / np.maximum(self.pieces, 1.0))
        shares = np.where(self.is_noisy, errors.shares, 0.0)
        correlated = self.refit_with_errors(fit, replace(errors, shares=shares)) if shares.any() else None
        return None if correlated is None or self._is_refuted(fit, correlated) else correlated

    def whiten(self, fit: TrajectoryFit) -> FloatArray:
        """Return the residuals (O, N) without the correlated part of the errors of measurement."""
        return fit.residuals if self.errors is None else self.estimator.whiten(fit.residuals, self.errors)

    def squares(self, fit: TrajectoryFit) -> FloatArray:
        """Return the mean squares (O,) of the whitened residuals."""
        return fit.squares if self.errors is None else self.estimator.squares(self.whiten(fit))

    @property
    def has_independent_errors(self) -> npt.NDArray[np.bool_]:
        """Whether the errors of measurement of each state (O,) are treated as independent between rows, and not
        zero."""
        return self.is_noisy & (self.errors is None)

    def inflation(self, model: FittedModel) -> float:
        """Return the variance inflation: the number of correlated rows that count as one independent row in the
        covariance of constants.

        It is 1 if errors are independent."""
        return self._inflation(model.fit)

    def _inflation(self, fit: TrajectoryFit) -> float:
        rows = self.misfit.effective_rows(self.squares(fit))
        return float(self.counts.sum() / min(rows.sum(), self.counts.sum()))

    def integration_error_factor(self, model: FittedModel) -> float:
        """Return the ratio, at least 1, of the mean square of integration errors to the mean square of the
        residuals."""
        return float(max(1.0, (self.least_errors**2 / np.maximum(model.fit.squares, 1e-300)).max()))

    def length(self, program: Program) -> float:
        """Return the nats of a program with fitted constants."""
        return structure_length(program) + self.constant_nats * len(constant_places(program))

    def may_be_improved(self, model: FittedModel) -> bool:
        """Tell whether a system with more terms could be a shorter description than `model`. The residuals of this
        model have calibrated the errors."""
        return self.possible_gain(model) >= least_term_length(self.constant_nats)

    def possible_gain(self, model: FittedModel) -> float:
        """Return the largest possible decrease of the misfit of `model`, in nats. The residuals of this model have
        calibrated the errors.

        The misfit of a nearly noise-free state could decrease to the noise, or to the residuals of an exact model. If
        the residuals of a state are as small as the smoother's noise, a longer system could at most explain one part of
        the residuals: their slow part, as far as it is larger than the slow part of independent errors. If the
        residuals are larger than the noise, the result is infinite.
        """
        measurements, squares = self.estimator.measurements, self.squares(model.fit)
        misfit = self._misfit_of(model.fit.system)
        is_clean = self.misfit.low == self.misfit.high
        if not np.all(is_clean | self._is_like_noise(model)):
            return math.inf
        noise = np.minimum(measurements.noise, self.roughness)
        least = np.minimum(np.maximum(noise, SETTINGS.inference.exact * self._scales) ** 2, squares)
        shares, expected = slow_shares(measurements, self.whiten(model.fit), self.pieces)
        left = np.minimum((1.0 - shares) / np.maximum(1.0 - expected, 1e-12), 1.0)
        return misfit.total(squares) - misfit.total(np.where(is_clean, least, left * squares))

    def _noise(self, errors: ErrorModel | None) -> FloatArray:
        """Return the standard deviations (O,) of errors. This is the smoother's noise if errors are independent. If
        `errors` of a state are correlated, it is their standard deviation, but at least the smoother's noise."""
        noise = self.estimator.measurements.noise
        return noise if errors is None else np.where(errors.shares > 0.0, np.maximum(errors.sigmas, noise), noise)

    def length_limit(self, model: FittedModel, equation: int, room: float | None = None) -> float:
        """Return a limit of the length in nats for programs of one equation: with a longer program, no description can
        be about as short as the description by `model`.

        The limit assumes that the misfit decreases at most by `room` nats (None: `possible_gain`).
        """
        room = self.possible_gain(model) if room is None else room
        return self.length(model.programs[equation]) + room + SETTINGS.inference.distinct_nats

    def _is_like_noise(self, model: FittedModel) -> npt.NDArray[np.bool_]:
        """Tell for which states (O,) the residuals are no larger than the errors of a sensor or the smoother's noise.

        Independent errors may have different sizes, such as outliers. The variance of n errors with the kurtosis k is
        known as precisely as the variance of 2 n/(k - 1) normal errors.
        """
        measurements, rows, squares = self.estimator.measurements, self.counts, model.fit.squares
        errors = measurements.weights * model.fit.residuals**2
        kurtosis = rows * (errors**2).sum(axis=1) / np.maximum(errors.sum(axis=1) ** 2, 1e-300)
        uneven = _variance_factors(rows * 2.0 / np.maximum(kurtosis - 1.0, 2.0)) * measurements.noise**2
        is_independent = squares <= _variance_factors(rows) * self.roughness**2
        is_noise = (squares <= _variance_factors(rows) * measurements.noise**2) | (is_independent & (squares <= uneven))
        return is_noise if self.errors is None else is_noise | (self.errors.shares > 0.0)

    def is_exact(self, model: FittedModel) -> bool:
        """Tell whether all residuals are integration errors."""
        return bool(np.all(model.fit.squares <= self.least_errors * self.least_errors))

    def excess(self, model: FittedModel) -> float:
        """Return the ratio of the residuals to the noise, for the state with the largest ratio.

        Smoothed states that are inputs are assumed to add residuals as large as the noise.
        """
        measurements, residuals = self.estimator.measurements, np.sqrt(model.fit.squares)
        least = SETTINGS.common.negligible * self._scales
        errors = self.errors

        def ratio() -> float:
            allowed = np.maximum(self._noise(errors), least) * (2.0 if measurements.has_smoothed_inputs else 1.0)
            return float(np.max(residuals / allowed))

        if errors is None and ratio() > SETTINGS.inference.excess:
            correlated = self._refit_with_sensor_errors(model.fit)
            errors = None if correlated is None else correlated.errors
        return ratio()

    def _is_refuted(self, independent_fit: TrajectoryFit, fit: TrajectoryFit) -> bool:
        """Tell whether the constants of `fit` differ by more than chance from the constants of `independent_fit`.

        If so, the correlated part of the residuals is no error of measurement, but an error of the equations (Hausman
        1978, Econometrica 46:1251).
        """
        from scipy import special

        moved = fit.system.values - independent_fit.system.values
        if not moved.any():
            return False
        distance = 2.0 * quadratic_misfit_increase(
            moved, self._inflation(independent_fit) * bounded_covariance(independent_fit)
        )
        return bool(special.chdtrc(len(moved), distance) < SETTINGS.inference.improbable)
