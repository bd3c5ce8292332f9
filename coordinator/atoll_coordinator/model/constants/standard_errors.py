"""Standard errors, intervals and correlations of the constants of fitted equations, from normal equations. Pure.

All fits use this module: fits to the rows of a target, to trajectories, and to the steps of a process.
`estimate_covariance` inverts the matrix of the normal equations, scaled to a unit diagonal. The data do not determine
directions with a negligible eigenvalue. A constant with a component along such a direction is not determined either.
`ConstantErrors` holds the result, and `ConstantErrors.describe` turns it into 95 % intervals (Student's t) for the
report.

Doubtful: the covariance is a local linear approximation, so intervals of strongly nonlinear constants are too
symmetric. Constants on a bound are treated as known: their uncertainty is not included in the errors of the other
constants. The limit between "determined" and "not determined" (`_LEAST_EIGENVALUE`) follows from rounding errors and
not from statistics.

Letters: P fitted constants.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.model.least_squares import inverse
from atoll_coordinator.model.refinement import UnitCoefficient
from atoll_coordinator.result.base import finite
from atoll_coordinator.result.equations import Constant, SimpleNumber
from atoll_coordinator.result.findings import Correlation, Covariance, Place
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.restrictions import Restrictions
from atoll_core.expression.unit_coefficients import (
    ONE,
    ExplicitCoefficients,
    as_written,
    make_coefficients_explicit,
    write_factors,
)

_HIGH_CORRELATION: Final = 0.95
"""Correlations of at least this size between two constants are reported."""
_LEAST_EIGENVALUE: Final = 1e-11
"""Smaller eigenvalues of the normal matrix with a unit diagonal are rounding errors."""
_UNDETERMINED_LOADING: Final = 1e-6
"""A constant is not determined if its squared component along an undetermined direction is larger than this."""
_CANCELLED_SHARE: Final = 1e-13
"""If a diagonal element of the reduced normal matrix is below this share of the element of the full matrix, it is a
rounding error: changes of the initial states can then replace a change of the constant."""
_SMALLEST_CURVATURE: Final = 1e-200
"""Guard: diagonal elements are limited to the range from this value to its inverse, so that variances and products of
two variances do not overflow."""
_ERROR_ON_BOUND: Final = 1e-9
"""Assumed standard error of a constant on its bound, as a share of its absolute value."""

Flags = npt.NDArray[np.bool_]

# ------------------------------------------------------------------------------------------------------- covariances


def estimate_covariance(
    normal: FloatArray, values: FloatArray, on_bound: Flags, diagonal: FloatArray | None = None
) -> tuple[FloatArray, Flags]:
    """Return the covariance (P, P) of fitted constants, which is positive definite, and a mask (P,) of the constants
    that are not determined.

    A constant is not determined if it has a component along a direction that the data do not determine; its variance is
    then large. Constants `on_bound` are treated as known when the errors of the other constants are computed.

    Args:
        normal: the matrix (P, P) of the normal equations, after elimination of the other fitted numbers.
        values: the values of the constants (P,).
        on_bound: which constants (P,) lie on a bound.
        diagonal: the diagonal (P,) of the matrix before the elimination; None: nothing was eliminated.
    """
    diagonal = np.diag(normal) if diagonal is None else diagonal
    if not on_bound.any():
        return _invert_normal(diagonal, normal)
    free, count = np.flatnonzero(~on_bound), len(on_bound)
    covariances, is_undetermined = np.zeros((count, count)), np.zeros(count, np.bool_)
    if len(free):
        covariances[np.ix_(free, free)], is_undetermined[free] = _invert_normal(
            diagonal[free], normal[np.ix_(free, free)]
        )
    covariances[on_bound, on_bound] = (_ERROR_ON_BOUND * np.maximum(np.abs(values[on_bound]), _ERROR_ON_BOUND)) ** 2
    return covariances, is_undetermined


def _invert_normal(diagonal: FloatArray, normal: FloatArray) -> tuple[FloatArray, Flags]:
    """Return the inverse of the normal matrix, and a mask of the constants that are not determined."""
    least = np.maximum(_CANCELLED_SHARE * np.nan_to_num(diagonal), _SMALLEST_CURVATURE)
    scale = np.sqrt(np.clip(np.nan_to_num(np.diag(normal)), least, 1.0 / _SMALLEST_CURVATURE))
    with np.errstate(all="ignore"):
        unit = np.nan_to_num(normal / np.outer(scale, scale), posinf=0.0, neginf=0.0)
    try:
        values, vectors = np.linalg.eigh(unit)
    except np.linalg.LinAlgError:
        values, vectors = np.zeros(len(scale)), np.eye(len(scale))
    is_undetermined = (vectors[:, values < _LEAST_EIGENVALUE] ** 2 > _UNDETERMINED_LOADING).any(axis=1)
    with np.errstate(all="ignore"):
        inverse = (vectors / np.maximum(values, _LEAST_EIGENVALUE)) @ vectors.T / np.outer(scale, scale)
    return np.asarray(inverse), np.asarray(is_undetermined)


def one_sided_interval_lengths(normal: FloatArray, gradient: FloatArray | None, on_bound: Flags) -> dict[int, float]:
    """Return the lengths of the one-sided 95 % intervals of the constants on a bound, by index. The interval of such a
    constant starts at the bound.

    Near the bound the likelihood is approximately normal. The centre of the normal distribution lies beyond the bound,
    at the Newton step of the gradient. The distribution of the constant is the part of the normal distribution within
    the bounds.

    Args:
        normal: the curvature (P, P) of minus the log-likelihood.
        gradient: the slope (P,) of the log-likelihood; None: it is not known, and assumed to be zero.
        on_bound: which constants (P,) lie on a bound.
    """
    from scipy import special

    free, one_sided_lengths = np.flatnonzero(~on_bound), {}
    for number in np.flatnonzero(on_bound).tolist():
        chosen = np.array([*free, number])
        error = math.sqrt(max(float(inverse(normal[np.ix_(chosen, chosen)])[-1, -1]), 0.0))
        beyond = 0.0 if gradient is None else abs(float(gradient[number])) * error
        tail = math.log(0.05) + float(
            special.log_ndtr(-beyond)
        )  # log of the tail probability beyond the end of the interval
        reach = error * (-float(special.ndtri_exp(tail)) - beyond)
        one_sided_lengths[number] = reach if math.isfinite(reach) else 0.0
    return one_sided_lengths


@dataclass(frozen=True, eq=False)
class ConstantErrors:
    """The estimates of all constants and their errors.

    `values` (P,) have the joint covariance `finite_covariance` (P, P), a positive definite matrix: the inverse of the
    matrix of the normal equations times `scale`. `undetermined` (P,) tells which constants the data do not determine.
    `degrees_of_freedom` are the degrees of freedom of Student's t. `lower` and `upper` (P,) are bounds; None: there are
    no bounds. `one_sided_lengths` has, by index, the length of the interval of each constant on a bound. If several
    constants are multiples of one fitted number, `columns` (P,) has the index of this number for each constant.
    `has_intervals` is False if the errors of rows are correlated.
    """

    values: FloatArray
    finite_covariance: FloatArray
    undetermined: Flags
    degrees_of_freedom: float
    scale: float = 1.0
    lower: FloatArray | None = None
    upper: FloatArray | None = None
    one_sided_lengths: Mapping[int, float] = field(default_factory=dict)
    columns: Ints | None = None
    has_intervals: bool = True

    @classmethod
    def from_fit(  # noqa: PLR0913, as much as normal equations have
        cls, values: FloatArray, normal: FloatArray, degrees_of_freedom: float, scale: float = 1.0,
        bounds: Sequence[FloatArray] | FloatArray | None = None, gradient: FloatArray | None = None,
        diagonal: FloatArray | None = None, *, has_intervals: bool = True,
    ) -> "ConstantErrors":  # fmt: skip
        """Return the errors from normal equations, see `estimate_covariance` and `one_sided_interval_lengths`."""
        on_bound = np.zeros(len(values), np.bool_)
        if bounds is not None:
            on_bound = (values <= bounds[0]) | (values >= bounds[1])
        covariance, is_undetermined = estimate_covariance(normal, values, on_bound, diagonal)
        one_sided_lengths = one_sided_interval_lengths(
            normal / scale, None if gradient is None else gradient / scale, on_bound
        )
        lower, upper = (None, None) if bounds is None else bounds
        return cls(
            values,
            covariance * scale,
            is_undetermined,
            degrees_of_freedom,
            scale,
            lower,
            upper,
            one_sided_lengths,
            has_intervals=has_intervals,
        )

    @property
    def covariance(self) -> FloatArray:
        """The covariance (P, P). The variance of a constant that is not determined is infinite."""
        covariance = self.finite_covariance.copy()
        covariance[self.undetermined, self.undetermined] = math.inf
        return covariance

    @property
    def standard_errors(self) -> FloatArray:
        """The standard errors (P,)."""
        return np.where(self.undetermined, math.inf, np.sqrt(np.maximum(np.diag(self.finite_covariance), 0.0)))

    def for_multiples(self, columns: Ints, multiples: FloatArray) -> "ConstantErrors":
        """Return the errors of constants (C,): constant c is fitted number `columns[c]` times `multiples[c]`."""
        scale = np.outer(multiples, multiples)
        lower = upper = None
        if self.lower is not None and self.upper is not None:
            lower, upper = np.sort([multiples * self.lower[columns], multiples * self.upper[columns]], axis=0)
        return ConstantErrors(
            multiples * self.values[columns], scale * self.finite_covariance[np.ix_(columns, columns)],
            self.undetermined[columns], self.degrees_of_freedom, self.scale, lower, upper,
            {
                place: abs(float(multiples[place])) * self.one_sided_lengths[number]
                for place, number in enumerate(columns.tolist())
                if number in self.one_sided_lengths
            },
            columns,
        )  # fmt: skip

    def describe(self, number: int, value: float, **more: bool) -> Constant:
        """Return a constant shown as `value`, with its estimate, standard error and 95 % interval (Student's t)."""
        fitted, error = float(self.values[number]), float(self.standard_errors[number])
        constant = Constant(value=value, fitted=fitted, std_error=error, **more)
        if self.has_intervals:
            reach = student_quantile_95(self.degrees_of_freedom) * error
            interval = (fitted - reach, fitted + reach) if math.isfinite(error) else None
            constant = constant.replaced(interval=interval, identifiable=reach < abs(fitted))
        if self.lower is None or self.upper is None:
            return constant
        return _clip_to_bounds(
            constant, float(self.lower[number]), float(self.upper[number]), self.one_sided_lengths.get(number)
        )


def _clip_to_bounds(constant: Constant, lower: float, upper: float, reach: float | None) -> Constant:
    """Return a constant whose interval is clipped to its bounds.

    For a constant on a bound, the interval is one-sided and has the length `reach`. Such a constant has no standard
    error, since the minimum of the misfit lies beyond the bound. `bounds` are set if at least one bound is finite.
    """
    if not (math.isfinite(lower) or math.isfinite(upper)):
        return constant
    if reach is None:
        low, high = constant.interval or (None, None)
        clipped = (lower if low is None else max(low, lower), upper if high is None else min(high, upper))
        return constant.replaced(bounds=(lower, upper), interval=constant.interval and clipped)
    at = lower if constant.fitted is not None and constant.fitted <= lower else upper
    interval = (at, min(at + reach, upper)) if at == lower else (max(at - reach, lower), at)
    return constant.replaced(
        value=at, std_error=None, interval=interval, identifiable=True, bounds=(lower, upper), at_bound=True
    )


def student_quantile_95(degrees_of_freedom: float) -> float:
    """Return half the width of a 95 % interval divided by the standard error (Student's t). It is infinite without
    degrees of freedom."""
    from scipy import special

    return float(special.stdtrit(degrees_of_freedom, 0.975)) if degrees_of_freedom > 0.0 else math.inf


# --------------------------------------------------------------------------------------------- constants of equations


@dataclass(frozen=True)
class EquationConstants:
    """The constants of one equation with their errors: `written` constants, and factors of one that are not written."""

    written: tuple[Constant, ...]
    unit_coefficients: tuple[UnitCoefficient, ...] = ()

    @property
    def refuted_factors(self) -> list[int]:
        """The indices of factors of one that the data refute: their intervals do not contain one."""
        return [number for number, one in enumerate(self.unit_coefficients) if not one.constant.is_within]

    def with_simple_numbers(self, simple: Sequence[SimpleNumber | None]) -> "EquationConstants":
        """Return the constants, each with the simple number near it. `simple` is empty for an equation that the user
        gave."""
        if not simple:
            return self
        pairs = zip(self.written, simple, strict=True)
        return replace(self, written=tuple(constant.replaced(simple=number) for constant, number in pairs))


def make_explicit_if_free(program: Program, restrictions: Restrictions, *, is_given: bool) -> ExplicitCoefficients:
    """Return an equation with its factors of one written as constants. An equation that the user gave, or that has
    bounds, is not changed."""
    is_written = is_given or restrictions.bounds is not None
    return as_written(program) if is_written else make_coefficients_explicit(program)


def describe_constants(
    given: Collection[int], explicit: Sequence[ExplicitCoefficients], shown: Sequence[Program], errors: ConstantErrors
) -> list[EquationConstants]:
    """Return the constants of each program with standard errors and 95 % intervals.

    Args:
        given: the equations, by index, whose constants were not fitted.
        explicit: the programs to which `errors` belong; in these programs, factors of one are written as constants.
        shown: the same programs as they are written.
        errors: the errors of all constants of `explicit`, one program after the other.
    """
    described: list[EquationConstants] = []
    number = 0
    for equation, (coefficients, program) in enumerate(zip(explicit, shown, strict=True)):
        values = program.constants[constant_places(program)].tolist()
        written, units = [Constant(value=value) for value in values], list[UnitCoefficient]()
        for origin in () if equation in given else coefficients.origins:
            if origin is None:
                units.append(UnitCoefficient(coefficients.terms[len(units)], errors.describe(number, ONE)))
            else:
                written[origin] = errors.describe(number, values[origin])
            number += 1
        described.append(EquationConstants(tuple(written), tuple(units)))
    return described


def write_refuted_factors(
    explicit: Sequence[ExplicitCoefficients], fitted: Sequence[Program], shown: Sequence[Program],
    known: Sequence[EquationConstants],
) -> list[Program]:  # fmt: skip
    """Return the programs `shown`, with factors of one written as fitted constants if the data refute the value one.

    `fitted` are the programs of `explicit` with fitted constants, and `known` are their constants with errors.
    """
    return [
        write_factors(coefficients, program, constants.refuted_factors) if constants.refuted_factors else written
        for coefficients, program, written, constants in zip(explicit, fitted, shown, known, strict=True)
    ]


def list_fitted_places(
    given: Collection[int], variables: Sequence[str], explicit: Sequence[ExplicitCoefficients]
) -> list[Place]:
    """Return the variable and the place of each fitted constant, in the order of the fit. The place of a factor of one
    is None."""
    return [
        Place(variable=variable, constant=origin)
        for equation, (variable, coefficients) in enumerate(zip(variables, explicit, strict=True))
        if equation not in given
        for origin in coefficients.origins
    ]


def find_correlations(places: Sequence[Place], errors: ConstantErrors) -> tuple[Correlation, ...]:
    """Return the pairs of written constants that are highly correlated, the highest correlation first."""
    spreads = np.sqrt(np.maximum(np.diag(errors.covariance), 1e-300))
    with np.errstate(invalid="ignore"):  # infinite variances
        unit = (errors.covariance / np.outer(spreads, spreads)).tolist()
    pairs = [
        Correlation(first=places[first], second=places[second], value=unit[first][second])
        for second in range(len(places))
        for first in range(second)
        if places[first].constant is not None and places[second].constant is not None
        if errors.columns is None or errors.columns[first] != errors.columns[second]
        if _HIGH_CORRELATION <= abs(unit[first][second]) <= 1.0 + 1e-6
    ]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair.value or 0.0)))


def joint_covariance(places: Sequence[Place], matrix: FloatArray, degrees_of_freedom: float) -> Covariance | None:
    """Return the covariance (P, P) of the constants at these places; None if there are no constants. An infinite
    element becomes None (null in JSON)."""
    if not places:
        return None
    rows = tuple(tuple(map(finite, row)) for row in matrix.tolist())
    return Covariance(constants=tuple(places), matrix=rows, freedom=degrees_of_freedom)
