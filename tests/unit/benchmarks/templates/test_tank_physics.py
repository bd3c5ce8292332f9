"""The physics of two tanks, against steady levels and the balance of volumes."""

import numpy as np
import pytest

from benchmarks.templates.tank_physics import levels


def test_levels_at_which_inflow_and_outflow_are_equal_do_not_change() -> None:
    k, a, b, e, r, c, d = 0.05, 0.06, 0.04, 0.03, 0.5, 0.2, 0.1
    upper = (k * 2.0 / a) ** 2 - c
    lower = (b * k * 2.0 / a / e) ** 2 - d
    found = levels(np.array([k, a, b, e, r, upper, lower, c, d]), np.full(50, 2.0))
    assert found == pytest.approx(np.full(50, lower), rel=1e-9)


def test_a_full_upper_tank_overflows_into_the_lower_one() -> None:
    numbers = np.array([0.05, 0.01, 0.0, 0.0, 0.5, 10.0, 1.0, 0.0, 0.0])
    rise = 0.5 * (0.05 * 2.0 - 0.01 * 10.0**0.5)  # half of what the upper tank cannot hold
    assert levels(numbers, np.full(5, 2.0)) == pytest.approx(1.0 + 4.0 * rise * np.arange(5), rel=1e-9)
    assert levels(numbers, np.full(100, 2.0)).max() == 10.0
