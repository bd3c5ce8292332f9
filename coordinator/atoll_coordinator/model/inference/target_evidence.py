"""The evidence on an equation from the rows of its target alone, without trajectories to simulate. Pure.

Letters: R rows, K constants.
"""

import math
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Final

import numpy as np

from atoll_coordinator.data.differentiation.quantisation import find_quantisation
from atoll_coordinator.model.inference.null_models import log_bayes_factor, structure_price
from atoll_coordinator.model.inference.residual_covariance import projected_away
from atoll_coordinator.model.inference.verdict import Evidence
from atoll_coordinator.model.refinement import JobKind, Refined
from atoll_coordinator.model.selection.comparison import differ
from atoll_coordinator.model.shooting.points_between import points_between
from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import EXACT_ERROR, FloatArray, IntArray, Problem
from atoll_core.expression.evaluation import values_and_gradient, values_of
from atoll_core.expression.program import Program, constant_places, variables_of

_MOST_ROWS: Final = 250
"""Rows up to which the covariance of residuals is made; of more the distribution of correlations is about normal."""


@dataclass(frozen=True, eq=False)
class _Regression:
    """A program on rows, linearised about its constants.

    `errors` (R,) are target minus program, weighted; `basis` (R, K) has the derivatives by the `constants`. With
    `has_location` the constants can move all values alike.
    """

    errors: FloatArray
    basis: FloatArray
    has_location: bool
    constants: int


def target_evidence(
    shown: Refined, problem: Problem, weights: FloatArray | None, *, kind: JobKind = "target", is_known: bool = False,
    stopped: str = "",
) -> Evidence:  # fmt: skip
    """Return the evidence of the rows of a problem on the equation that is shown.

    Args:
        shown: the equation, its error and its constants.
        problem: the rows, of which at most about `RowSettings.most` are used.
        weights: (R,) of the rows, 1 on average; None: all alike.
        kind: "target", or the kind of a job along whose trajectories the equation was not simulated.
        is_known: whether the equation was given.
        stopped: the stage that was stopped.
    """
    target = problem.target
    scale = target.standard_deviation
    variance = scale * scale
    evidence = Evidence(
        kind=kind,
        error=shown.error / scale if scale else math.inf,
        target_uncertainty=target.uncertainty,
        target_r2=1.0 - shown.mse / variance if variance and math.isfinite(shown.mse) else None,
        constants=shown.constants,
        unit_coefficients=[coefficient.constant for coefficient in shown.unit_coefficients],
        unfitted=0 if is_known or shown.constants else len(constant_places(shown.program)),
        is_known=is_known,
        is_unsimulated=kind != "target",
        convergence_threshold=target.convergence_threshold(),
        stopped=stopped,
    )
    if kind != "target":
        return evidence
    evidence = replace(evidence, alternative=_nearest(shown, problem))
    return _with_rows(evidence, shown.program, problem, weights, is_known=is_known)


def _nearest(shown: Refined, problem: Problem) -> float | None:
    """Return the nats of the next best of its alternatives that says something else among the rows.

    None without one. Alternatives that agree with the equation do not count: their predictions are as good.
    """
    among = np.concatenate([problem.inputs, points_between(problem.inputs).T], axis=1)
    among = np.ascontiguousarray(among[:, np.isfinite(values_of(shown.program, among))])
    own = values_of(shown.program, among)
    others = (alternative for alternative in shown.alternatives if not alternative.is_shown)
    return min(
        (
            other.nats
            for other in others
            if differ(values_of(other.program, among), own, math.sqrt(SETTINGS.inference.part))
        ),
        default=None,
    )


