"""Gaps in the times: bridged when short, where a trajectory goes on as another when long."""

import math

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.trajectories.measurements import find_pieces, split_at_gaps
from atoll_core.config import Angle, DataConfig, JobConfig
from tests.unit.coordinator.data.tables import measurements_of, oscillator, table_of


def without(columns, *ranges):
    """Leave out half-open ranges of rows."""
    kept = [row for row in range(len(columns["t"])) if not any(first <= row < last for first, last in ranges)]
    return {name: np.asarray(values)[kept] for name, values in columns.items()}


def split(columns, span=20, starts=(0,), **options):
    measurements = measurements_of(table_of(columns, starts), DataConfig(**options))
    return measurements, split_at_gaps(measurements, span)


def noisy(columns, noise=0.05):
    rng = np.random.default_rng(0)
    return columns | {name: columns[name] + noise * rng.standard_normal(len(columns[name])) for name in "xy"}


@pytest.mark.parametrize(
    ("times", "span", "pieces"),
    [
        (np.arange(30.0), 5, [(0, 30)]),
        (np.array([*range(10), *range(40, 50)]), 30, [(0, 10), (10, 20)]),
        (np.array([*range(10), *range(40, 50)]), 31, [(0, 20)]),
        (np.array([*range(10), *range(30, 40)]), 3, [(0, 10), (10, 20)]),
        (np.array([*range(10), *range(29, 39)]), 3, [(0, 20)]),
        (np.array([*range(6), *range(40, 41), *range(80, 90)]), 20, [(0, 6), (6, 7), (7, 17)]),
    ],
)
def test_pieces_lie_between_gaps_longer_than_the_span(times, span, pieces):
    assert find_pieces(times.astype(float), span) == pieces


def test_times_drawn_at_random_have_no_gaps():
    times = np.sort(np.random.default_rng(0).uniform(0.0, 100.0, 10_000))
    assert len(find_pieces(times, 5)) == 1


def test_even_times_are_left_alone():
    measurements, whole = split(oscillator(60))
    assert whole is measurements


def test_a_trajectory_is_split_and_its_parts_are_named():
    columns = without(oscillator(200), (50, 80), (120, 160))
    measurements, pieces = split(columns, starts=(0, 10))
    assert pieces.trajectories is not None
    assert pieces.ranges == ((0, 10), (10, 50), (50, 90), (90, 130))
    assert pieces.trajectories.names == ("1", "2", "2b", "2c")
    assert [len(times) for times in pieces.trajectories.times] == [10, 40, 40, 40]
    assert (
        np.concatenate(pieces.trajectories.states["x"]).tolist()
        == np.concatenate(measurements.trajectories.states["x"]).tolist()
    )
    sentence = "2 gaps in the times are longer than what is smoothed at a time; trajectories are split there: 2 into "
    assert pieces.warnings[-1] == sentence + "2, 2b, 2c."


def test_short_pieces_are_left_out():
    columns = without(oscillator(200), (50, 80), (83, 120))
    _, pieces = split(columns, inputs=("y",))
    assert pieces.ranges == ((0, 50), (50, 130))
    assert pieces.warnings[-1] == "3 rows in pieces of fewer than 5 rows between gaps are left out."
    assert pieces.columns["y"].tolist() == [*columns["y"][:50], *columns["y"][53:]]


def test_bursts_too_short_to_be_differentiated_are_bridged():
    columns = without(oscillator(400), *((first + 3, first + 33) for first in range(0, 330, 33)))
    columns = {name: values[:32] for name, values in columns.items()}
    measurements, whole = split(columns)
    assert whole.ranges == measurements.ranges
    assert whole.warnings[-1].startswith("10 gaps in the times are bridged although long, because the pieces")


def test_held_out_trajectories_are_split_too():
    columns = {name: np.tile(values, 2) for name, values in without(oscillator(100), (40, 70)).items()}
    _, pieces = split(columns, starts=(0, 70), holdout=1)
    assert pieces.held_out == (False, False, True, True)
    assert pieces.held_out_rows == list(range(70, 140))


def test_a_recording_has_the_pieces_as_trajectories():
    """Dropped rows may leave a gap: nothing is measured for a while."""
    columns = noisy(oscillator(300))
    columns["x"][100:220] = columns["y"][100:220] = math.nan
    recording = prepare(table_of(columns), JobConfig(data=DataConfig(missing="drop"))).recording
    assert recording is not None
    assert [(trajectory.name, len(trajectory.times)) for trajectory in recording.trajectories] == [
        ("1", 100),
        ("1b", 80),
    ]
    assert recording.trajectories[1].times[0] - recording.trajectories[0].times[-1] == pytest.approx(12.1)
    assert [trajectory.measured.shape for trajectory in recording.trajectories] == [(2, 100), (2, 80)]


def test_derivatives_do_not_reach_across_a_long_gap():
    """What is measured after the gap has nothing to do with what was before."""
    columns = without(oscillator(300), (100, 200))
    moved = {name: np.where(np.arange(200) < 100, values, values + 7.0) for name, values in columns.items()}
    slopes = []
    for measured in (columns, moved):
        measured["t"] = columns["t"]
        recording = prepare(table_of(measured), JobConfig()).recording
        assert recording is not None
        slopes.append(np.concatenate([part.slopes for part in recording.trajectories], axis=1))
    assert slopes[1] == pytest.approx(slopes[0], abs=1e-9)


def test_an_angle_is_unwrapped_before_it_is_split():
    columns = without(oscillator(200), (80, 120))
    columns["y"] = np.mod(0.5 * columns["t"], 2 * math.pi)
    _, pieces = split(columns, angles=(Angle(column="y"),))
    assert np.concatenate(pieces.trajectories.states["y"]) == pytest.approx(0.5 * columns["t"])


def test_thirty_percent_of_the_rows_may_be_missing():
    for noise in (0.0, 0.05):
        columns = noisy(oscillator(400), noise)
        columns["x"][np.random.default_rng(1).uniform(size=400) < 0.3] = math.nan
        preparation = prepare(table_of(columns), JobConfig(data=DataConfig(missing="drop")))
        assert preparation.recording is not None
        assert len(preparation.recording.trajectories) == 1
        error = np.abs(preparation.dataset.targets[0].values - preparation.dataset.inputs[1])
        assert error.mean() < (1e-7 if noise == 0.0 else 0.06)
