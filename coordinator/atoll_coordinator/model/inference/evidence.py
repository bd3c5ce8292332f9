"""The evidence on each equation of a final model, which its checks take. Pure."""

import math
from collections.abc import Collection, Sequence
from functools import cached_property

import numpy as np

from atoll_coordinator.data.differentiation.inputs import unknown_variance
from atoll_coordinator.data.differentiation.kernels.stencils import HALF_WIDTHS
from atoll_coordinator.data.recording import InputKind, Smoothing
from atoll_coordinator.model.inference.final_model import FinalModel
from atoll_coordinator.model.inference.long_run import LongRun
from atoll_coordinator.model.inference.null_models import log_bayes_factor, squared_steps, structure_price
from atoll_coordinator.model.inference.residual_covariance import residual_covariance
from atoll_coordinator.model.inference.residuals import ReferenceSmoother
from atoll_coordinator.model.inference.verdict import Evidence
from atoll_coordinator.model.refinement import Alternative, Refined
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.noise import roughness
from atoll_coordinator.model.structure.poles import find_poles
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import EXACT_ERROR, FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program, constant_places, variables_of


class ModelEvidence:
    """Evidence on the equations of one model; facts about the whole model are computed once."""

    def __init__(self, final: FinalModel, long_run: LongRun) -> None:
        """Take a model, and its description of whole trajectories."""
        self.final = final
        self._long_run = long_run
        self._task = final.task
        self._measurements = final.seen.estimator.measurements

    def of(self, index: int, equation: Refined, held_out_r2: float | None) -> Evidence:
        """Return the evidence on an equation, with its place in the model.

        `held_out_r2` is its R2 along trajectories that took no part, or were left out one at a time; None: there are
        none.
        """
        final, task, measurements, long_run = self.final, self._task, self._measurements, self._long_run
        alternatives, prediction = equation.alternatives, equation.prediction
        name, program = task.variables[index], final.shown[index]
        target = task.dataset.problem(name).target
        variance = target.standard_deviation**2
        smoothing = self._smoothing(index)
        noise = estimate = float(measurements.noise[index])
        sensor, innovations = final.comparison.score.errors, None
        if sensor is not None and sensor.shares[index] > 0.0:
            noise = float(sensor.sigmas[index])
            whitened = final.seen.estimator.whitened(final.seen_fit.residuals, sensor)
            innovations = _pieces_of(whitened, measurements, index)
        is_noise_residual = False
        if smoothing.method == "interpolation" and np.bincount(measurements.owners_of_rows).max() <= 2 * HALF_WIDTHS:
            # Of rows so few that none has all the neighbours that predict it, interpolation hides noise: it takes the
            # least of several estimates. What is rough in the residuals is noise then.
            rough = float(roughness(measurements, final.seen_fit.residuals)[index])
            is_noise_residual = rough > estimate
            estimate = max(estimate, rough)
            noise = max(noise, estimate)
        deviation = _standard_deviation(measurements, index)
        nearest = _no_elaborations(final.ranking.selection.model.programs[index], alternatives)
        rivals = sum(math.exp(-max(one.nats, 0.0)) for one in alternatives if not one.is_shown)
        is_decided = not task.is_nearly_clean or rivals <= math.exp(-SETTINGS.inference.exact_nats)
        if prediction is not None and not is_decided:
            prediction = prediction.replaced(measure_from=self._disputed_state(index), is_disputed=True)
        followed = self._followed(index)
        baseless = self._baseless(followed)
        return Evidence(
            kind="groups" if final.by_group else "trajectories",
            error=equation.error / target.standard_deviation,
            target_uncertainty=target.uncertainty,
            convergence_threshold=target.convergence_threshold(),
            target_r2=1.0 - equation.mse / variance if variance else None,
            residuals=_pieces_of(final.seen_fit.residuals, measurements, index),
            innovations=innovations,
            covariance=self._residual_covariance(index) if innovations is None else None,
            solver=task.solver,
            parameters=self._fitted[index],
            noise=0.0 if _is_interpolated(smoothing) else noise,
            noise_estimate=estimate,
            is_noise_residual=is_noise_residual,
            is_near=measurements.has_smoothed_inputs,
            standard_deviation=deviation,
            reference=_reference_smoother(smoothing, noise) if innovations is None else None,
            are_errors_summed=final.are_errors_summed,
            has_outliers=smoothing.outliers > 0,
            held_out_r2=held_out_r2,
            is_cross_validated=final.unseen is None,
            null_nats=self._null_nats[index],
            constants=equation.constants,
            unit_coefficients=[coefficient.constant for coefficient in equation.unit_coefficients],
            prediction=None if baseless else prediction,
            unpredicted=f"they follow from '{baseless}', whose equation describes its rows no better than no equation",
            chaos=long_run.chaos,
            fits_whole=self._fits_whole(index, noise / deviation),
            piece=task.piece,
            predictable_rows=long_run.predictable_rows,
            alternative=min((alternative.nats for alternative in nearest), default=None),
            rivals=rivals if task.is_nearly_clean else 0.0,
            rivals_agree=not is_decided,
            passes_pole=self._passes_pole(program),
            distinct_rows=_distinct_rows(
                measurements, index, {task.dataset.names[one] for one in variables_of(program)}
            ),
            unknown_inputs=self._unknown_inputs([index, *followed]),
            held_inputs=[
                name
                for name, kind in zip(task.recording.inputs, task.recording.input_kinds, strict=False)
                if kind == "held"
            ],
            stopped="the choice of the equations" if task.has_been_stopped else "",
        )

    def _smoothing(self, index: int) -> Smoothing:
        recording = self._task.recording
        return recording.smoothing[recording.states.index(self._task.variables[index])]

    def _disputed_state(self, index: int) -> dict[str, float]:
        """Return the state next to the measured ones where an equation and its alternatives differ most."""
        ranking = self.final.ranking
        others = [one.model for one in ranking.alternatives[index]]
        return ranking.selection.comparison.disputed_state(ranking.selection.model, others, index)

    def _passes_pole(self, program: Program) -> bool:
        """Tell whether the simulation of the model goes from one row to the next through a pole of an equation."""
        points, owners = self.final.visited, self._measurements.owners_of_rows
        rows = np.flatnonzero(owners[1:] == owners[:-1])
        return bool(find_poles(program, points[:, rows], points[:, rows + 1]))

    def _fits_whole(self, index: int, noise: float) -> bool | None:
        """Tell whether the equation of a state describes whole trajectories; None where that was not tested.

        Where only pieces are described up to the noise (over the standard deviation), whole trajectories have an R2
        above 0.9 minus the noise.
        """
        long_run = self._long_run
        if long_run.fits is not None or long_run.r2 is None:
            return long_run.fits
        r2 = long_run.r2[index]
        return r2 is None or r2 >= 1.0 - SETTINGS.inference.part - noise * noise

    # --------------------------------------------------------------------------------------- numbers that were fitted

    def _residual_covariance(self, index: int) -> FloatArray | None:
        """Return the covariance of the residuals of a state; None where constants were fitted to other rows than are
        simulated."""
        final, measurements = self.final, self.final.comparison.estimator.measurements
        if measurements.rows != self._measurements.rows or final.piece != self._task.piece:
            return None
        return residual_covariance(measurements, final.free.fit, index)

    @cached_property
    def _fitted(self) -> list[float]:
        """How many numbers were fitted to the measurements of each state.

        In few rows the share follows from the covariance of residuals, by the projection on all fitted numbers: a state
        gets the share of a number that other states do not need. In many rows, and without noise, the numbers are
        shared evenly.
        """
        shared = self.final.free.fit.system.count + self.final.seen_fit.starts.size
        fitted = []
        for index in range(len(self._task.variables)):
            is_exact = _is_interpolated(self._smoothing(index))
            covariance = None if is_exact else self._residual_covariance(index)
            evenly = shared / len(self._measurements.observed)
            fitted.append(evenly if covariance is None else len(covariance) - float(np.trace(covariance)))
        return fitted

    @cached_property
    def _null_nats(self) -> list[float]:
        """By how many nats each equation describes its state better than no equation does."""
        return [self._nats_over_none(index) for index in range(len(self._task.variables))]

    def _nats_over_none(self, index: int) -> float:
        """Return by how many nats an equation describes the measured state better than no equation does.

        Without an equation the state is constant along each trajectory, or a random walk: the better of both counts. A
        constant rate is compared with a walk that has a drift, since few rows of any smooth curve are about a line.
        Residuals about a constant count as many as are independent; where a walk is compared, the innovations of
        correlated errors do. Rows count by their weights. Constants are the equation's own, or as many as each state
        has on average, or the numbers fitted to this one, if they are more, and with them initial numbers beyond one
        for each trajectory.
        """
        final, measurements, fit, sensor = (
            self.final,
            self._measurements,
            self.final.seen_fit,
            self.final.comparison.score.errors,
        )
        program, is_given = final.shown[index], index in final.comparison.fixed
        squares = deviations = effective = 0.0
        series, times = [], []
        for owner in range(len(measurements.names)):
            rows = (measurements.owners_of_rows == owner) & (measurements.weights[index] > 0.0)
            values, weights = measurements.measured[index][rows], measurements.weights[index][rows]
            if len(values):
                mean = float((weights * values).sum() / weights.sum())
                deviations += float((weights * (values - mean) ** 2).sum())
                squares += float((weights * fit.residuals[index][rows] ** 2).sum())
                effective += float(weights.sum()) ** 2 / float((weights * weights).sum())
                series.append(np.sqrt(weights) * (values - mean))
                times.append(measurements.times[rows])
        steps = squared_steps(series)
        if not (deviations > 0.0 and steps > 0.0):
            return math.inf
        drift = 0
        if not variables_of(program):  # a constant rate is the drift of a random walk
            drift, least = 1, deviations * EXACT_ERROR**2
            squares, steps = max(squares, least), max(squared_steps(series, times), 2.0 * least)
        lengths = final.free.fit.errors.lengths
        rows_of_one = max(float(lengths[index]) if len(lengths) > index else 1.0, 1.0)
        own = max(len(constant_places(program)), final.free.fit.system.count / len(final.shown))
        constants = 0.0 if is_given else own
        constants += max(fit.starts.size / len(measurements.observed) - len(series), 0.0)
        constants = max(constants, self._fitted[index] - len(series))
        of_constant = log_bayes_factor(effective / rows_of_one - (len(series) - 1), constants, squares / deviations)
        innovations = squares
        if sensor is not None and sensor.shares[index] > 0.0:
            innovations = float(final.seen.estimator.squared_innovations(fit.residuals, sensor)[index])
            constants += 1.0  # the correlation was fitted as well, and a walk has none
        free = effective - drift - (len(series) - 1)
        of_walk = log_bayes_factor(free, max(constants - drift, 0.0), innovations / steps)
        price = 0.0 if is_given else structure_price(program, len(self._task.dataset.names))
        return min(of_constant, of_walk) - price

    # ------------------------------------------------------------------------- states and inputs that an equation needs

    def _followed(self, index: int) -> list[int]:
        """Return the other equations that the simulation of one state follows from, directly or through others."""
        task, recording = self._task, self._task.recording
        owners = {symbol: column for column, symbol in zip(recording.states, recording.state_symbols, strict=True)}
        owners |= dict(zip(recording.velocity_symbols, recording.states, strict=False))
        needed, waiting = {task.variables[index]}, [index]
        while waiting:
            symbols = (task.dataset.names[one] for one in variables_of(self.final.shown[waiting.pop()]))
            new = {owners[symbol] for symbol in symbols if symbol in owners} - needed
            needed |= new
            waiting += [task.variables.index(name) for name in new if name in task.variables]
        return [place for place, name in enumerate(task.variables) if name in needed and place != index]

    def _baseless(self, followed: Sequence[int]) -> str:
        """Return a state that the predictions of another one follow from, and whose equation is no better than none.

        If the equation of a state describes its rows no better than no equation, its simulation holds only along the
        measured trajectories. "" if there is no such state; given equations need no evidence.
        """
        least, given = SETTINGS.inference.chance_nats, self.final.comparison.fixed
        baseless = (one for one in followed if self._null_nats[one] < least and one not in given)
        return next((self._task.variables[one] for one in baseless), "")

    def _unknown_inputs(self, equations: Sequence[int]) -> dict[str, float]:
        """Return the share of the variance of a rate that each input makes between its rows, where it is not known.

        The largest of some equations, and of the groups of trajectories with their own constants. NaN if there are too
        few rows.
        """
        names, shares = self._task.dataset.names, dict[str, float]()
        for name, symbol, variance in self._unknown_variances:
            column = names.index(symbol) if symbol in names else -1
            using = [one for one in equations if column in variables_of(self.final.shown[one])]
            if using:
                by = math.nan if variance is None else math.sqrt(variance)
                shares[name] = max(
                    _share_of_rate(programs[one], points, column, by)
                    for programs, points in self._points_of_programs
                    for one in using
                )
        return shares

    @cached_property
    def _points_of_programs(self) -> list[tuple[Sequence[Program], FloatArray]]:
        """The equations as they are shown, and the rows (V, R) that they hold for: all, or those of each group."""
        measurements, visited = self._measurements, self.final.visited
        if not self.final.by_group or measurements.groups is None:
            return [(self.final.shown, visited)]
        groups = measurements.groups[measurements.owners_of_rows]
        return [
            (programs, visited[:, groups == group])
            for group, programs in enumerate(self.final.by_group)
            if np.any(groups == group)
        ]

    @cached_property
    def _unknown_variances(self) -> list[tuple[str, str, float | None]]:
        """Name, symbol and `unknown_variance` of each input."""
        recording = self._task.recording
        kinds: Sequence[InputKind | None] = recording.input_kinds or [None] * len(recording.inputs)
        times = [part.times for part in recording.trajectories]
        return [
            (name, symbol, unknown_variance(times, [part.inputs[place] for part in recording.trajectories], kind))
            for place, (name, symbol, kind) in enumerate(
                zip(recording.inputs, recording.input_symbols, kinds, strict=True)
            )
        ]


