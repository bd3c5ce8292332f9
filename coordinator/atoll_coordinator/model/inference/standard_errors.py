"""Standard errors, intervals and correlations of the constants of a fitted model. Pure.

Letters: P fitted constants.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll.data.dataset import FloatArray
from atoll.expression.program import Program, constant_places
from atoll_coordinator.model.refinement import Constant, Correlation
from atoll_coordinator.model.regression.covariance import Known, describe, student_95
from atoll_coordinator.model.selection.comparison import FittedModel, ModelComparison
from atoll_coordinator.model.shooting.covariance import covariance
from atoll_coordinator.model.structure.unit_coefficients import ExplicitCoefficients

_HIGH_CORRELATION: Final = 0.95
"""Correlations of at least this size between two constants are reported."""


@dataclass(frozen=True, eq=False)
class Errors:
    """What the fit of all constants says of them: their joint covariance (P, P), and the rows left to judge it by."""

    values: FloatArray
    covariance: FloatArray
    freedom: float


def estimate_errors(comparison: ModelComparison, model: FittedModel) -> Errors:
    """Return the errors of the constants of a fit, variances corrected for the numbers fitted."""
    fit = model.fit
    counts = float(comparison.counts.sum())
    fitted = len(fit.system.places) + fit.starts.size
    freedom = max(counts - fitted, 1.0)
    return Errors(fit.system.values, covariance(fit) * (counts / freedom), freedom)


def describe_constants(
    comparison: ModelComparison, explicit: Sequence[ExplicitCoefficients], shown: Sequence[Program], errors: Errors
) -> list[Known]:
    """Return the constants of each program with standard errors and 95 % intervals (Student's t).

    Args:
        comparison: says which equations are given.
        explicit: the programs that `errors` are of, their factors of one being constants as well.
        shown: the same programs as they are written.
        errors: of all constants of `explicit`, one program after the other.
    """
    quantile = student_95(errors.freedom)
    spreads = np.sqrt(np.maximum(np.diag(errors.covariance), 0.0)).tolist()
    fitted = errors.values.tolist()
    found: list[Known] = []
    for equation, (each, program) in enumerate(zip(explicit, shown, strict=True)):
        if equation in comparison.fixed:
            values = program.constants[constant_places(program)].tolist()
            found.append(Known(tuple(map(Constant, values)), ()))
            continue
        count = len(each.origins)
        found.append(describe(each, program, fitted[:count], spreads[:count], quantile))
        fitted, spreads = fitted[count:], spreads[count:]
    return found


def find_correlations(
    comparison: ModelComparison, variables: Sequence[str], explicit: Sequence[ExplicitCoefficients], errors: Errors
) -> tuple[Correlation, ...]:
    """Return the pairs of constants that are written and highly correlated, the highest first."""
    names = [
        (variable, origin)
        for equation, (variable, explicit_program) in enumerate(zip(variables, explicit, strict=True))
        if equation not in comparison.fixed
        for origin in explicit_program.origins
    ]
    spreads = np.sqrt(np.maximum(np.diag(errors.covariance), 1e-300))
    with np.errstate(invalid="ignore"):  # infinite variances
        unit = errors.covariance / np.outer(spreads, spreads)
    pairs = [
        Correlation((one, first_number), (other, second_number), float(unit[first, second]))
        for second, (other, second_number) in enumerate(names)
        for first, (one, first_number) in enumerate(names[:second])
        if first_number is not None and second_number is not None
        if _HIGH_CORRELATION <= abs(unit[first, second]) <= 1.0 + 1e-6
    ]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair.value)))
