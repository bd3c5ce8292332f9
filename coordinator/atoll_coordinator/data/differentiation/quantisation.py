"""Finds the steps in which a state was recorded: a decimal place, significant digits, or steps of an encoder. Pure.

Rounding to steps of the size s causes errors with the standard deviation s / sqrt(12) (Widrow & Kollár 2008, chapter
5), in addition to other errors.
"""

import math
from collections.abc import Sequence
from decimal import Decimal
from typing import Final

import numpy as np

from atoll_coordinator.data.columns.values import has_few_levels, repeats_in_step
from atoll_coordinator.data.differentiation.interpolation import predict_left_out
from atoll_coordinator.data.differentiation.smoothing import Signal
from atoll_coordinator.data.recording import StateQuantisation
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

_ROOT_12: Final = math.sqrt(12.0)
LIMITS = SETTINGS.common
_WRITTEN_STEPS: Final = 3.0
"""A difference of at most this many steps of the last written digit is a rounding error."""
_SHARES_OF_LEAST: Final = (1, 2, 3)
"""The step is the least difference of two values divided by one of these numbers."""


def find_quantisation(parts: Sequence[FloatArray]) -> StateQuantisation | None:
    """Return the coarsest rounding that is common to all values of a state. None if this is only the rounding of
    doubles.

    `parts` are the values along each trajectory, NaN where they are missing.
    """
    values = np.concatenate([part[np.isfinite(part)] for part in parts])
    values = values[:: max(1, len(values) // SETTINGS.rows.most)]
    unique = np.unique(values)
    if len(unique) <= 2:
        return None  # a switched state has no derivative; differentiation raises an error later
    if len(unique) < LIMITS.few_values and repeats_in_step(parts):
        return None
    if len(unique) < LIMITS.few_values and has_few_levels(parts):
        # with this number of rows, a finer step would have produced values in between
        least = float(np.diff(unique).min())
        multiples = (unique - unique[0]) / least
        is_even = float(np.abs(multiples - np.round(multiples)).max()) <= SETTINGS.common.negligible
        return StateQuantisation("steps", least, least / _ROOT_12) if is_even else _decimal_rounding(unique)
    decimal, binary = _decimal_rounding(unique), _binary_rounding(unique)
    step = _common_step(unique, max(decimal.step, 0.0 if binary is None else binary.step))
    roundings = [decimal, *(rounding for rounding in (binary, step) if rounding is not None)]
    coarsest = max(roundings, key=lambda rounding: rounding.error)
    spread = float(unique[-1] - unique[0])
    return coarsest if coarsest.error > SETTINGS.smoothing.smallest_noise * spread else None


def is_refuted(quantisation: StateQuantisation, signals: Sequence[Signal]) -> bool:
    """Tell whether a state is exact: at every row, it is nearer to a smooth curve than rounded values can be.

    Squares of whole numbers, or a line with even steps, seem to be rounded but have no rounding errors. If values were
    rounded, the distance of a smooth curve from some row is about the rounding error, even if the state moves slowly.
    The `signals` are long enough to be differentiated.
    """
    errors, gains = predict_left_out([signal.measured for signal in signals])
    largest = np.max(np.abs(errors) / gains, axis=0)
    return bool(np.any(largest < SETTINGS.common.negligible * quantisation.error))


def _decimal_rounding(values: FloatArray) -> StateQuantisation:
    """Return the decimal rounding: to a decimal place, or to significant digits if this rounding is coarser."""
    numbers = [Decimal(repr(value)).normalize() for value in values.tolist() if value != 0.0]
    digits = max(len(number.as_tuple().digits) for number in numbers)
    place = min(int(number.as_tuple().exponent) for number in numbers)
    steps = [10.0 ** (number.adjusted() + 1 - digits) for number in numbers]
    by_digits = math.sqrt(sum(step * step for step in steps) / len(steps)) / _ROOT_12
    by_place = 10.0**place / _ROOT_12
    if by_digits > by_place:
        return StateQuantisation("digits", max(steps), by_digits)
    return StateQuantisation("decimals", 10.0**place, by_place)


def _binary_rounding(values: FloatArray) -> StateQuantisation | None:
    largest = float(np.finfo(np.float32).max)
    if not (np.abs(values) < largest).all() or not (values.astype(np.float32).astype(np.float64) == values).all():
        return None
    steps = np.spacing(np.abs(values).astype(np.float32)).astype(np.float64)
    square = math.fsum((steps * steps).tolist()) / len(steps)
    return StateQuantisation("single precision", float(steps.max()), math.sqrt(square) / _ROOT_12)


def _common_step(values: FloatArray, finest: float) -> StateQuantisation | None:
    """Return a step such that all differences of the ascending `values` are multiples of it; None if there is no such
    step.

    The step is the least difference divided by a small whole number. Then the step is refined from larger and larger
    differences. All differences must be multiples of it, within the digits in which the values were written. For n
    random values, the probability that each differs from a multiple by at most a share m of the step is (2 m)^n.
    `finest` is the step of the last written digit; smaller differences are rounding errors.
    """
    written = finest + 4.0 * float(np.spacing(np.abs(values).max()))
    offsets = values - values[0]
    nearest = max(_WRITTEN_STEPS * finest, written)  # values with a smaller distance are one value, rounded in two ways
    offsets = offsets[np.concatenate([[True], np.diff(values) > nearest])]
    if len(offsets) < LIMITS.few_values:
        return None
    least = float(np.diff(offsets).min())
    for share in _SHARES_OF_LEAST:
        step = least / share
        for lengths in (np.sort(np.diff(offsets)), offsets[1:]):  # least squares over more and more differences
            products, squares = 0.0, 0.0
            for length in lengths.tolist():
                count = round(length / step)
                products, squares = products + count * length, squares + count * count
                step = products / squares if squares * step > step else step
        multiples = offsets / step
        away = float(np.abs(multiples - np.round(multiples)).max())
        probability = (2.0 * away) ** (len(offsets) - 2) * len(_SHARES_OF_LEAST)
        if step > _WRITTEN_STEPS * finest and away * step <= written and probability < LIMITS.improbable:
            return StateQuantisation("steps", step, step / _ROOT_12)
    return None
