"""The checks that apply to an equation in every kind of job. A check has a quantity, a limit, and a clause of the
verdict's sentence. Pure.

`EquationChecks` belongs to one equation. The properties of this class are quantities, such as the ratio of the
residuals to the noise. Each quantity is computed when a check first needs it. Each method `check_...` compares a
quantity with a limit of `InferenceSettings` and returns a `Finding`: outcome, reason, value, limit, power.
`verdict.RULES` lists the checks, and `verdict.judge` decides the grade from all findings. The subclasses in
`trajectory_checks`, `target_checks` and `stochastic.checks` set the quantities and add checks.

Doubtful: most limits are conventions (a tenth of a variance, 3 nats, p < 0.01). They are not corrected for the number
of checks. The power of a test is computed for a slow pattern and for larger noise, not for every possible departure.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import ClassVar, Final, NamedTuple

from atoll_coordinator.model.inference.residuals import (
    ReferenceSmoother,
    ResidualStatistics,
    clip_outliers,
    residual_statistics,
)
from atoll_coordinator.model.refinement import CheckOutcome, JobKind, Refined
from atoll_coordinator.result.equations import Prediction
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, Target
from atoll_core.expression.program import constant_places

_UNKNOWN: Final = 10.0
"""A relative standard error of at least this size is not shown as a percentage. For an estimate of 0 it is infinite."""


class Finding(NamedTuple):
    """The outcome of a check (see `Check`), its reason as a clause, and its `advice`: what the user can do."""

    outcome: CheckOutcome
    reason: str
    value: float | None = None
    limit: float | None = None
    power: float | None = None
    advice: str = ""

    @property
    def clause(self) -> str:
        """The reason, and the advice behind a colon."""
        return f"{self.reason}: {self.advice}" if self.advice else self.reason


UNSIMULATED: Final = Finding("not made", "it was not simulated along the trajectories")


class EquationChecks:
    """The checks that apply to an equation in every kind of job.

    A check returns None if the equation was not simulated, or if it has no value on some rows. The finding of this
    check is then `default_finding`.

    The quantities of the residuals are in the unit of the state or target. `residuals` has (R,) numbers for each piece
    of a trajectory: measured minus simulated values of this state, or target minus equation. For a target, the rows
    were sorted in `orders` different ways. `residuals` has the order in which neighbouring residuals are most similar.
    `innovations` are the whitened residuals if the errors of a sensor are correlated. `covariance` (R, R) is the
    covariance of the residuals for independent errors of variance one, None if it is not known. `parameters` is the
    number of fitted constants and initial values. A constant or value that was fitted to n states counts as 1/n.
    `noise` is the standard deviation of the measurement errors; it is 0 if there is no noise. `reference` is the
    smoother that estimated the noise, None if the noise is known. If `has_outliers`, the tests are robust.
    """

    kind: ClassVar[JobKind]
    default_finding: ClassVar[Finding]
    null_models: ClassVar[str]
    residuals: Sequence[FloatArray] = ()
    parameters: float = 0.0
    noise: float = 0.0
    standard_deviation: float = 1.0
    orders: int = 1
    innovations: Sequence[FloatArray] | None = None
    covariance: FloatArray | None = None
    reference: ReferenceSmoother | None = None
    has_outliers: bool = False
    null_nats: float | None = None
    """Log-likelihood of the equation minus the log-likelihood of the best null model, see `null_models`."""
    distinct_rows: int | None = None
    """Number of rows that differ by more than rounding."""
    alternative: float | None = None
    """Difference of description lengths: the length of the best alternative minus the length of this equation. The
    alternative is another function and has no more constants."""
    solver: str | None = None

    def __init__(
        self, shown: Refined, target: Target, *, is_known: bool = False, stopped: str = "", is_cancelled: bool = False
    ) -> None:
        """Set the equation as it is `shown`, and its `target` on the rows of the search.

        `is_known`: the user gave the equation. `stopped` names the stage that was stopped: by the user if
        `is_cancelled`, else by the time limit.
        """
        self.shown, self.target = shown, target
        self.is_known, self.stopped, self.is_cancelled = is_known, stopped, is_cancelled

    # ------------------------------------------------------------------------------------------------------- quantities

    @cached_property
    def error(self) -> float:
        """The normalized error on the rows of the search."""
        return self.target.normalized(self.shown.error)

    @cached_property
    def target_r2(self) -> float | None:
        """The explained share of the target's variance."""
        return self.target.r2(self.shown.mse)

    @cached_property
    def prediction(self) -> Prediction | None:
        """The test of predictions of the state from other initial states; None if predictions were not tested."""
        return None

    @property
    def merit(self) -> str:
        """The reason why the equation is good, used if no check gives a more specific reason."""
        return "all checks have passed"

    @cached_property
    def statistics(self) -> ResidualStatistics:
        """The tests of the residuals."""
        residuals, innovations = self.residuals, self.innovations
        if self.has_outliers:  # outliers must not dominate the tests
            residuals = clip_outliers(residuals)
            innovations = None if innovations is None else clip_outliers(innovations)
        statistics = residual_statistics(
            residuals, self.noise, self.parameters, self.reference, innovations, self.covariance
        )
        return replace(statistics, pattern_probability=min(self.orders * statistics.pattern_probability, 1.0))

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return sum(map(len, self.residuals))

    @property
    def relative_residuals(self) -> float:
        """The standard deviation of the residuals divided by the standard deviation of the measured values."""
        return self.statistics.standard_deviation / self.standard_deviation

    @property
    def relative_noise(self) -> float:
        """The noise divided by the standard deviation of the measured values."""
        return self.noise / self.standard_deviation

    @property
    def is_noisy(self) -> bool:
        """Whether the noise is larger than bias and rounding errors."""
        return self.relative_noise > SETTINGS.common.clean

    @property
    def are_integration_errors(self) -> bool:
        """Whether the residuals may be integration errors, which always have a pattern."""
        return self.relative_residuals <= (SETTINGS.inference.exact if self.is_noisy else SETTINGS.common.negligible)

    @property
    def largest_departure(self) -> float:
        """The largest departure that residuals of this size can hide: the upper 95 % bound of their variance."""
        from scipy import special

        free = self.rows - self.parameters
        if free < 1.0:
            return math.inf
        sum_of_squares = free * self.relative_residuals**2
        return float(sum_of_squares / special.chdtri(free, 1.0 - math.exp(-SETTINGS.inference.distinct_nats)))

    def departure(self, share: float) -> float:
        """Return `share` times the variance of the noise, divided by the variance of the state; at most
        `largest_departure`.
        """
        return min(share * self.relative_noise**2, self.largest_departure) if self.rows else math.inf

    # ----------------------------------------------------------------------------------------------- rows and their fit

    def check_explained_variance(self) -> Finding:
        """Check that R2 is at least 0.1. If R2 is smaller, the grade is `no model`."""
        if not math.isfinite(self.error):
            return Finding("failed", "its error is not finite", None, SETTINGS.inference.part)
        if self.target_r2 is None:
            return Finding("not made", "the target does not vary")
        what = "it is not" if self.is_known else "no equation was found that is"
        what += f" much better than a constant (R2 {format_r2(self.target_r2)} on the target)"
        return judge_r2(self.target_r2, SETTINGS.inference.part, f"R2 {format_r2(self.target_r2)}", what)

    def check_time(self) -> Finding:
        """Check that neither the time limit nor the user stopped a stage."""
        if not self.stopped:
            return Finding("passed", "no time limit was reached")
        if self.is_cancelled:
            return Finding("not made", f"the job was cancelled before {self.stopped}", advice="let the job run longer")
        reason = f"the time limit stopped {self.stopped}"
        return Finding("not made", reason, advice="give more time with --max-time")

    def check_degrees_of_freedom(self) -> Finding | None:
        """Check that there are more rows than fitted numbers."""
        if not self.residuals:
            return None
        rows = self.rows if self.distinct_rows is None else min(self.rows, self.distinct_rows)
        free = rows - self.parameters
        if free >= 1.0:
            return Finding("passed", f"{free:.0f} rows more than fitted numbers", free, 1.0)
        which = "rows" if rows == self.rows else "rows that differ"
        reason = f"{self.parameters:.0f} numbers were fitted to {rows} {which}, so that no rows are left to test them"
        return Finding("failed", reason, free, 1.0, advice="measure more rows")

    def check_distinct_rows(self) -> Finding | None:
        """Check that enough rows differ by more than rounding."""
        count, least = self.distinct_rows, SETTINGS.common.fewest_rows
        if count is None:
            return None
        if count >= least:
            return Finding("passed", f"{count} rows differ", count, least)
        reason = f"only {count} rows differ, and many equations fit so few rows"
        return Finding("failed", reason, count, least, advice="measure at other times or points")

    def check_no_equation(self) -> Finding | None:
        """Check that the equation describes the rows better than the null models do."""
        nats, least = self.null_nats, SETTINGS.inference.chance_nats
        if nats is None:
            return None
        if nats >= least:
            reason = f"it describes the rows better than no equation (Δ log-likelihood {nats:.3g})"
            return Finding("passed", reason, nats, least)
        reason = f"{self.null_models} describes the rows about as well (Δ log-likelihood {nats:.2g})"
        return Finding("failed", reason, nats, least, advice="measure more rows")

    def check_residual_pattern(self) -> Finding | None:
        """Check that neighbouring residuals are not correlated."""
        if not self.residuals:
            return None
        statistics, limit = self.statistics, SETTINGS.inference.part
        if not statistics.standard_deviation > 0.0:
            return Finding("not applicable", "there are no residuals")
        if self.are_integration_errors:
            size = format_percent(self.relative_residuals)
            reason = f"a term of {size} of the standard deviation would look like integration errors"
            return Finding("passed", reason, statistics.correlation, limit, self.largest_departure)
        detectable = statistics.detectable_correlation
        power = self.departure(detectable / (1.0 - detectable) if detectable < 1.0 else math.inf)
        if statistics.correlation > limit and statistics.pattern_probability < SETTINGS.inference.improbable:
            share = format_percent(min(statistics.correlation, 1.0))
            reason = f"{share} of the residual variance follows a pattern (p = {statistics.pattern_probability:.1g})"
            return Finding("failed", reason, statistics.correlation, limit, power)
        reason = "the residuals show no pattern"
        if self.innovations is not None:
            reason = "the residuals are correlated like errors of a sensor and show no other pattern"
        return Finding("passed", reason, statistics.correlation, limit, power)

    # ------------------------------------------------------------------------------------------ alternatives, constants

    def check_alternative_equations(self) -> Finding | None:
        """Check that no other equation with at most as many constants describes the data about as well."""
        nats, least = self.alternative, SETTINGS.inference.distinct_nats
        if nats is None and not self.residuals:
            return None
        if nats is None:
            reason = "no other equation with as few constants and with different predictions was compared"
            return Finding("not applicable", reason)
        if nats >= least:
            reason = f"the best other equation with as few constants fits worse (Δ description length {nats:.3g})"
            return Finding("passed", reason, nats, least)
        reason = f"another equation describes the data about as well (Δ description length {nats:.2g})"
        return Finding("failed", reason, nats, least)

    def check_constants(self) -> Finding | None:
        """Check that the data determine all constants, and that the best values are within the bounds."""
        constants = self.shown.constants
        unfitted = 0 if self.is_known or constants else len(constant_places(self.shown.program))
        if unfitted:
            many = f"{unfitted} constants" if unfitted > 1 else "constant"
            reason = f"the errors of its {many} are not known"
            return Finding("not made", reason, advice="ask for a shorter equation with --max-size")
        if not constants:
            return Finding("not applicable", "the equation has no constants")
        bound = next((constant for constant in constants if constant.at_bound), None)
        if bound is not None:
            return Finding("failed", f"the best value of the constant {bound.value or 0.0:.3g} lies beyond its bound")
        loose = sum(not constant.identifiable for constant in constants)
        if not loose:
            return Finding("passed", "all constants are determined by the data", loose, 0.0)
        many = f"{loose} of {len(constants)} constants are" if len(constants) > 1 else "its constant is"
        return Finding("failed", f"{many} not determined by the data", loose, 0.0)

    # -------------------------------------------------------------------------------------------------------- exactness

    def check_precision(self) -> Finding:
        """Check that the error is as small as rounding errors."""
        limit = self.target.convergence_threshold()
        is_met = self.target.uncertainty <= SETTINGS.common.clean and self.error <= limit
        reason = f"the error, {self.error:.1g} of the target's standard deviation, is at the level of rounding"
        return Finding("passed" if is_met else "failed", reason, self.error, limit)

    def check_odds_against_chance(self) -> Finding | None:
        """Check that the odds of the equation against the null models are at least 200."""
        nats, least = self.null_nats, SETTINGS.inference.exact_nats
        if nats is None:
            return None
        reason = f"it describes the rows better than no equation (Δ log-likelihood {nats:.2g}; {least} is needed)"
        return Finding("passed" if nats >= least else "failed", reason, nats, least)

    def check_precision_of_constants(self) -> Finding:
        """Check that the relative standard errors of all constants are at most 0.1 %.

        If a constant is t standard errors from zero, the equation without this constant has a misfit about t^2/2 nats
        larger. In data without noise, a term of the law gains millions of nats, and a term that describes integration
        errors gains tens of nats. Redundant factors of one, such as the factors of x*y in x*y - x*(y - x), have no
        standard errors and are not checked.
        """
        limit = SETTINGS.common.negligible
        shares = [
            (constant.std_error / max(abs(constant.estimate), 1e-300), constant.value or 0.0)
            for constant in (*self.shown.constants, *(factor.constant for factor in self.shown.unit_coefficients))
            if constant.std_error is not None
        ]
        if not shares:
            return Finding("not applicable", "no constant has a standard error")
        share, value = max(shares)
        if share <= limit:
            return Finding("passed", f"all constants are known to {format_percent(share)} or better", share, limit)
        certainty = f"is known to {format_percent(share)} only" if share < _UNKNOWN else "is not distinguishable from 0"
        return Finding(
            "failed", f"the constant {value:.3g} {certainty}: its term may describe errors of the data", share, limit
        )


def judge_r2(r2: float, least: float, merit: str, fault: str) -> Finding:
    """Return the finding of a check that R2 is at least `least`. The check fails if R2 is NaN."""
    return Finding("passed", merit, r2, least) if r2 >= least else Finding("failed", fault, r2, least)


def describe_initial_state(known: Prediction) -> str:
    """Return the initial state from which a measurement is most informative, such as "x = 1, y = 2"."""
    return ", ".join(f"{name} = {value:.3g}" for name, value in (known.measure_from or {}).items())


def format_percent(share: float) -> str:
    """Return a share in percent, with two digits."""
    return f"{100.0 * share:.2g} %" if share < 0.995 else f"{100.0 * share:.0f} %"


def format_r2(value: float) -> str:
    """Return R2 with up to four decimals. A value below 1 is never rounded up to 1."""
    return f"{math.floor(value * 1e4) / 1e4:.4g}" if math.isfinite(value) else str(value)
