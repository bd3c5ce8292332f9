"""Rows far closer than the states' time scales become means, so that what comes after sees the same motion alike."""

import math

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.derivatives import Differentiation, estimate_states
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.roles.roles import assign_roles
from atoll_coordinator.data.row_means import (
    average_oversampled_rows,
    correlation_length,
    divided_blocks,
    even_blocks,
    input_means,
    interpolated,
    rows_of_mean,
)
from atoll_coordinator.data.trajectories.measurements import take_measurements
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import DataConfig, JobConfig
from tests.unit.coordinator.data.tables import table_of

PERIOD = 2.0 * math.pi


def wave(rows, periods=5.0, noise=0.02, **columns):
    """Return a sine and a cosine over some periods with noise, and further columns by functions of time."""
    t = np.linspace(0.0, periods * PERIOD, rows)
    rng = np.random.default_rng(3)
    made = {"t": t, "x": np.sin(t), "y": np.cos(t)}
    made |= {name: made[name] + noise * rng.standard_normal(rows) for name in ("x", "y")}
    return made | {name: column(t) for name, column in columns.items()}


def smoothed(columns, starts=(0,), **options):
    """Return measurements and estimates as preparing has them before it averages."""
    table = table_of(columns, starts)
    roles, config = assign_roles(table, DataConfig(**options))
    measurements = take_measurements(table, roles, config)
    differentiation = Differentiation(config.order, False, config.robust)
    return measurements, estimate_states(measurements, measurements.weights, differentiation)


def averaged(columns, starts=(0,), **options):
    return average_oversampled_rows(*smoothed(columns, starts, **options))


@pytest.mark.parametrize("rows", [500, 1500, 5000, 15000])
def test_the_correlation_length_is_a_share_of_the_period_however_often_it_is_sampled(rows):
    """The autocorrelation of a sinusoid is the cosine of the lag, 1/e after 1.194 rad."""
    measurements, estimates = smoothed(wave(rows))
    expected = math.acos(math.exp(-1.0)) / PERIOD * rows / 5.0
    for estimate in estimates:
        assert correlation_length(measurements, estimate) == pytest.approx(expected, rel=0.05, abs=1.0)


@pytest.mark.parametrize(("rows", "expected"), [(500, 1), (1000, 3), (3000, 7), (10000, 23)])
def test_means_are_of_as_many_rows_as_there_are_too_many_of(rows, expected):
    """Whole trajectories are compared of 500 rows and less; there is room for rows where an input is switched."""
    assert rows_of_mean(*smoothed(wave(rows))) == expected


def test_a_table_of_few_rows_in_a_correlation_length_stays_as_it_is():
    measurements, estimates = smoothed(wave(4000, periods=60.0))
    assert average_oversampled_rows(measurements, estimates) is measurements


@pytest.mark.parametrize("noise", [0.0, 3e-5])
def test_nor_are_states_averaged_that_have_next_to_no_noise(noise):
    measurements, estimates = smoothed(wave(6000, noise=noise))
    assert average_oversampled_rows(measurements, estimates) is measurements


def test_means_have_less_noise_and_neither_bias_nor_memory():
    columns = wave(10000, noise=0.05)
    made = averaged(columns)
    (times,), offset = made.trajectories.times, made.trajectories.offset
    for name, truth in (("x", np.sin), ("y", np.cos)):
        errors = made.trajectories.states[name][0] - truth(times + offset)
        assert float(np.std(errors)) == pytest.approx(0.05 / math.sqrt(23), rel=0.15)
        assert abs(float(np.mean(errors))) < 4.0 * 0.05 / math.sqrt(10000)
        neighbours = float(np.corrcoef(errors[1:], errors[:-1])[0, 1])
        assert abs(neighbours) < 3.0 / math.sqrt(len(errors))
        assert made.columns[name].tolist() == made.trajectories.states[name][0].tolist()


def test_what_is_prepared_of_the_same_motion_is_alike():
    sampled = [prepare(table_of(wave(rows, noise=0.03), (0,)), JobConfig()) for rows in (3000, 10000)]
    for preparation in sampled:
        (trajectory,) = preparation.recording.trajectories
        assert 425 <= len(trajectory.times) <= 435
        assert "means of" in preparation.dataset.warnings[0]
    assert [preparation.recording.rows_of_mean for preparation in sampled] == [7, 23]
    noises = [preparation.recording.smoothing[0].noise for preparation in sampled]
    assert noises == pytest.approx([0.03 / math.sqrt(n) for n in (7, 23)], rel=0.15)


