"""Times: centred, and exactly even where they are even within their precision."""

import numpy as np
import pytest

from atoll_coordinator.data.trajectories.measurements import distinguish, format_number, unwrap
from atoll_core.config import DataConfig
from tests.unit.coordinator.data.tables import measurements_of, oscillator, table_of


def times_of(columns, starts=(0,)):
    return measurements_of(table_of(columns, starts), DataConfig(states=("x", "y"), missing="drop")).trajectories.times


@pytest.mark.parametrize("start", [0.0, 1900.0, -3.0, 1e9])
def test_an_offset_of_the_times_costs_no_precision(start):
    (times,) = times_of(oscillator(501, 0.02, start))
    assert np.abs(np.diff(times) - 0.02).max() < 1e-14


def test_times_are_centred_over_all_trajectories():
    columns = {name: np.tile(values, 2) for name, values in oscillator(11).items()}
    columns["t"][11:] += 3.0
    first, second = times_of(columns, (0, 11))
    assert first[0] == pytest.approx(-2.0)
    assert second[-1] == pytest.approx(2.0)


def test_uneven_steps_stay_as_they_are():
    columns = oscillator(20)
    columns["t"] = np.cumsum(np.random.default_rng(0).uniform(0.1, 0.2, 20))
    (times,) = times_of(columns)
    assert np.diff(times) == pytest.approx(np.diff(columns["t"]), rel=1e-12)


def test_dropped_rows_leave_an_uneven_step():
    columns = oscillator(20)
    columns["x"][7] = columns["y"][7] = np.nan
    (times,) = times_of(columns)
    assert times[7] - times[6] == pytest.approx(0.2)


def test_unwrapping_takes_out_jumps_of_more_than_half_a_turn():
    angles = np.cumsum(np.random.default_rng(1).uniform(-3.0, 3.0, 100))
    assert unwrap(np.mod(angles + np.pi, 2 * np.pi) - np.pi) - angles == pytest.approx(
        np.full(100, round(-angles[0] / (2 * np.pi)) * 2 * np.pi), abs=1e-9
    )


def test_names_that_come_again_get_letters():
    assert distinguish(["2", "2", "3", "2"]) == ("2", "2b", "3", "2c")
    assert distinguish(["7", "7", "7b"]) == ("7", "7b", "7bb")
    many = distinguish(["1"] * 28)
    assert (many[25], many[26], many[27]) == ("1z", "1aa", "1ab")


@pytest.mark.parametrize(
    ("value", "text"),
    [(4.0, "4"), (-3.0, "-3"), (0.5, "0.5"), (1e300, "1e+300"), (-0.0, "-0"), (1e15, "1000000000000000.0")],
)
def test_numbers_are_written_plainly(value, text):
    assert format_number(value) == text
