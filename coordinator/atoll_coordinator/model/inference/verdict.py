"""The checks of an equation, and the verdict that follows from them. Pure.

`RULES` is the table: the name of each check, the quantity it measures, its limit, and the kinds of job to which it
applies. One function for each check measures the quantity and returns a `Finding` with a clause for the sentence. A
check has passed, has failed, is not applicable to this table, or was not made; the clause then says why and what to do.
An equation is `good` or `exact` only if every check that applies was made, could detect a relevant departure, and
passed. A departure is relevant if it has more than a tenth of the variance of a state, since predictions of a good
equation have an R2 above 0.9. A test that was not made never counts as passed.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import cached_property
from typing import Final, NamedTuple

from atoll_coordinator.data.columns.finding import listed
from atoll_coordinator.model.inference.residuals import (
    ReferenceSmoother,
    ResidualStatistics,
    clip_outliers,
    residual_statistics,
)
from atoll_coordinator.model.refinement import CheckOutcome, Grade, JobKind
from atoll_coordinator.model.shooting.noise import ROUGHNESS_VARIANCE
from atoll_coordinator.result.equations import Check, Estimate, Prediction
from atoll_coordinator.result.findings import Chaos
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import EXACT_ERROR, FloatArray

_UNKNOWN: Final = 10.0
"""Standard errors over an estimate from which on a percentage is not shown: of an estimate of 0 it is infinite."""

_ADVICE: Final = re.compile(r": (?=(?:add|ask|give|leave|let|measure|sample) )")
"""What separates the reason of a check from the advice behind it."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """The known facts about the equation of one variable, in a job of this `kind`. Defaults mean: not known.

    Target, on the rows of the search: `error` is the normalized error, `target_uncertainty` the uncertainty of the
    target over its standard deviation, and `convergence_threshold` the normalized error below which an equation counts
    as converged. `target_r2` is the explained share of the target's variance, `predicted_r2` the same share for rows
    left out one at a time.

    Residuals: `residuals` has (R,) numbers for each piece of a trajectory: measured minus simulated values of this
    state, or target minus equation. A model is simulated to the end of all pieces or of none. `parameters` is the count
    of numbers fitted to the residuals: constants and initial values, each divided by the number of states that it was
    fitted to. `standard_deviation` is the standard deviation of the measured values, in the unit of the state.
    `covariance` (R, R) is the covariance of the residuals for independent errors of variance one, or None. The rows
    stand in the one of `orders` possible orders in which neighbours are most alike. `are_errors_summed`: errors
    accumulate along trajectories, like the errors of a solver, so that constants were fitted to short pieces.
    `has_outliers` makes the tests robust. `held_out_r2` is the R2 of simulations of held-out trajectories, or, with
    `is_cross_validated`, of trajectories left out one at a time.

    Noise: `noise` is the smoother's estimate of the measurement errors, in the unit of the state: 0 for an interpolated
    state, whose second differences give `noise_estimate`. For a sensor with correlated errors it is their size, and
    `innovations` are the whitened residuals. `is_noise_residual`: the rows are too few for an estimate, and the rough
    part of the residuals is treated as noise. `reference` judges the variance of the residuals, None if the noise is
    known. `solver` names the solver that computed the table, whose errors are subtracted from the residuals.

    `null_nats` is the log-likelihood ratio of the equation over no equation (see `null_models`).

    Model: `constants` as reported; `unit_coefficients` are factors of one that are not written. `unfitted` counts
    constants as the search left them, without errors. `alternative` is the Δ description length of the next best
    equation that is another function and has no more constants. `rivals` are the odds of all other equations of a table
    without noise; `rivals_agree`: some of these agree on the measured trajectories. `prediction` says how far the state
    can be predicted from other initial states (near measured ones with `is_near`); if None, `unpredicted` is the
    reason. `chaos` describes a model whose trajectories cannot be predicted for long. `fits_whole`: the model describes
    whole trajectories; None if only pieces of `piece` rows were simulated. `predictable_rows`: the rows over which a
    driven model can be predicted, if these are fewer than a piece. `passes_pole`: the simulation passes a point where
    the equation has no finite value. `is_known`: the equation was given. `is_unsimulated`: there are trajectories, but
    the equation was not simulated along them.

    Table: `distinct_rows` counts rows that differ by more than rounding. `unknown_inputs` are, by name, the shares of
    the variance of a rate caused by uncertain values of an input between rows; NaN if there are too few rows, empty
    without inputs. `held_inputs` names all held inputs. `digits` is the number of digits of a rounded target, else
    None.

    `stopped` names the stage that the time limit or, with `is_cancelled`, the user stopped; else it is empty.
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
    constants: Sequence[Estimate] = ()
    unit_coefficients: Sequence[Estimate] = ()
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
        if self.has_outliers:  # outliers must not decide
            residuals = clip_outliers(residuals)
            innovations = None if innovations is None else clip_outliers(innovations)
        statistics = residual_statistics(
            residuals, self.noise, self.parameters, self.reference, innovations, self.covariance
        )
        return replace(statistics, patterned=min(self.orders * statistics.patterned, 1.0))

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
        """Return `share` times the variance of the noise, over the variance of the state.

        At most the largest departure that residuals of this size can hide.
        """
        return min(share * self.relative_noise**2, self.largest_departure) if self.rows else math.inf


