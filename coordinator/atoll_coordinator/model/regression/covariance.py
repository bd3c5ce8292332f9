"""Standard errors of fitted constants from the normal equations, and what a fitted equation costs by them. Pure.

Letters: n rows, K constants that are fitted.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.model.criteria import RegressionCriterion
from atoll_coordinator.model.least_squares import inverse
from atoll_coordinator.model.refinement import UnitCoefficient
from atoll_coordinator.model.regression.fit import Fitted, LeastSquares
from atoll_coordinator.model.regression.simple_numbers import fitted_length
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
    """What is known of the constants of one equation: those that are written, and factors of one that are not."""

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

    The variance of the errors is the sum of squared residuals over n - K, as if one were left where none is, or the
    square of the target's uncertainty if that is larger.
    """
    degrees_of_freedom = max(criterion.rows - len(fitted.normal), 1)
    return criterion.variance(fitted.mse * criterion.rows / degrees_of_freedom) * inverse(fitted.normal, _RIDGE)


def standard_errors(fitted: Fitted, criterion: RegressionCriterion) -> list[float]:
    """Return the standard errors of the constants that were fitted, in node order."""
    variances: list[float] = np.diag(covariance_of(fitted, criterion)).tolist()
    return [math.sqrt(max(variance, 0.0)) for variance in variances]


def description_length(fitted: Fitted, criterion: RegressionCriterion) -> float:
    """Return the description length of a model all of whose constants were fitted, infinite without a finite error."""
    if not math.isfinite(criterion.misfit(fitted.mse)):
        return math.inf
    values = fitted.program.constants[constant_places(fitted.program)].tolist()
    numbers = sum(map(fitted_length, values, standard_errors(fitted, criterion)))
    return criterion.length(fitted.mse, fitted.program, numbers)


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
            degrees of freedom) and constants that the data do not determine can be told.
    """
    bounds = least_squares.restrictions.bounds
    explicit = make_coefficients_explicit(program) if bounds is None else as_written(program)
    fitted = least_squares.fit(explicit.program)
    if not math.isfinite(fitted.mse):
        explicit = as_written(program)
        fitted = least_squares.fit(program)
    values = fitted.program.constants[constant_places(fitted.program)].tolist()
    degrees_of_freedom = criterion.rows - len(values)
    ranges = None if bounds is None else bounds.ranges(fitted.program)
    whole = fitted
    if ranges is not None:
        fitted = _with_held(fitted, _on_bounds(values, ranges))
    errors = [math.inf] * len(values)
    if degrees_of_freedom > 0 and math.isfinite(fitted.mse):
        errors = standard_errors(fitted, criterion)
    known = describe(explicit, program, values, errors, student_95(degrees_of_freedom) if has_intervals else None)
    return known if ranges is None else _bounded(known, whole, ranges, criterion, degrees_of_freedom)


def _on_bounds(values: Sequence[float], ranges: tuple[FloatArray, FloatArray]) -> npt.NDArray[np.bool_]:
    """Return which of the constants (K,) lie on a bound."""
    return np.asarray((np.asarray(values) <= ranges[0]) | (np.asarray(values) >= ranges[1]))


def _with_held(fitted: Fitted, held: npt.NDArray[np.bool_]) -> Fitted:
    """Return a fit whose normal equations say nothing of the others where some constants are held."""
    normal = fitted.normal.copy()
    diagonal = np.diag(normal).copy()
    normal[held, :] = normal[:, held] = 0.0
    np.fill_diagonal(normal, diagonal)
    return replace(fitted, normal=normal)


def _bounded(
    known: Known,
    fitted: Fitted,
    ranges: tuple[FloatArray, FloatArray],
    criterion: RegressionCriterion,
    degrees_of_freedom: int,
) -> Known:
    """Return the constants with intervals within their bounds; those on a bound are as good as given for the others."""
    lower, upper = ranges
    values = fitted.program.constants[constant_places(fitted.program)]
    variance = criterion.variance(fitted.mse * criterion.rows / max(degrees_of_freedom, 1))
    likelier = -fitted.gradient / variance
    reaches = one_sided_reaches(fitted.normal / variance, likelier, _on_bounds(values.tolist(), ranges))
    written = [
        within_bounds(constant, float(low), float(high), reaches.get(number))
        if math.isfinite(low) or math.isfinite(high)
        else constant
        for number, (constant, low, high) in enumerate(zip(known.written, lower, upper, strict=True))
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