def test_trajectories_groups_and_held_out_ones_stay_apart():
    parts = [wave(4000), wave(4000), wave(4000)]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    columns["kind"] = np.repeat([1.0, 2.0, 1.0], 4000)
    made = averaged(columns, (0, 4000, 8000), group="kind", holdout=1)
    assert made.ranges == ((0, 444), (444, 888), (888, 1332))
    assert (made.held_out, made.groups) == ((False, False, True), ("1", "2", "1"))


def test_missing_values_count_for_nothing_and_a_block_without_most_of_them_is_missing():
    columns = wave(10000)
    columns["x"][5003] = np.nan
    columns["y"][6008:6028] = np.nan
    made = averaged(columns, missing="drop")
    (x,), (y,) = made.trajectories.states["x"], made.trajectories.states["y"]
    assert np.isfinite(x).all()
    assert np.flatnonzero(np.isnan(y)).tolist() == [261]


def test_outliers_do_not_move_the_means_of_robust_smoothing():
    columns = wave(3000)
    without = averaged(columns, robust=True).trajectories.states["x"][0]
    columns["x"][::97] += 40.0
    made = averaged(columns, robust=True)
    assert made.trajectories.states["x"][0] == pytest.approx(without, abs=0.1)


def test_weights_of_rows_add_up():
    columns = wave(10000)
    columns["w"] = np.where(columns["t"] < 15.0, 1.0, 4.0)
    weights = averaged(columns, weights="w").weights
    assert (weights[0], weights[-1]) == (23.0, 96.0)


# ------------------------------------------------------------------------------------------------------ inputs


def switched(t):
    return np.where(np.sin(0.4 * t) > 0.0, 1.0, -1.0)


def test_rows_stay_one_by_one_where_an_input_is_switched():
    """The states have no means there."""
    columns = wave(10000, u=switched)
    made = averaged(columns, inputs=("u",))
    (times,), ((u,), (x,)) = made.trajectories.times, (made.inputs[0], made.trajectories.states["x"])
    steps = np.diff(times)
    switches = np.flatnonzero(np.abs(np.diff(u)) > 1.0)
    assert len(switches) == int(np.sum(np.diff(switched(columns["t"])) != 0.0))
    assert np.max(steps[switches]) < 4.0 * columns["t"][1]
    assert np.isnan(x[switches]).all()
    assert set(np.round(u, 9)) == {-1.0, 1.0}
    assert np.isnan(x).mean() < 0.2
    assert len(times) < 700


def test_an_input_that_changes_as_slowly_as_the_states_is_averaged_with_them():
    made = averaged(wave(10000, u=lambda t: np.cos(3.0 * t)), inputs=("u",))
    assert made.row_count == 434
    assert made.inputs[0][0] == pytest.approx(
        np.cos(3.0 * (made.trajectories.times[0] + made.trajectories.offset)), abs=1e-3
    )


def test_fewer_rows_are_averaged_where_an_input_is_switched_all_the_time():
    columns = wave(10000, u=lambda t: np.where(np.arange(len(t)) // 7 % 2, 1.0, -1.0))
    assert averaged(columns, inputs=("u",)).row_count == 5000


@pytest.mark.parametrize("count", [3, 4, 7, 20])
def test_means_of_inputs_follow_a_parabola(count):
    times = np.arange(100.0) ** 1.1
    blocks = even_blocks(100, count)
    assert input_means(blocks, times, times**2 - times) == pytest.approx((times**2 - times)[blocks.centres], rel=1e-9)


def test_cubics_between_rows_follow_a_parabola():
    times = np.array([0.0, 0.1, 0.5, 0.6, 2.0])
    wanted = np.linspace(0.0, 2.0, 21)
    assert interpolated(times, times**2, wanted) == pytest.approx(wanted**2, abs=1e-12)


def test_blocks_are_divided_until_the_integral_of_the_input_is_right():
    times = np.arange(400.0)
    step = np.where(times < 203.0, 0.0, 1.0)
    blocks = divided_blocks(even_blocks(400, 20), times, step, 0.01)
    rows = blocks.centres
    assert {202, 203} <= set(rows.tolist())
    errors = interpolated(times[rows], input_means(blocks, times, step), times) - step
    sums = [abs(float(errors[first:end].sum())) for first, end in blocks.ranges.tolist() if end - first > 1]
    assert max(sums) <= 0.01
    assert blocks.ranges[0].tolist() == [0, 20]
    assert blocks.ranges[-1].tolist() == [380, 400]
    assert blocks.is_whole.tolist().count(True) > 10
    assert int(blocks.sizes.sum()) == 400
    assert SETTINGS.inference.part < 1.0