class Finding(NamedTuple):
    """The outcome of a check, see `Check`."""

    outcome: CheckOutcome
    reason: str
    value: float | None = None
    limit: float | None = None
    power: float | None = None


@dataclass(frozen=True)
class Rule:
    """A check: its `name`, the quantity it `measures`, its `limit` in words, and the `kinds` of job it applies to.

    `find` measures the quantity; it returns None if the equation was not simulated or has no value on some rows. Checks
    with `is_exactness` are needed for the grade `exact` alone.
    """

    name: str
    measures: str
    limit: str
    kinds: Sequence[JobKind]
    find: Callable[[Evidence], Finding | None]
    is_exactness: bool = False


@dataclass(frozen=True)
class Verdict:
    """The `grade` of an equation, the `reason` as a sentence, and the `checks` that it follows from."""

    grade: Grade
    reason: str
    checks: tuple[Check, ...]


# ---------------------------------------------------------------------------------------------------------- verdict


def judge(evidence: Evidence) -> Verdict:
    """Return the verdict on an equation.

    `no model`: it explains less than a tenth of the variance. `doubtful`: a check that applies has failed, was not
    made, or could not detect a relevant departure. `exact`: the checks of exactness have passed as well. `good`: else.
    """
    checks, exactness = make_checks(evidence), make_checks(evidence, of_exactness=True)
    explained = next((check for check in checks if check.name == "explained variance"), None)
    if explained is not None and explained.outcome == "failed":
        return Verdict("no model", sentence([explained.reason]), checks)
    against = failures(checks)
    if against:
        return Verdict("doubtful", sentence(against), checks)
    precise, *others = exactness
    if precise.outcome == "passed":
        unsure = [check.reason for check in others if check.outcome not in ("passed", "not applicable")]
        return Verdict("good" if unsure else "exact", sentence([precise.reason, *unsure]), (*checks, *exactness))
    return Verdict("good", sentence(_merits(evidence, checks)), checks)


def make_checks(evidence: Evidence, *, of_exactness: bool = False) -> tuple[Check, ...]:
    """Return the checks of an equation that apply to its kind of job, in the order of their weight."""
    return tuple(
        check_of(rule.name, rule.find(evidence) or Finding("not made", _unsimulated(evidence)))
        for rule in RULES
        if rule.is_exactness == of_exactness and evidence.kind in rule.kinds
    )


def check_of(name: str, finding: Finding) -> Check:
    """Return a check; one that has passed but could not detect a relevant departure counts as not made."""
    power = finding.power
    if finding.outcome == "passed" and power is not None and power > SETTINGS.inference.part:
        least = f"below {percent(power)} of the variance" if math.isfinite(power) else "of any size"
        reason = f"the check of {name} cannot detect errors of the model {least}: measure more rows, or with less noise"
        finding = finding._replace(outcome="not made", reason=reason)
    return Check(name=name, **finding._asdict())


