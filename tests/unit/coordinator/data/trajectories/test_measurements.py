"""Checks of measurements, times of trajectories, and gaps in the times."""

import math

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.trajectories.measurements import (
    distinguish,
    find_pieces,
    split_at_gaps,
)
from atoll_coordinator.data.trajectories.table_checks import check_no_turns
from atoll_core.config import Angle, DataConfig, JobConfig
from atoll_core.errors import DataError
from tests.unit.coordinator.data.tables import measurements_of, oscillator, table_of


def refusal(columns, starts=(0,), **options):
    with pytest.raises(DataError) as raised:
        measurements_of(table_of(columns, starts), DataConfig(**options))
    assert raised.value.exit_code == 2
    return str(raised.value)


def changed(name, rows, value):
    columns = oscillator()
    columns[name] = columns[name].copy()
    columns[name][rows] = value
    return columns


def test_a_missing_value_of_a_state_costs_that_value_when_told():
    columns = changed("x", [11, 39], math.inf)
    measurements = measurements_of(table_of(columns), DataConfig(missing="drop"))
    assert measurements.row_count == 60
    assert np.flatnonzero(np.isnan(measurements.trajectories.states["x"][0])).tolist() == [11, 39]
    assert measurements.trajectories.states["y"][0].tolist() == columns["y"].tolist()
    assert measurements.warnings == ("Values are missing, 2 of x; their rows are used for the other states.",)


def test_rows_without_any_state_are_dropped_when_told():
    columns = changed("x", [11, 39], math.nan)
    columns["y"][[11, 20]] = math.nan
    measurements = measurements_of(table_of(columns), DataConfig(missing="drop"))
    assert measurements.columns["t"].tolist() == np.delete(columns["t"], [11]).tolist()
    assert measurements.warnings == (
        "1 of 60 rows hold NaN or infinity and were dropped.",
        "Values are missing, 1 of x and 1 of y; their rows are used for the other states.",
    )


def test_nothing_left_after_dropping_is_refused():
    columns = changed("x", slice(None), math.nan)
    assert refusal(columns, missing="drop") == "state 'x' of a.csv has 0 values; at least 5 are needed"
    columns["y"][:] = math.nan
    assert refusal(columns, missing="drop").startswith("every row of a.csv holds NaN or infinity")


def test_a_trajectory_that_is_too_short_is_named():
    message = refusal(oscillator(60), starts=(0, 30, 33))
    assert message.startswith("trajectory 2, which begins in row 31 (line 32 of a.csv), has 3 rows; at least 5")


def test_a_constant_input_is_only_remarked():
    measurements = measurements_of(table_of(changed("y", slice(None), 2.5)), DataConfig(inputs=("y",)))
    assert measurements.warnings == ("Column 'y' is constant: no equation can use it.",)


@pytest.mark.parametrize(("turn", "name", "option"), [(2 * math.pi, "2 pi", "y"), (360.0, "360", "y:deg")])
@pytest.mark.parametrize("low", [0.0, -0.5])
def test_unmarked_turns_of_an_angle_are_refused(turn, name, option, low):
    columns = oscillator(200)
    phases = np.linspace(0.3, 3.7, 200) + 0.02 * np.sin(np.arange(200))
    columns["y"] = turn * ((phases - low) % 1.0 + low)
    message = refusal(columns)
    assert f"state 'y' jumps by about {name} " in message
    assert f"add --angle {option} so that it is unwrapped" in message


@pytest.mark.parametrize(
    "values",
    [
        10 * np.sin(np.linspace(0, 40, 200)),
        np.where(np.linspace(0, 10, 200) % 2 < 1, -1.5, 1.5) + 0.01 * np.sin(np.arange(200)),
        3 * np.tanh(8 * np.sin(np.linspace(0, 12, 200))),
        np.random.default_rng(0).normal(0, 1, 200),
        180 * np.sin(np.linspace(0, 30, 200)),
    ],
)
def test_other_jumps_are_none_of_an_angle(values):
    columns = oscillator(200)
    columns["y"] = values
    measurements_of(table_of(columns), DataConfig())


@pytest.mark.parametrize("largest", [3.2, 4.0, 5.0, 6.2])
@pytest.mark.parametrize("seed", range(5))
def test_noise_is_none_of_an_angle_whatever_its_range(seed, largest):
    draw = np.random.default_rng(seed)
    for values in (draw.normal(size=200), draw.uniform(size=200), draw.integers(1, 7, 200), draw.poisson(4.0, 200)):
        columns = oscillator(200)
        columns["y"] = (values - np.min(values)) * largest / np.ptp(values)
        measurements_of(table_of(columns), DataConfig())