def _pieces_of(residuals: FloatArray, measurements: Measurements, index: int) -> list[FloatArray]:
    """Return the residuals of a state along each piece, on measured rows that count, as in a row of weight 1."""
    pieces = [slice(first, end) for first, end in measurements.bounds.tolist()]
    residuals = (
        residuals[index]
        if measurements.inverse_variances is None
        else residuals[index] * np.sqrt(measurements.inverse_variances[index])
    )
    parts = [residuals[rows][measurements.weights[index, rows] > 0.0] for rows in pieces]
    return [part for part in parts if len(part)]


def _standard_deviation(measurements: Measurements, index: int) -> float:
    """Return the standard deviation of the measured values of a state, where they count, as in a row of weight 1."""
    counts = measurements.weights[index] > 0.0
    values = measurements.measured[index][counts]
    if not len(values):
        return 1e-300
    weights = np.ones(len(values))
    if measurements.inverse_variances is not None:
        weights = measurements.inverse_variances[index][counts]
    mean = float((weights * values).sum() / weights.sum())
    return max(math.sqrt(float(np.mean(weights * (values - mean) ** 2))), 1e-300)


def _distinct_rows(measurements: Measurements, index: int, used: Collection[str]) -> int:
    """Return how many rows differ by more than rounding in one state and in the variables `used` by its equation.

    Rows at a point of rest say the same over and over. Where a variable was not measured, all columns count.
    """
    states, inputs = len(measurements.smoothed), measurements.variables[len(measurements.smoothed) :]
    names = [*(measurements.variables[:states][place] for place in measurements.observed), *inputs]
    values = np.concatenate([measurements.measured, measurements.inputs])
    if set(used) <= set(names):
        values = values[[place for place, name in enumerate(names) if place == index or name in used]]
    scales = np.maximum(np.nanstd(values, axis=1), 1e-300)[:, None]
    return len(np.unique(np.nan_to_num(np.round(values / (EXACT_ERROR * scales))) + 0.0, axis=1).T)


