"""Angles: into radians, and full turns taken out. Pure."""

import math
from typing import Final

from atoll.config import Angle
from atoll.data.dataset import FloatArray

RADIANS_PER_DEGREE: Final = math.pi / 180.0


def convert_to_radians(values: FloatArray, angle: Angle | None) -> FloatArray:
    """Return an angle's values in radians, as sin and cos of expressions need them; other values as they are."""
    return values * RADIANS_PER_DEGREE if angle is not None and angle.degrees else values


def unwrap(values: FloatArray) -> FloatArray:
    """Return an angle (radians) of one trajectory with jumps of more than half a turn taken out."""
    turn = 2.0 * math.pi
    result = values.copy()
    turns = 0
    for index in range(1, len(values)):
        turns -= round((float(values[index]) - float(values[index - 1])) / turn)
        result[index] = float(values[index]) + turns * turn
    return result