def with_objection(verdict: Verdict, name: str, outcome: CheckOutcome, reason: str) -> Verdict:
    """Return a verdict with a further check that has failed or was not made: the verdict is at best doubtful."""
    checks = (*verdict.checks, check_of(name, Finding(outcome, reason)))
    if verdict.grade in ("no model", "doubtful"):
        return Verdict(verdict.grade, verdict.reason, checks)
    return Verdict("doubtful", sentence([reason]), checks)


def failures(checks: Sequence[Check]) -> list[str]:
    """Return the reasons of checks that speak against an equation: failed ones, then those that were not made."""
    failed = [check.reason for check in checks if check.outcome == "failed"]
    unmade = dict.fromkeys(check.reason for check in checks if check.outcome == "not made")
    if failed:
        unmade.pop(_UNSIMULATED, None)  # the check of the simulation itself has said so
    return [*failed, *unmade]


def sentence(clauses: Sequence[str]) -> str:
    """Return the first two clauses as a sentence; with two, their advice follows in sentences of its own."""
    if len(clauses) == 1:
        return _capitalised(clauses[0])
    parts = [_ADVICE.split(clause, maxsplit=1) for clause in clauses[:2]]
    advice = dict.fromkeys(part for _, *rest in parts for part in rest)
    return " ".join(map(_capitalised, [", and ".join(part[0] for part in parts), *advice]))


def _capitalised(clause: str) -> str:
    return clause[0].upper() + clause[1:] + "."


def _merits(evidence: Evidence, checks: Sequence[Check]) -> list[str]:
    """Return why an equation is good, as one clause: residuals, then predictions, separated by semicolons."""
    reasons = {check.name: check.reason for check in checks if check.outcome != "not applicable"}
    size = next((reasons[name] for name in ("residual size", "rows left out") if name in reasons), "")
    pattern = reasons.get("residual pattern", "")
    if pattern.startswith("a term"):
        has_told = evidence.solver is not None or evidence.left <= SETTINGS.inference.exact
        size, pattern = size if has_told else f"{size}; {pattern}", ""
    if size.startswith("the residuals") and pattern:
        size, pattern = f"{size} and {pattern.removeprefix('the residuals ')}", ""
    merits = [merit for merit in (size, pattern) if merit]
    merits += [reasons[name] for name in ("held-out trajectories", "long run") if name in reasons]
    known = evidence.prediction
    if known is not None and known.reached is not None:
        merits.append(
            f"from other initial states within the measured range it reaches {known.reached:.3g}, outside of this "
            f"range: measure from {_where(known)} to test this"
        )
    return ["; ".join(merits) or "all checks have passed"]


# ------------------------------------------------------------------------------------------------------- simulation

_UNSIMULATED: Final = "it was not simulated along the trajectories"


def _unsimulated(evidence: Evidence) -> str:
    if evidence.kind != "target":
        return _UNSIMULATED
    return "the equation has no finite value on some rows: leave out divisions and logarithms, or these rows"


def _explained(evidence: Evidence) -> Finding:
    least = SETTINGS.inference.part
    if evidence.kind != "target" and evidence.residuals:
        r2 = 1.0 - evidence.left**2
        what = f"its simulation explains too little of the measurements (R2 {r2_text(r2)})"
    elif not math.isfinite(evidence.error):
        return Finding("failed", "its error is not finite", None, least)
    elif evidence.target_r2 is None:
        return Finding("not made", "the target does not vary")
    else:
        r2 = evidence.target_r2
        what = "it is not" if evidence.is_known else "no equation was found that is"
        what += f" much better than a constant (R2 {r2_text(r2)} on the target)"
    if r2 >= least:  # NaN explains nothing
        return Finding("passed", f"R2 {r2_text(r2)}", r2, least)
    return Finding("failed", what, r2, least)


def _simulated(evidence: Evidence) -> Finding:
    if not evidence.is_unsimulated:
        return Finding("passed", "it was simulated along the trajectories")
    return Finding("failed", "it was not simulated along the trajectories; it was fitted to the derivatives only")


