"""How many independent numbers trajectories hold: the lag at which they have forgotten themselves."""

import math
from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.shooting.independence import _correlation_length, count_pieces
from atoll_coordinator.model.shooting.measurements import measurements_of
from tests.unit.coordinator.model.shooting.made import SWING, recording


def summed(parts):
    """Return the first lag by its definition."""
    least = sum(float(part @ part) for part in parts) / math.e
    longest = max(map(len, parts), default=1)
    lags = range(1, max(longest, 2))
    sums = (sum(float(part[:-lag] @ part[lag:]) for part in parts if len(part) > lag) for lag in lags)
    return next((lag for lag, total in zip(lags, sums, strict=True) if not total > least), max(longest, 1))


@pytest.mark.parametrize("width", [1, 5, 60])
@pytest.mark.parametrize("lengths", [(), (0,), (1,), (2, 1), (200,), (150, 3, 80)])
def test_the_lag_is_that_of_the_definition(width, lengths):
    rng = np.random.default_rng(width)
    smooth = [np.convolve(rng.normal(size=rows + width - 1), np.ones(width), "valid") for rows in lengths if rows]
    parts = [*smooth, *(np.zeros(0) for rows in lengths if not rows)]
    assert _correlation_length(parts) == summed(parts)
    assert _correlation_length([1e150 * part for part in parts]) == summed([1e150 * part for part in parts])


@pytest.mark.parametrize("value", [0.0, 1.0, math.nan])
def test_what_does_not_change_has_a_lag_as_well(value):
    parts = [np.full(40, value), np.full(7, value)]
    assert _correlation_length(parts) == summed(parts)


def test_a_million_rows_take_no_longer_than_a_transform():
    """Were each lag summed up, sixty thousand of them would be."""
    slow = np.sin(2e-5 * np.arange(1_000_000))
    assert 55_000 < _correlation_length([np.diff(slow)]) < 60_000


def test_pieces_are_rows_over_the_lag():
    rows = measurements_of(recording(SWING, ([1.0, 2.0],), 0.1 * np.arange(300.0), noise=0.1), [0, 1])
    lags = [summed([np.diff(values)]) for values in rows.smoothed]
    assert count_pieces(rows) == pytest.approx([300.0 / lag for lag in lags])
    half = replace(rows, weights=np.where(np.arange(300) < 150, rows.weights, 0.0))
    assert count_pieces(half) == pytest.approx([150.0 / lag for lag in lags])
