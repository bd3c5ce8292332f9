"""Arguments of Python users as numbers: what is none is named in one sentence, with what was expected."""

from collections.abc import Mapping

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.quoting import shown


def numbers(given: object, what: str, expected: str = "numbers") -> FloatArray:
    """Return an array of real numbers of any shape; raises UsageError, which says `what` it was to be."""
    try:
        plain = np.asarray(given)
        if given is not None and plain.dtype.kind in "biufO":
            return np.asarray(plain, dtype=np.float64)
    except (TypeError, ValueError):  # rows of different lengths, or objects that are no numbers
        pass
    raise UsageError(f"{what} must be {expected}, but {shown(given)} was given")


def number(given: object, what: str) -> float:
    """Return one number; raises UsageError."""
    value = numbers(given, what, "a number")
    if value.ndim:
        raise UsageError(f"{what} must be a number, but {shown(given)} was given")
    return float(value)


def interval(given: object, what: str) -> tuple[float, float]:
    """Return a lower and an upper bound; raises UsageError where it is no finite interval."""
    bounds = numbers(given, what, "two numbers")
    if bounds.shape != (2,):
        raise UsageError(f"{what} must be two numbers, such as (0.0, 1.0), but {shown(given)} was given")
    if not (np.isfinite(bounds).all() and bounds[0] < bounds[1]):
        raise UsageError(f"{what} must have a lower bound, then an upper one, but {shown(given)} was given")
    return float(bounds[0]), float(bounds[1])


def by_name(given: object, what: str) -> Mapping[str, object]:
    """Return a mapping from names, empty for None; raises UsageError."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise UsageError(f"{what} must be given by name, such as {{'x': 1.0}}, but {shown(given)} was given")
    return given