def _reference_smoother(smoothing: Smoothing, noise: float) -> ReferenceSmoother | None:
    """Return the smoother with a narrower span than the selected one; None where the state was interpolated.

    `noise` is the noise of a row of weight 1 by the selected model.
    """
    if smoothing.degree is None or not smoothing.narrower_span:
        return None
    narrower = smoothing.narrower_noise * (noise / smoothing.noise if smoothing.noise > 0.0 else 1.0)
    return ReferenceSmoother(smoothing.narrower_span, smoothing.degree, narrower)


def _is_interpolated(smoothing: Smoothing) -> bool:
    """Tell whether a state was treated as noise-free."""
    return smoothing.method == "interpolation" and smoothing.quantisation is None


def _no_elaborations(program: Program, alternatives: Sequence[Alternative]) -> list[Alternative]:
    """Return the others that have no more constants than `program`, as it was before its constants were made simple.

    More constants always describe about as well; that is no reason to doubt the equation with fewer, unless they
    describe the data far better.
    """
    most = len(constant_places(program))
    return [
        alternative
        for alternative in alternatives
        if not alternative.is_shown
        and (len(constant_places(alternative.program)) <= most or alternative.nats < -SETTINGS.inference.distinct_nats)
    ]


def _share_of_rate(program: Program, points: FloatArray, column: int, by: float) -> float:
    """Return the share of the variance of a rate that errors of one variable, of this size (`by`), make of it.

    The errors have either sign, and the larger change of the rate counts at each of the points (V, R). The share is of
    the sum of both variances: 1 where a change leads to where the rate has no value, NaN for a size that is not known.
    """
    if not by > 0.0:
        return by
    moved = np.repeat(points[:, :, None], 2, axis=2)
    moved[column] += np.array([-by, by])
    rates = values_of(program, points)
    with np.errstate(all="ignore"):
        changes = np.abs(values_of(program, moved.reshape(len(points), -1)).reshape(-1, 2) - rates[:, None])
        squares = np.maximum(changes[:, 0], changes[:, 1])[np.isfinite(rates)] ** 2
        variance = float(np.var(rates[np.isfinite(rates)])) if np.isfinite(rates).any() else 0.0
    is_finite = np.isfinite(squares)
    if not is_finite.all() or not len(squares):
        return 1.0
    change = float(np.mean(squares))
    return change / (change + variance) if change > 0.0 else 0.0
