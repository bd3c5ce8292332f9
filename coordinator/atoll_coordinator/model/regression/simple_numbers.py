"""Simple numbers: how many nats it takes to write one down, which lie near a fitted constant, and how densely.

A simple number is a fraction p/q of whole numbers, a decimal m 10^e or a multiple p/q of pi, whichever is shorter. A
fitted constant counts as a decimal, too: one with as many digits as its standard error leaves it.
"""

import math
import sys
from collections.abc import Iterator
from functools import cache
from typing import Final

from atoll_coordinator.settings import SETTINGS

_POWER: Final = math.log(3.0)
_MANY: Final = 10_000
"""Of more numerators the sum of their probabilities is an integral."""
_FINER: Final = math.log(10.0) + _POWER
"""A decimal that is finer than the error may need one digit more."""


def fraction_length(numerator: int, denominator: int) -> float:
    """Return the length of p/q in nats."""
    return math.log1p(abs(numerator)) + (math.log1p(denominator) if denominator > 1 else 0.0)


def decimal_length(mantissa: int, exponent: int) -> float:
    """Return the length of m 10^e in nats."""
    return math.log1p(abs(mantissa)) + _POWER * abs(exponent)


def fitted_length(value: float, error: float) -> float:
    """Return the length in nats of `value` written with the digits that its standard error leaves it."""
    error = min(max(error, abs(value) * 10.0**-sys.float_info.dig), abs(value))
    if error == 0.0:
        return 0.0
    return math.log1p(abs(value) / error) + _POWER * abs(math.log10(error)) + _FINER


def simple_numbers(value: float, error: float, *, in_any_unit: bool = False) -> dict[float, float]:
    """Return numbers within a few standard errors of `value`, each with its length in nats; 0 is not among them.

    The more digits the error leaves, the more of them are considered, up to one more than it justifies.

    Args:
        value: not 0.
        error: its standard error.
        in_any_unit: count the digits of decimals, not their power of ten, which the size of `value` tells.
    """
    reach = max(SETTINGS.regression.rounding_reach * error, abs(value) * 4.0 * 2.0**-52)
    found: dict[float, float] = {}
    for number, length in (
        *_fractions(value),
        *_multiples_of_pi(value),
        *_decimals(value, error, in_any_unit=in_any_unit),
    ):
        if number != 0.0 and abs(number - value) <= reach:
            found[number] = min(length, found.get(number, math.inf))
    return found


def continuum_density(value: float) -> float:
    """Return the probability of any number per unit at `value`, when it is as large by decades as that of simple ones.

    Simple numbers of length L have the probability e^-L in any unit, up to a common factor; the sum of those between
    two powers of ten is spread evenly over the logarithm of that decade.
    """
    return _probability_of_decade(math.floor(math.log10(abs(value)))) / (math.log(10.0) * abs(value))


@cache
def _probability_of_decade(exponent: int) -> float:
    """Return the sum of e^-L over the simple numbers between 10^exponent and ten times that, pi left out."""
    lengths: dict[float, float] = {}
    for power in (exponent, exponent - 1):
        for mantissa in range(10 ** (exponent - power), 10 ** (exponent - power + 1)):
            if mantissa % 10 or mantissa == 0:
                lengths[float(f"{mantissa}e{power}")] = decimal_length(mantissa, exponent - power)
    finer = range(2, sys.float_info.dig)
    total = sum(0.9 * math.log(10.0) * math.exp(-_POWER * more) for more in finer)
    for denominator in SETTINGS.regression.denominators:
        first, last = math.ceil(denominator * 10.0**exponent), math.ceil(denominator * 10.0 ** (exponent + 1))
        if last > _MANY:
            share = sum(math.gcd(each, denominator) == 1 for each in range(denominator)) / denominator
            total += share * math.log(10.0) * math.exp(-fraction_length(0, denominator))
            continue
        for numerator in range(max(first, 1), last):
            if math.gcd(numerator, denominator) == 1:
                its = numerator / denominator
                lengths[its] = min(fraction_length(numerator, denominator), lengths.get(its, math.inf))
    return total + sum(math.exp(-each) for each in lengths.values())


def _fractions(value: float) -> Iterator[tuple[float, float]]:
    if abs(value) > 1e6:
        return
    for denominator in SETTINGS.regression.denominators:
        nearest = round(value * denominator)
        for numerator in range(
            nearest - SETTINGS.regression.numerators_beside, nearest + SETTINGS.regression.numerators_beside + 1
        ):
            if math.gcd(numerator, denominator) == 1:
                yield numerator / denominator, fraction_length(numerator, denominator)


def _multiples_of_pi(value: float) -> Iterator[tuple[float, float]]:
    for denominator in SETTINGS.regression.denominators:
        numerator = round(value * denominator / math.pi)
        if numerator and math.gcd(numerator, denominator) == 1:
            yield (
                numerator * math.pi / denominator,
                fraction_length(numerator, denominator) + SETTINGS.regression.pi_nats,
            )


def _decimals(value: float, error: float, *, in_any_unit: bool) -> Iterator[tuple[float, float]]:
    if value == 0.0:
        return
    first = math.floor(math.log10(abs(value))) + 1
    finest = max(error / 10.0, abs(value) * 10.0**-sys.float_info.dig)
    for exponent in range(first, first - sys.float_info.dig - 1, -1):
        if 10.0**exponent < finest:
            return
        nearest = round(value / 10.0**exponent) if exponent > -300 else 0
        for mantissa in range(
            nearest - SETTINGS.regression.numerators_beside, nearest + SETTINGS.regression.numerators_beside + 1
        ):
            if mantissa % 10:
                power = len(str(abs(mantissa))) - 1 if in_any_unit else exponent
                yield float(f"{mantissa}e{exponent}"), decimal_length(mantissa, power)