def _with_rows(
    evidence: Evidence, program: Program, problem: Problem, weights: FloatArray | None, *, is_known: bool
) -> Evidence:
    """Return the evidence with residuals and rows left out."""
    places = thinned_places(len(problem.target.values), SETTINGS.rows.most)
    inputs, values = np.ascontiguousarray(problem.inputs[:, places]), problem.target.values[places]
    roots = np.ones(len(values)) if weights is None else np.sqrt(weights[places] / weights[places].mean())
    regression = _linearised(program, inputs, values, roots, is_known=is_known)
    total = _squares_about_mean(values, roots)
    if regression is None or not total > 0.0:
        return evidence
    used = sorted(variables_of(program))
    distinct = _distinct_rows(inputs[used]) if used else _distinct_rows(inputs)
    square = float(regression.errors @ regression.errors)
    predicted = regression.errors / np.maximum(1.0 - (regression.basis**2).sum(axis=1), EXACT_ERROR)
    order = _order(regression.errors, inputs, _fitted(values, roots, regression))
    weight = roots * roots
    distinct = min(distinct, int(weight.sum() ** 2 / (weight * weight).sum()))
    is_exact = evidence.error <= evidence.convergence_threshold
    free = max(len(values) - regression.constants, 1)
    price = 0.0 if is_known else structure_price(program, len(inputs)) - SETTINGS.criterion.common
    return replace(
        evidence,
        residuals=[regression.errors[order]],
        orders=len(inputs) + 1,
        covariance=projected_away(regression.basis[order], slice(None)) if len(values) <= _MOST_ROWS else None,
        parameters=float(regression.constants),
        noise=0.0 if is_exact else math.sqrt(square / free),
        standard_deviation=math.sqrt(total / len(values)),
        predicted_r2=1.0 - float(predicted @ predicted) / total,
        distinct_rows=distinct,
        null_nats=_null_nats(regression, values * roots, total, distinct, price),
        digits=_digits(problem.target.values),
    )


def _digits(values: FloatArray) -> int | None:
    """Return how many digits the values (R,) have that were rounded in decimals, None where they were not."""
    rounded = values[np.isfinite(values) & (values != 0.0)]
    quantisation = find_quantisation([values])
    if quantisation is None or quantisation.kind not in ("decimals", "digits") or not len(rounded):
        return None
    return max(len(Decimal(repr(value)).normalize().as_tuple().digits) for value in rounded.tolist())


def _linearised(
    program: Program, inputs: FloatArray, values: FloatArray, roots: FloatArray, *, is_known: bool
) -> _Regression | None:
    """Return errors of a program on rows and its derivatives by constants, None if a row has no finite value."""
    places = [] if is_known else constant_places(program)
    fitted, slopes = values_and_gradient(program, inputs, places)
    errors = (values - fitted) * roots
    if not np.isfinite(errors).all():
        return None
    columns = (np.nan_to_num(slopes, posinf=0.0, neginf=0.0) * roots).T
    sizes = np.sqrt((columns**2).sum(axis=0))
    columns = columns[:, sizes > 0.0] / sizes[sizes > 0.0]
    basis, singular, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, singular > EXACT_ERROR * singular.max(initial=0.0)]
    location = roots / math.sqrt(float(roots @ roots))
    missed = location - basis @ (basis.T @ location)
    return _Regression(errors, basis, bool(missed @ missed < SETTINGS.inference.exact), len(places))


def _fitted(values: FloatArray, roots: FloatArray, regression: _Regression) -> FloatArray:
    return np.asarray(values - regression.errors / np.maximum(roots, 1e-300))


def _order(errors: FloatArray, columns: FloatArray, fitted: FloatArray) -> IntArray:
    """Return that order of the rows, by a column or by the fitted values, in which neighbouring errors are most alike.

    The errors of an equation vary with its columns, so that they are similar on neighbouring rows.
    """
    orders = [np.argsort(key, kind="stable") for key in (*columns, fitted)]
    return max(orders, key=lambda order: float(errors[order][:-1] @ errors[order][1:]))


def _squares_about_mean(values: FloatArray, roots: FloatArray) -> float:
    weights = roots * roots
    mean = float((weights * values).sum() / weights.sum())
    return float((weights * (values - mean) ** 2).sum())


def _distinct_rows(columns: FloatArray) -> int:
    """Return how many rows of some columns differ by more than rounding."""
    scales = columns.std(axis=1)
    varying = columns[scales > 0.0] / (EXACT_ERROR * scales[scales > 0.0, None])
    return len(np.unique(np.round(varying) + 0.0, axis=1).T) if len(varying) else 1


def _null_nats(regression: _Regression, values: FloatArray, total: float, distinct: int, price: float) -> float:
    """Return by how many nats the program describes the rows better than a constant does.

    Rows of the same inputs count as one. Where the constants cannot move all values alike, both are compared with 0.

    Args:
        regression: the program.
        values: of the target (R,), weighted.
        total: their squares about their mean.
        distinct: how many rows have different inputs.
        price: nats of the structure minus the nats of a constant.
    """
    square = float(regression.errors @ regression.errors)
    if regression.has_location:
        return log_bayes_factor(distinct, max(regression.constants - 1, 0), square / total) - price
    whole = max(float(values @ values), 1e-300)
    constant = log_bayes_factor(distinct + 1, 1, total / whole)
    return log_bayes_factor(distinct + 1, regression.constants, square / whole) - constant - price
