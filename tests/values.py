"""Whether two values are equal to the bit, for tests."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from atoll_core.expression.program import Program


def is_same(one: Any, other: Any) -> bool:
    """Tell whether values have the same parts, arrays to the bit and in the same order in memory if it is one."""
    if isinstance(one, np.ndarray):
        if one.dtype != other.dtype or one.shape != other.shape or one.tobytes() != other.tobytes():
            return False
        return not (one.flags.forc and other.flags.forc) or one.flags.c_contiguous == other.flags.c_contiguous
    if isinstance(one, Program):
        return isinstance(other, Program) and one == other and one.constants.tobytes() == other.constants.tobytes()
    if is_dataclass(one):
        return type(one) is type(other) and all(
            is_same(getattr(one, part.name), getattr(other, part.name)) for part in fields(one)
        )
    if isinstance(one, Mapping):
        return list(one) == list(other) and all(is_same(one[key], other[key]) for key in one)
    if isinstance(one, Sequence) and not isinstance(one, str | bytes):
        return len(one) == len(other) and all(map(is_same, one, other))
    if isinstance(one, float):
        return bool(np.float64(one).tobytes() == np.float64(other).tobytes())
    return type(one) is type(other) and bool(one == other)