def _time(evidence: Evidence) -> Finding:
    if not evidence.stopped:
        return Finding("passed", "no time limit was reached")
    if evidence.is_cancelled:
        return Finding("not made", f"the job was cancelled before {evidence.stopped}: let it run on")
    return Finding("not made", f"the time limit stopped {evidence.stopped}: give more time with --max-time")


def _freedom(evidence: Evidence) -> Finding | None:
    if not evidence.residuals:
        return None
    rows = evidence.rows if evidence.distinct_rows is None else min(evidence.rows, evidence.distinct_rows)
    free = rows - evidence.parameters
    if free >= 1.0:
        return Finding("passed", f"{free:.0f} rows more than fitted numbers", free, 1.0)
    which = "rows" if rows == evidence.rows else "rows that differ"
    reason = f"{evidence.parameters:.0f} numbers were fitted to {rows} {which}, so that no rows are left to test them"
    return Finding("failed", f"{reason}: measure more rows", free, 1.0)


def _null(evidence: Evidence) -> Finding | None:
    nats, least = evidence.null_nats, SETTINGS.inference.chance_nats
    if nats is None:
        return None
    if nats >= least:
        reason = f"it describes the rows better than no equation (Δ log-likelihood {nats:.3g})"
        return Finding("passed", reason, nats, least)
    what = "a constant" if evidence.kind == "target" else "a constant or a random walk"
    reason = f"{what} describes the rows about as well (Δ log-likelihood {nats:.2g}): measure more rows"
    return Finding("failed", reason, nats, least)


def _held_out(evidence: Evidence) -> Finding:
    r2 = evidence.held_out_r2
    if r2 is None:
        return Finding("not applicable", "no trajectory was held out or left out")
    which = "trajectories left out one at a time" if evidence.is_cross_validated else "held-out trajectories"
    least = 1.0 - evidence.relative_noise**2 - SETTINGS.inference.part
    if r2 >= least:
        return Finding("passed", f"R2 of {which}: {r2_text(r2)}", r2, least)
    return Finding("failed", f"the R2 of {which} is only {r2_text(r2)}", r2, least)


def _residual_size(evidence: Evidence) -> Finding | None:
    if not evidence.residuals:
        return None
    if not evidence.is_noisy:
        return _size_without_noise(evidence)
    statistics, limit, left = evidence.statistics, SETTINGS.inference.excess, evidence.left
    power = evidence.departure(max(statistics.seen_ratio**2 - 1.0, 0.0))
    size = f"the residuals ({percent(left)} of the standard deviation)"
    if statistics.ratio > limit and statistics.too_large < SETTINGS.inference.improbable:
        reason = f"{size} are {statistics.ratio:.2g} times the noise (p = {statistics.too_large:.1g})"
        return Finding("failed", reason, statistics.ratio, limit, power)
    noise = percent(evidence.relative_noise)
    reason = f"{size} agree with the noise ({noise})"
    if evidence.is_noise_residual:
        reason = f"{size} look like noise in these few rows"
        power = evidence.largest_departure
    if _are_of_integration(evidence):
        reason = f"{size} are as small as integration errors, although the noise was estimated as {noise}"
    if not evidence.is_noise_residual and statistics.ratio > limit:
        reason = f"{size} may be noise ({noise} by these few rows)"
    return Finding("passed", reason, statistics.ratio, limit, power)


def _size_without_noise(evidence: Evidence) -> Finding:
    left, negligible = evidence.left, SETTINGS.common.negligible
    limit = max(SETTINGS.inference.exact, 2.0 * evidence.relative_noise)
    reason = f"there is no noise, and the residuals are {percent(left)} of the standard deviation"
    if evidence.solver is not None:
        reason += f": these are the rows that {evidence.solver}, computes from the equations"
    elif evidence.are_errors_summed and 1.0 - left * left >= 1.0 - SETTINGS.inference.part:
        reason += ", since errors accumulate along trajectories, like the errors of a solver"
    elif left > negligible and _exceeds(evidence):
        return Finding("failed", reason.replace("noise, and", "noise, but"), left, limit)
    elif left > negligible:
        reason = f"the residuals ({percent(left)} of the standard deviation) may be noise in these few rows"
    elif left > limit:
        limit = negligible  # errors of integration, or a departure that no prediction shows
    return Finding("passed", reason, left, limit, evidence.largest_departure)


