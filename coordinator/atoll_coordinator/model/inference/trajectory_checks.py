"""The checks of an equation along trajectories: quantities, limits, clauses. Pure.

`TrajectoryChecks` has the checks of an equation that was simulated along the measured trajectories, as part of a
`FinalModel`. `UnsimulatedChecks` has the checks of an equation that was not simulated.
`TrajectoryChecks._set_quantities` chooses the noise, its reference smoother and the number of fitted parameters; these
choices decide the tests of the residuals. The other checks use the results of `long_run`, `prediction`, held-out
trajectories, and alternatives.

Doubtful: the noise of interpolated states is hard to estimate. If there are few rows, the rough part of their residuals
is treated as noise; this can hide a missing term. The check of inputs assumes that the errors of inputs between rows
have the size that the data suggest.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar

import numpy as np

from atoll_coordinator.data.columns.examined_columns import listed
from atoll_coordinator.data.differentiation.kernels.stencils import HALF_WIDTHS
from atoll_coordinator.model.inference.checks import (
    UNSIMULATED,
    EquationChecks,
    Finding,
    describe_initial_state,
    format_percent,
    format_r2,
    judge_r2,
)
from atoll_coordinator.model.inference.final_model import FinalModel
from atoll_coordinator.model.inference.long_run import LongRun
from atoll_coordinator.model.inference.null_models import log_bayes_factor, squared_steps, structure_price
from atoll_coordinator.model.inference.residuals import ReferenceSmoother
from atoll_coordinator.model.inference.trajectory_simulation import squares_about_mean
from atoll_coordinator.model.refinement import Alternative, JobKind, Refined
from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_coordinator.model.shooting.residual_noise import ROUGHNESS_VARIANCE, roughness
from atoll_coordinator.model.structure.poles import find_poles
from atoll_coordinator.result.equations import Prediction
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import EXACT_ERROR, FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program, constant_places, variables_of


class TrajectoryChecks(EquationChecks):
    """The checks of an equation of a model that was simulated along the trajectories.

    `index` is the place of the equation in the model, and `equations` has the checks of all its equations.
    `held_out_r2` is the R2 of simulations along held-out trajectories, or along trajectories left out one at a time.
    None: there are no such trajectories. `fits_whole`: the equation describes whole trajectories; None: this was not
    tested. `noise_estimate` is the estimated noise. For an interpolated state this estimate comes from second
    differences, although `noise` is 0 for this state. `is_noise_residual`: there are too few rows for an estimate, and
    the rough part of the residuals is treated as noise. `solver` names the solver that computed the table, if its
    errors were subtracted from the table.
    """

    kind: ClassVar[JobKind] = "trajectories"
    default_finding: ClassVar[Finding] = UNSIMULATED
    null_models: ClassVar[str] = "a constant or a random walk"
    noise_estimate: float = 0.0
    is_noise_residual: bool = False
    fits_whole: bool | None = True
    held_out_r2: float | None = None

    def __init__(
        self, final: FinalModel, long_run: LongRun, index: int, shown: Refined, held_out_r2: float | None,
        equations: "Sequence[TrajectoryChecks]",
    ) -> None:  # fmt: skip
        """Set the model, its test on whole trajectories (`long_run`), and the equation."""
        task = final.task
        self.name = task.variables[index]
        stopped = "the choice of the equations" if task.has_been_stopped else ""
        super().__init__(shown, task.dataset.problem(self.name).target, stopped=stopped)
        self.final, self.long_run, self.index, self.equations = final, long_run, index, equations
        self.held_out_r2, self.solver = held_out_r2, task.solver
        self.measurements = final.shown_comparison.estimator.measurements
        sensor = final.comparison.score.errors
        self.column = final.columns[index]
        self._set_quantities(sensor if sensor is not None and sensor.shares[self.column] > 0.0 else None)

    # ------------------------------------------------------------------------------ residuals and errors of measurement

    def _set_quantities(self, sensor: ErrorModel | None) -> None:
        """Set the quantities of the residuals; `sensor` has the error model if measurement errors are correlated."""
        final, measurements, index, residuals = (
            self.final,
            self.measurements,
            self.column,
            self.final.shown_fit.residuals,
        )
        recording = final.task.recording
        smoothing = recording.smoothing[recording.states.index(final.task.shown_names[index])]
        noise = self.noise_estimate = float(measurements.noise[index])
        if sensor is not None:
            noise = float(sensor.sigmas[index])
            self.innovations = _split_into_pieces(
                final.shown_comparison.estimator.whiten(residuals, sensor), measurements, index
            )
        if smoothing.method == "interpolation" and np.bincount(measurements.owners_of_rows).max() <= 2 * HALF_WIDTHS:
            # With so few rows, no row has all neighbours that an estimate of its noise needs. Then interpolation hides
            # noise, because it uses the smallest of several estimates. So the rough part of the residuals counts as
            # noise.
            rough = float(roughness(measurements, residuals)[index])
            self.is_noise_residual = rough > self.noise_estimate
            self.noise_estimate = max(self.noise_estimate, rough)
            noise = max(noise, self.noise_estimate)
        self.residuals = _split_into_pieces(residuals, measurements, index)
        self.standard_deviation = standard_deviation(measurements, index)
        self.has_outliers = smoothing.outliers > 0
        self.distinct_rows = self._count_distinct_rows()
        is_free_of_noise = smoothing.method == "interpolation" and smoothing.quantisation is None
        self.noise = 0.0 if is_free_of_noise else noise
        if sensor is None and smoothing.degree is not None and smoothing.narrower_span:
            narrower = smoothing.narrower_noise * (noise / smoothing.noise if smoothing.noise > 0.0 else 1.0)
            self.reference = ReferenceSmoother(smoothing.narrower_span, smoothing.degree, narrower)
        covariance = None if final.residual_covariances is None else final.residual_covariances[index]
        self.covariance = covariance if sensor is None else None
        # The number of parameters that a state determines: with few rows, it is the part of the trace of the projection
        # (on the derivatives by all fitted numbers) that belongs to the rows of the state. With many rows, or without
        # noise, fitted numbers are divided evenly between the states.
        numbers = final.free.fit.system.count + final.shown_fit.starts.size
        self.parameters = numbers / len(measurements.observed)
        if covariance is not None and not is_free_of_noise:
            self.parameters = len(covariance) - float(np.trace(covariance))
        self.null_nats = self._nats_over_no_equation(sensor)
        self.fits_whole = self._fits_whole(noise / self.standard_deviation)
        # An equation with more constants always fits about as well. This is no reason to doubt the equation with fewer
        # constants, unless the longer equation fits far better. Constants are counted before some of them are replaced
        # by simple numbers.
        chosen = final.ranking.selection
        most = len(constant_places(chosen.comparison.equations_of(chosen.model)[self.index]))
        self.alternative = min((one.nats for one in drop_larger_equations(most, self.shown.alternatives)), default=None)

    def _count_distinct_rows(self) -> int:
        """Return how many rows differ by more than rounding in the state and in the variables of its equation.

        Rows at a fixed point repeat the same information. If a variable was not measured, all columns are compared.
        """
        measurements, dataset = self.measurements, self.final.task.dataset
        used = {dataset.names[one] for one in variables_of(self.shown.program)}
        states, inputs = len(measurements.smoothed), measurements.variables[len(measurements.smoothed) :]
        computed = self.final.task.recording.observed
        names = [*measurements.variables[:states], *computed]
        names = [*(names[place] for place in measurements.observed), *inputs]
        values = np.concatenate([measurements.measured, measurements.inputs])
        if used <= set(names):
            values = values[[place for place, name in enumerate(names) if place == self.column or name in used]]
        scales = np.maximum(np.nanstd(values, axis=1), 1e-300)[:, None]
        return len(np.unique(np.nan_to_num(np.round(values / (EXACT_ERROR * scales))) + 0.0, axis=1).T)

    def _nats_over_no_equation(self, sensor: ErrorModel | None) -> float:
        """Return by how many nats the equation describes the measured state better than the null models do.

        There are two null models: the state is constant along each trajectory, or it is a random walk. The better null
        model counts. If the rate of the equation is a constant, the walk has a drift, since few rows of any smooth
        curve are almost on a line. In the comparison with a constant, only independent rows count. In the comparison
        with a walk, the innovations are used if errors are correlated. Each row counts with its weight. The number of
        constants is the largest of three numbers: the number of constants of the equation, the mean number of constants
        per equation, and the count of numbers fitted to this state. If there are more initial values than trajectories,
        the additional values are also counted.
        """
        final, measurements, index, fit = self.final, self.measurements, self.column, self.final.shown_fit
        program, is_given = self.shown.program, self.index in final.comparison.fixed
        is_held = self.index in final.comparison.held
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
        own = max(len(constant_places(program)), final.free.fit.system.count / len(final.programs))
        constants = 0.0 if is_held else own
        constants += max(fit.starts.size / len(measurements.observed) - len(series), 0.0)
        constants = max(constants, self.parameters - len(series))
        of_constant = log_bayes_factor(effective / rows_of_one - (len(series) - 1), constants, squares / deviations)
        innovations = squares
        if sensor is not None:
            innovations = float(final.shown_comparison.estimator.squared_innovations(fit.residuals, sensor)[index])
            constants += 1.0  # the correlation of the errors was also fitted; a random walk has no such parameter
        free = effective - drift - (len(series) - 1)
        of_walk = log_bayes_factor(free, max(constants - drift, 0.0), innovations / steps)
        price = 0.0 if is_given else structure_price(final.searched[self.index], len(final.task.dataset.names))
        return min(of_constant, of_walk) - price

    def check_explained_variance(self) -> Finding:
        """Check the R2 of the simulation, or the R2 on the target if the equation was not simulated."""
        if not self.residuals:
            return super().check_explained_variance()
        r2 = 1.0 - self.relative_residuals**2
        what = f"its simulation explains too little of the measurements (R2 {format_r2(r2)})"
        return judge_r2(r2, SETTINGS.inference.part, f"R2 {format_r2(r2)}", what)

    def check_simulation(self) -> Finding:
        """Check that the trajectories could be simulated."""
        return Finding("passed", "it was simulated along the trajectories")

    def check_residual_size(self) -> Finding | None:
        """Check that the residuals are as large as the noise."""
        if not self.residuals:
            return None
        if not self.is_noisy:
            return self._size_without_noise()
        statistics, limit, left = self.statistics, SETTINGS.inference.excess, self.relative_residuals
        power = self.departure(max(statistics.detectable_ratio**2 - 1.0, 0.0))
        size = f"the residuals ({format_percent(left)} of the standard deviation)"
        if statistics.ratio > limit and statistics.size_probability < SETTINGS.inference.improbable:
            reason = f"{size} are {statistics.ratio:.2g} times the noise (p = {statistics.size_probability:.1g})"
            return Finding("failed", reason, statistics.ratio, limit, power)
        noise = format_percent(self.relative_noise)
        reason = f"{size} agree with the noise ({noise})"
        if self.is_noise_residual:
            reason = f"{size} look like noise in these few rows"
            power = self.largest_departure
        if self.are_integration_errors:
            reason = f"{size} are as small as integration errors, although the noise was estimated as {noise}"
        if not self.is_noise_residual and statistics.ratio > limit:
            reason = f"{size} may be noise ({noise} by these few rows)"
        return Finding("passed", reason, statistics.ratio, limit, power)

    def _size_without_noise(self) -> Finding:
        left, negligible = self.relative_residuals, SETTINGS.common.negligible
        limit = max(SETTINGS.inference.exact, 2.0 * self.relative_noise)
        reason = f"there is no noise, and the residuals are {format_percent(left)} of the standard deviation"
        if self.solver is not None:
            reason += f": {self.solver}, reproduces the rows from the equations"
        elif self.final.are_errors_summed and 1.0 - left * left >= 1.0 - SETTINGS.inference.part:
            reason += ", since errors accumulate along trajectories, like the errors of a solver"
        elif left > negligible and self._exceeds_noise():
            return Finding("failed", reason.replace("noise, and", "noise, but"), left, limit)
        elif left > negligible:
            reason = f"the residuals ({format_percent(left)} of the standard deviation) may be noise in these few rows"
        elif left > limit:
            limit = negligible  # integration errors, or a departure too small to matter in predictions
        return Finding("passed", reason, left, limit, self.largest_departure)

    def _exceeds_noise(self) -> bool:
        """Tell whether the residuals are significantly larger than the noise of an interpolated state (F test).

        The noise is estimated from second differences, which have 18/35 degrees of freedom per row.
        """
        from scipy import special

        noise = max(self.noise_estimate, 0.5 * SETTINGS.common.clean * self.standard_deviation)
        ratio = (self.statistics.standard_deviation / noise) ** 2
        free, known = max(self.rows - self.parameters, 1.0), 2.0 * self.rows / ROUGHNESS_VARIANCE
        return bool(special.fdtrc(free, known, ratio) < SETTINGS.inference.improbable)

    @property
    def are_integration_errors(self) -> bool:
        """Whether the residuals may be integration errors, or errors of a solver that computed the table."""
        is_of_solver = self.final.are_errors_summed or self.solver is not None
        return super().are_integration_errors or (is_of_solver and not self.is_noisy)

    def check_precision(self) -> Finding:
        """Check that there is no noise, and that the residuals are as small as integration errors."""
        if not self.residuals:
            return super().check_precision()
        left, limit = self.relative_residuals, max(SETTINGS.inference.exact, 2.0 * self.relative_noise)
        reason = f"without noise, the residuals are {left:.1g} of the standard deviation"
        if self.solver is not None:
            reason = (
                f"without noise, {self.solver}, reproduces the rows from the equations up to {left:.1g} of the "
                "standard deviation"
            )
        return Finding("passed" if not self.is_noisy and left <= limit else "failed", reason, left, limit)

    # ----------------------------------------------------------------------------------------------- whole trajectories

    def check_held_out_trajectories(self) -> Finding:
        """Check the R2 of held-out trajectories, or of trajectories left out one at a time."""
        r2 = self.held_out_r2
        if r2 is None:
            return Finding("not applicable", "no trajectory was held out or left out")
        which = (
            "trajectories left out one at a time" if self.final.held_out_comparison is None else "held-out trajectories"
        )
        least = 1.0 - self.relative_noise**2 - SETTINGS.inference.part
        return judge_r2(r2, least, f"R2 of {which}: {format_r2(r2)}", f"the R2 of {which} is only {format_r2(r2)}")

    def _fits_whole(self, noise: float) -> bool | None:
        """Tell whether the equation describes whole trajectories; None if this was not tested.

        `noise` is relative to the standard deviation of the state. If the size of the residuals was tested for pieces
        only, the R2 of whole trajectories must be above 0.9 minus the square of `noise`.
        """
        long_run = self.long_run
        if long_run.fits is not None or long_run.r2 is None:
            return long_run.fits
        r2 = long_run.r2[self.column]
        return r2 is None or r2 >= 1.0 - SETTINGS.inference.part - noise * noise

    def check_whole_trajectories(self) -> Finding | None:
        """Check that the equation describes whole trajectories, not only the pieces to which constants were fitted."""
        if not self.residuals:
            return None
        if self.long_run.chaos is not None:
            return Finding("not applicable", "the model is chaotic, and its long run is compared instead")
        if self.fits_whole:
            return Finding("passed", "whole trajectories are simulated")
        pieces = f"pieces of {self.final.task.piece} rows"
        if self.fits_whole is False:
            reason = f"it describes {pieces} but not whole trajectories: a term that matters in the long run is missing"
            return Finding("failed", reason)
        if self.long_run.predictable_rows is not None:
            reason = (
                f"errors of initial states grow so fast that only {self.long_run.predictable_rows} rows can be "
                "predicted, and the long run of a model with inputs is not compared"
            )
            return Finding("not made", reason, advice="measure shorter trajectories")
        reason = f"only {pieces} were simulated, not whole trajectories"
        return Finding("not made", reason, advice="sample less often, or measure shorter trajectories")

    def check_long_run(self) -> Finding | None:
        """Check that a chaotic model keeps the measured means and variances in a long simulation."""
        if not self.residuals:
            return None
        chaos, limit = self.long_run.chaos, SETTINGS.inference.improbable
        if chaos is None:
            return Finding("not applicable", "whole trajectories are tested, or no chaos was found")
        value = chaos.probability
        if chaos.is_kept:
            reason = (
                f"chaotic: errors grow by a factor of e in {chaos.lyapunov_time or 0.0:.2g}, and a long simulation "
                "keeps the measured means and variances"
            )
            return Finding("passed", reason, value, limit)
        if chaos.is_unfinished:
            reason = "a long simulation needs more integration steps than are allowed: its end is not known"
            return Finding("not made", reason, value, limit)
        if value is None:
            return Finding("failed", "a long simulation diverges from the measured range", value, limit)
        reason = f"means or variances of a long simulation differ from the measured values (p = {value:.1g})"
        return Finding("failed", reason, value, limit)

    @cached_property
    def passes_pole(self) -> bool:
        """Whether the simulation passes a pole of the equation between two neighbouring rows."""
        points, owners = self.final.visited_points, self.measurements.owners_of_rows
        rows = np.flatnonzero(owners[1:] == owners[:-1])
        return bool(find_poles(self.shown.program, points[:, rows], points[:, rows + 1]))

    def check_poles(self) -> Finding | None:
        """Check that the simulation passes no pole."""
        if not self.residuals:
            return None
        if not self.passes_pole:
            return Finding("passed", "its simulation passes no pole")
        # for example 6e-13/(3e-12 - x**3), which acts like a switch
        reason = "its simulation passes a pole, where the equation has no value"
        return Finding("failed", reason, advice="measure there, or leave out divisions")

    # ----------------------------------------------------------- predictions, and the equations on which they depend

    @cached_property
    def needed_equations(self) -> "list[TrajectoryChecks]":
        """The other equations on which the simulation of this state depends, directly or through other states."""
        task, recording = self.final.task, self.final.task.recording
        owners = {symbol: column for column, symbol in zip(recording.states, recording.state_symbols, strict=True)}
        owners |= dict(zip(recording.velocity_symbols, recording.states, strict=False))
        needed, waiting = {self.name}, [self.index]
        while waiting:
            symbols = (task.dataset.names[one] for one in variables_of(self.final.programs[waiting.pop()]))
            new = {owners[symbol] for symbol in symbols if symbol in owners} - needed
            needed |= new
            waiting += [task.variables.index(name) for name in new if name in task.variables]
        return [other for other in self.equations if other.name in needed and other is not self]

    @cached_property
    def unsupported_state(self) -> str:
        """The name of a state on which the predictions depend, although its equation is not better than the null
        models; "" if there is no such state.

        The simulation of such a state is only valid along the measured trajectories. Equations that the user gave need
        no evidence.
        """
        least, given = SETTINGS.inference.chance_nats, self.final.comparison.fixed
        return next(
            (one.name for one in self.needed_equations if (one.null_nats or 0.0) < least and one.index not in given), ""
        )

    @cached_property
    def prediction(self) -> Prediction | None:
        """The test of predictions of the state from other initial states; None if predictions were not tested."""
        if self.unsupported_state or self.shown.prediction is None or not self._are_alternatives_likely:
            return None if self.unsupported_state else self.shown.prediction
        ranking = self.final.ranking
        others = [one.model for one in ranking.alternatives[self.index]]
        disputed = ranking.selection.comparison.disputed_state(ranking.selection.model, others, self.index)
        return self.shown.prediction.replaced(measure_from=disputed, is_disputed=True)

    def check_other_initial_states(self) -> Finding | None:
        """Check whether predictions from other initial states within the measured range can be trusted."""
        if not self.residuals:
            return None
        known, wrong = self.prediction, math.exp(-SETTINGS.inference.distinct_nats)
        if known is None:
            reason = (
                "predictions from other initial states were not tested: they follow from "
                f"'{self.unsupported_state}', whose equation describes its rows no better than no equation"
            )
            return Finding("not made", reason)
        starts, unfinished, probability = known.starts or 0, known.unfinished or 0, known.probability or 0.0
        lost = starts - (known.followed or 0) - unfinished
        if lost:
            reason = f"from {lost} of {starts} other initial states within the measured range its simulation diverges"
            return Finding("failed", reason, probability, 1.0 - wrong)
        if unfinished:
            reason = (
                f"from {unfinished} of {starts} other initial states within the measured range its simulation needs "
                "more integration steps than are allowed: its end is not known"
            )
            return Finding("not made", reason, probability, 1.0 - wrong)
        if 1.0 - probability > wrong:
            reason = (
                "alternative models that fit about as well predict something different from other initial states "
                f"within the measured range ({format_percent(probability)} of the odds agree)"
            )
            return Finding("failed", reason, probability, 1.0 - wrong, advice=self._advice_where_to_measure)
        where = " near measured states" if self.measurements.has_smoothed_inputs else ""
        reason = f"{format_percent(probability)} of the odds agree from {starts} other initial states{where}"
        return Finding("passed", reason, probability, 1.0 - wrong)

    @property
    def _advice_where_to_measure(self) -> str:
        """The advice where to measure; empty if predictions were not tested."""
        return "" if self.prediction is None else f"measure from {describe_initial_state(self.prediction)} to decide"

    # ----------------------------------------------------------------------------------------------------- alternatives

    @cached_property
    def odds_of_alternatives(self) -> float:
        """The sum of the odds of all other equations, for a table without noise. For a table with noise, it is 0."""
        if not self.final.task.is_nearly_clean:
            return 0.0
        return sum(math.exp(-max(one.nats, 0.0)) for one in self.shown.alternatives if not one.is_shown)

    @property
    def _are_alternatives_likely(self) -> bool:
        return self.odds_of_alternatives > math.exp(-SETTINGS.inference.exact_nats)

    def check_alternative_equations(self) -> Finding | None:
        """Check that no alternative fits about as well. If there is no noise, the finding also advises to measure where
        the equations differ."""
        finding = super().check_alternative_equations()
        if finding is None or finding.outcome != "failed" or not self._are_alternatives_likely:
            return finding
        return finding._replace(advice=self._advice_where_to_measure)

    def check_other_laws(self) -> Finding:
        """Check that the odds of all other equations are small for a table without noise."""
        limit = math.exp(-SETTINGS.inference.exact_nats)
        if not self._are_alternatives_likely:
            return Finding("passed", "no other equation fits as well", self.odds_of_alternatives, limit)
        share = self.odds_of_alternatives / (1.0 + self.odds_of_alternatives)
        reason = (
            "the data do not distinguish it from other equations that agree on the measured trajectories and differ "
            f"elsewhere ({format_percent(share)} of the odds)"
        )
        return Finding("failed", reason, self.odds_of_alternatives, limit, advice=self._advice_where_to_measure)

    # ----------------------------------------------------------------------------------------------------------- inputs

    @cached_property
    def unknown_inputs(self) -> dict[str, float]:
        """For each input, the share of the variance of a rate that is due to the uncertainty of the input between its
        rows.

        It is the largest share for all equations on which the state depends, and for all groups of trajectories. NaN if
        there are too few rows.
        """
        names, shares = self.final.task.dataset.names, dict[str, float]()
        for name, symbol, variance in self.final.unknown_variances:
            column = names.index(symbol) if symbol in names else -1
            places = [one.index for one in (self, *self.needed_equations)]
            using = [place for place in places if column in variables_of(self.final.programs[place])]
            if using:
                by = math.nan if variance is None else math.sqrt(variance)
                shares[name] = max(
                    share_of_rate(programs[place], points, column, by)
                    for programs, points in self.final.visited_points_by_group
                    for place in using
                )
        return shares

    def check_inputs_between_rows(self) -> Finding:
        """Check that the inputs are known between their rows."""
        most, shares = SETTINGS.inference.part, self.unknown_inputs
        if not shares:
            return Finding("not applicable", "the equations have no input")
        unestimated = [one for one, share in shares.items() if math.isnan(share)]
        if unestimated:
            reason = f"there are too few rows to estimate {_quoted(unestimated)} between rows"
            return Finding("not made", reason, advice="sample more rows")
        unknown, worst = [one for one, share in shares.items() if share > most], max(shares.values())
        if not unknown:
            reason = f"uncertain inputs between rows cause at most {format_percent(worst)} of the variance of a rate"
            return Finding("passed", reason, worst, most)
        recording, verb = self.final.task.recording, "is" if len(unknown) == 1 else "are"
        kinds = zip(recording.inputs, recording.input_kinds, strict=False)
        held = listed(sorted({*(name for name, kind in kinds if kind == "held"), *unknown}))
        share = format_percent(worst)
        reason = f"{_quoted(unknown)} {verb} uncertain between rows, which causes {share} of the variance of a rate"
        advice = (
            f"add --hold {held} if {_quoted(unknown)} {verb} constant from row to row, else sample faster, or with "
            "less noise"
        )
        return Finding("not made", reason, worst, most, advice=advice)


class UnsimulatedChecks(TrajectoryChecks):
    """The checks of an equation that was not simulated along the trajectories: it failed, or time was over.

    The equation was fitted to derivatives only, so the quantities that need a simulation are not known.
    """

    unknown_inputs: ClassVar = {}
    odds_of_alternatives = 0.0
    prediction = None
    __init__ = EquationChecks.__init__

    def check_simulation(self) -> Finding:
        """Return a failed finding: there is no simulation."""
        return Finding("failed", f"{UNSIMULATED.reason}; it was fitted to the derivatives only")

    def check_constants(self) -> Finding | None:
        """Check the constants, if their standard errors are known."""
        return super().check_constants() if self.shown.constants else None


def drop_larger_equations(most: int, alternatives: Sequence[Alternative]) -> list[Alternative]:
    """Return the alternatives that have at most `most` constants, or a far shorter description."""
    return [
        one
        for one in alternatives
        if not one.is_shown
        and (len(constant_places(one.program)) <= most or one.nats < -SETTINGS.inference.distinct_nats)
    ]


def standard_deviation(measurements: TrajectoryMeasurements, index: int) -> float:
    """Return the standard deviation of the measured values of a state, scaled to weight 1. Only rows that count are
    used."""
    squares, count = squares_about_mean(measurements, index, slice(None))
    return max(math.sqrt(squares / max(count, 1)), 1e-300)


def _split_into_pieces(residuals: FloatArray, measurements: TrajectoryMeasurements, index: int) -> list[FloatArray]:
    """Return the residuals of a state along each piece, on measured rows that count, scaled to weight 1."""
    own = residuals[index]
    if measurements.inverse_variances is not None:
        own = own * np.sqrt(measurements.inverse_variances[index])
    pieces = (slice(first, end) for first, end in measurements.bounds.tolist())
    parts = [own[rows][measurements.weights[index, rows] > 0.0] for rows in pieces]
    return [part for part in parts if len(part)]


def _quoted(names: Sequence[str]) -> str:
    return " and ".join(f"'{name}'" for name in names)


def share_of_rate(program: Program, points: FloatArray, column: int, by: float) -> float:
    """Return the share of the variance of a rate that is due to errors of size `by` in one variable.

    At each of the points (V, R), `by` is added to the variable and also subtracted from it; the larger change of the
    rate counts. The share is the mean square of these changes, divided by the sum of this mean square and the variance
    of the rate. It is 1 if a changed rate has no finite value, and NaN if `by` is not known.
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
