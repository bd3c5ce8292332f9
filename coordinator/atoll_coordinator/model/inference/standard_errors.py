"""Standard errors, intervals and correlations of the constants of a fitted model. Pure.

Letters: P fitted constants.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from atoll_coordinator.model.inference.residual_covariance import widening
from atoll_coordinator.model.regression.covariance import Known, describe, student_95
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.shooting.system import System
from atoll_coordinator.model.shooting.trajectory_fit import covariance
from atoll_coordinator.model.structure.one_sided import one_sided_reaches, within_bounds
from atoll_coordinator.result.base import finite
from atoll_coordinator.result.equations import Constant
from atoll_coordinator.result.findings import Correlation, Covariance, Place
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.unit_coefficients import ExplicitCoefficients

_HIGH_CORRELATION: Final = 0.95
"""Correlations of at least this size between two constants are reported."""


@dataclass(frozen=True, eq=False)
class ConstantErrors:
    """The estimates of all constants and their errors.

    `values` (P,) have the joint `covariance` (P, P), the covariance of the normal equations times `scale`: the number
    of rows over the independent rows beyond the fitted numbers. `degrees_of_freedom` is for Student's t. `lower` and
    `upper` (P,) are bounds, None without bounds; a constant on a bound has a one-sided interval that `reaches` this far
    from it. Where several constants are multiples of one number, `columns` (P,) say of which.
    """

    values: FloatArray
    covariance: FloatArray
    degrees_of_freedom: float
    scale: float
    lower: FloatArray | None = None
    upper: FloatArray | None = None
    reaches: Mapping[int, float] = field(default_factory=dict)
    columns: Ints | None = None

    def of_constants(self, system: System) -> "ConstantErrors":
        """Return the errors of all constants of a system, from the errors of the numbers that they are multiples of."""
        if system.sharing is None:
            return self
        (columns,), multiples = system.columns, system.sharing.multiples
        scale = np.outer(multiples, multiples)
        lower = upper = None
        if self.lower is not None and self.upper is not None:
            lower, upper = np.sort([multiples * self.lower[columns], multiples * self.upper[columns]], axis=0)
        return ConstantErrors(
            multiples * self.values[columns], scale * self.covariance[np.ix_(columns, columns)],
            self.degrees_of_freedom, self.scale, lower, upper,
            {
                place: abs(float(multiples[place])) * self.reaches[number]
                for place, number in enumerate(columns.tolist())
                if number in self.reaches
            },
            columns,
        )  # fmt: skip


def estimate_errors(comparison: ModelComparison, model: FittedModel) -> ConstantErrors:
    """Return the errors of the constants of a fit, by the errors of measurement by which systems are compared.

    Variances are corrected for the fitted numbers, and multiplied by the number of rows that count as one
    (`ModelComparison.inflation`), since the errors of an equation vary as slowly as the states; or by the factor of a
    correlation that the rows do not exclude, if that is larger.
    """
    fit = model.fit
    counts, inflation = float(comparison.score.counts.sum()), comparison.score.inflation(model)
    noisy = comparison.score.has_independent_errors
    wide = widening(comparison.estimator.measurements, fit, noisy) if noisy.any() else 1.0
    left = max(counts - fit.system.count - fit.starts.size, 1.0)
    certain = float(comparison.score.counts @ fit.errors.degrees_of_freedom) / counts
    scale = max(wide, inflation) * counts / left
    return ConstantErrors(
        fit.system.values, covariance(fit) * scale, max(left * certain / inflation, 1.0), scale,
        fit.system.lower, fit.system.upper,
        one_sided_reaches(
            fit.reduced / scale, None if fit.gradient is None else fit.gradient / scale, fit.system.on_bounds
        ),
    )  # fmt: skip


def describe_constants(
    comparison: ModelComparison,
    explicit: Sequence[ExplicitCoefficients],
    shown: Sequence[Program],
    errors: ConstantErrors,
) -> list[Known]:
    """Return the constants of each program with standard errors and 95 % intervals (Student's t).

    Args:
        comparison: says which equations are given.
        explicit: the programs of the `errors`, with factors of one as constants.
        shown: the same programs as they are written.
        errors: of all constants of `explicit`, one program after the other.
    """
    quantile = student_95(errors.degrees_of_freedom)
    spreads = np.sqrt(np.maximum(np.diag(errors.covariance), 0.0)).tolist()
    fitted = errors.values.tolist()
    constants: list[Known] = []
    for equation, (coefficients, program) in enumerate(zip(explicit, shown, strict=True)):
        if equation in comparison.fixed:
            values = program.constants[constant_places(program)].tolist()
            constants.append(Known(tuple(Constant(value=value) for value in values), ()))
            continue
        count = len(coefficients.origins)
        known = describe(coefficients, program, fitted[:count], spreads[:count], quantile)
        constants.append(_bounded(known, coefficients, errors, len(errors.values) - len(fitted)))
        fitted, spreads = fitted[count:], spreads[count:]
    return constants


def _bounded(known: Known, explicit: ExplicitCoefficients, errors: ConstantErrors, first: int) -> Known:
    """Return the constants of an equation, whose first number is `first`, with intervals within their bounds."""
    if errors.lower is None or errors.upper is None:
        return known
    written = list(known.written)
    for number, origin in enumerate(explicit.origins, start=first):
        lower, upper = float(errors.lower[number]), float(errors.upper[number])
        if origin is not None and (math.isfinite(lower) or math.isfinite(upper)):
            written[origin] = within_bounds(written[origin], lower, upper, errors.reaches.get(number))
    return Known(tuple(written), known.unit_coefficients)


def fitted_places(
    comparison: ModelComparison, variables: Sequence[str], explicit: Sequence[ExplicitCoefficients]
) -> list[Place]:
    """Return variable and place of each fitted constant, None for a factor of one, in the order of the fit."""
    return [
        Place(variable=variable, constant=origin)
        for equation, (variable, coefficients) in enumerate(zip(variables, explicit, strict=True))
        if equation not in comparison.fixed
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