def _exceeds(evidence: Evidence) -> bool:
    """Tell whether residuals are larger than the noise of an interpolated state can be (F test).

    The noise is estimated from second differences, which have 18/35 as many degrees of freedom as rows.
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


def _residual_pattern(evidence: Evidence) -> Finding | None:
    if not evidence.residuals:
        return None
    statistics, limit = evidence.statistics, SETTINGS.inference.part
    if not statistics.standard_deviation > 0.0:
        return Finding("not applicable", "there are no residuals")
    if _are_of_integration(evidence):
        reason = f"a term of {percent(evidence.left)} of the standard deviation would look like integration errors"
        return Finding("passed", reason, statistics.correlation, limit, evidence.largest_departure)
    seen = statistics.seen_correlation
    power = evidence.departure(seen / (1.0 - seen) if seen < 1.0 else math.inf)
    if statistics.correlation > limit and statistics.patterned < SETTINGS.inference.improbable:
        share = percent(min(statistics.correlation, 1.0))
        reason = f"{share} of the residual variance follows a pattern (p = {statistics.patterned:.1g})"
        return Finding("failed", reason, statistics.correlation, limit, power)
    reason = "the residuals show no pattern"
    if evidence.innovations is not None:
        reason = "the residuals are correlated like errors of a sensor and show no other pattern"
    return Finding("passed", reason, statistics.correlation, limit, power)


def _whole(evidence: Evidence) -> Finding | None:
    if not evidence.residuals:
        return None
    if evidence.chaos is not None:
        return Finding("not applicable", "the model is chaotic, and its long run is compared instead")
    if evidence.fits_whole:
        return Finding("passed", "whole trajectories are simulated")
    if evidence.fits_whole is False:
        reason = f"it describes pieces of {evidence.piece} rows but not whole trajectories: a term that matters in the "
        return Finding("failed", f"{reason}long run is missing")
    if evidence.predictable_rows is not None:
        reason = (
            f"errors of initial states grow so fast that only {evidence.predictable_rows} rows can be predicted, and "
            "the long run of a model with inputs is not compared: measure shorter trajectories"
        )
        return Finding("not made", reason)
    reason = f"only pieces of {evidence.piece} rows were simulated, not whole trajectories"
    return Finding("not made", f"{reason}: sample less often, or measure shorter trajectories")


def _long_run(evidence: Evidence) -> Finding | None:
    """Check a chaotic model by a simulation much longer than its trajectories can be predicted."""
    chaos, limit = evidence.chaos, SETTINGS.inference.improbable
    if chaos is None and not evidence.residuals:
        return None
    if chaos is None:
        return Finding("not applicable", "whole trajectories are tested, or no chaos was found")
    value = chaos.probability
    if chaos.is_kept:
        reason = (
            f"chaotic: errors grow by a factor of e in {chaos.lyapunov_time or 0.0:.2g}, and a long simulation keeps "
            "the measured means and variances"
        )
        return Finding("passed", reason, value, limit)
    if chaos.is_unfinished:
        reason = "a long simulation needs more integration steps than are allowed: its end is not known"
        return Finding("not made", reason, value, limit)
    if value is None:
        return Finding("failed", "a long simulation diverges from the measured range", value, limit)
    reason = f"the means or variances of a long simulation differ from the measured ones (p = {value:.1g})"
    return Finding("failed", reason, value, limit)


# ------------------------------------------------------------------------------------------------------- prediction


def _other_starts(evidence: Evidence) -> Finding | None:
    """Check whether predictions from other initial states within the measured range can be trusted."""
    known, limit = evidence.prediction, 1.0 - math.exp(-SETTINGS.inference.distinct_nats)
    if not evidence.residuals:
        return None
    if known is None:
        return Finding("not made", f"predictions from other initial states were not tested: {evidence.unpredicted}")
    starts, unfinished, probability = known.starts or 0, known.unfinished or 0, known.probability or 0.0
    lost = starts - (known.followed or 0) - unfinished
    if lost:
        reason = f"from {lost} of {starts} other initial states within the measured range its simulation diverges"
        return Finding("failed", reason, probability, limit)
    if unfinished:
        reason = (
            f"from {unfinished} of {starts} other initial states within the measured range its simulation needs more "
            "integration steps than are allowed: its end is not known"
        )
        return Finding("not made", reason, probability, limit)
    if 1.0 - probability > math.exp(-SETTINGS.inference.distinct_nats):
        reason = (
            "alternative models that fit about as well predict something different from other initial states within "
            f"the measured range ({percent(probability)} of the odds agree): measure from {_where(known)} to decide"
        )
        return Finding("failed", reason, probability, limit)
    where = " near the measured ones" if evidence.is_near else ""
    reason = f"{percent(probability)} of the odds agree from {starts} other initial states{where}"
    return Finding("passed", reason, probability, limit)


def _to_decide(known: Prediction | None) -> str:
    """Return the advice where to measure, behind a colon; empty without a prediction."""
    return "" if known is None else f": measure from {_where(known)} to decide"


def _where(known: Prediction) -> str:
    return ", ".join(f"{name} = {value:.3g}" for name, value in (known.measure_from or {}).items())


# ----------------------------------------------------------------------------------------------------------- target


def _target_noise(evidence: Evidence) -> Finding:
    """Check the uncertainty of the target: many wrong equations fit an uncertain target as well as the law does."""
    uncertainty, most = evidence.target_uncertainty, SETTINGS.inference.largest_uncertainty
    if uncertainty <= most:
        return Finding("passed", f"the target is uncertain by {percent(uncertainty)}", uncertainty, most)
    reason = f"the target itself is uncertain by {percent(uncertainty)} of its standard deviation"
    return Finding("failed", reason, uncertainty, most)


def _predicted_rows(evidence: Evidence) -> Finding:
    """Check the rows left out of a fit: a good equation predicts them with an R2 above 0.9.

    If the target is uncertain, the R2 need not be higher than this uncertainty allows.
    """
    r2 = evidence.predicted_r2
    if r2 is None:
        return Finding("not made", "the equation has no finite value on some rows, so that no row can be left out")
    least = 1.0 - SETTINGS.inference.part - min(2.0 * evidence.target_uncertainty, 1.0) ** 2
    if r2 >= least:
        return Finding("passed", f"leave-one-out R2 of the rows: {r2_text(r2)}", r2, least)
    return Finding("failed", f"the leave-one-out R2 of the rows is only {r2_text(r2)}", r2, least)


# ------------------------------------------------------------------------------------------------------------ model


def _distinct(evidence: Evidence) -> Finding | None:
    count, least = evidence.distinct_rows, SETTINGS.common.fewest_rows
    if count is None:
        return None
    if count >= least:
        return Finding("passed", f"{count} rows differ", count, least)
    reason = f"only {count} rows differ, and many equations fit so few: measure at other times or points"
    return Finding("failed", reason, count, least)


def _inputs(evidence: Evidence) -> Finding:
    most, shares = SETTINGS.inference.part, evidence.unknown_inputs
    if not shares:
        return Finding("not applicable", "the equations have no input")
    unestimated = [one for one, share in shares.items() if math.isnan(share)]
    if unestimated:
        return Finding(
            "not made", f"there are too few rows to estimate {_quoted(unestimated)} between them: sample more rows"
        )
    unknown, worst = [one for one, share in shares.items() if share > most], max(shares.values())
    if not unknown:
        reason = f"uncertain inputs between rows cause at most {percent(worst)} of the variance of a rate"
        return Finding("passed", reason, worst, most)
    held, verb = listed(sorted({*evidence.held_inputs, *unknown})), "is" if len(unknown) == 1 else "are"
    reason = (
        f"{_quoted(unknown)} {verb} uncertain between rows, which causes {percent(worst)} of the variance of a rate: "
        f"add --hold {held} if {_quoted(unknown)} {verb} constant from row to row, else sample faster, or with less "
        "noise"
    )
    return Finding("not made", reason, worst, most)


def _quoted(names: Sequence[str]) -> str:
    return " and ".join(f"'{name}'" for name in names)


def _poles(evidence: Evidence) -> Finding | None:
    if not evidence.residuals:
        return None
    if not evidence.passes_pole:
        return Finding("passed", "its simulation passes no pole")
    # such as the pole of 6e-13/(3e-12 - x**3), by which a state seems to be switched
    return Finding(
        "failed", "its simulation passes a pole, where the equation has no value: measure there, or leave out divisions"
    )


def _alternatives(evidence: Evidence) -> Finding | None:
    nats, least = evidence.alternative, SETTINGS.inference.distinct_nats
    if nats is None and not evidence.residuals:
        return None
    if nats is None:
        reason = "no other equation with as few constants, which predicts something else, was compared"
        return Finding("not applicable", reason)
    if nats >= least:
        reason = f"the best other equation with as few constants fits worse (Δ description length {nats:.3g})"
        return Finding("passed", reason, nats, least)
    where = _to_decide(evidence.prediction) if evidence.rivals_agree else ""
    reason = f"another equation describes the data about as well (Δ description length {nats:.2g}){where}"
    return Finding("failed", reason, nats, least)


def _constants(evidence: Evidence) -> Finding | None:
    constants = evidence.constants
    if not constants and evidence.is_unsimulated:
        return None
    if evidence.unfitted:
        many = f"{evidence.unfitted} constants" if evidence.unfitted > 1 else "constant"
        reason = f"the errors of its {many} are not known: ask for a shorter equation with --max-size"
        return Finding("not made", reason)
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


def _precision(evidence: Evidence) -> Finding:
    """Check whether the residuals are as small as rounding and integration errors."""
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
                f"without noise, the rows are those that {evidence.solver}, computes from the equations, up to "
                f"{error:.1g} of the standard deviation"
            )
    return Finding("passed" if is_met else "failed", reason, error, limit)


def _loosest(evidence: Evidence) -> Finding:
    """Check that all constants are known as precisely as in an exact law.

    Dropping a constant whose estimate is t standard errors away from zero costs about t^2/2 nats. In data without noise
    a term of the law gains millions of nats, a term that follows integration errors gains tens. Redundant factors of
    one, such as the factors of x*y in x*y - x*(y - x), have no errors and do not count.
    """
    limit = SETTINGS.common.negligible
    shares = [
        (constant.std_error / max(abs(constant.estimate), 1e-300), constant.value or 0.0)
        for constant in (*evidence.constants, *evidence.unit_coefficients)
        if constant.std_error is not None
    ]
    if not shares:
        return Finding("not applicable", "no constant has a standard error")
    share, value = max(shares)
    if share <= limit:
        return Finding("passed", f"all constants are known to {percent(share)} or better", share, limit)
    certainty = f"is known to {percent(share)} only" if share < _UNKNOWN else "is not distinguishable from 0"
    return Finding(
        "failed", f"the constant {value:.3g} {certainty}: its term may describe errors of the data", share, limit
    )


def _digits(evidence: Evidence) -> Finding:
    """Check that constants have no more digits than the values: longer ones may follow the rounding errors.

    A wave in the last digit of a column can reproduce the rounding of every row.
    """
    most = evidence.digits
    if most is None:
        return Finding("not applicable", "the values are not rounded")
    values = (constant.value or 0.0 for constant in evidence.constants)
    count = max((len(Decimal(repr(value)).normalize().as_tuple().digits) for value in values), default=0)
    if count <= most:
        return Finding("passed", f"constants have {count} digits at most, and the values {most}", count, most)
    reason = f"a constant has {count} digits and the values {most}: its term may describe rounding errors"
    return Finding("failed", reason, count, most)


def _undecided(evidence: Evidence) -> Finding:
    """Check that no other equation may be the law of a table without noise."""
    limit = math.exp(-SETTINGS.inference.exact_nats)
    if evidence.rivals <= limit:
        return Finding("passed", "no other equation fits as well", evidence.rivals, limit)
    share = evidence.rivals / (1.0 + evidence.rivals)
    reason = (
        "the data do not distinguish it from other equations that agree on the measured trajectories and differ "
        f"elsewhere ({percent(share)} of the odds){_to_decide(evidence.prediction)}"
    )
    return Finding("failed", reason, evidence.rivals, limit)


def _chance(evidence: Evidence) -> Finding | None:
    """Check that the equation is likelier than no equation by odds of 200, as `exact` requires."""
    nats, least = evidence.null_nats, SETTINGS.inference.exact_nats
    if nats is None:
        return None
    reason = f"it describes the rows better than no equation (Δ log-likelihood {nats:.2g}; {least} is needed)"
    return Finding("passed" if nats >= least else "failed", reason, nats, least)


# ------------------------------------------------------------------------------------------------------------ table

_SIMULATED: Final[Sequence[JobKind]] = ("trajectories", "groups")
_TARGET: Final[Sequence[JobKind]] = ("target",)
_ALL: Final = (*_SIMULATED, *_TARGET)
"""The steps of a process have checks of their own, see `stochastic.conclusion`."""

# name, quantity measured, limit, kinds of job, function; the most important checks come first, also in the sentence
RULES: Final[Sequence[Rule]] = (
    Rule("explained variance", "R2 of the simulation, or on the target", "0.1", _ALL, _explained),
    Rule("simulation", "whether the trajectories could be simulated", "all", _SIMULATED, _simulated),
    Rule("time", "stages that the time limit stopped", "nothing", _ALL, _time),
    Rule("degrees of freedom", "rows minus the numbers fitted to them", "1", _ALL, _freedom),
    Rule("distinct rows", "rows that differ by more than rounding", "5", _ALL, _distinct),
    Rule("inputs between rows", "share of the variance of a rate that is not known", "0.1", _SIMULATED, _inputs),
    Rule("no equation", "Δ log-likelihood over a constant and a random walk", "4.6", _ALL, _null),
    Rule("held-out trajectories", "R2 of trajectories left out", "0.9 minus the noise", _SIMULATED, _held_out),
    Rule("rows left out", "R2 of rows left out one at a time", "0.9", _TARGET, _predicted_rows),
    Rule("target uncertainty", "uncertainty of the target", "0.01", _TARGET, _target_noise),
    Rule("residual size", "residuals over the noise", "1.25, p < 0.01", _SIMULATED, _residual_size),
    Rule("residual pattern", "correlation of neighbouring residuals", "0.1, p < 0.01", _ALL, _residual_pattern),
    Rule("whole trajectories", "whether whole trajectories are described", "all", _SIMULATED, _whole),
    Rule("long run", "means and variances of a chaotic model", "p < 0.01", _SIMULATED, _long_run),
    Rule("other initial states", "odds of models that predict the same", "0.95", _SIMULATED, _other_starts),
    Rule("poles", "poles that the simulation passes", "none", _SIMULATED, _poles),
    Rule("alternative equations", "Δ description length of the next best equation", "3", _ALL, _alternatives),
    Rule("constants", "constants that the data do not determine", "none", _ALL, _constants),
    Rule("precision", "residuals without noise", "1e-6, or rounding", _ALL, _precision, is_exactness=True),
    Rule("odds against chance", "Δ log-likelihood over no equation", "5.3", _ALL, _chance, is_exactness=True),
    Rule("precision of constants", "standard error over estimate", "1e-3", _ALL, _loosest, is_exactness=True),
    Rule("digits of constants", "digits of constants and values", "as many", _TARGET, _digits, is_exactness=True),
    Rule("other laws", "odds of other equations", "1/200", _SIMULATED, _undecided, is_exactness=True),
)


# ------------------------------------------------------------------------------------------------------------- text


def percent(share: float) -> str:
    """Return a share in percent, two digits of it."""
    return f"{100.0 * share:.2g} %" if share < 0.995 else f"{100.0 * share:.0f} %"


def r2_text(value: float) -> str:
    """Return R2 in up to four decimals, never rounded up to 1."""
    return f"{math.floor(value * 1e4) / 1e4:.4g}" if math.isfinite(value) else str(value)
