"""Steps in which a state was recorded, from its digits: of a decimal place, of digits, of an encoder. Pure.

Rounding to steps of s leaves errors of s / sqrt(12) at least (Widrow & Kollár 2008, chapter 5), plus other errors.
"""

import math
from collections.abc import Sequence
from decimal import Decimal
from typing import Final

import numpy as np

from atoll_coordinator.data.columns.values import has_few_levels, repeats_in_step
from atoll_coordinator.data.differentiation.interpolation import predict_left_out
from atoll_coordinator.data.differentiation.smoothing import Signal
from atoll_coordinator.data.recording import Quantisation
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

_ROOT_12: Final = math.sqrt(12.0)
LIMITS = SETTINGS.common
_WRITTEN_STEPS: Final = 3.0
"""Differences of at most this many steps of the last digit are rounding in writing."""
_SHARES_OF_LEAST: Final = (1, 2, 3)
"""The step is the least difference of two values, or one of these shares of it."""


def find_quantisation(parts: Sequence[FloatArray]) -> Quantisation | None:
    """Return the coarsest rounding that all values of a state show; None if that is only the rounding of doubles.

    `parts` are the values along each trajectory, NaN where they are missing.
    """
    values = np.concatenate([part[np.isfinite(part)] for part in parts])
    values = values[:: max(1, len(values) // SETTINGS.rows.most)]
    unique = np.unique(values)
    if len(unique) <= 2:
        return None  # a switch, which has no derivative: differentiation refuses it
    if len(unique) < LIMITS.few_values and repeats_in_step(parts):
        return None
    if len(unique) < LIMITS.few_values and has_few_levels(parts):
        # with this number of rows, a finer step would have given values in between
        least = float(np.diff(unique).min())
        multiples = (unique - unique[0]) / least
        is_even = float(np.abs(multiples - np.round(multiples)).max()) <= SETTINGS.common.negligible
        return Quantisation("steps", least, least / _ROOT_12) if is_even else _decimal_rounding(unique)
    decimal, binary = _decimal_rounding(unique), _binary_rounding(unique)
    step = _common_step(unique, max(decimal.step, 0.0 if binary is None else binary.step))
    roundings = [decimal, *(rounding for rounding in (binary, step) if rounding is not None)]
    coarsest = max(roundings, key=lambda rounding: rounding.error)
    spread = float(unique[-1] - unique[0])
    return coarsest if coarsest.error > SETTINGS.smoothing.smallest_noise * spread else None


def is_refuted(quantisation: Quantisation, signals: Sequence[Signal]) -> bool:
    """Tell whether a state follows a smooth curve more closely, in every row, than rounded values could: it is exact.

    Whole numbers that are squares, or a line in even steps, show a step and have no error. Where values were rounded,
    the curve misses some row by about the error of rounding, however slowly the state moves. The `signals` are long
    enough to be differentiated.
    """
    errors, gains = predict_left_out([signal.measured for signal in signals])
    largest = np.max(np.abs(errors) / gains, axis=0)
    return bool(np.any(largest < SETTINGS.common.negligible * quantisation.error))


def _decimal_rounding(values: FloatArray) -> Quantisation:
    """Return the rounding of decimals: to a place, or to significant digits where that is coarser."""
    numbers = [Decimal(repr(value)).normalize() for value in values.tolist() if value != 0.0]
    digits = max(len(number.as_tuple().digits) for number in numbers)
    place = min(int(number.as_tuple().exponent) for number in numbers)
    steps = [10.0 ** (number.adjusted() + 1 - digits) for number in numbers]
    by_digits = math.sqrt(sum(step * step for step in steps) / len(steps)) / _ROOT_12
    by_place = 10.0**place / _ROOT_12
    if by_digits > by_place:
        return Quantisation("digits", max(steps), by_digits)
    return Quantisation("decimals", 10.0**place, by_place)


def _binary_rounding(values: FloatArray) -> Quantisation | None:
    largest = float(np.finfo(np.float32).max)
    if not (np.abs(values) < largest).all() or not (values.astype(np.float32).astype(np.float64) == values).all():
        return None
    steps = np.spacing(np.abs(values).astype(np.float32)).astype(np.float64)
    square = math.fsum((steps * steps).tolist()) / len(steps)
    return Quantisation("single precision", float(steps.max()), math.sqrt(square) / _ROOT_12)


def _common_step(values: FloatArray, finest: float) -> Quantisation | None:
    """Return the step of which all differences of `values` (ascending) are multiples, if there is one.

    It is a share of the least difference, and refined by ever larger differences. All values must be multiples to
    within the digits in which they were written; by chance they would all lie within a share m of a step from multiples
    with the probability (2 m)^n. `finest` is the step in which numbers were written down; smaller differences are
    rounding errors.
    """
    written = finest + 4.0 * float(np.spacing(np.abs(values).max()))
    offsets = values - values[0]
    nearest = max(_WRITTEN_STEPS * finest, written)  # nearer ones are one value, rounded in two ways
    offsets = offsets[np.concatenate([[True], np.diff(values) > nearest])]
    if len(offsets) < LIMITS.few_values:
        return None
    least = float(np.diff(offsets).min())
    for share in _SHARES_OF_LEAST:
        step = least / share
        for lengths in (np.sort(np.diff(offsets)), offsets[1:]):  # least squares over ever more differences
            products, squares = 0.0, 0.0
            for length in lengths.tolist():
                count = round(length / step)
                products, squares = products + count * length, squares + count * count
                step = products / squares if squares * step > step else step
        multiples = offsets / step
        away = float(np.abs(multiples - np.round(multiples)).max())
        probability = (2.0 * away) ** (len(offsets) - 2) * len(_SHARES_OF_LEAST)
        if step > _WRITTEN_STEPS * finest and away * step <= written and probability < LIMITS.improbable:
            return Quantisation("steps", step, step / _ROOT_12)
    return None
