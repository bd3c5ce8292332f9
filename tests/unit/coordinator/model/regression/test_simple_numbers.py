"""How long numbers are, and which simple ones are near."""

import math
import sys

import pytest

from atoll_coordinator.model.regression.rounding import (
    continuum_density,
    fitted_length,
    number_length,
    simple_numbers,
)


def nearest(value: float, error: float) -> float:
    """The number that an error of so much would be round_constants to."""
    priced = {
        number: length + 0.5 * ((number - value) / error) ** 2
        for number, length in simple_numbers(value, error).items()
    }
    return min(priced, key=priced.__getitem__)


@pytest.mark.parametrize(
    ("value", "error", "expected"),
    [
        (0.0993, 0.002, 0.1),
        (2.9997, 0.01, 3.0),
        (0.4924, 0.0037, 0.5),
        (0.07483, 0.00053, 0.075),
        (-0.04936, 0.00058, -0.05),
        (3.327, 0.024, 10.0 / 3.0),
        (9.93, 0.065, 10.0),
        (2.9999999999999996, 1e-14, 3.0),
        (1.234e-6, 1e-10, 1.234e-6),
        (19.6e6, 3e5, 2e7),
    ],
)
def test_a_constant_is_near_its_simple_number(value, error, expected):
    assert nearest(value, error) == expected


def test_a_number_beyond_reach_is_not_considered():
    assert 1.0 not in simple_numbers(1.1, 0.01)
    assert 0.0 not in simple_numbers(0.001, 10.0)


def test_a_constant_without_error_is_exact():
    assert set(simple_numbers(0.25, 0.0)) == {0.25}
    assert simple_numbers(0.25, 0.0)[0.25] == number_length(1, 4)


def test_fractions_and_decimals_have_their_lengths():
    assert number_length(-2, 3) == math.log1p(2.0) + math.log1p(3.0)
    assert number_length(7) == math.log1p(7.0)
    assert number_length(75) == pytest.approx(math.log(76.0) + math.log(3.0))


def test_fewer_digits_are_shorter():
    lengths = [simple_numbers(number, 0.0)[number] for number in (3.0, 3.1, 3.14, 3.141, 3.1416)]
    assert lengths == sorted(lengths)


def test_a_fitted_constant_is_longer_the_better_it_is_known_and_than_the_decimal_it_needs():
    lengths = [fitted_length(3.14159, 10.0**-digits) for digits in range(1, 12)]
    assert lengths == sorted(lengths)
    assert all(fitted_length(3.14159, error) > number_length(314) for error in (0.01, 0.006))


def test_an_error_larger_than_the_constant_leaves_its_sign_only():
    assert fitted_length(0.5, 100.0) == fitted_length(0.5, 0.5)
    assert fitted_length(0.0, 0.0) == 0.0


@pytest.mark.parametrize("value", [sys.float_info.max, 1e308, -3e307, 1e-307, -5e-324])
def test_the_largest_and_the_smallest_numbers_have_lengths_and_densities(value):
    error = max(1e-3 * abs(value), 5e-324)
    assert all(math.isfinite(value) for number in simple_numbers(value, error).items() for value in number)
    assert math.isfinite(fitted_length(value, error))
    assert continuum_density(value) > 0.0
