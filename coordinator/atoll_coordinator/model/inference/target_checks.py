"""The checks of an equation on the rows of its target, if there are no trajectories: quantities, limits, clauses. Pure.

`TargetChecks` linearises the equation about its constants and sets the quantities of `EquationChecks`: residuals, their
covariance, leave-one-out R2, number of distinct rows, evidence against a constant. Rows of a target have no natural
order. So the rows are sorted by each input and by the fitted values. The order with the strongest correlation of
neighbouring residuals is tested.

Doubtful: there is no independent estimate of the noise, so the size of the residuals cannot be tested. Leave-one-out R2
is computed for a given structure; it does not show that the same rows were used to choose the structure.

Letters: R rows, K constants.
"""

import math
from decimal import Decimal
from typing import ClassVar, Final

import numpy as np

from atoll_coordinator.data.differentiation.quantisation import find_quantisation
from atoll_coordinator.model.inference.checks import EquationChecks, Finding, format_percent, format_r2, judge_r2
from atoll_coordinator.model.inference.null_models import log_bayes_factor, structure_price
from atoll_coordinator.model.inference.residual_covariance import orthonormal_basis
from atoll_coordinator.model.refinement import JobKind, Refined
from atoll_coordinator.model.selection.comparison import differ
from atoll_coordinator.model.shooting.points_between import points_between
from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import EXACT_ERROR, FloatArray, Problem
from atoll_core.expression.evaluation import values_and_gradient, values_of
from atoll_core.expression.program import constant_places, variables_of

_MOST_ROWS: Final = 250
"""Most rows for which the covariance of residuals is computed. With more rows, the distribution of correlations is
about normal."""


