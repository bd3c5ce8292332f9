"""Standard errors, intervals and correlations of the constants of fitted equations, by normal equations. Pure.

One way for all fits: to the rows of a target, to trajectories, and to the steps of a process. Letters: P fitted
constants.
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
_OPEN_LOADING: Final = 1e-6
"""Squared component of a constant along a direction that is not determined, from which it is not determined itself."""
_CANCELLED: Final = 1e-13
"""Share of its diagonal below which the normal matrix is rounding: initial states then replace a constant."""
_HELD: Final = 1e-9
"""Standard error of a constant on its bound, over its size."""

Flags = npt.NDArray[np.bool_]

# ------------------------------------------------------------------------------------------------------- covariances


def covariance_of(
    normal: FloatArray, values: FloatArray, held: Flags, diagonal: FloatArray | None = None
) -> tuple[FloatArray, Flags]:
    """Return the covariance (P, P) of fitted constants, positive definite, and which of them are not determined.

    A constant is not determined if it loads on a direction that the data do not determine; its variance is large.
    Constants that are `held` on a bound are as good as given: the others are judged with these where they are.

    Args:
        normal: the matrix (P, P) of the normal equations, other fitted numbers eliminated.
        values: of the constants (P,).
        held: which constants (P,) lie on a bound.
        diagonal: of the matrix (P,) before the elimination; None: nothing was eliminated.
    """
    diagonal = np.diag(normal) if diagonal is None else diagonal
    if not held.any():
        return _inverse(diagonal, normal)
    free, count = np.flatnonzero(~held), len(held)
    covariances, is_open = np.zeros((count, count)), np.zeros(count, np.bool_)
    if len(free):
        covariances[np.ix_(free, free)], is_open[free] = _inverse(diagonal[free], normal[np.ix_(free, free)])
    covariances[held, held] = (_HELD * np.maximum(np.abs(values[held]), _HELD)) ** 2
    return covariances, is_open


def _inverse(diagonal: FloatArray, normal: FloatArray) -> tuple[FloatArray, Flags]:
    """Return the inverse of the normal matrix, and which constants are open."""
    least = np.maximum(_CANCELLED * np.nan_to_num(diagonal), 1e-100)
    scale = np.sqrt(np.clip(np.nan_to_num(np.diag(normal)), least, 1e100))
    with np.errstate(all="ignore"):
        unit = np.nan_to_num(normal / np.outer(scale, scale), posinf=0.0, neginf=0.0)
    try:
        values, vectors = np.linalg.eigh(unit)
    except np.linalg.LinAlgError:
        values, vectors = np.zeros(len(scale)), np.eye(len(scale))
    is_open = (vectors[:, values < _LEAST_EIGENVALUE] ** 2 > _OPEN_LOADING).any(axis=1)
    with np.errstate(all="ignore"):
        inverse = (vectors / np.maximum(values, _LEAST_EIGENVALUE)) @ vectors.T / np.outer(scale, scale)
    return np.asarray(inverse), np.asarray(is_open)


def one_sided_reaches(normal: FloatArray, gradient: FloatArray | None, held: Flags) -> dict[int, float]:
    """Return for each constant on a bound, by number, how far from it 95 % of its distribution reach.

    Near the bound the likelihood is a normal distribution whose centre lies beyond it, by the Newton step that
    the gradient asks for; its part on the near side is the distribution of the constant.

    Args:
        normal: the curvature (P, P) of minus the log-likelihood.
        gradient: the slope (P,) of the log-likelihood; None: not known, and taken as zero.
        held: which constants (P,) lie on a bound.
    """
    from scipy import special

    free, reaches = np.flatnonzero(~held), {}
    for number in np.flatnonzero(held).tolist():
        chosen = np.array([*free, number])
        error = math.sqrt(max(float(inverse(normal[np.ix_(chosen, chosen)])[-1, -1]), 0.0))
        beyond = 0.0 if gradient is None else abs(float(gradient[number])) * error
        tail = math.log(0.05) + float(special.log_ndtr(-beyond))  # of all that lies beyond the centre
        reach = error * (-float(special.ndtri_exp(tail)) - beyond)
        reaches[number] = reach if math.isfinite(reach) else 0.0
    return reaches


@dataclass(frozen=True, eq=False)
class ConstantErrors:
    """The estimates of all constants and their errors.

    `values` (P,) have the joint covariance `bounded` (P, P), positive definite: the inverse of the normal equations
    times `scale`. Constants that are `open` (P,) are not determined by the data. `degrees_of_freedom` is for Student's
    t. `lower` and `upper` (P,) are bounds, None without bounds; a constant on a bound has a one-sided interval that
    `reaches` this far from it. Where several constants are multiples of one number, `columns` (P,) say of which.
    Without `has_intervals` the errors of rows are not independent.
    """

    values: FloatArray
    bounded: FloatArray
    open: Flags
    degrees_of_freedom: float
    scale: float = 1.0
    lower: FloatArray | None = None
    upper: FloatArray | None = None
    reaches: Mapping[int, float] = field(default_factory=dict)
    columns: Ints | None = None
    has_intervals: bool = True

    @classmethod
    def of_fit(  # noqa: PLR0913, as much as normal equations have
        cls, values: FloatArray, normal: FloatArray, degrees_of_freedom: float, scale: float = 1.0,
        bounds: Sequence[FloatArray] | FloatArray | None = None, gradient: FloatArray | None = None,
        diagonal: FloatArray | None = None, *, has_intervals: bool = True,
    ) -> "ConstantErrors":  # fmt: skip
        """Return the errors by the normal equations of a fit, see `covariance_of` and `one_sided_reaches`."""
        held = np.zeros(len(values), np.bool_)
        if bounds is not None:
            held = (values <= bounds[0]) | (values >= bounds[1])
        covariance, is_open = covariance_of(normal, values, held, diagonal)
        reaches = one_sided_reaches(normal / scale, None if gradient is None else gradient / scale, held)
        lower, upper = (None, None) if bounds is None else bounds
        return cls(
            values,
            covariance * scale,
            is_open,
            degrees_of_freedom,
            scale,
            lower,
            upper,
            reaches,
            has_intervals=has_intervals,
        )

    @property
    def covariance(self) -> FloatArray:
        """The covariance (P, P), with infinite variances of constants that are not determined."""
        covariance = self.bounded.copy()
        covariance[self.open, self.open] = math.inf
        return covariance

    @property
    def standard_errors(self) -> FloatArray:
        """The standard errors (P,)."""
        return np.where(self.open, math.inf, np.sqrt(np.maximum(np.diag(self.bounded), 0.0)))

    def of_multiples(self, columns: Ints, multiples: FloatArray) -> "ConstantErrors":
        """Return the errors of constants, of which each is one of these numbers (`columns`) times a multiple."""
        scale = np.outer(multiples, multiples)
        lower = upper = None
        if self.lower is not None and self.upper is not None:
            lower, upper = np.sort([multiples * self.lower[columns], multiples * self.upper[columns]], axis=0)
        return ConstantErrors(
            multiples * self.values[columns], scale * self.bounded[np.ix_(columns, columns)], self.open[columns],
            self.degrees_of_freedom, self.scale, lower, upper,
            {
                place: abs(float(multiples[place])) * self.reaches[number]
                for place, number in enumerate(columns.tolist())
                if number in self.reaches
            },
            columns,
        )  # fmt: skip

    def described(self, number: int, value: float, **more: bool) -> Constant:
        """Return a constant shown as `value`: its estimate, the standard error, and the 95 % interval (Student's t)."""
        fitted, error = float(self.values[number]), float(self.standard_errors[number])
        constant = Constant(value=value, fitted=fitted, std_error=error, **more)
        if self.has_intervals:
            reach = student_95(self.degrees_of_freedom) * error
            interval = (fitted - reach, fitted + reach) if math.isfinite(error) else None
            constant = constant.replaced(interval=interval, identifiable=reach < abs(fitted))
        if self.lower is None or self.upper is None:
            return constant
        return _within_bounds(constant, float(self.lower[number]), float(self.upper[number]), self.reaches.get(number))


def _within_bounds(constant: Constant, lower: float, upper: float, reach: float | None) -> Constant:
    """Return a constant with its interval clipped to its bounds; on a bound, with the one-sided interval of `reach`.

    Its `bounds` are given then, infinite on an open side. There is no standard error on a bound: the data would have
    the constant beyond.
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


def student_95(degrees_of_freedom: float) -> float:
    """Return how many standard errors lie on either side of a 95 % interval (Student's t); infinite without freedom."""
    from scipy import special

    return float(special.stdtrit(degrees_of_freedom, 0.975)) if degrees_of_freedom > 0.0 else math.inf


# --------------------------------------------------------------------------------------------- constants of equations


@dataclass(frozen=True)
class Known:
    """The constants of one equation with their errors: the written constants, and factors of one, which are not."""

    written: tuple[Constant, ...]
    unit_coefficients: tuple[UnitCoefficient, ...] = ()

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


def explicit_coefficients(program: Program, restrictions: Restrictions, *, is_given: bool) -> ExplicitCoefficients:
    """Return an equation with its factors of one as constants; as it is written if it is given, or has bounds."""
    is_written = is_given or restrictions.bounds is not None
    return as_written(program) if is_written else make_coefficients_explicit(program)


def describe_constants(
    given: Collection[int], explicit: Sequence[ExplicitCoefficients], shown: Sequence[Program], errors: ConstantErrors
) -> list[Known]:
    """Return the constants of each program with standard errors and 95 % intervals.

    Args:
        given: the equations, by number, whose constants were not fitted.
        explicit: the programs of the `errors`, with factors of one as constants.
        shown: the same programs as they are written.
        errors: of all constants of `explicit`, one program after the other.
    """
    described: list[Known] = []
    number = 0
    for equation, (coefficients, program) in enumerate(zip(explicit, shown, strict=True)):
        values = program.constants[constant_places(program)].tolist()
        written, units = [Constant(value=value) for value in values], list[UnitCoefficient]()
        for origin in () if equation in given else coefficients.origins:
            if origin is None:
                units.append(UnitCoefficient(coefficients.terms[len(units)], errors.described(number, ONE)))
            else:
                written[origin] = errors.described(number, values[origin])
            number += 1
        described.append(Known(tuple(written), tuple(units)))
    return described


def with_refuted_factors(
    explicit: Sequence[ExplicitCoefficients], fitted: Sequence[Program], shown: Sequence[Program],
    known: Sequence[Known],
) -> list[Program]:  # fmt: skip
    """Return the programs `shown` with those factors of one written out that the data refute.

    `fitted` are the programs of `explicit` with fitted constants, `known` are the constants of these.
    """
    return [
        write_factors(coefficients, program, constants.refuted_factors) if constants.refuted_factors else written
        for coefficients, program, written, constants in zip(explicit, fitted, shown, known, strict=True)
    ]


def fitted_places(
    given: Collection[int], variables: Sequence[str], explicit: Sequence[ExplicitCoefficients]
) -> list[Place]:
    """Return variable and place of each fitted constant, None for a factor of one, in the order of the fit."""
    return [
        Place(variable=variable, constant=origin)
        for equation, (variable, coefficients) in enumerate(zip(variables, explicit, strict=True))
        if equation not in given
        for origin in coefficients.origins
    ]


def find_correlations(places: Sequence[Place], errors: ConstantErrors) -> tuple[Correlation, ...]:
    """Return the pairs of constants that are written and highly correlated, the highest first."""
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
    """Return the covariance (P, P) of the constants at these places; None without any. Infinite variances are null."""
    if not places:
        return None
    rows = tuple(tuple(map(finite, row)) for row in matrix.tolist())
    return Covariance(constants=tuple(places), matrix=rows, freedom=degrees_of_freedom)
