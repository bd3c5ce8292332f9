"""Errors that grow with the value are found in the residuals of smoothing; the numbers that trajectories hold."""

import math
from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.shooting.measurements import measurements_of
from atoll_coordinator.model.shooting.residual_noise import _correlation_length, count_pieces
from atoll_coordinator.model.shooting.smoothing_noise import VarianceModel, estimate_variances
from atoll_core.config import JobConfig
from tests.unit.coordinator.data.tables import table_of
from tests.unit.coordinator.model.shooting.made import LOTKA, SWING, recording


def estimate_variance(rows, state) -> VarianceModel:
    return estimate_variances(rows)[state]


STARTS = [[10.0, 5.0], [6.0, 2.0]]
TIMES = np.linspace(0.0, 12.0, 200)


def measured(proportional, constant=0.0, seed=0):
    """Return a recording whose first state has errors of both kinds, smoothed exactly."""
    exact, draw = recording(LOTKA, STARTS, TIMES), np.random.default_rng(seed)
    parts = []
    for part in exact.trajectories:
        sizes = np.sqrt(constant**2 + (proportional * part.measured) ** 2)
        noisy = part.measured + sizes * draw.standard_normal(part.measured.shape)
        parts.append(replace(part, measured=noisy, smoothed=part.measured))
    smoothing = tuple(replace(estimate, method="loess", noise=0.1) for estimate in exact.smoothing)
    return replace(exact, trajectories=tuple(parts), smoothing=smoothing)


def test_proportional_errors_are_found_and_weighted():
    rows = measured(0.05)
    model = estimate_variance(rows, 0)
    assert model.proportional >= 0.9
    layout = measurements_of(rows, [0, 1])
    errors = (layout.measured - layout.smoothed) ** 2 * layout.weights
    low = layout.smoothed[0] < np.median(layout.smoothed[0])
    assert errors[0, low].mean() == pytest.approx(errors[0, ~low].mean(), rel=0.4)
    assert layout.inverse_variances.mean() == pytest.approx(1.0)


def test_a_constant_part_beside_it_is_told_apart():
    estimates = [estimate_variance(measured(0.05, 0.03, seed), 0) for seed in range(20)]
    assert [estimate.proportional > 0.0 for estimate in estimates].count(True) >= 18
    true = (0.05 * estimates[0].rms) ** 2 / ((0.05 * estimates[0].rms) ** 2 + 0.03**2)
    assert np.median([estimate.proportional for estimate in estimates]) == pytest.approx(true, abs=0.15)


def test_equal_errors_are_hardly_ever_taken_for_proportional_ones():
    estimates = [estimate_variance(measured(0.0, 0.2, seed), 0).proportional for seed in range(40)]
    assert sum(share > 0.0 for share in estimates) <= 4


def test_rows_with_weights_or_interpolated_states_stay_as_they_are():
    rows = measured(0.05)
    clean = replace(rows, smoothing=tuple(replace(estimate, method="interpolation") for estimate in rows.smoothing))
    given = replace(rows, trajectories=tuple(replace(part, weights=np.ones(200)) for part in rows.trajectories))
    assert estimate_variance(clean, 0).proportional == 0.0
    assert estimate_variance(given, 0).proportional == 0.0
    assert measurements_of(clean, [0]).inverse_variances is None


def test_zeros_along_a_whole_trajectory_say_nothing_of_errors():
    rows = measured(0.0, 0.3)
    absent = replace(rows.trajectories[1], measured=0.0 * rows.trajectories[1].measured, smoothed=np.zeros((2, 200)))
    assert estimate_variance(replace(rows, trajectories=(rows.trajectories[0], absent)), 0) == estimate_variance(
        replace(rows, trajectories=rows.trajectories[:1]), 0
    )


@pytest.mark.parametrize("count", [8, 12, 21])
def test_few_equal_errors_are_rarely_taken_for_proportional_ones(count):
    """Loess follows the rows at the ends, where a decay is largest and least: their residuals say little."""
    times, draw, found = np.linspace(0.0, 6.0, count), np.random.default_rng(3), 0
    for _ in range(40):
        values = 2.0 * np.exp(-0.4 * times) + 0.1 * draw.standard_normal(count)
        prepared = prepare(table_of({"t": times, "x": values}), JobConfig())
        found += estimate_variance(prepared.recording, 0).proportional > 0.0
    assert found <= 4


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
