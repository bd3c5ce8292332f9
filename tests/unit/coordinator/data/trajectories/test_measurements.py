"""Checks of measurements: each objection is one sentence that names rows and gives advice."""

import math

import numpy as np
import pytest

from atoll_coordinator.data.trajectories.checks import check_no_turns
from atoll_core.config import Angle, DataConfig
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


def test_nan_is_refused_with_its_rows():
    assert refusal(changed("x", [11, 39], math.nan)) == (
        "column 'x' holds NaN or an empty cell in rows 12, 40 (lines 13, 41 of a.csv), 2 in all; "
        "correct them, or add --missing drop to do without them"
    )


def test_infinity_is_refused_and_other_columns_are_mentioned():
    columns = changed("x", [5], math.inf)
    columns["y"][7] = math.nan
    message = refusal(columns)
    assert "column 'x' holds NaN or infinity in row 6 (line 7 of a.csv), and so do y (2 rows over all)" in message


def test_columns_without_a_part_may_hold_anything():
    columns = changed("y", [5], math.nan)
    assert measurements_of(table_of(columns), DataConfig(states=("x",))).row_count == 60


def test_a_missing_value_of_a_state_costs_that_value_when_told():
    columns = changed("x", [11, 39], math.inf)
    measurements = measurements_of(table_of(columns), DataConfig(missing="drop"))
    assert measurements.row_count == 60
    assert np.flatnonzero(np.isnan(measurements.trajectories.states["x"][0])).tolist() == [11, 39]
    assert measurements.trajectories.states["y"][0].tolist() == columns["y"].tolist()
    assert measurements.warnings == ("Values are missing, 2 of x; their rows count for the other states.",)


def test_rows_without_any_state_are_dropped_when_told():
    columns = changed("x", [11, 39], math.nan)
    columns["y"][[11, 20]] = math.nan
    measurements = measurements_of(table_of(columns), DataConfig(missing="drop"))
    assert measurements.columns["t"].tolist() == np.delete(columns["t"], [11]).tolist()
    assert measurements.warnings == (
        "1 of 60 rows hold NaN or infinity and were dropped.",
        "Values are missing, 1 of x and 1 of y; their rows count for the other states.",
    )


@pytest.mark.parametrize("options", [{"target": "y"}, {"inputs": ("x",)}])
def test_rows_without_an_input_are_dropped_when_told(options):
    columns = changed("x", [11, 39], math.nan)
    measurements = measurements_of(table_of(columns), DataConfig(missing="drop", **options))
    assert measurements.row_count == 58
    assert measurements.warnings[0] == "2 of 60 rows hold NaN or infinity and were dropped."


def test_nothing_left_after_dropping_is_refused():
    columns = changed("x", slice(None), math.nan)
    assert refusal(columns, missing="drop") == "state 'x' of a.csv has 0 values; at least 5 are needed"
    columns["y"][:] = math.nan
    assert refusal(columns, missing="drop").startswith("every row of a.csv holds NaN or infinity")


def test_an_angle_is_unwrapped_over_what_is_missing():
    columns = oscillator(200)
    smooth = np.linspace(0.1, 25.0, 200)
    columns["y"] = smooth % (2 * math.pi)
    columns["y"][[60, 61, 130]] = math.nan
    measurements = measurements_of(table_of(columns), DataConfig(angles=(Angle(column="y"),), missing="drop"))
    known = np.isfinite(columns["y"])
    assert measurements.trajectories.states["y"][0][known] == pytest.approx(smooth[known])


@pytest.mark.parametrize("rows", [1, 4])
def test_too_few_rows_are_refused(rows):
    count = "1 row" if rows == 1 else f"{rows} rows"
    assert refusal(oscillator(rows)) == f"a.csv has {count} of data; at least 5 are needed"


def test_a_trajectory_that_is_too_short_is_named():
    message = refusal(oscillator(60), starts=(0, 30, 33))
    assert message.startswith("trajectory 2, which begins in row 31 (line 32 of a.csv), has 3 rows; at least 5")


def test_a_constant_state_is_refused():
    message = refusal(changed("y", slice(None), 2.5))
    assert message.startswith("state 'y' of a.csv is constant (2.5 in every row)")


def test_a_constant_target_is_refused():
    message = refusal(changed("y", slice(None), 2.5), target="y")
    assert message.startswith("target 'y' of a.csv is constant (2.5 in every row)")


def test_a_constant_input_is_only_remarked():
    measurements = measurements_of(table_of(changed("y", slice(None), 2.5)), DataConfig(inputs=("y",)))
    assert measurements.warnings == ("Column 'y' is constant: no equation can use it.",)


def test_constant_time_is_refused():
    assert refusal(changed("t", slice(None), 1.0)) == "the time column 't' is constant (1); name another with --time"


def test_repeated_times_are_refused():
    message = refusal(changed("t", [8], 0.1 * 7))
    assert message.startswith("time 0.7000000000000001 is repeated at row 9 (line 10 of a.csv); keep one row")


def test_times_that_go_back_are_refused():
    message = refusal(changed("t", [8], 0.25))
    assert message.startswith(
        "time goes back from 0.7000000000000001 to 0.25 at row 9 (line 10 of a.csv); sort the rows, or mark"
    )


def test_times_may_start_again_where_a_trajectory_does():
    columns = {name: np.tile(values, 2) for name, values in oscillator(30).items()}
    assert len(measurements_of(table_of(columns, starts=(0, 30)), DataConfig()).ranges) == 2
    columns["run"] = np.repeat([7.0, 3.0], 30)
    assert len(measurements_of(table_of(columns), DataConfig(trajectory="run")).ranges) == 2


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


def test_an_angle_that_only_makes_full_turns_is_constant():
    columns = oscillator(20)
    columns["y"] = 360.0 * (np.arange(20) // 5)
    assert "state 'y' of a.csv is constant" in refusal(columns, angles=(Angle(column="y", degrees=True),))


def test_columns_of_text_and_unused_time_are_remarked():
    table = table_of(oscillator(), skipped=("who",))
    warnings = measurements_of(table, DataConfig(target="y")).warnings
    assert warnings[0] == "Columns of text or without a name are not used: who."
    assert warnings[1] == "Column 't' is taken for time and not used; add --inputs t to use it."


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


def test_an_input_may_be_nothing_but_zeros():
    columns = oscillator()
    measurements = measurements_of(table_of(columns | {"y": 0.0 * columns["y"]}), DataConfig(inputs=("y",)))
    assert measurements.roles.inputs == ("y",)


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


def test_prey_that_are_eaten_between_two_rows_do_not_turn():
    """5.6 to 0.2 is about a turn, but nothing goes on as before once it is taken out."""
    check_no_turns("x", [np.array([4.2, 5.6, 0.2, 0.0, 0.1, 0.0, 0.0, -0.1, -0.1, -0.1])])
