"""How far an expression is from another one, or from values, on given rows."""

import math
from collections.abc import Mapping

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix


def values_on(text: str, columns: Mapping[str, FloatArray]) -> FloatArray:
    """Return the values (R,) of an expression; raises UsageError where it is none over the names of `columns`."""
    with np.errstate(all="ignore"):
        return values_of(from_infix(text, tuple(columns)), np.array([*columns.values()]))


def rms(values: FloatArray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def error_on(text: str, truth: str, columns: Mapping[str, FloatArray]) -> float | None:
    """Return the root mean square difference over the truth's standard deviation; None where it is not finite."""
    try:
        sought = values_on(truth, columns)
        with np.errstate(all="ignore"):
            return finite(float(np.sqrt(np.mean((values_on(text, columns) - sought) ** 2)) / np.std(sought)))
    except UsageError:
        return None


def finite(value: float | None) -> float | None:
    """Return a number, None for one that is not finite."""
    return value if value is not None and math.isfinite(value) else None
