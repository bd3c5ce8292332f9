"""Angles: into radians, and full turns taken out. Pure."""

import math
from itertools import pairwise
from typing import Final

import numpy as np

from atoll_core.config import Angle
from atoll_core.data.dataset import FloatArray

RADIANS_PER_DEGREE: Final = math.pi / 180.0


def convert_to_radians(values: FloatArray, angle: Angle | None) -> FloatArray:
    """Return an angle's values in radians, as sin and cos of expressions need them; other values as they are."""
    return values * RADIANS_PER_DEGREE if angle is not None and angle.degrees else values


def unwrap(values: FloatArray) -> FloatArray:
    """Return an angle (radians) of one trajectory with jumps of more than half a turn taken out, NaN passed over."""
    turn = 2.0 * math.pi
    result = values.copy()
    turns = 0
    for before, index in pairwise(np.flatnonzero(np.isfinite(values)).tolist()):
        turns -= round((float(values[index]) - float(values[before])) / turn)
        result[index] = float(values[index]) + turns * turn
    return result
