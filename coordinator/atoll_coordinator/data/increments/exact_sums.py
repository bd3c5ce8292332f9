"""Sums that are the same on every machine. Pure."""

import math

from atoll_core.data.dataset import FloatArray


def total(values: FloatArray) -> float:
    """Return the sum, correctly rounded."""
    return math.fsum(values.tolist())
