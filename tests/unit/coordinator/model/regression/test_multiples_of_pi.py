"""Multiples of pi are simple numbers, but no decimal of one or two digits is taken for one."""

import math

import pytest

from atoll_coordinator.model.regression.rounding import simple_numbers


def _shortest(value: float, error: float) -> float:
    simple = simple_numbers(value, error)
    return min(simple, key=simple.__getitem__)


@pytest.mark.parametrize("multiple", [math.pi, math.pi / 2.0, -math.pi / 6.0, 2.0 * math.pi, 4.0 * math.pi / 3.0])
def test_what_is_known_to_three_digits_may_be_a_multiple_of_pi(multiple: float) -> None:
    assert _shortest(multiple * 1.0001, abs(multiple) * 2e-4) == pytest.approx(multiple, rel=1e-15)


@pytest.mark.parametrize(
    ("value", "error", "simple"), [(3.0, 0.1, 3.0), (3.1, 0.02, 3.1), (1.5, 0.05, 1.5), (0.5, 0.02, 0.5)]
)
def test_short_decimals_stay_what_they_are(value: float, error: float, simple: float) -> None:
    assert _shortest(value, error) == simple


def test_a_number_far_from_every_multiple_is_none() -> None:
    assert all(number / math.pi * 12.0 % 1.0 > 1e-9 for number in simple_numbers(2.0, 1e-3))