@pytest.mark.parametrize("rows_a_turn", [4.3, 6.1, 20.7, 400.0])
def test_turns_are_seen_at_any_speed_that_shows_them(rows_a_turn):
    columns = oscillator(1000)
    columns["y"] = (2.0 * math.pi / rows_a_turn * np.arange(1000.0)) % (2.0 * math.pi)
    assert "as a wrapped angle does" in refusal(columns)


@pytest.mark.parametrize("degrees", [False, True])
def test_a_marked_angle_is_unwrapped_into_radians(degrees):
    columns = oscillator(200)
    smooth = np.linspace(0.1, 25.0, 200)
    columns["y"] = np.degrees(smooth) % 360 if degrees else smooth % (2 * math.pi)
    measurements = measurements_of(table_of(columns), DataConfig(angles=(Angle(column="y", degrees=degrees),)))
    assert measurements.trajectories.states["y"][0] == pytest.approx(smooth)
    assert measurements.warnings == (("Degrees were converted to radians: y.",) if degrees else ())


def test_columns_of_text_and_unused_time_are_remarked():
    table = table_of(oscillator(), skipped=("who",))
    warnings = measurements_of(table, DataConfig(target="y")).warnings
    assert warnings[0] == "Columns of text or without a name are not used: who."
    assert warnings[1] == "Column 't' is treated as the time and not used; add --inputs t to use it."


@pytest.mark.parametrize("size", [1e160, -1e300, 1e-160])
@pytest.mark.parametrize("roles", [{}, {"states": ("x",), "inputs": ("y",)}, {"target": "x", "inputs": ("y",)}])
def test_a_column_without_squares_is_refused_in_every_role(size, roles):
    columns = oscillator()
    message = refusal(columns | {"y": size * columns["y"]}, **roles)
    assert message == "the values of 'y' are too large or too small to compute with; choose another unit"


@pytest.mark.parametrize(("size", "values", "order", "found"), [
    (1e-301, 1.0, 1, "t"), (1e-160, 1.0, 1, "t"), (1e-80, 1.0, 2, "t"), (1e-100, 1e60, 1, "derivative of x"),
    (1e300, 1.0, 1, "t"), (1e-60, 1e50, 2, "derivative of x"),
])  # fmt: skip
def test_steps_and_rates_without_squares_are_refused(size, values, order, found):
    columns = oscillator()
    scaled = {"t": size * columns["t"], "x": values * columns["x"], "y": columns["y"]}
    message = refusal(scaled, order=order, states=("x", "y"))
    assert message == f"the values of '{found}' are too large or too small to compute with; choose another unit"


def test_a_fall_in_few_rows_is_no_turn():
    """4.5 to 0.5 is less than a turn by far more than the other steps are long."""
    check_no_turns("x", [np.array([5.4, 4.5, 0.5, 0.7, 1.8])])
    with pytest.raises(DataError, match="wrapped angle"):
        check_no_turns("x", [np.array([5.0, 5.6, 6.1, 0.4, 0.9, 1.4])])


@pytest.mark.parametrize(("rows", "noise"), [(9, 0.0), (25, 0.01), (60, 0.01), (60, 0.03)])
def test_noisy_turns_are_seen(rows, noise):
    """Noise of a share of a turn; the more other rows show no jump, the less likely is one by chance."""
    seen = 0
    for seed in range(40):
        draw = np.random.default_rng([rows, seed])
        phases = 0.3 + 1.4 * np.linspace(0.0, 1.0, rows) + noise * draw.standard_normal(rows)
        try:
            check_no_turns("x", [360.0 * (phases % 1.0)])
        except DataError:
            seen += 1
    assert seen >= 30


def times_of(columns, starts=(0,)):
    return measurements_of(table_of(columns, starts), DataConfig(states=("x", "y"), missing="drop")).trajectories.times


@pytest.mark.parametrize("start", [0.0, 1900.0, -3.0, 1e9])
def test_an_offset_of_the_times_costs_no_precision(start):
    (times,) = times_of(oscillator(501, 0.02, start))
    assert np.abs(np.diff(times) - 0.02).max() < 1e-14


def test_names_that_come_again_get_letters():
    assert distinguish(["2", "2", "3", "2"]) == ("2", "2b", "3", "2c")
    assert distinguish(["7", "7", "7b"]) == ("7", "7b", "7bb")
    many = distinguish(["1"] * 28)
    assert (many[25], many[26], many[27]) == ("1z", "1aa", "1ab")


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
    sentence = "2 gaps in the times are longer than the span of smoothing; trajectories are split there: 2 into "
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
