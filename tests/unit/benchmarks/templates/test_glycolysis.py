"""The benchmark of glycolysis: its frequency, and what rows can say about it."""

import numpy as np
import pytest

from benchmarks.templates.glycolysis import STATES, period, truth
from benchmarks.templates.information import table_of_information


def test_a_period_is_found_between_rows() -> None:
    times = np.linspace(0.0, 10.0, 151)
    assert period(times, 3.0 + np.sin(2.0 * np.pi * times / 1.7)) == pytest.approx(1.7, rel=1e-3)
    assert period(times, times) is None


def test_the_truth_oscillates_as_published() -> None:
    times = np.linspace(0.0, 5.0, 2001)
    assert period(times[600:], truth(times)[600:, STATES.index("A3")]) == pytest.approx(1.168, rel=1e-3)


def test_more_noise_and_fewer_rows_say_less_about_the_frequency() -> None:
    lines = table_of_information([50, 200], [5, 10]).splitlines()[2:6]
    few, few_noisy, many, many_noisy = (float(line.split("|")[3].removesuffix(" % ")) for line in lines)
    assert few_noisy == pytest.approx(2.0 * few, rel=1e-2)
    assert many_noisy == pytest.approx(2.0 * many, rel=2e-2)
    # four times as many rows have at least half the deviation, apart from rows at the very end
    assert 0.3 < many / few < 0.6
    with_bounds = float(lines[0].split("|")[5].removesuffix(" % "))
    assert with_bounds < few
