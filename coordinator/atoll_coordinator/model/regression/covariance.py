"""Standard errors of fitted constants from the normal equations. Pure.

Letters: n rows, K constants that are fitted.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll_coordinator.model.criteria import RegressionCriterion
from atoll_coordinator.model.least_squares import inverse
from atoll_coordinator.model.refinement import UnitCoefficient
from atoll_coordinator.model.regression.fit import Fitted, LeastSquares
from atoll_coordinator.model.structure.one_sided import one_sided_reaches, within_bounds
from atoll_coordinator.result.equations import Constant, SimpleNumber
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.unit_coefficients import (
    ONE,
    ExplicitCoefficients,
    as_written,
    make_coefficients_explicit,
)

_RIDGE: Final = 1e-14


@dataclass(frozen=True)
class Known:
    """The constants of one equation with their errors: the written constants, and factors of one, which are not."""

    written: tuple[Constant, ...]
    unit_coefficients: tuple[UnitCoefficient, ...]

    @property
    def refuted_factors(self) -> list[int]:
        """The factors of one, by number, that the data refute: their intervals do not hold one."""
        return [number for number, one in enumerate(self.unit_coefficients) if not one.constant.is_within]

    def with_simple(self, simple: Sequence[SimpleNumber | None]) -> "Known":
        """Return the same with the simple numbers near the constants that are written; none for a given equation."""
        if not simple:
            return self
        pairs = zip(self.written, simple, strict=True)
        return replace(self, written=tuple(constant.replaced(simple=number) for constant, number in pairs))


def covariance_of(fitted: Fitted, criterion: RegressionCriterion) -> FloatArray:
    """Return the covariance (K, K) of the constants that were fitted, in node order.

    The variance of the errors is the sum of squared residuals over n - K, at least one, or the square of the target's
    uncertainty if that is larger.
    """
    degrees_of_freedom = max(criterion.rows - len(fitted.normal), 1)
    return criterion.variance(fitted.mse * criterion.rows / degrees_of_freedom) * inverse(fitted.normal, _RIDGE)


def standard_errors(fitted: Fitted, criterion: RegressionCriterion) -> list[float]:
    """Return the standard errors of the constants that were fitted, in node order."""
    variances: list[float] = np.diag(covariance_of(fitted, criterion)).tolist()
    return [math.sqrt(max(variance, 0.0)) for variance in variances]


def estimate_constants(
    program: Program, least_squares: LeastSquares, criterion: RegressionCriterion, *, has_intervals: bool
) -> Known:
    """Return the constants of `program` as they are fitted, with standard errors.

    Factors of one that are not written are fitted as well. The variance of the errors is the sum of squared residuals
    over n - K, or the square of the target's uncertainty if that is larger. Where n <= K it is not known: standard
    errors are infinite and there are no intervals.

    Args:
        program: the equation as it is shown.
        least_squares: fits it to the rows that decide its constants.
        criterion: has the number of these rows and the least variance of their errors.
        has_intervals: whether the errors are independent, so that there are 95 % intervals (Student's t with n - K
            degrees of freedom) and constants that the data do not determine are recognised.
    """
    bounds = least_squares.restrictions.bounds
    explicit = make_coefficients_explicit(program) if bounds is None else as_written(program)
    fitted = least_squares.fit(explicit.program)
    if not math.isfinite(fitted.mse):
        explicit = as_written(program)
        fitted = least_squares.fit(program)
    values = fitted.program.constants[constant_places(fitted.program)]
    degrees_of_freedom = criterion.rows - len(values)
    quantile = student_95(degrees_of_freedom) if has_intervals else None
    ranges = None if bounds is None else bounds.ranges(fitted.program)
    lower, upper = ranges or (np.full(len(values), -math.inf), np.full(len(values), math.inf))
    held = (values <= lower) | (values >= upper)
    errors = [math.inf] * len(values)
    if degrees_of_freedom > 0 and math.isfinite(fitted.mse):
        normal = np.where((held[:, None] | held) & ~np.eye(len(values), dtype=bool), 0.0, fitted.normal)
        errors = standard_errors(replace(fitted, normal=normal), criterion)  # a held constant counts as given
    known = describe(explicit, program, values.tolist(), errors, quantile)
    if ranges is None:
        return known
    variance = criterion.variance(fitted.mse * criterion.rows / max(degrees_of_freedom, 1))
    reaches = one_sided_reaches(fitted.normal / variance, -fitted.gradient / variance, held)
    written = [
        within_bounds(constant, low, high, reaches.get(number))
        if math.isfinite(low) or math.isfinite(high)
        else constant
        for number, (constant, low, high) in enumerate(zip(known.written, lower.tolist(), upper.tolist(), strict=True))
    ]
    return Known(tuple(written), known.unit_coefficients)


def student_95(degrees_of_freedom: float) -> float:
    """Return how many standard errors lie on either side of a 95 % interval (Student's t); infinite without freedom."""
    from scipy import special

    return float(special.stdtrit(degrees_of_freedom, 0.975)) if degrees_of_freedom > 0.0 else math.inf


def describe(
    explicit: ExplicitCoefficients,
    program: Program,
    fitted: Sequence[float],
    errors: Sequence[float],
    quantile: float | None,
) -> Known:
    """Return the constants of `program`, and its factors of one that are not written.

    Args:
        explicit: `program` with these factors as constants.
        program: as it is written.
        fitted: the K constants of `explicit`, fitted.
        errors: their standard errors, infinite where the data do not determine them.
        quantile: standard errors on either side of a 95 % interval; None: there are no intervals.
    """
    values = program.constants[constant_places(program)].tolist()
    written: dict[int, Constant] = {}
    unit_coefficients: list[UnitCoefficient] = []
    for origin, value, error in zip(explicit.origins, fitted, errors, strict=True):
        if origin is None:
            term = explicit.terms[len(unit_coefficients)]
            unit_coefficients.append(UnitCoefficient(term, constant_of(ONE, value, error, quantile)))
        else:
            written[origin] = constant_of(values[origin], value, error, quantile)
    return Known(tuple(written[number] for number in range(len(values))), tuple(unit_coefficients))


def constant_of(value: float, fitted: float, error: float, quantile: float | None, **more: bool) -> Constant:
    """Return a constant shown as `value`: its estimate, the standard error, and the 95 % interval (see `describe`)."""
    if quantile is None:
        return Constant(value=value, fitted=fitted, std_error=error, **more)
    reach = quantile * error
    interval = (fitted - reach, fitted + reach) if math.isfinite(error) else None
    return Constant(
        value=value, fitted=fitted, std_error=error, interval=interval, identifiable=reach < abs(fitted), **more
    )
