"""Rows laid out for fits: pieces, segments, weights, what is measured and what is an input."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.shooting.measurements import BLOW_UP_WIDTHS, measurements_of
from atoll_core.config import JobConfig
from atoll_core.data.table import Table
from tests.unit.coordinator.model.shooting.made import DRIVEN, LOTKA, SWING, recording

TIMES = 0.1 * np.arange(30.0)
STARTS = ([1.0, 2.0], [0.5, -1.0], [2.0, 0.3])


def lengths_of(*rows):
    return [0.1 * np.arange(float(count)) for count in rows]


def swinging(rows=(30, 20, 11), **options):
    return recording(SWING, STARTS[: len(rows)], lengths_of(*rows), **options)


def test_rows_of_all_trajectories_stand_one_after_another():
    rows = measurements_of(swinging(noise=0.1), [0, 1])
    assert rows.rows == 61
    assert rows.bounds.tolist() == [[0, 30], [30, 50], [50, 61]]
    assert rows.owners.tolist() == [0, 1, 2]
    assert rows.names == ("1", "2", "3")
    assert rows.variables == ("x", "y")
    assert rows.observed.tolist() == [0, 1]
    whole = swinging(noise=0.1)
    assert rows.measured.tolist() == np.concatenate([part.measured for part in whole.trajectories], axis=1).tolist()
    assert rows.scales == pytest.approx(rows.smoothed.std(axis=1))
    assert rows.relative_noise == pytest.approx(0.1 / rows.scales)
    assert (rows.weights == 1.0).all()


def test_a_state_that_is_not_modelled_is_an_input_as_smoothed():
    rows = measurements_of(swinging(noise=0.1), [1])
    whole = measurements_of(swinging(noise=0.1), [0, 1])
    assert rows.variables == ("y", "x")
    assert rows.measured.tolist() == whole.measured[1:].tolist()
    assert rows.inputs.tolist() == whole.smoothed[:1].tolist()
    assert rows.input_slopes[0] == pytest.approx(whole.smoothed[1])


def test_inputs_of_the_recording_come_first():
    rows = measurements_of(recording(DRIVEN, [[1.0]], TIMES), [0])
    assert rows.variables == ("x", "u")
    assert rows.inputs[0] == pytest.approx(np.cos(2.0 * TIMES))
    assert rows.input_slopes[0] == pytest.approx(-2.0 * np.sin(2.0 * TIMES))
    assert rows.sizes == pytest.approx([np.abs(rows.smoothed[0]).mean(), np.abs(rows.inputs[0]).mean()])


def test_with_order_2_velocities_are_states_that_nobody_measured():
    oscillator = swinging(noise=0.1)
    first = replace(oscillator, order=2, velocity_symbols=("x_dot", "y_dot"))
    rows = measurements_of(first, [0])
    assert rows.variables == ("x", "x_dot", "y", "y_dot")
    assert rows.observed.tolist() == [0]
    assert rows.measured.shape == (1, 61)
    assert rows.smoothed.shape == (2, 61)
    slopes = np.concatenate([part.slopes for part in first.trajectories], axis=1)
    assert rows.smoothed[1].tolist() == slopes[0].tolist()
    assert rows.inputs[1].tolist() == slopes[1].tolist()
    inner = np.ones(61, bool)
    inner[rows.bounds[:, 0]] = inner[rows.bounds[:, 1] - 1] = False
    bends = -2.0 * slopes[0] - 0.3 * slopes[1]
    assert rows.input_slopes[1][inner] == pytest.approx(bends[inner], abs=0.02)
    both = measurements_of(first, [0, 1])
    assert both.variables == ("x", "y", "x_dot", "y_dot")
    assert both.scales.shape == (4,)
    assert both.noise.shape == (2,)


def test_held_out_trajectories_are_apart():
    rows = swinging(held_out=[1])
    assert measurements_of(rows, [0, 1]).names == ("1", "3")
    assert measurements_of(rows, [0, 1], held_out=True).names == ("2",)
    with pytest.raises(ValueError, match="concatenate"):
        measurements_of(swinging(), [0, 1], held_out=True)


def test_missing_values_have_no_weight():
    rows = swinging(noise=0.1)
    rows.trajectories[1].measured[0, 3:5] = np.nan
    weights = measurements_of(rows, [0, 1]).weights
    assert np.argwhere(weights == 0.0).tolist() == [[0, 33], [0, 34]]


def test_rows_where_an_input_is_not_known_are_left_out():
    rows = swinging(noise=0.1)
    is_known = np.ones((2, 20), np.bool_)
    is_known[0, :3] = is_known[0, 11:13] = False
    second = replace(rows.trajectories[1], is_known=is_known)
    rows = replace(rows, trajectories=(rows.trajectories[0], second, rows.trajectories[2]))
    driven = measurements_of(rows, [1])
    assert driven.bounds.tolist() == [[0, 30], [30, 38], [38, 45], [45, 56]]
    assert driven.owners.tolist() == [0, 1, 1, 2]
    assert driven.times[30:38].tolist() == second.times[3:11].tolist()
    assert measurements_of(rows, [0]).rows == measurements_of(rows, [0, 1]).rows == 61


def test_measurements_weigh_what_smoothing_trusted_them_with():
    rows = swinging(noise=0.1)
    assert (measurements_of(rows, [0, 1]).weights == 1.0).all()
    trust = np.ones_like(rows.trajectories[0].measured)
    trust[0, 7], trust[1, 2] = 0.0, 0.25
    robust = replace(
        rows, trajectories=(replace(rows.trajectories[0], robustness_weights=trust), *rows.trajectories[1:])
    )
    weights = measurements_of(robust, [0, 1]).weights
    assert np.argwhere(weights != 1.0).tolist() == [[0, 7], [1, 2]]
    assert (weights[0, 7], weights[1, 2]) == (0.0, 0.25)
    assert measurements_of(robust, [1]).weights[0, 2] == 0.25


def test_a_long_trajectory_falls_into_pieces_of_its_own():
    rows = measurements_of(recording(SWING, STARTS[:2], lengths_of(1203, 40)), [0, 1])
    assert rows.owners.tolist() == [0, 0, 0, 1]
    assert rows.bounds.tolist() == [[0, 401], [401, 802], [802, 1203], [1203, 1243]]


@settings(max_examples=50, deadline=None)
@given(rows=st.lists(st.integers(5, 700), min_size=1, max_size=3), length=st.none() | st.integers(1, 60))
def test_segments_cover_every_row_once_and_have_about_the_length(rows, length):
    bounds = np.cumsum([0, *rows])
    measured = replace(measurements_of(swinging((5,)), [0, 1]), bounds=np.stack([bounds[:-1], bounds[1:]], axis=1))
    segments = measured.segments(length)
    assert np.concatenate([np.arange(*segment) for segment in segments]).tolist() == list(range(sum(rows)))
    assert set(bounds.tolist()) <= set(segments.ravel().tolist())
    sizes = np.diff(segments, axis=1)[:, 0]
    if length is None:
        assert sizes.tolist() == rows
    else:
        assert sizes.max() <= 1.5 * length + 1
        assert sizes.min() >= min(*rows, length / 1.5 - 1)


@pytest.mark.parametrize("most", [130, 200, 600])
def test_thinned_rows_are_pieces_of_the_trajectories(most):
    rows = measurements_of(recording(SWING, STARTS[:2], lengths_of(1203, 400), noise=0.1), [0, 1])
    thinned = rows.thin(most)
    assert most // 2 <= thinned.rows <= 1.5 * most
    assert thinned.bounds[:, 0].tolist() == [0, *thinned.bounds[:-1, 1].tolist()]
    assert thinned.bounds[-1, 1] == thinned.rows
    assert thinned.limits.shape == (2, 2)
    for (first, end), owner in zip(thinned.bounds.tolist(), thinned.owners.tolist(), strict=True):
        (start,) = np.flatnonzero(rows.measured[0] == thinned.measured[0, first])
        part = slice(start, start + end - first)
        assert rows.measured[:, part].tolist() == thinned.measured[:, first:end].tolist()
        assert rows.times[part].tolist() == thinned.times[first:end].tolist()
        piece = int(np.searchsorted(rows.bounds[:, 1], start, side="right"))
        assert rows.owners[piece] == owner
        assert start + end - first <= rows.bounds[piece, 1]
    assert (thinned.scales.tolist(), thinned.noise.tolist()) == (rows.scales.tolist(), rows.noise.tolist())


@settings(max_examples=60, deadline=None)
@given(trajectories=st.integers(1, 30), rows=st.integers(200, 3000), most=st.integers(100, 1500))
@example(trajectories=6, rows=1000, most=1200)
def test_thinned_rows_come_from_all_trajectories_and_from_late_rows_as_from_early_ones(trajectories, rows, most):
    measured = measurements_of(swinging((2,)), [0, 1])
    ends = rows * np.arange(1, trajectories + 1)
    blank = np.zeros((2, trajectories * rows))
    whole = replace(
        measured,
        bounds=np.stack([ends - rows, ends], axis=1),
        owners=np.arange(trajectories),
        times=np.tile(0.1 * np.arange(rows), trajectories),
        **dict.fromkeys(("measured", "weights", "smoothed"), blank),
        **dict.fromkeys(("inputs", "input_slopes"), blank[:0]),
    )
    thinned = whole.thin(most)
    pieces, places = len(thinned.bounds), 10.0 * thinned.times / rows
    if pieces >= 6:
        assert places.min() < 0.3
        assert places.max() > 0.7
        assert 0.25 < np.mean(places < 0.5) < 0.75
    kept = np.bincount(thinned.owners, minlength=trajectories)
    assert abs(kept - pieces / trajectories).max() < 1.0


def test_some_trajectories_can_be_taken_out():
    rows = measurements_of(swinging(noise=0.1), [0, 1])
    part = rows.part({0, 2})
    assert part.bounds.tolist() == [[0, 30], [30, 41]]
    assert part.owners.tolist() == [0, 2]
    assert part.names == rows.names
    kept = [*range(30), *range(50, 61)]
    for name in ("times", "measured", "weights", "smoothed", "inputs", "input_slopes"):
        assert getattr(part, name).tolist() == getattr(rows, name)[..., kept].tolist()


def test_pieces_are_as_long_as_asked_for_at_most():
    rows = measurements_of(swinging(), [0, 1], piece=15)
    assert rows.bounds.tolist() == [[0, 15], [15, 30], [30, 40], [40, 50], [50, 61]]
    assert rows.owners.tolist() == [0, 0, 1, 1, 2]


def test_few_rows_are_not_thinned():
    rows = measurements_of(swinging(), [0, 1])
    assert rows.thin(61) is rows


def test_limits_leave_room_on_both_sides():
    rows = measurements_of(recording(LOTKA, [[1.0, 3.0]], TIMES), [0, 1])
    low, high = rows.smoothed.min(axis=1), rows.smoothed.max(axis=1)
    assert rows.limits[:, 0] == pytest.approx(low - BLOW_UP_WIDTHS * (high - low))
    assert rows.limits[:, 1] == pytest.approx(high + BLOW_UP_WIDTHS * (high - low))


def test_rows_count_by_their_weights_and_by_their_robustness_weights():
    recorded = recording(LOTKA, ([1.0, 3.0], [4.0, 1.0]), TIMES, 0.1)
    first, second = recorded.trajectories
    weights = np.linspace(0.5, 1.5, len(TIMES))
    trust = np.ones((2, len(TIMES)))
    trust[1, 2] = 0.25
    both = (replace(first, weights=weights, robustness_weights=trust), replace(second, weights=weights))
    weighed = replace(recorded, trajectories=both)
    rows = measurements_of(weighed, [0, 1])
    assert rows.weights[0, : len(TIMES)] == pytest.approx(weights)
    assert rows.weights[1, 2] == pytest.approx(0.25 * weights[2])
    assert rows.inverse_variances == pytest.approx(np.tile(weights, (2, 2)))
    assert rows.part([1]).inverse_variances == pytest.approx(np.tile(weights, (2, 1)))
    assert measurements_of(recorded, [0, 1]).inverse_variances is None


def test_a_state_that_is_zero_throughout_rests_and_has_no_weight():
    rows = swinging(noise=0.1)
    rows.trajectories[1].measured[0] = 0.0
    rows.trajectories[1].measured[0, 4] = np.nan
    measured = measurements_of(rows, [0, 1])
    assert np.flatnonzero(measured.resting[0]).tolist() == list(range(30, 50))
    assert not measured.resting[1].any()
    assert (measured.weights[0] == 0.0).tolist() == measured.resting[0].tolist()
    assert measured.part([1]).resting.shape == (2, 20)
    assert measurements_of(swinging(noise=0.1), [0, 1]).resting is None
    assert measurements_of(replace(rows, order=2, velocity_symbols=("x_dot", "y_dot")), [0, 1]).resting is None


def rounding_of(*states):
    count = len(states[0])
    rows, names = np.arange(count, dtype=np.int64), ("t", "x", "y")[: 1 + len(states)]
    columns = np.array([np.linspace(0.0, 30.0, count), *states])
    rounded = Table(names, ("",) * len(names), columns, (0,), ("a.csv",), 0 * rows, rows + 2, ())
    return measurements_of(prepare(rounded, JobConfig()).recording, range(len(states))).rounding


def test_rounding_errors_are_known_in_steps_and_not_in_digits():
    times = np.linspace(0.0, 30.0, 300)
    digits = np.vectorize(lambda value: float(f"{value:.2g}"))(40.0 * np.exp(2.0 * np.cos(times)))
    assert rounding_of(digits, np.round(20.0 + 5.0 * np.sin(times))) == pytest.approx([0.0, 12.0**-0.5])
    assert rounding_of(digits) is None


@pytest.mark.parametrize(
    "course",
    [
        lambda time: np.cos(2.0 * time),
        lambda time: 1.0 / (1.0 + np.exp(5.0 - time)),
        lambda time: np.exp(-time / 2.0),
        lambda time: np.exp(-2.0 * time),
        lambda time: np.exp(6.0 * (np.cos(3.0 * time) - 1.0)),
        lambda time: np.exp(-((time - 3.0) ** 2)),
    ],
    ids=["oscillation", "growth", "decay", "decay to rest", "outbreaks", "pulse"],
)
@pytest.mark.parametrize("levels", [20, 60])
@pytest.mark.parametrize("rows", [100, 300, 1000])
def test_rounding_errors_are_hardly_smaller_than_their_known_size_also_where_a_state_rests(course, levels, rows):
    values = levels * course(np.linspace(0.0, 10.0, rows))
    error = np.sqrt(np.mean((np.round(values) - values) ** 2))
    known = rounding_of(np.round(values))
    assert known is None or known[0] < 1.25 * error
