"""How far the equation of a variable can be trusted: a grade, and one sentence with the reason. Pure.

A model that was fitted to trajectories is judged by what its simulation leaves of the measurements, by what its
constants are known to, and by the next best equation. Without trajectories (labels or derivatives were given) there is
only the error on the target. The rules and limits: ADR 0020.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from atoll_coordinator.model.inference.residuals import Check, ReferenceSmoother, check
from atoll_coordinator.model.refinement import Chaos, Constant, Grade, Prediction
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import EXACT_ERROR, FloatArray

_UNKNOWN: Final = 10.0
"""Standard errors over an estimate from which on percents say nothing: they have hundreds of digits where it is 0."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of the equation of one variable. Defaults stand for what is not known.

    Of the target, on the rows of the search: `error` is the normalized error, `target_uncertainty` that of the target
    and `convergence_threshold` the normalized error at most which an equation has converged when the job asks for none;
    `target_r2` is the share of the target's variance that is explained.

    Of the simulation: `residuals` has (R,) numbers for each piece of a trajectory, measured minus simulated values of
    this state; a model is simulated to the end of all of them or of none. `parameters` is how many numbers were fitted
    to them: constants and initial values, each shared by as many states as it was fitted to. `noise` is
    the smoother's estimate of the measurement errors (0 for a state that was interpolated), or where they go together
    that of such errors, and `innovations` are what is left of the residuals without that; `standard_deviation` is
    that of what was measured, in the state's unit as the noise; `reference` judges the variance of the residuals, None
    where the noise is known; `are_errors_summed` tells that errors add up along trajectories, as those of a solver do,
    and that constants were fitted to short pieces therefore; `has_outliers` makes the checks robust. `held_out_r2` is
    the R2 of the simulations of held-out trajectories; with `is_cross_validated`, of those left out one at a time.

    Of the model: `constants`, as they are reported, and `unit_coefficients`, factors of one that are not written;
    `alternative` is how many nats longer the description is with the next best equation that is another function and
    has no more constants; `prediction` is how far the state can be foretold from other initial states, None where that
    is not known; `chaos` is what is known of a model whose courses cannot be foretold for long; `fails_beyond` is how
    many rows long the pieces are that it describes where it does not describe whole trajectories, None where it does or
    that is not known; `passes_pole` tells that its simulation goes through a point where this equation has no finite
    value; `distinct_rows` counts rows that differ by more than rounding, None where that is not known; `is_known` tells
    that the equation was given; `solver` names the one that computed the table, whose errors are not in the residuals;
    `is_unsimulated` tells that there are trajectories, along which it was not simulated.
    """

    error: float = math.inf
    target_uncertainty: float = 0.0
    target_r2: float | None = None
    residuals: Sequence[FloatArray] = ()
    parameters: float = 0.0
    noise: float = 0.0
    standard_deviation: float = 1.0
    reference: ReferenceSmoother | None = None
    are_errors_summed: bool = False
    has_outliers: bool = False
    held_out_r2: float | None = None
    is_cross_validated: bool = False
    constants: Sequence[Constant] = ()
    unit_coefficients: Sequence[Constant] = ()
    alternative: float | None = None
    rivals: float = 0.0
    rivals_agree: bool = False
    prediction: Prediction | None = None
    chaos: Chaos | None = None
    fails_beyond: int | None = None
    passes_pole: bool = False
    distinct_rows: int | None = None
    is_known: bool = False
    is_unsimulated: bool = False
    innovations: Sequence[FloatArray] | None = None
    solver: str | None = None
    convergence_threshold: float = EXACT_ERROR

    @property
    def is_simulated(self) -> bool:
        """Whether the model was fitted to trajectories."""
        return bool(self.residuals)


def judge(evidence: Evidence) -> tuple[Grade, str]:
    """Return the grade of an equation, and the reason in one sentence."""
    if evidence.is_simulated:
        return _by_simulation(evidence)
    return _by_target(evidence)


def _by_simulation(evidence: Evidence) -> tuple[Grade, str]:
    residuals = check(
        evidence.residuals, evidence.noise, evidence.parameters, evidence.reference, evidence.innovations,
        is_robust=evidence.has_outliers,
    )  # fmt: skip
    left = residuals.standard_deviation / evidence.standard_deviation
    r2 = 1.0 - left * left
    if not r2 >= SETTINGS.inference.part:  # NaN explains nothing
        return "no model", f"Its simulation explains too little of the measurements (R2 {_r2(r2)})."
    objections = [
        *_objections_to_simulation(evidence, residuals),
        *_objections_to_attractor(evidence.chaos),
        *_objections_to_prediction(evidence.prediction),
        *_objections_to_model(evidence),
    ]
    if objections:
        return "doubtful", _sentence(objections)
    if evidence.noise <= SETTINGS.common.clean * evidence.standard_deviation and left <= max(
        SETTINGS.inference.exact, 2.0 * evidence.noise / evidence.standard_deviation
    ):
        missed = f"without noise, the simulation misses the measurements by {left:.1g} of their deviation"
        if evidence.solver is not None:
            missed = (
                f"without noise: {evidence.solver}, gives these rows of the equations to {left:.1g} of their deviation"
            )
        unsure = _loosest(evidence) or _undecided(evidence)
        return ("exact", _sentence([missed])) if unsure is None else ("good", _sentence([missed, unsure]))
    return "good", _sentence([_merit_of_simulation(evidence, residuals)])


def _loosest(evidence: Evidence) -> str | None:
    """Return what is to be said of the constant that is known least, None when all are known as in an exact law.

    Dropping a constant of which the estimate is t standard errors away from zero costs about t^2/2 nats. In data
    without noise a law stands out by millions of nats, while terms that follow the errors of a simulation do by tens.
    Factors of one of which some stand for others, as those of x*y in x*y - x*(y - x), have no errors and do not count.
    """
    known = [
        (
            constant.std_error / max(abs(constant.value if constant.fitted is None else constant.fitted), 1e-300),
            constant.value,
        )
        for constant in (*evidence.constants, *evidence.unit_coefficients)
        if constant.std_error is not None and math.isfinite(constant.std_error)
    ]
    share, value = max(known, default=(0.0, 0.0))
    if share <= SETTINGS.common.negligible:
        return None
    certainty = f"is known to {_percent(share)} only" if share < _UNKNOWN else "cannot be told from 0"
    return f"the constant {value:.3g} {certainty}: its term may follow errors of the data"


def _undecided(evidence: Evidence) -> str | None:
    """Return what the data do not tell from an equation that may be the law, None where that is hardly another one."""
    if evidence.rivals <= math.exp(-SETTINGS.inference.exact_nats):
        return None
    share = evidence.rivals / (1.0 + evidence.rivals)
    return (
        f"it cannot be told from other equations, which agree along what was measured and differ beside it "
        f"({_percent(share)} of the odds){_to_decide(evidence.prediction)}"
    )


def _by_target(evidence: Evidence) -> tuple[Grade, str]:
    is_converged = evidence.error <= evidence.convergence_threshold
    if evidence.target_uncertainty <= SETTINGS.common.clean and is_converged and not evidence.is_unsimulated:
        return "exact", f"The error, {evidence.error:.1g} of the target's deviation, is at the level of rounding."
    if not math.isfinite(evidence.error):
        return "no model", "Its error is not finite."
    is_at_floor = evidence.error <= 2.0 * evidence.target_uncertainty
    r2 = evidence.target_r2
    if r2 is not None and r2 < SETTINGS.inference.part:
        what = (
            "It is not much better than a constant"
            if evidence.is_known
            else "Nothing much better than a constant was found"
        )
        return "no model", f"{what} (R2 {_r2(r2)} on the target)."
    objections = [*_objections_to_target(evidence, is_at_floor=is_at_floor), *_objections_to_model(evidence)]
    if objections:
        return "doubtful", _sentence(objections)
    return "good", _sentence([_merit_of_target(evidence, is_at_floor=is_at_floor)])


def _objections_to_simulation(evidence: Evidence, residuals: Check) -> Iterator[str]:
    """Yield what speaks against the simulation, the worst first."""
    left = residuals.standard_deviation / evidence.standard_deviation
    noise = evidence.noise / evidence.standard_deviation
    if evidence.held_out_r2 is not None and evidence.held_out_r2 < 1.0 - noise * noise - SETTINGS.inference.part:
        yield f"{_unseen(evidence)} are simulated with R2 {_r2(evidence.held_out_r2)} only"
    if left <= SETTINGS.common.negligible:
        return
    if noise <= SETTINGS.common.clean:
        if evidence.are_errors_summed and 1.0 - left * left >= 1.0 - SETTINGS.inference.part:
            return
        yield f"there is no noise, but the simulation misses the measurements by {_percent(left)} of their deviation"
        return
    if residuals.ratio > SETTINGS.inference.excess and residuals.too_large < SETTINGS.inference.improbable:
        yield (
            f"the simulation misses the measurements by {_percent(left)} of their deviation, "
            f"{residuals.ratio:.2g} times the noise (p = {residuals.too_large:.1g})"
        )
    if residuals.correlation > SETTINGS.inference.part and residuals.patterned < SETTINGS.inference.improbable:
        share = _percent(min(residuals.correlation, 1.0))
        yield f"about {share} of what it leaves follows a pattern (p = {residuals.patterned:.1g})"


def _objections_to_attractor(chaos: Chaos | None) -> Iterator[str]:
    """Yield what speaks against a model by a simulation far longer than errors of an initial state can be carried."""
    if chaos is None or chaos.is_kept:
        return
    if chaos.is_unfinished:
        yield "a long simulation takes more steps than are allowed, so that it is not known where it leads"
    elif chaos.probability is None:
        yield "a long simulation runs away from what was measured"
    else:
        yield f"means or variances of a long simulation are not those measured (p = {chaos.probability:.1g})"


def _objections_to_prediction(prediction: Prediction | None) -> Iterator[str]:
    """Yield what speaks against relying on the model elsewhere in the measured box, and what to measure."""
    if prediction is None:
        return
    lost = prediction.starts - prediction.followed - prediction.unfinished
    if lost:
        yield f"from {lost} of {prediction.starts} other initial states within the measured range it runs away"
    if prediction.unfinished:
        yield (
            f"from {prediction.unfinished} of {prediction.starts} other initial states within the measured range its "
            "simulation takes more steps than are allowed, so that it is not known where it leads"
        )
    if prediction.followed and 1.0 - prediction.probability > math.exp(-SETTINGS.inference.distinct_nats):
        yield (
            "rivals that describe the data about as well foretell something else from other initial states within the "
            f"measured range ({_percent(prediction.probability)} of the odds agree){_to_decide(prediction)}"
        )


def _unknown(prediction: Prediction | None) -> str:
    """Return what the data do not show although the model says something of it, behind a semicolon, or nothing."""
    if prediction is None or prediction.reached is None:
        return ""
    return (
        f"; from other initial states within the measured range it leads to {prediction.reached:.3g}, which was never "
        f"measured: measure from {_where(prediction)} to know"
    )


def _chaotic(chaos: Chaos | None) -> str:
    """Return for how long a chaotic model foretells, behind a semicolon, or nothing."""
    if chaos is None:
        return ""
    return (
        f"; chaotic: errors grow e-fold in {chaos.lyapunov_time:.2g}, and a long simulation keeps the measured means "
        "and variances"
    )


def _to_decide(prediction: Prediction | None) -> str:
    """Return what to measure, behind a colon, or nothing where that is not known."""
    return "" if prediction is None else f": measure from {_where(prediction)} to decide"


def _where(prediction: Prediction) -> str:
    return ", ".join(f"{name} = {value:.3g}" for name, value in (prediction.measure_from or {}).items())


def _objections_to_target(evidence: Evidence, *, is_at_floor: bool) -> Iterator[str]:
    if evidence.is_unsimulated:
        yield "it was not simulated along the trajectories, and fits the derivatives alone"
    if evidence.target_r2 is not None and evidence.target_r2 < 1.0 - SETTINGS.inference.part and not is_at_floor:
        yield f"it explains the target with R2 {_r2(evidence.target_r2)} only"
    if evidence.target_uncertainty > SETTINGS.inference.largest_uncertainty:
        yield f"the target itself is uncertain by {_percent(evidence.target_uncertainty)} of its deviation"


def _objections_to_model(evidence: Evidence) -> Iterator[str]:
    if evidence.distinct_rows is not None and evidence.distinct_rows < SETTINGS.checks.min_rows:
        yield (
            f"the rows repeat {evidence.distinct_rows} measurements, through which many equations lead: measure at "
            "other times"
        )
    if evidence.fails_beyond is not None:
        yield (
            f"it describes pieces of {evidence.fails_beyond} rows and not whole trajectories: what shows in the long "
            "run is missing"
        )
    if evidence.passes_pole:  # such as 6e-13/(3e-12 - x**3), by which a state seems to be switched
        yield "its simulation passes a pole, where it has no value: measure there, or leave out divisions"
    if evidence.alternative is not None and evidence.alternative < SETTINGS.inference.distinct_nats:
        nats = (
            f"{evidence.alternative:.2g} nats apart"
            if evidence.alternative >= 0.0
            else f"{-evidence.alternative:.2g} nats shorter"
        )
        where = _to_decide(evidence.prediction) if evidence.rivals_agree else ""
        yield f"another equation describes the data about as well ({nats}){where}"
    bound = next((constant for constant in evidence.constants if constant.is_at_bound), None)
    if bound is not None:
        yield f"the data would have the constant {bound.value:.3g} beyond its bound"
    loose = sum(not constant.identifiable for constant in evidence.constants)
    if loose:
        many = (
            f"{loose} of {len(evidence.constants)} constants are" if len(evidence.constants) > 1 else "its constant is"
        )
        yield f"{many} not determined by the data"


def _merit_of_simulation(evidence: Evidence, residuals: Check) -> str:
    left = residuals.standard_deviation / evidence.standard_deviation
    held_out = f"; {_unseen(evidence)}: R2 {_r2(evidence.held_out_r2)}" if evidence.held_out_r2 is not None else ""
    held_out += _unknown(evidence.prediction) + _chaotic(evidence.chaos)
    if left <= SETTINGS.common.negligible:
        return f"the simulation misses the measurements by {left:.1g} of their deviation{held_out}"
    if evidence.are_errors_summed:
        return (
            f"the simulation misses the measurements by {_percent(left)} of their deviation, by errors that add up "
            f"along trajectories, as those of a solver do{held_out}"
        )
    rest = "and without a pattern" if evidence.innovations is None else "which goes together in neighbouring rows"
    return (
        f"what the simulation leaves, {_percent(left)} of the deviation, is like the noise, "
        f"{_percent(evidence.noise / evidence.standard_deviation)}, {rest}{held_out}"
    )


def _unseen(evidence: Evidence) -> str:
    return "trajectories left out one at a time" if evidence.is_cross_validated else "held-out trajectories"


def _merit_of_target(evidence: Evidence, *, is_at_floor: bool) -> str:
    if is_at_floor:
        return f"the error is that of the target itself, {_percent(evidence.target_uncertainty)} of its deviation"
    if evidence.target_r2 is None:
        return f"the error is {_percent(evidence.error)} of the target's deviation"
    return f"it explains the target with R2 {_r2(evidence.target_r2)}; how much of the rest is noise is not known"


def _sentence(clauses: Sequence[str]) -> str:
    """Return at most two clauses as a sentence; a third is worth no more reading."""
    text = ", and ".join(clauses[:2])
    return text[0].upper() + text[1:] + "."


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.995 else f"{100.0 * share:.0f} %"


def _r2(value: float) -> str:
    """Return R2 in up to four decimals, never rounded up to 1."""
    return f"{math.floor(value * 1e4) / 1e4:.4g}" if math.isfinite(value) else str(value)
