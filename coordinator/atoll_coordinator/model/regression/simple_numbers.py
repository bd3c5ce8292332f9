"""Simple numbers: how many nats it takes to write one down, which lie near a fitted constant, and how densely.

A simple number is p/q times a power of ten, p and q whole numbers and q small, or pi times that: whole numbers and
short decimals have q = 1. No unit is preferred: a number is as long as ten times it. A fitted constant counts as a
decimal, too: one with as many digits as its standard error leaves it.
"""

import math
import sys
from collections.abc import Iterator
from functools import cache
from typing import Final

from atoll_coordinator.settings import SETTINGS

_DIGIT: Final = math.log(3.0)
"""Nats of each digit beyond the first, beside the number that the digits are."""
_SHORT: Final = 3
"""Of numerators with more digits the sum of probabilities is an integral."""
_DIGITS_OF_PI: Final = 2
"""Digits of multiples of pi: with more, they would say less than the decimal beside them."""
_LARGE: Final = 1e200
"""Beyond, and below its inverse, numbers are told by others of another power of ten, lest powers of ten overflow."""
_FINER: Final = math.log(10.0) + _DIGIT
"""A decimal that is finer than the error may need one digit more."""


def number_length(numerator: int, denominator: int = 1) -> float:
    """Return the length in nats of p/q times any power of ten: of p, its digits beyond the first, and q if not one."""
    digits = len(str(abs(numerator))) - 1
    return math.log1p(abs(numerator)) + _DIGIT * digits + (math.log1p(denominator) if denominator > 1 else 0.0)


def fitted_length(value: float, error: float) -> float:
    """Return the length in nats of `value` written with the digits that its standard error leaves it."""
    error = min(max(error, abs(value) * 10.0**-sys.float_info.dig), abs(value))
    if error == 0.0:
        return 0.0
    steps = abs(value) / error
    return math.log1p(steps) + _DIGIT * math.log10(steps) + _FINER


def simple_numbers(value: float, error: float) -> dict[float, float]:
    """Return numbers within a few standard errors of `value`, each with its length in nats; 0 is not among them.

    The more digits the error leaves, the more of them are considered, of decimals up to one more than it justifies.

    Args:
        value: not 0.
        error: its standard error.
    """
    if value != 0.0 and not 1.0 / _LARGE < abs(value) < _LARGE:
        scale = _LARGE**0.5 if abs(value) < 1.0 else _LARGE**-0.5
        near = simple_numbers(value * scale, error * scale).items()
        return {
            quotient: length
            for number, length in near
            if (quotient := number / scale) != 0.0 and math.isfinite(quotient)
        }
    lengths: dict[float, float] = {}
    for unit, digits, price in ((1.0, sys.float_info.dig, 0.0), (math.pi, _DIGITS_OF_PI, SETTINGS.regression.pi_nats)):
        for denominator in SETTINGS.regression.denominators:
            for number, numerator in _near(value, error, denominator, unit, digits):
                length = number_length(numerator, denominator) + price
                lengths[number] = min(length, lengths.get(number, math.inf))
    return lengths


def continuum_density(value: float) -> float:
    """Return the probability of any number per unit at `value`, when it is as large by decades as that of simple ones.

    Simple numbers of length L have the probability e^-L, up to a common factor; the sum of those between two powers of
    ten, the same for all, is spread evenly over the logarithm of that decade.
    """
    return _probability_of_decade() / math.log(10.0) / abs(value)


@cache
def _probability_of_decade() -> float:
    """Return the sum of e^-L over the simple numbers between a power of ten and ten times that, pi left out."""
    lengths: dict[str, float] = {}
    rest = 0.0
    for denominator in SETTINGS.regression.denominators:
        for numerator in range(1, 10**_SHORT):
            if numerator % 10 and math.gcd(numerator, denominator) == 1:
                digits = f"{numerator / denominator:.12e}".split("e")[0]
                lengths[digits] = min(number_length(numerator, denominator), lengths.get(digits, math.inf))
        recurs = 10 * denominator
        share = sum(residue % 10 > 0 and math.gcd(residue, denominator) == 1 for residue in range(recurs)) / recurs
        of_digits = share * math.log(10.0) * math.exp(number_length(0) - number_length(0, denominator))
        rest += sum(of_digits * math.exp(-_DIGIT * more) for more in range(_SHORT, sys.float_info.dig))
    return rest + sum(math.exp(-length) for length in lengths.values())


def _near(value: float, error: float, denominator: int, unit: float, digits: int) -> Iterator[tuple[float, int]]:
    """Yield multiples of `unit` by p/q times powers of ten near `value`, with p, which has at most so many digits."""
    if value == 0.0:
        return
    beside = SETTINGS.regression.numerators_beside
    reach = max(SETTINGS.regression.rounding_reach * error, abs(value) * 4.0 * 2.0**-52)
    size, scale = value / unit * denominator, denominator / unit
    finest = max(error if scale != 1.0 else error / 10.0, abs(value) * 10.0**-sys.float_info.dig) * scale
    first = math.floor(math.log10(abs(size))) + 1
    for exponent in range(first, max(first - digits, -300) - 1, -1):
        step = 10.0**exponent
        if step < 0.999 * finest:  # not equal by chance of rounding in another unit
            return
        nearest, around = round(size / step), beside if reach * scale > 0.25 * step else 0
        if abs(nearest * step - size) > 2.0 * reach * scale:
            continue
        for numerator in range(nearest - around, nearest + around + 1):
            if numerator % 10 and math.gcd(numerator, denominator) == 1:
                number = _ratio(numerator, denominator, exponent) * unit
                if abs(number - value) <= reach:
                    yield number, numerator


def _ratio(numerator: int, denominator: int, exponent: int) -> float:
    """Return p/q times a power of ten as the nearest number that there is."""
    return float(numerator * 10 ** max(exponent, 0) / (denominator * 10 ** max(-exponent, 0)))
