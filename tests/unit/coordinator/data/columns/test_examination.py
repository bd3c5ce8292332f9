"""What columns say before the search: each finding in tables that have it, none in tables that have not."""

import numpy as np
import pytest

from atoll_coordinator.data.columns.examination import examine
from atoll_core.config import DataConfig, JobConfig, PriorConfig
from tests.unit.coordinator.data.tables import oscillator, table_of


def found(columns, config=None, **data):
    """Return what is examined, and what is said in one text."""
    config = config or JobConfig(data=DataConfig(**data))
    examination = examine(table_of(columns), config)
    return examination, "\n".join(finding.sentence for finding in examination.findings)


def prey(rows=200, end=20.0):
    """Return a motion on a closed orbit that is no wave, with time and both states."""
    columns = oscillator(rows, end / rows)
    return {"t": columns["t"], "x": np.exp(columns["x"]), "y": np.exp(0.5 * columns["y"])}


def noisy(columns, size, seed=0):
    draw = np.random.default_rng(seed)
    return {
        name: values if name == "t" else values + size * draw.standard_normal(len(values))
        for name, values in columns.items()
    }


@pytest.mark.parametrize(
    ("name", "values", "text"),
    [
        ("copy", lambda x, y: x, "'copy' is x in every row"),
        ("feet", lambda x, y: np.round(3.28084 * x, 7), "'feet' is 3.281*x in every row"),
        ("total", lambda x, y: x + 2.0 * y, "'total' is x + 2*y in every row"),
    ],
)
def test_a_state_that_others_make_is_left_out(name, values, text):
    columns = noisy(prey(), 0.02)
    columns[name] = values(columns["x"], columns["y"])
    examination, said = found(columns)
    assert text in said
    assert f"--states x,y,{name} keeps it" in said
    assert examination.roles.states == ("x", "y")
    assert said in "\n".join(examination.measurements.warnings)


def test_a_state_that_counts_the_rows_is_left_out():
    columns = noisy(prey(), 0.02) | {"Packet no.": np.arange(17.0, 217.0)}
    examination, said = found(columns)
    assert "'Packet no.' counts the rows and is no quantity of the system" in said
    assert "--states 'x,y,Packet no.' keeps it" in said
    assert examination.roles.states == ("x", "y")
    kept, silent = found(columns, states=("x", "y", "Packet no."))
    assert (kept.roles.states, "counts the rows" in silent) == (("x", "y", "Packet no."), False)


@pytest.mark.parametrize("change", [lambda n: 0.5 * n, lambda n: n + (n > 90), lambda n: 3.0 * n, lambda n: 0.5 + n])
def test_a_state_that_rises_otherwise_does_not_count_the_rows(change):
    columns = noisy(prey(), 0.02) | {"z": change(np.arange(200.0))}
    assert "counts the rows" not in found(columns)[1]


def test_whole_numbers_that_differ_by_one_are_not():
    columns = {name: values if name == "t" else np.round(5.0 * values) for name, values in prey().items()}
    columns["z"] = columns["x"] + (np.arange(200) % 40 == 0)
    assert found(columns)[0].roles.states == ("x", "y", "z")


@pytest.mark.parametrize(
    "config",
    [
        JobConfig(data=DataConfig(states=("x", "y", "copy"))),
        JobConfig(data=DataConfig(only=("copy",))),
        JobConfig(prior=PriorConfig(guesses={"x": ("2*copy",)})),
    ],
)
def test_a_state_that_is_named_is_kept(config):
    columns = noisy(prey(), 0.02)
    examination, said = found(columns | {"copy": columns["x"]}, config)
    assert "copy" in examination.roles.states
    assert "'copy' is x in every row" in said
    assert "add --states x,y" in said


def test_a_sum_that_stays_constant_is_said_and_nothing_is_left_out():
    columns = prey()
    rest = 10.0 - columns["x"] - columns["y"]
    examination, said = found({**columns, "z": rest})
    assert "x + y + z stays 10 in every row" in said
    assert examination.roles.states == ("x", "y", "z")


def test_a_relation_that_holds_up_to_noise_is_said_and_nothing_is_left_out():
    columns = prey()
    examination, said = found(noisy({**columns, "z": columns["x"]}, 0.02))
    assert "'z' is x up to noise" in said
    assert examination.roles.states == ("x", "y", "z")


