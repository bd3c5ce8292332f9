"""Do the intervals of the constants of a found equation contain the truth?

A found equation may be written otherwise than the truth, x*(3 - 2*y - x) for 3*x - 2*x*y - x**2. So the true value of
each of its constants is found by fitting the found structure to the true right-hand side on rows without noise. Only a
fit that is exact says what the true values are; of a structure with more constants than its function has, none are.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.optimize import least_squares

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program
from atoll_core.expression.text.parsing import from_infix

EXACT: Final = 1e-8
"""Error of the fit over the target's deviation (root mean square) below which the fit is exact."""

SMALLEST_CHANGE: Final = 1e-7
"""A relative change of the constants matters when it changes the values by more than this share of it.

In units of the target's deviation; also the ratio of singular values below which constants cannot be told apart.
"""

FAR: Final = 1e150

_NUMBER: Final = re.compile(r"(?<![\w.])(?:\d+\.\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)")
"""Numbers that are constants: printed with a point or an exponent, as whole exponents of powers are not."""


@dataclass(frozen=True)
class Covered:
    """One constant of a found equation: what is shown, its value by maximum likelihood, the truth, and the interval."""

    value: float
    fitted: float | None
    truth: float
    low: float | None
    high: float | None
    is_identifiable: bool

    @property
    def has_interval(self) -> bool:
        """Whether an interval was given."""
        return self.low is not None and self.high is not None

    @property
    def is_covered(self) -> bool:
        """Whether the interval contains the truth."""
        return self.low is not None and self.high is not None and self.low <= self.truth <= self.high

    @property
    def relative_width(self) -> float | None:
        """Length of the interval over the size of the truth; None without either."""
        if self.low is None or self.high is None or self.truth == 0.0:
            return None
        return (self.high - self.low) / abs(self.truth)


@dataclass(frozen=True, eq=False)
class _Structure:
    """An expression whose constants are parameters: `owners` says which entry each belongs to and with what sign."""

    program: Program
    owners: tuple[tuple[int, float], ...]
    columns: tuple[FloatArray, ...]

    def values(self, constants: FloatArray) -> FloatArray:
        rows = len(self.columns[0])
        parameters = [np.full(rows, sign * constants[entry]) for entry, sign in self.owners]
        return values_of(self.program, np.array([*self.columns, *parameters]))


def covered(
    expression: str, constants: Sequence[Mapping[str, Any]], columns: Mapping[str, FloatArray], truth: FloatArray
) -> list[Covered] | None:
    """Return every constant of `expression` with its true value; None when the structure has no exact fit, or many.

    Args:
        expression: the found equation, as the result prints it.
        constants: its constants as the result lists them: ``value``, and where known ``fitted``, ``interval`` and
            ``identifiable``.
        columns: values (R,) without noise of all variables.
        truth: the true right-hand side (R,) there.
    """
    kept = np.isfinite(truth)
    rows = {name: values[kept] for name, values in columns.items()}
    structure = _structure(expression, [float(constant["value"]) for constant in constants], rows)
    if not structure.owners:
        return []
    used = sorted({entry for entry, _ in structure.owners})
    for field in ("fitted", "value"):
        start = [float(constant["value"] if constant.get(field) is None else constant[field]) for constant in constants]
        values = _exact_fit(structure, np.array(start), used, truth[kept])
        if values is not None:
            return [_covered(constants[entry], float(values[entry])) for entry in used]
    return None


def _structure(expression: str, values: Sequence[float], rows: Mapping[str, FloatArray]) -> _Structure:
    """Replace the constants of `expression` by parameters, and find the entry of `values` of each by its size.

    A constant that is printed twice is one parameter; a number that is no constant, as in 2.0*x for x + x, stays.
    """
    unused = list(range(len(values)))
    owners: list[tuple[int, float]] = []

    def parameter(match: re.Match[str]) -> str:
        size = float(match[0])
        owner = next((entry for entry in [*unused, *range(len(values))] if abs(values[entry]) == size), None)
        if owner is None:
            return match[0]
        if owner in unused:
            unused.remove(owner)
        owners.append((owner, -1.0 if values[owner] < 0.0 else 1.0))
        return f"constant_{len(owners)}_"

    text = _NUMBER.sub(parameter, expression)
    names = (*rows, *(f"constant_{number}_" for number in range(1, len(owners) + 1)))
    return _Structure(from_infix(text, names), tuple(owners), tuple(rows.values()))


def _exact_fit(structure: _Structure, start: FloatArray, used: Sequence[int], truth: FloatArray) -> FloatArray | None:
    """Return the constants with which `structure` is the truth, by least squares from `start`; None if there are none.

    None, too, when other constants would do as well.
    """
    deviation = float(np.std(truth)) or 1.0
    constants = start.copy()

    def residuals(free: FloatArray) -> FloatArray:
        constants[used] = free
        with np.errstate(all="ignore"):
            errors = (structure.values(constants) - truth) / deviation
        return np.nan_to_num(errors, nan=FAR, posinf=FAR, neginf=-FAR)

    if len(truth) < len(used) or np.abs(residuals(start[used])).max() >= FAR:
        return None
    with np.errstate(all="ignore"):
        fit = least_squares(
            residuals, start[used], "3-point", method="lm", x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15
        )
    error = float(np.sqrt(np.mean(residuals(fit.x) ** 2)))
    if not error <= EXACT or not _is_determined(fit.jac * fit.x):
        return None
    constants[used] = fit.x
    return constants


def _is_determined(jacobian: FloatArray) -> bool:
    """Tell whether every relative change of the constants changes the values."""
    lengths = np.sqrt((jacobian**2).sum(axis=0))
    if not lengths.min() > SMALLEST_CHANGE * np.sqrt(len(jacobian)):
        return False
    singular = np.linalg.svd(jacobian / lengths, compute_uv=False)
    return bool(singular[-1] > SMALLEST_CHANGE * singular[0])


def _covered(entry: Mapping[str, Any], truth: float) -> Covered:
    low, high = entry.get("interval") or (None, None)
    identifiable = entry.get("identifiable")
    return Covered(float(entry["value"]), entry.get("fitted"), truth, low, high, identifiable is not False)
