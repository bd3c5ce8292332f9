"""The checks of an equation: what each measures, its limit, and to which kinds of job it applies. Pure.

A check has passed, has failed, or was not made, and then says why and what to do; or it is not applicable to a table,
which has nothing of what it looks at. `verdict.judge` makes the grade of them: an equation is `good` or `exact` only if
every check that applies was made, would have seen a departure that matters, and passed. A departure matters if it has
more than a tenth of the variance of a state, since predictions of a good equation have an R2 above 0.9.

Adding a kind of job means adding it to `JobKind` and to the `kinds` of every rule; a test compares them.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import cached_property
from typing import Final

from atoll_coordinator.data.columns.finding import listed
from atoll_coordinator.model.inference.residuals import (
    ReferenceSmoother,
    ResidualStatistics,
    clip_outliers,
    residual_statistics,
)
from atoll_coordinator.model.refinement import Chaos, Check, CheckOutcome, Constant, JobKind, Prediction
from atoll_coordinator.model.shooting.noise import ROUGHNESS_VARIANCE
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import EXACT_ERROR, FloatArray

_UNKNOWN: Final = 10.0
"""Standard errors over an estimate from which on percents say nothing: they have hundreds of digits where it is 0."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of the equation of one variable of a job of this `kind`. Defaults stand for what is not known.

    Target, on the rows of the search: `error` is the normalized error, `target_uncertainty` the uncertainty of the
    target over its standard deviation and `convergence_threshold` the normalized error at most which an equation has
    converged when the job asks for none; `target_r2` is the share of the target's variance that is explained,
    `predicted_r2` the same for rows left out one at a time.

    Simulation: `residuals` has (R,) numbers for each piece of a trajectory, measured minus simulated values of this
    state, or target minus equation; a model is simulated to the end of all of them or of none. `parameters` is how many
    numbers were fitted to them: constants and initial values, each shared by as many states as it was fitted to.
    `noise` is the smoother's estimate of the measurement errors (0 for a state that was interpolated, of which
    `noise_estimate` is what its second differences say; it `is_noise_residual` where few rows hide it and what is rough
    in the residuals is taken for it), or the size of correlated errors of a sensor, and `innovations` are the whitened
    residuals then; `covariance` (R, R) is that of residuals of independent errors of variance one, None where it is not
    known; they stand in the one of so many `orders` of the rows in which neighbours are most alike;
    `standard_deviation` is that of the measured values, in the state's unit as the noise; `reference` judges the
    variance of the residuals, None where the noise is known; `are_errors_summed` tells that errors add up along
    trajectories, as those of a solver do, and that constants were fitted to short pieces therefore; `has_outliers`
    makes the tests robust. `held_out_r2` is the R2 of the simulations of held-out trajectories; with
    `is_cross_validated`, of those left out one at a time.

    `null_nats` is by how many nats the equation describes the rows better than no equation does (see `null_models`).

    Model: `constants`, as they are reported, and `unit_coefficients`, factors of one that are not written;
    `alternative` is how many nats longer the description is with the next best equation that is another function and
    has no more constants; `rivals` are the odds of all other equations of a table without noise, `rivals_agree` tells
    that some agree along what was measured; `prediction` is how far the state can be predicted from other initial
    states, which lie near measured ones where it `is_near`, None where that was not tested, for the reason
    `unpredicted`; `chaos` is what is known of a model whose trajectories cannot be predicted for long. `fits_whole`
    tells whether it describes whole trajectories, None where only pieces of `piece` rows were simulated;
    `predictable_rows` is over how many rows a driven model can be predicted at all, where its errors grow so fast that
    this is less than a piece. `passes_pole` tells that its simulation goes through a point where this equation has no
    finite value; `distinct_rows` counts rows that differ by more than rounding, None where that is not known;
    `is_known` tells that the equation was given; `solver` names the one that computed the table, whose errors are not
    in the residuals; `is_unsimulated` tells that there are trajectories, along which it was not simulated.
    `unknown_inputs` are the shares of the variance of a rate that each input makes between its rows, where it is not
    known, by name; NaN where too few rows tell, empty without inputs; `held_inputs` names all that are held.
    `digits` is how many digits a target's values have that were rounded, None where they were not; `unfitted` counts
    constants that are as the search left them, so that nothing is known of their errors.
    `stopped` says what was stopped, nothing where nothing was: by a limit of time, or, with `is_cancelled`, by a user.
    """

    kind: JobKind = "trajectories"
    error: float = math.inf
    target_uncertainty: float = 0.0
    target_r2: float | None = None
    predicted_r2: float | None = None
    residuals: Sequence[FloatArray] = ()
    parameters: float = 0.0
    noise: float = 0.0
    noise_estimate: float = 0.0
    is_noise_residual: bool = False
    is_near: bool = False
    standard_deviation: float = 1.0
    reference: ReferenceSmoother | None = None
    are_errors_summed: bool = False
    has_outliers: bool = False
    held_out_r2: float | None = None
    is_cross_validated: bool = False
    null_nats: float | None = None
    constants: Sequence[Constant] = ()
    unit_coefficients: Sequence[Constant] = ()
    alternative: float | None = None
    rivals: float = 0.0
    rivals_agree: bool = False
    prediction: Prediction | None = None
    unpredicted: str = "no other initial state was simulated"
    chaos: Chaos | None = None
    fits_whole: bool | None = True
    piece: int | None = None
    predictable_rows: int | None = None
    passes_pole: bool = False
    distinct_rows: int | None = None
    is_known: bool = False
    is_unsimulated: bool = False
    innovations: Sequence[FloatArray] | None = None
    covariance: FloatArray | None = None
    orders: int = 1
    solver: str | None = None
    convergence_threshold: float = EXACT_ERROR
    unknown_inputs: Mapping[str, float] = field(default_factory=dict)
    held_inputs: Sequence[str] = ()
    digits: int | None = None
    unfitted: int = 0
    stopped: str = ""
    is_cancelled: bool = False

    @cached_property
    def statistics(self) -> ResidualStatistics:
        """The tests of the residuals."""
        residuals, innovations = self.residuals, self.innovations
        if self.has_outliers:  # which must not decide
            residuals = clip_outliers(residuals)
            innovations = None if innovations is None else clip_outliers(innovations)
        made = residual_statistics(residuals, self.noise, self.parameters, self.reference, innovations, self.covariance)
        return replace(made, patterned=min(self.orders * made.patterned, 1.0))

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return sum(map(len, self.residuals))

    @property
    def free_rows(self) -> float:
        """Rows beyond the numbers that were fitted to them."""
        return self.rows - self.parameters

    @property
    def left(self) -> float:
        """The standard deviation of the residuals over that of the measured values."""
        return self.statistics.standard_deviation / self.standard_deviation

    @property
    def relative_noise(self) -> float:
        """The noise over the standard deviation of the measured values."""
        return self.noise / self.standard_deviation

    @property
    def is_noisy(self) -> bool:
        """Whether the noise is more than bias and rounding."""
        return self.relative_noise > SETTINGS.common.clean

    @property
    def largest_departure(self) -> float:
        """The largest share of a variance that residuals of this size can hide, at 95 %: their own upper bound."""
        from scipy import special

        if self.free_rows < 1.0:
            return math.inf
        sum_of_squares = self.free_rows * self.left**2
        return float(sum_of_squares / special.chdtri(self.free_rows, 1.0 - math.exp(-SETTINGS.inference.distinct_nats)))

    def departure(self, share: float) -> float:
        """Return the share of the state's variance that is so many times the variance of the noise.

        What residuals of this size cannot hide is no departure.
        """
        return min(share * self.relative_noise**2, self.largest_departure) if self.rows else math.inf


Maker = Callable[[Evidence], Check]
"""Makes a check; where a table has nothing to check it is "not applicable", with the reason."""


@dataclass(frozen=True)
class Rule:
    """A check: its `name`, what it `measures`, and its `limit` in words.

    `kinds` says for each kind of job why it does not apply; "" where it does. Checks that `is_exactness` are needed for
    the grade `exact` alone.
    """

    name: str
    measures: str
    limit: str
    kinds: Mapping[JobKind, str]
    make: Maker
    is_exactness: bool = False


def make_checks(evidence: Evidence, *, of_exactness: bool = False) -> tuple[Check, ...]:
    """Return the checks of an equation that apply to its kind of job, in the order of their weight."""
    rules = (rule for rule in RULES if rule.is_exactness == of_exactness and not rule.kinds[evidence.kind])
    made = (rule.make(evidence) for rule in rules)
    return tuple(map(_with_power, made))


def _nothing(name: str, reason: str) -> Check:
    """Return a check that is not applicable to a table."""
    return Check(name, "not applicable", reason)


_UNSIMULATED: Final = "it was not simulated along the trajectories"


_UNDEFINED: Final = "the equation has no finite value on some rows: leave out divisions and logarithms, or these rows"


def _unsimulated(evidence: Evidence, name: str) -> Check:
    return Check(name, "not made", _UNDEFINED if evidence.kind == "target" else _UNSIMULATED)


def _with_power(check: Check) -> Check:
    """Return a check, as not made if it has passed and would not have seen a departure that matters."""
    if check.outcome != "passed" or check.power is None or check.power <= SETTINGS.inference.part:
        return check
    least = f"below {percent(check.power)} of the variance" if math.isfinite(check.power) else "of any size"
    reason = (
        f"the check of {check.name} cannot detect errors of the model {least}: measure more rows, or with less noise"
    )
    return replace(check, outcome="not made", reason=reason)


# ------------------------------------------------------------------------------------------------------- simulation


def _explained(evidence: Evidence) -> Check:
    name, least = "explained variance", SETTINGS.inference.part
    if evidence.kind != "target" and evidence.residuals:
        r2 = 1.0 - evidence.left**2
        what = f"its simulation explains too little of the measurements (R2 {r2_text(r2)})"
    elif not math.isfinite(evidence.error):
        return Check(name, "failed", "its error is not finite", None, least)
    elif evidence.target_r2 is None:
        return Check(name, "not made", "the target does not vary")
    else:
        r2 = evidence.target_r2
        what = "it is" if evidence.is_known else "nothing was found that is"
        what += f" much better than a constant (R2 {r2_text(r2)} on the target)"
        what = what.replace("it is much", "it is not much")
    if r2 >= least:  # NaN explains nothing
        return Check(name, "passed", f"R2 {r2_text(r2)}", r2, least)
    return Check(name, "failed", what, r2, least)


def _simulated(evidence: Evidence) -> Check:
    if not evidence.is_unsimulated:
        return Check("simulation", "passed", "it was simulated along the trajectories")
    return Check("simulation", "failed", "it was not simulated along the trajectories, and fits the derivatives alone")


def _time(evidence: Evidence) -> Check:
    if not evidence.stopped:
        return Check("time", "passed", "no limit of time has stopped anything")
    if evidence.is_cancelled:
        return Check("time", "not made", f"the job was cancelled before {evidence.stopped}: let it run on")
    return Check("time", "not made", f"the limit of time stopped {evidence.stopped}: give more time with --max-time")


def _freedom(evidence: Evidence) -> Check:
    name = "degrees of freedom"
    if not evidence.residuals:
        return _unsimulated(evidence, name)
    rows = evidence.rows if evidence.distinct_rows is None else min(evidence.rows, evidence.distinct_rows)
    free = rows - evidence.parameters
    if free >= 1.0:
        return Check(name, "passed", f"{free:.0f} rows more than fitted numbers", free, 1.0)
    which = "rows" if rows == evidence.rows else "rows that differ"
    reason = f"{evidence.parameters:.0f} numbers were fitted to {rows} {which}, which leaves none to test them by"
    return Check(name, "failed", f"{reason}: measure more rows", free, 1.0)


def _null(evidence: Evidence) -> Check:
    name, least = "no equation", SETTINGS.inference.chance_nats
    if evidence.null_nats is None:
        return _unsimulated(evidence, name)
    nats = evidence.null_nats
    if nats >= least:
        return Check(
            name, "passed", f"it describes the rows better than no equation (Δ log-likelihood {nats:.3g})", nats, least
        )
    what = "a constant" if evidence.kind == "target" else "a constant or a random walk"
    reason = f"the rows are described about as well without an equation, by {what}"
    return Check(name, "failed", f"{reason} (Δ log-likelihood {nats:.2g}): measure more rows", nats, least)


def _held_out(evidence: Evidence) -> Check:
    name, r2 = "held-out trajectories", evidence.held_out_r2
    if r2 is None:
        return _nothing(name, "no trajectory was held out or left out")
    least = 1.0 - evidence.relative_noise**2 - SETTINGS.inference.part
    if r2 >= least:
        return Check(name, "passed", f"{_unseen(evidence)}: R2 {r2_text(r2)}", r2, least)
    reason = f"{_unseen(evidence)} are simulated with R2 {r2_text(r2)} only"
    return Check(name, "failed", reason, r2, least)


def _residual_size(evidence: Evidence) -> Check:
    name = "residual size"
    if not evidence.residuals:
        return _unsimulated(evidence, name)
    left = evidence.left
    if not evidence.is_noisy:
        return _size_without_noise(evidence)
    statistics = evidence.statistics
    power = evidence.departure(max(statistics.seen_ratio**2 - 1.0, 0.0))
    size = f"the residuals ({percent(left)} of the standard deviation)"
    if statistics.ratio > SETTINGS.inference.excess and statistics.too_large < SETTINGS.inference.improbable:
        reason = f"{size} are {statistics.ratio:.2g} times the noise (p = {statistics.too_large:.1g})"
        return Check(name, "failed", reason, statistics.ratio, SETTINGS.inference.excess, power)
    reason = f"{size} agree with the noise ({percent(evidence.relative_noise)})"
    if evidence.is_noise_residual:
        reason, power = (
            f"{size} are as rough as noise, which so few rows do not show otherwise",
            evidence.largest_departure,
        )
    if _are_of_integration(evidence):
        reason = f"{size} are those of the integration, though the noise seems to be {percent(evidence.relative_noise)}"
    if not evidence.is_noise_residual and statistics.ratio > SETTINGS.inference.excess:
        reason = f"{size} may be noise ({percent(evidence.relative_noise)}), of which so few rows tell little"
    return Check(name, "passed", reason, statistics.ratio, SETTINGS.inference.excess, power)


def _size_without_noise(evidence: Evidence) -> Check:
    name, left = "residual size", evidence.left
    limit = max(SETTINGS.inference.exact, 2.0 * evidence.relative_noise)
    reason = f"there is no noise, and the residuals are {percent(left)} of the standard deviation"
    if evidence.solver is not None:
        reason += f": {evidence.solver}, gives these rows of the equations so closely"
    elif evidence.are_errors_summed and 1.0 - left * left >= 1.0 - SETTINGS.inference.part:
        reason += ", since errors add up along trajectories, as those of a solver do"
    elif left > SETTINGS.common.negligible and _exceeds(evidence):
        return Check(name, "failed", reason.replace("noise, and", "noise, but"), left, limit)
    elif left > SETTINGS.common.negligible:
        reason = (
            f"the residuals are {percent(left)} of the standard deviation, and so few rows do not exclude such noise"
        )
    elif left > limit:
        limit = SETTINGS.common.negligible  # errors of integration, or a departure that no prediction shows
    return Check(name, "passed", reason, left, limit, evidence.largest_departure)


def _exceeds(evidence: Evidence) -> bool:
    """Tell whether residuals are larger than an interpolated state's noise can be, which so many rows tell.

    Second differences, by which it is estimated, have 18/35 as many degrees of freedom as rows.
    """
    from scipy import special

    noise = max(evidence.noise_estimate, 0.5 * SETTINGS.common.clean * evidence.standard_deviation)
    ratio = (evidence.statistics.standard_deviation / noise) ** 2
    known = 2.0 * evidence.rows / ROUGHNESS_VARIANCE
    return bool(special.fdtrc(max(evidence.free_rows, 1.0), known, ratio) < SETTINGS.inference.improbable)


def _are_of_integration(evidence: Evidence) -> bool:
    """Tell whether residuals are as small as errors of integration may be, which always have a pattern."""
    if evidence.is_noisy:
        return evidence.left <= SETTINGS.inference.exact
    is_small = evidence.left <= SETTINGS.common.negligible or evidence.are_errors_summed
    return is_small or evidence.solver is not None


def _residual_pattern(evidence: Evidence) -> Check:
    name = "residual pattern"
    if not evidence.residuals:
        return _unsimulated(evidence, name)
    if not evidence.statistics.standard_deviation > 0.0:
        return _nothing(name, "there are no residuals")
    statistics, limit = evidence.statistics, SETTINGS.inference.part
    if _are_of_integration(evidence):
        reason = (
            f"a term of {percent(evidence.left)} of the standard deviation would be taken for errors of integration"
        )
        return Check(name, "passed", reason, statistics.correlation, limit, evidence.largest_departure)
    seen = statistics.seen_correlation
    power = evidence.departure(seen / (1.0 - seen) if seen < 1.0 else math.inf)
    if statistics.correlation > limit and statistics.patterned < SETTINGS.inference.improbable:
        share = percent(min(statistics.correlation, 1.0))
        reason = f"{share} of the residual variance follows a pattern (p = {statistics.patterned:.1g})"
        return Check(name, "failed", reason, statistics.correlation, limit, power)
    reason = "the residuals show no pattern"
    if evidence.innovations is not None:
        reason = "the residuals are correlated as errors of a sensor are, and show no other pattern"
    return Check(name, "passed", reason, statistics.correlation, limit, power)


def _whole(evidence: Evidence) -> Check:
    name = "whole trajectories"
    if not evidence.residuals:
        return _unsimulated(evidence, name)
    if evidence.chaos is not None:
        return _nothing(name, "errors of initial states grow in chaos, and the long run is compared")
    if evidence.fits_whole is None and evidence.predictable_rows is not None:
        reason = (
            f"errors of initial states grow, so that no more than {evidence.predictable_rows} rows can be predicted, "
        )
        return Check(
            name, "not made", f"{reason}and the long run of a driven model is not compared: measure shorter runs"
        )
    if evidence.fits_whole is False:
        reason = f"it describes pieces of {evidence.piece} rows and not whole trajectories: what shows in the long "
        return Check(name, "failed", f"{reason}run is missing")
    if evidence.fits_whole is None:
        reason = f"only pieces of {evidence.piece} rows were simulated, and not whole trajectories"
        return Check(name, "not made", f"{reason}: sample less often, or measure shorter trajectories")
    return Check(name, "passed", "whole trajectories are simulated")


def _long_run(evidence: Evidence) -> Check:
    """Check a chaotic model by a simulation far longer than errors of an initial state can be carried."""
    name, chaos = "long run", evidence.chaos
    if chaos is None and not evidence.residuals:
        return _unsimulated(evidence, name)
    if chaos is None:
        return _nothing(name, "whole trajectories are tested, or no chaos was found")
    limit, value = SETTINGS.inference.improbable, chaos.probability
    if chaos.is_kept:
        return Check(
            name, "passed",
            f"chaotic: errors grow e-fold in {chaos.lyapunov_time:.2g}, and a long simulation keeps the measured means "
            "and variances", value, limit,
        )  # fmt: skip
    if chaos.is_unfinished:
        reason = "a long simulation takes more steps than are allowed, so that it is not known where it leads"
        return Check(name, "not made", reason, value, limit)
    if value is None:
        return Check(name, "failed", "a long simulation runs away from what was measured", value, limit)
    reason = f"means or variances of a long simulation are not those measured (p = {value:.1g})"
    return Check(name, "failed", reason, value, limit)


# ------------------------------------------------------------------------------------------------------- prediction


def _other_starts(evidence: Evidence) -> Check:
    """Check how far the model can be relied on elsewhere in the measured range."""
    name, known = "other initial states", evidence.prediction
    if not evidence.residuals:
        return _unsimulated(evidence, name)
    wrong = math.exp(-SETTINGS.inference.distinct_nats)
    if known is None:
        return Check(name, "not made", f"predictions from other initial states were not tested: {evidence.unpredicted}")
    lost = known.starts - known.followed - known.unfinished
    if lost:
        reason = f"from {lost} of {known.starts} other initial states within the measured range it runs away"
        return Check(name, "failed", reason, known.probability, 1.0 - wrong)
    if known.unfinished:
        reason = (
            f"from {known.unfinished} of {known.starts} other initial states within the measured range its "
            "simulation takes more steps than are allowed, so that it is not known where it leads"
        )
        return Check(name, "not made", reason, known.probability, 1.0 - wrong)
    if 1.0 - known.probability > wrong:
        reason = (
            "alternative models that fit about as well predict something different from other initial states within "
            f"the measured range ({percent(known.probability)} of the odds agree){_to_decide(known)}"
        )
        return Check(name, "failed", reason, known.probability, 1.0 - wrong)
    where = " near the measured ones" if evidence.is_near else ""
    reason = f"{percent(known.probability)} of the odds agree from {known.starts} other initial states{where}"
    return Check(name, "passed", reason, known.probability, 1.0 - wrong)


def outside_of_range(known: Prediction | None) -> str:
    """Return what a model predicts outside of the measured range as a clause, or nothing."""
    if known is None or known.reached is None:
        return ""
    return (
        f"from other initial states within the measured range it leads to {known.reached:.3g}, which was never "
        f"measured: measure from {_where(known)} to know"
    )


def _to_decide(known: Prediction | None) -> str:
    """Return what to measure, behind a colon, or nothing where that is not known."""
    return "" if known is None else f": measure from {_where(known)} to decide"


def _where(known: Prediction) -> str:
    return ", ".join(f"{name} = {value:.3g}" for name, value in (known.measure_from or {}).items())


# ----------------------------------------------------------------------------------------------------------- target


def _target_noise(evidence: Evidence) -> Check:
    """Check what is known of the target: nonsense fits an uncertain one as well as the law does."""
    name, most = "target uncertainty", SETTINGS.inference.largest_uncertainty
    uncertainty = evidence.target_uncertainty
    if uncertainty <= most:
        return Check(name, "passed", f"the target is uncertain by {percent(uncertainty)}", uncertainty, most)
    reason = f"the target itself is uncertain by {percent(uncertainty)} of its standard deviation"
    return Check(name, "failed", reason, uncertainty, most)


def _predicted_rows(evidence: Evidence) -> Check:
    """Check the rows that take no part in a fit: of a good equation they are predicted with an R2 above 0.9.

    Where the target's own uncertainty is known, an equation cannot be asked for more than that.
    """
    name, least = "rows left out", 1.0 - SETTINGS.inference.part
    r2 = evidence.predicted_r2
    if r2 is None:
        return Check(name, "not made", "the equation has no finite value on some rows, so that none can be left out")
    least -= min(2.0 * evidence.target_uncertainty, 1.0) ** 2
    if r2 >= least:
        return Check(name, "passed", f"rows left out one at a time are predicted with R2 {r2_text(r2)}", r2, least)
    return Check(name, "failed", f"rows left out one at a time are predicted with R2 {r2_text(r2)} only", r2, least)


# ------------------------------------------------------------------------------------------------------------ model


def _distinct(evidence: Evidence) -> Check:
    count, least = evidence.distinct_rows, SETTINGS.checks.min_rows
    if count is None:
        return _unsimulated(evidence, "distinct rows")
    if count >= least:
        return Check("distinct rows", "passed", f"{count} rows differ", count, least)
    reason = (
        f"the rows repeat {count} measurements, through which many equations lead: measure at other times or points"
    )
    return Check("distinct rows", "failed", reason, count, least)


def _inputs(evidence: Evidence) -> Check:
    name, most, shares = "inputs between rows", SETTINGS.inference.part, evidence.unknown_inputs
    if not shares:
        return _nothing(name, "the equations have no input")
    if any(map(math.isnan, shares.values())):
        untold = [one for one, share in shares.items() if math.isnan(share)]
        return Check(
            name, "not made", f"there are too few rows to know {_quoted(untold)} between them: sample more rows"
        )
    unknown, worst = [one for one, share in shares.items() if share > most], max(shares.values())
    if not unknown:
        reason = f"what is not known of inputs between rows makes {percent(worst)} of the variance of a rate at most"
        return Check(name, "passed", reason, worst, most)
    held, verb = listed(sorted({*evidence.held_inputs, *unknown})), "is" if len(unknown) == 1 else "are"
    reason = (
        f"what is not known of {_quoted(unknown)} between rows makes {percent(worst)} of the variance of a rate: add "
        f"--hold {held} if {_quoted(unknown)} {verb} constant from row to row, else sample faster, or with less noise"
    )
    return Check(name, "not made", reason, worst, most)


def _quoted(names: Sequence[str]) -> str:
    return " and ".join(f"'{name}'" for name in names)


def _poles(evidence: Evidence) -> Check:
    if not evidence.residuals:
        return _unsimulated(evidence, "poles")
    if not evidence.passes_pole:
        return Check("poles", "passed", "its simulation passes no pole")
    reason = "its simulation passes a pole, where it has no value: measure there, or leave out divisions"
    return Check("poles", "failed", reason)  # such as 6e-13/(3e-12 - x**3), by which a state seems to be switched


def _alternatives(evidence: Evidence) -> Check:
    name, nats, least = "alternative equations", evidence.alternative, SETTINGS.inference.distinct_nats
    if nats is None and not evidence.residuals:
        return _unsimulated(evidence, name)
    if nats is None:
        return _nothing(name, "no other equation with as few constants, which predicts something else, was compared")
    if nats >= least:
        return Check(
            name,
            "passed",
            f"the next best equation with as few constants fits worse (Δ description length {nats:.3g})",
            nats,
            least,
        )
    where = _to_decide(evidence.prediction) if evidence.rivals_agree else ""
    reason = f"another equation describes the data about as well (Δ description length {nats:.2g}){where}"
    return Check(name, "failed", reason, nats, least)


def _constants(evidence: Evidence) -> Check:
    name, constants = "constants", evidence.constants
    if not constants and evidence.is_unsimulated:
        return _unsimulated(evidence, name)
    if evidence.unfitted:
        many = f"{evidence.unfitted} constants are" if evidence.unfitted > 1 else "constant is"
        return Check(
            name, "not made", f"how well its {many} determined is not known: seek a shorter equation, --max-size"
        )
    if not constants:
        return _nothing(name, "it has no constants")
    bound = next((constant for constant in constants if constant.is_at_bound), None)
    if bound is not None:
        return Check(name, "failed", f"the data would have the constant {bound.value:.3g} beyond its bound")
    loose = sum(not constant.identifiable for constant in constants)
    if not loose:
        return Check(name, "passed", "all constants are determined by the data", loose, 0.0)
    many = f"{loose} of {len(constants)} constants are" if len(constants) > 1 else "its constant is"
    return Check(name, "failed", f"{many} not determined by the data", loose, 0.0)


# -------------------------------------------------------------------------------------------------------- exactness


def _precision(evidence: Evidence) -> Check:
    """Check whether the equation is met but for rounding and errors of integration."""
    name = "precision"
    if not evidence.residuals or evidence.kind == "target":
        error, limit = evidence.error, evidence.convergence_threshold
        is_met = evidence.target_uncertainty <= SETTINGS.common.clean and error <= limit
        reason = f"the error, {error:.1g} of the target's standard deviation, is at the level of rounding"
    else:
        error, limit = evidence.left, max(SETTINGS.inference.exact, 2.0 * evidence.relative_noise)
        is_met = not evidence.is_noisy and error <= limit
        reason = f"without noise, the residuals are {error:.1g} of the standard deviation"
        if evidence.solver is not None:
            reason = (
                f"without noise: {evidence.solver}, gives these rows of the equations to {error:.1g} of the standard "
                "deviation"
            )
    return Check(name, "passed" if is_met else "failed", reason, error, limit)


def _loosest(evidence: Evidence) -> Check:
    """Check that all constants are known as in an exact law.

    Dropping a constant of which the estimate is t standard errors away from zero costs about t^2/2 nats. In data
    without noise a law stands out by millions of nats, while terms that follow the errors of a simulation do by tens.
    Factors of one of which some stand for others, as those of x*y in x*y - x*(y - x), have no errors and do not count.
    """
    name, limit = "precision of constants", SETTINGS.common.negligible
    known = [
        (
            constant.std_error / max(abs(constant.value if constant.fitted is None else constant.fitted), 1e-300),
            constant.value,
        )
        for constant in (*evidence.constants, *evidence.unit_coefficients)
        if constant.std_error is not None and math.isfinite(constant.std_error)
    ]
    if not known:
        return _nothing(name, "no constant has a standard error")
    share, value = max(known)
    outcome: CheckOutcome = "passed" if share <= limit else "failed"
    certainty = f"is known to {percent(share)} only" if share < _UNKNOWN else "cannot be told from 0"
    reason = f"the constant {value:.3g} {certainty}: its term may follow errors of the data"
    if outcome == "passed":
        reason = f"the constant known least is known to {percent(share)}"
    return Check(name, outcome, reason, share, limit)


def _digits(evidence: Evidence) -> Check:
    """Check that values with few digits are met by constants with as few: others follow the errors of rounding.

    What is periodic in the last digit of a column can give the rounding of every row.
    """
    name, most = "digits of constants", evidence.digits
    if most is None:
        return _nothing(name, "the values are not rounded")
    count = max((len(Decimal(repr(one.value)).normalize().as_tuple().digits) for one in evidence.constants), default=0)
    if count <= most:
        return Check(name, "passed", f"constants have {count} digits at most, and the values {most}", count, most)
    reason = f"the values have {most} digits and a constant has {count}: its term may follow errors of rounding"
    return Check(name, "failed", reason, count, most)


def _undecided(evidence: Evidence) -> Check:
    """Check that no other equation may be the law of a table without noise."""
    name, limit = "other laws", math.exp(-SETTINGS.inference.exact_nats)
    if evidence.rivals <= limit:
        return Check(name, "passed", "no other equation may be the law", evidence.rivals, limit)
    share = evidence.rivals / (1.0 + evidence.rivals)
    reason = (
        "the data do not distinguish it from other equations, which agree along the measured trajectories and differ "
        f"elsewhere ({percent(share)} of the odds){_to_decide(evidence.prediction)}"
    )
    return Check(name, "failed", reason, evidence.rivals, limit)


def _chance(evidence: Evidence) -> Check:
    """Check that the equation stands out from none as an exact one must: odds of 200."""
    nats, least = evidence.null_nats, SETTINGS.inference.exact_nats
    if nats is None:
        return _unsimulated(evidence, "odds against chance")
    outcome: CheckOutcome = "passed" if nats >= least else "failed"
    reason = f"it describes the rows better than no equation (Δ log-likelihood {nats:.2g}; {least} is needed)"
    return Check("odds against chance", outcome, reason, nats, least)


# ------------------------------------------------------------------------------------------------------------ table

_NO_SIMULATION: Final = "nothing is simulated where a target is given"
_PROCESS: Final = "the steps of a process have checks of their own, see `stochastic.conclusion`"


def _simulation_alone() -> dict[JobKind, str]:
    return {"trajectories": "", "groups": "", "target": _NO_SIMULATION, "process": _PROCESS}


def _everywhere() -> dict[JobKind, str]:
    return {"trajectories": "", "groups": "", "target": "", "process": _PROCESS}


def _target_alone() -> dict[JobKind, str]:
    reason = "derivatives of smoothed states are no measurements, along which a model is simulated"
    return {"trajectories": reason, "groups": reason, "target": "", "process": _PROCESS}


RULES: Final[Sequence[Rule]] = (
    Rule("explained variance", "R2 of the simulation, or on the target", "0.1", _everywhere(), _explained),
    Rule("simulation", "whether the trajectories could be simulated", "all", _simulation_alone(), _simulated),
    Rule("time", "what a limit of time has stopped", "nothing", _everywhere(), _time),
    Rule("degrees of freedom", "rows less the numbers fitted to them", "1", _everywhere(), _freedom),
    Rule("distinct rows", "rows that differ by more than rounding", "5", _everywhere(), _distinct),
    Rule(
        "inputs between rows",
        "share of the variance of a rate that inputs make between rows",
        "0.1",
        _simulation_alone(),
        _inputs,
    ),
    Rule("no equation", "Δ log-likelihood over a constant and a random walk", "4.6", _everywhere(), _null),
    Rule("held-out trajectories", "R2 of trajectories left out", "0.9 less the noise", _simulation_alone(), _held_out),
    Rule("rows left out", "R2 of rows left out one at a time", "0.9", _target_alone(), _predicted_rows),
    Rule("target uncertainty", "uncertainty of the target", "0.01", _target_alone(), _target_noise),
    Rule("residual size", "residuals over the noise", "1.25, p < 0.01", _simulation_alone(), _residual_size),
    Rule(
        "residual pattern", "correlation of neighbouring residuals", "0.1, p < 0.01", _everywhere(), _residual_pattern
    ),
    Rule("whole trajectories", "whether whole trajectories are described", "all", _simulation_alone(), _whole),
    Rule("long run", "means and variances of a chaotic model", "p < 0.01", _simulation_alone(), _long_run),
    Rule("other initial states", "odds of models that predict the same", "0.95", _simulation_alone(), _other_starts),
    Rule("poles", "poles that the simulation passes", "none", _simulation_alone(), _poles),
    Rule("alternative equations", "Δ description length of the next best equation", "3", _everywhere(), _alternatives),
    Rule("constants", "constants that the data do not determine", "none", _everywhere(), _constants),
    Rule("precision", "residuals without noise", "1e-6, or rounding", _everywhere(), _precision, is_exactness=True),
    Rule("odds against chance", "Δ log-likelihood over no equation", "5.3", _everywhere(), _chance, is_exactness=True),
    Rule("precision of constants", "standard error over estimate", "1e-3", _everywhere(), _loosest, is_exactness=True),
    Rule(
        "digits of constants",
        "digits beside those of the values",
        "as many",
        _target_alone(),
        _digits,
        is_exactness=True,
    ),
    Rule("other laws", "odds of other equations", "1/200", _simulation_alone(), _undecided, is_exactness=True),
)
"""All checks, those first that weigh most in a sentence."""


def failures(checks: Sequence[Check]) -> Iterator[str]:
    """Yield the reasons of checks that speak against an equation: failed ones, then those that were not made."""
    failed = [check.reason for check in checks if check.outcome == "failed"]
    unmade = dict.fromkeys(check.reason for check in checks if check.outcome == "not made")
    if failed:
        unmade.pop(_UNSIMULATED, None)  # the check of the simulation itself has said so
    yield from (*failed, *unmade)


# ------------------------------------------------------------------------------------------------------------- text


def _unseen(evidence: Evidence) -> str:
    return "trajectories left out one at a time" if evidence.is_cross_validated else "held-out trajectories"


def percent(share: float) -> str:
    """Return a share in percent, two digits of it."""
    return f"{100.0 * share:.2g} %" if share < 0.995 else f"{100.0 * share:.0f} %"


def r2_text(value: float) -> str:
    """Return R2 in up to four decimals, never rounded up to 1."""
    return f"{math.floor(value * 1e4) / 1e4:.4g}" if math.isfinite(value) else str(value)
