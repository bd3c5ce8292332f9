"""How long numbers are, and which simple ones are near."""

import math
import sys

import pytest

from atoll_coordinator.model.constants.rounding import (
    continuum_density,
    number_length,
    simple_numbers,
)


def nearest(value: float, error: float) -> float:
    """Return the most probable number near a value with this error."""
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


@pytest.mark.parametrize("value", [sys.float_info.max, 1e308, -3e307, 1e-307, -5e-324])
def test_the_largest_and_the_smallest_numbers_have_lengths_and_densities(value):
    error = max(1e-3 * abs(value), 5e-324)
    assert all(math.isfinite(value) for number in simple_numbers(value, error).items() for value in number)
    assert continuum_density(value) > 0.0


def shortest(value: float, error: float) -> float:
    simple = simple_numbers(value, error)
    return min(simple, key=simple.__getitem__)


@pytest.mark.parametrize("multiple", [math.pi, math.pi / 2.0, -math.pi / 6.0, 2.0 * math.pi, 4.0 * math.pi / 3.0])
def test_what_is_known_to_three_digits_may_be_a_multiple_of_pi(multiple: float) -> None:
    assert shortest(multiple * 1.0001, abs(multiple) * 2e-4) == pytest.approx(multiple, rel=1e-15)


@pytest.mark.parametrize(
    ("value", "error", "simple"), [(3.0, 0.1, 3.0), (3.1, 0.02, 3.1), (1.5, 0.05, 1.5), (0.5, 0.02, 0.5)]
)
def test_short_decimals_stay_what_they_are(value: float, error: float, simple: float) -> None:
    assert shortest(value, error) == simple


def test_a_number_far_from_every_multiple_is_none() -> None:
    assert all(number / math.pi * 12.0 % 1.0 > 1e-9 for number in simple_numbers(2.0, 1e-3))