class TargetChecks(EquationChecks):
    """The checks of an equation on at most about `RowSettings.most` rows of its target.

    `predicted_r2` is the leave-one-out R2; None if the equation has no finite value on some rows.
    """

    kind: ClassVar[JobKind] = "target"
    default_finding: ClassVar[Finding] = Finding(
        "not made", "the equation has no finite value on some rows",
        advice="leave out divisions and logarithms, or these rows",
    )  # fmt: skip
    null_models: ClassVar[str] = "a constant"
    predicted_r2: float | None = None

    def __init__(
        self, shown: Refined, problem: Problem, weights: FloatArray | None, *, is_known: bool = False,
        stopped: str = "", is_cancelled: bool = False,
    ) -> None:  # fmt: skip
        """Set the equation that is shown, and the rows. The mean of `weights` (R,) is 1; None: all weights are
        equal."""
        super().__init__(shown, problem.target, is_known=is_known, stopped=stopped, is_cancelled=is_cancelled)
        self._problem = problem
        places = thinned_places(len(problem.target.values), SETTINGS.rows.most)
        roots = np.ones(len(places)) if weights is None else np.sqrt(weights[places] / weights[places].mean())
        self.alternative = self._nearest_alternative()
        self._set_quantities(np.ascontiguousarray(problem.inputs[:, places]), problem.target.values[places], roots)

    def _set_quantities(self, inputs: FloatArray, values: FloatArray, roots: FloatArray) -> None:
        """Set the quantities of the residuals; `roots` (R,) are the square roots of the weights.

        The equation is linearised about its constants. No quantity is set if the equation has no finite value on some
        rows, or if the target does not vary.
        """
        program, weights = self.shown.program, roots * roots
        places = [] if self.is_known else constant_places(program)
        fitted, slopes = values_and_gradient(program, inputs, places)
        errors = (values - fitted) * roots
        mean = float((weights * values).sum() / weights.sum())
        total = float((weights * (values - mean) ** 2).sum())
        if not np.isfinite(errors).all() or not total > 0.0:
            return
        basis = orthonormal_basis((np.nan_to_num(slopes, posinf=0.0, neginf=0.0) * roots).T)
        # Errors of an equation depend on columns of the table. If the rows are sorted by the right column, neighbouring
        # rows have similar errors.
        orders = [np.argsort(key, kind="stable") for key in (*inputs, values - errors / np.maximum(roots, 1e-300))]
        order = max(orders, key=lambda order: float(errors[order][:-1] @ errors[order][1:]))
        square = float(errors @ errors)
        predicted = errors / np.maximum(1.0 - (basis**2).sum(axis=1), EXACT_ERROR)
        distinct = _count_distinct(inputs[sorted(variables_of(program))] if variables_of(program) else inputs)
        self.residuals = [errors[order]]
        self.orders = len(orders)
        if len(values) <= _MOST_ROWS:
            self.covariance = np.eye(len(values)) - basis[order] @ basis[order].T
        self.parameters = float(len(places))
        if self.error > self.target.convergence_threshold():
            self.noise = math.sqrt(square / max(len(values) - len(places), 1))
        self.standard_deviation = math.sqrt(total / len(values))
        self.predicted_r2 = 1.0 - float(predicted @ predicted) / total
        self.distinct_rows = min(distinct, int(weights.sum() ** 2 / (weights * weights).sum()))
        self.null_nats = self._nats_over_a_constant(values * roots, total, square, basis, roots)

    def _nats_over_a_constant(
        self, values: FloatArray, total: float, square: float, basis: FloatArray, roots: FloatArray
    ) -> float:
        """Return by how many nats the equation describes the rows better than a constant does.

        Rows with the same inputs count once. If the constants of the equation cannot shift all values equally, the
        equation and the constant are both compared with the value 0.

        Args:
            values: the values of the target (R,), times the roots of the weights.
            total: the sum of the squared differences of `values` from their mean.
            square: the sum of squared errors.
            basis: the derivatives by the constants (R, K), orthonormal.
            roots: the square roots of the weights (R,).
        """
        constants, distinct = int(self.parameters), self.distinct_rows or 0
        price = 0.0
        if not self.is_known:
            price = structure_price(self.shown.program, len(self._problem.inputs)) - SETTINGS.criterion.common
        location = roots / math.sqrt(float(roots @ roots))
        missed = location - basis @ (basis.T @ location)
        if missed @ missed < SETTINGS.inference.exact:
            return log_bayes_factor(distinct, max(constants - 1, 0), square / total) - price
        whole = max(float(values @ values), 1e-300)
        constant = log_bayes_factor(distinct + 1, 1, total / whole)
        return log_bayes_factor(distinct + 1, constants, square / whole) - constant - price

    def _nearest_alternative(self) -> float | None:
        """Return the nats of the best alternative whose values differ, at the rows and between them. None if there is
        no such alternative.

        Alternatives that agree with the equation do not count: they give the same predictions.
        """
        inputs, shown = self._problem.inputs, self.shown
        among = np.concatenate([inputs, points_between(inputs).T], axis=1)
        among = np.ascontiguousarray(among[:, np.isfinite(values_of(shown.program, among))])
        own, part = values_of(shown.program, among), math.sqrt(SETTINGS.inference.part)
        others = (other for other in shown.alternatives if not other.is_shown)
        return min((other.nats for other in others if differ(values_of(other.program, among), own, part)), default=None)

    def check_rows_left_out(self) -> Finding | None:
        """Check that the leave-one-out R2 is above 0.9.

        If the target is uncertain, the limit is reduced by the share of the variance that is due to this uncertainty.
        """
        r2 = self.predicted_r2
        if r2 is None:
            return None
        least = 1.0 - SETTINGS.inference.part - min(2.0 * self.target.uncertainty, 1.0) ** 2
        text = format_r2(r2)
        return judge_r2(
            r2, least, f"leave-one-out R2 of the rows: {text}", f"the leave-one-out R2 of the rows is only {text}"
        )

    def check_target_uncertainty(self) -> Finding:
        """Check the uncertainty of the target: many wrong equations fit an uncertain target well."""
        uncertainty, most = self.target.uncertainty, SETTINGS.inference.largest_uncertainty
        if uncertainty <= most:
            return Finding("passed", f"the target is uncertain by {format_percent(uncertainty)}", uncertainty, most)
        reason = f"the target itself is uncertain by {format_percent(uncertainty)} of its standard deviation"
        return Finding("failed", reason, uncertainty, most)

    def check_digits_of_constants(self) -> Finding:
        """Check that constants have no more digits than the values of the target.

        A term whose constants have more digits may fit the rounding errors. For example, a wave of the size of the last
        digit can reproduce the rounding of every row.
        """
        values = self.target.values
        rounded = values[np.isfinite(values) & (values != 0.0)]
        quantisation = find_quantisation([values])
        if quantisation is None or quantisation.kind not in ("decimals", "digits") or not len(rounded):
            return Finding("not applicable", "the values are not rounded")
        most = max(map(_count_digits, rounded.tolist()))
        count = max((_count_digits(constant.value or 0.0) for constant in self.shown.constants), default=0)
        if count <= most:
            return Finding("passed", f"constants have {count} digits at most, and the values have {most}", count, most)
        reason = f"a constant has {count} digits, but the values have {most}: its term may describe rounding errors"
        return Finding("failed", reason, count, most)


def _count_digits(value: float) -> int:
    return len(Decimal(repr(value)).normalize().as_tuple().digits)


def _count_distinct(columns: FloatArray) -> int:
    """Return how many rows of columns (V, R) differ by more than rounding."""
    scales = columns.std(axis=1)
    varying = columns[scales > 0.0] / (EXACT_ERROR * scales[scales > 0.0, None])
    return len(np.unique(np.round(varying) + 0.0, axis=1).T) if len(varying) else 1