def test_what_differs_by_a_motion_of_its_own_is_no_relation():
    columns = prey()
    examination, said = found({**columns, "z": columns["x"] + 0.02 * np.sin(5.0 * columns["t"])})
    assert said == ""
    assert examination.roles.states == ("x", "y", "z")


def test_clipped_values_are_missing():
    columns = prey()
    examination, said = found({**columns, "x": np.minimum(columns["x"], 2.0)})
    is_clipped = columns["x"] >= 2.0
    assert f"{np.count_nonzero(is_clipped)} values of 'x' are exactly 2" in said
    assert np.array_equal(np.isnan(examination.measurements.columns["x"]), is_clipped)
    assert not np.isnan(examination.measurements.columns["y"]).any()


@pytest.mark.parametrize(
    "values",
    [
        lambda t: np.round(1.0 - np.exp(-t), 2),
        lambda t: np.round(np.sin(t), 1),
        lambda t: np.maximum(2.0 - 0.2 * t, 0.0),
        lambda t: np.where(t < 5.0, 1.0, np.exp(5.0 - t)),
    ],
    ids=["comes to rest", "rounded", "stops", "begins at rest"],
)
def test_rest_and_rounded_turns_are_no_clipping(values):
    times = 0.05 * np.arange(400)
    examination, said = found({"t": times, "x": values(times)})
    assert "end of its range" not in said
    assert not np.isnan(examination.measurements.columns["x"]).any()


@pytest.mark.parametrize(("value", "rows"), [(-9999.0, (3, 30, 77)), (1e20, (5, 6)), (999.0, (8,))])
def test_a_value_that_stands_for_missing_ones_is_named(value, rows):
    columns = prey()
    columns["y"][list(rows)] = value
    assert f"add --missing-value {value:.15g}" in found(columns)[1]
    examination, said = found(columns, missing_values=(value,))
    assert "--missing-value" not in said
    assert np.flatnonzero(np.isnan(examination.measurements.columns["y"])).tolist() == sorted(rows)


def test_few_values_are_said():
    columns = {name: values if name == "t" else np.round(values) for name, values in oscillator(300, 0.07).items()}
    assert "'x' takes 3 values only" in found(columns)[1]


@pytest.mark.parametrize(
    ("values", "is_held"),
    [
        (lambda t, draw: np.repeat(draw.uniform(0.0, 3.0, 20), 10), True),
        (lambda t, draw: draw.integers(0, 2, 200).astype(float), True),
        (lambda t, draw: draw.standard_normal(200), True),
        (lambda t, draw: np.sin(0.3 * t), False),
        (lambda t, draw: np.sin(1.5 * np.arange(200.0)), False),
        (lambda t, draw: np.round(np.sin(0.3 * t), 1), False),
        (lambda t, draw: t, False),
    ],
    ids=["setpoints", "switched", "new in each row", "wave", "four rows a period", "rounded", "ramp"],
)
def test_inputs_that_are_held_are_said(values, is_held):
    columns = prey()
    columns["u"] = values(columns["t"], np.random.default_rng(3))
    assert ("add --hold u" in found(columns, inputs=("u",))[1]) == is_held


def test_positions_without_velocities_are_said():
    columns = prey()
    assert "add --order 2" in found({"t": columns["t"], "x": columns["x"]})[1]
    assert found(noisy(columns, 0.01))[1] == ""
    assert "--order" not in found({"t": columns["t"], "x": columns["x"]}, order=2)[1]
    assert "--order" not in found({"t": columns["t"], "x": columns["x"]}, hidden=("v",))[1]  # it may be the velocity


def test_a_motion_that_never_returns_is_not_said_to_be_of_second_order():
    times = 0.1 * np.arange(100)
    assert found(noisy({"t": times, "x": 10.0 / (1.0 + 9.0 * np.exp(-times))}, 0.05))[1] == ""


def test_steps_of_a_map_are_said():
    states = [0.3]
    for _ in range(199):
        states.append(3.9 * states[-1] * (1.0 - states[-1]))
    said = found({"t": np.arange(200.0), "x": np.array(states)})[1]
    assert "steps of a map" in said
    assert "--target x_next" in said


@pytest.mark.parametrize("seed", range(3))
def test_numbers_without_a_law_say_nothing(seed):
    draw = np.random.default_rng(seed)
    walks = {name: np.cumsum(draw.standard_normal(200)) for name in "xy"}
    assert found({"t": np.arange(200.0), **walks})[1] == ""
    assert found({"t": np.arange(200.0), "x": draw.standard_normal(200)})[1] == ""
