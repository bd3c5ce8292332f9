"""From tables to regression problems, in every mode."""

import math

import numpy as np
import pytest
import sympy
from sympy.parsing.sympy_parser import parse_expr

from atoll_coordinator.data.prepare import prepare
from atoll_core.config import DataConfig, JobConfig
from atoll_core.errors import DataError
from benchmarks.harness.systems import SYSTEMS, TRUTH, trajectories
from benchmarks.harness.systems import table_of as table_of_samples
from tests.unit.coordinator.data.tables import oscillator, table_of


def prepared(columns, starts=(0,), preset="default", **options):
    return prepare(table_of(columns, starts), JobConfig(preset=preset, data=DataConfig(**options))).dataset


def true_slopes(system, dataset):
    """Evaluate the texts in TRUTH by sympy at the rows of a dataset."""
    slopes = {}
    for variable, text in TRUTH[system].items():
        local = {name: sympy.Symbol(name) for name in dataset.names}
        function = sympy.lambdify(list(local.values()), parse_expr(text, local_dict=local), "numpy")
        slopes[variable] = function(*dataset.inputs)
    return slopes


def test_a_derivative_that_is_constant_up_to_rounding_is_judged_by_its_size():
    """Free fall, height alone: by its deviation, which is rounding, it would be uncertain, and no search would end."""
    times = 0.02 * np.arange(100.0)
    (target,) = prepared({"t": times, "h": 100.0 + 3.0 * times - 4.905 * times**2}, order=2).targets
    assert target.standard_deviation == pytest.approx(9.81)
    assert not target.is_noisy
    assert target.convergence_threshold() < 1e-8
    (noisy,) = prepared({"t": times, "h": times + 0.01 * np.random.default_rng(1).standard_normal(100)}).targets
    assert noisy.standard_deviation == pytest.approx(np.std(noisy.values))


def test_states_are_differentiated_in_time():
    dataset = prepared(oscillator(100))
    assert dataset.names == ("x", "y")
    assert dataset.variables == ("x", "y")
    assert [target.lhs for target in dataset.targets] == ["dx/dt", "dy/dt"]
    assert dataset.inputs.shape == (2, 92)
    assert dataset.targets[0].values == pytest.approx(dataset.inputs[1], abs=1e-10)
    assert dataset.targets[1].values == pytest.approx(-dataset.inputs[0], abs=1e-10)
    assert dataset.targets[0].standard_deviation == pytest.approx(np.std(dataset.targets[0].values))
    assert dataset.warnings[0].endswith("4 rows at each end of a trajectory are left out.")


def test_only_some_equations_keep_all_variables():
    dataset = prepared(oscillator(), only=("y",))
    assert dataset.variables == ("y",)
    assert dataset.names == ("x", "y")
    both = prepared(oscillator())
    assert dataset.targets[0].values.tolist() == both.targets[1].values.tolist()


def test_inputs_and_time_itself_are_variables():
    columns = oscillator(100, start=5.0)
    columns["u"] = columns["t"] ** 2
    dataset = prepared(columns, inputs=("u", "t"))
    assert dataset.names == ("x", "y", "u", "t")
    assert dataset.variables == ("x", "y")
    times = dataset.inputs[3]
    assert set(times.tolist()) <= set(columns["t"][4:-4].tolist())
    assert len(times) >= 85
    assert dataset.inputs[2] == pytest.approx(times**2)


def test_explicit_regression_takes_the_label_as_it_is():
    columns = {"label": [1.0, 2.0, 4.0, 8.0, 9.0], "x": [0.0, 1.0, 2.0, 3.0, 4.0], "y": [5.0, 5.0, 6.0, 7.0, 8.0]}
    dataset = prepared(columns, target="label")
    (target,) = dataset.targets
    assert (target.variable, target.lhs, target.uncertainty, target.noise) == ("label", "label", 0.0, 0.0)
    assert target.values.tolist() == columns["label"]
    assert dataset.names == ("x", "y")
    assert dataset.inputs.tolist() == [columns["x"], columns["y"]]


def test_given_derivatives_are_taken_as_they_are():
    columns = oscillator(20)
    columns |= {"dx": columns["y"], "dy": -columns["x"]}
    dataset = prepared(columns, states=("x", "y"), derivatives=("dx", "dy"))
    assert [target.lhs for target in dataset.targets] == ["dx/dt", "dy/dt"]
    assert [target.uncertainty for target in dataset.targets] == [0.0, 0.0]
    assert dataset.targets[1].values.tolist() == (-columns["x"]).tolist()
    assert dataset.inputs.shape == (2, 20)
    del columns["t"]
    assert prepared(columns, states=("x", "y"), derivatives=("dx", "dy")).targets[0].lhs == "dx/dt"


def test_a_velocity_keeps_out_of_the_way_of_a_column_of_its_name():
    columns = oscillator(100)
    columns["x_dot"] = columns.pop("y")
    dataset = prepared(columns, states=("x",), inputs=("x_dot",), order=2)
    assert dataset.names == ("x", "x_dot_", "x_dot")


def test_awkward_names_get_symbols():
    columns = oscillator(50)
    columns = {"t": columns["t"], "lambda": columns["x"], "v w": columns["y"], "θ": columns["x"] * columns["y"]}
    dataset = prepared(columns)
    assert dataset.names == ("lambda_", "v_w", "θ")
    assert dataset.symbols == {"lambda": "lambda_", "v w": "v_w", "θ": "θ"}
    assert [target.lhs for target in dataset.targets] == ["dlambda/dt", "dv w/dt", "dθ/dt"]


def test_a_missing_value_costs_that_value_and_not_its_row():
    columns = oscillator(100)
    columns["x"][[30, 31, 50]] = columns["y"][[7, 70]] = math.nan
    preparation = prepare(table_of(columns), JobConfig(data=DataConfig(missing="drop")))
    assert 88 <= preparation.dataset.inputs.shape[1] <= 100 - 8
    assert preparation.dataset.targets[0].values == pytest.approx(preparation.dataset.inputs[1], abs=1e-8)
    assert preparation.dataset.targets[1].values == pytest.approx(-preparation.dataset.inputs[0], abs=1e-8)
    assert preparation.recording.trajectories[0].is_known is None
    assert np.isnan(preparation.recording.trajectories[0].measured).sum(axis=1).tolist() == [3, 2]


def test_rows_that_lack_an_unknown_state_are_kept_from_the_search_and_in_the_recording():
    columns = oscillator(100)
    columns["x"][:20] = math.nan
    preparation = prepare(table_of(columns), JobConfig(data=DataConfig(missing="drop")))
    trajectory = preparation.recording.trajectories[0]
    assert 70 <= preparation.dataset.inputs.shape[1] <= 100 - 20 - 4
    assert len(trajectory.times) == 100
    assert trajectory.is_known.tolist() == [[False] * 20 + [True] * 80, [True] * 100]
    assert {row.reason for row in preparation.recording.smoothing[0].excluded_rows} == {"missing", "end"}
    assert "missing" not in {row.reason for row in preparation.recording.smoothing[1].excluded_rows}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.parametrize("step", [0.02, 0.1])
@pytest.mark.parametrize("system", [name for name in SYSTEMS if name != "pendulum"])
def test_the_truth_is_within_the_floor(system, step, seed):
    """With room: a search ends at twice the floor. Few rows are left out, and the floor admits no rough likeness."""
    dataset = prepare(table_of_samples(trajectories(system, step, seed)), JobConfig()).dataset
    truths = true_slopes(system, dataset)
    for target in dataset.targets:
        error = np.abs(target.values - truths[target.variable]).mean() / target.standard_deviation
        assert error <= max(0.5e-9, 0.7 * target.uncertainty)
        assert target.uncertainty < (2e-6 if step == 0.02 else 2e-5)
        assert target.noise == 0.0
    assert dataset.inputs.shape[1] >= (0.85 if step == 0.02 else 0.6) * 40 / step


def test_slightly_rounded_data_keep_most_rows():
    """Their derivatives are uncertain by more than is always good enough, but all of them alike."""
    table = table_of_samples(trajectories("bar_magnets", 0.02))
    columns = {name: np.round(column, 8) for name, column in zip(table.names, table.columns, strict=True)}
    dataset = prepare(table_of(columns, table.starts), JobConfig()).dataset
    assert dataset.inputs.shape[1] > 0.95 * 2000
    assert all(target.noise < 1e-6 for target in dataset.targets)


@pytest.mark.parametrize("slope", [1.0 / 3.0, -0.7, math.pi])
def test_the_floor_of_a_constant_derivative_covers_its_rounding(slope):
    """The mean must count as found, or the search would go on to fit the rounding."""
    columns = oscillator(100)
    columns["x"] = 1.0 + columns["t"] * slope
    target = prepared(columns).targets[0]
    mean = np.mean(target.values)
    assert mean == pytest.approx(slope)
    assert np.mean(np.abs(target.values - mean)) <= 2.0 * target.uncertainty * target.standard_deviation


def test_a_state_that_is_switched_is_said_to_stand_still():
    columns = oscillator(200)
    columns["x"] = np.where(np.arange(200) // 25 % 2 == 0, 1.0, 0.0)
    with pytest.raises(DataError, match=r"state 'x' is constant at all rows.*--inputs x"):
        prepare(table_of(columns), JobConfig())


def test_inputs_that_are_sampled_coarsely_are_told():
    """A state without noise under a sine of seven rows in a period, between which no curve knows it to a thousandth."""
    for step, count in ((0.9, 1), (0.1, 0)):
        times = np.arange(0.0, 60.0, step)
        columns = {"t": times, "x": np.sin(times - 0.5) + np.cos(0.3 * times), "u": np.sin(times)}
        told = [warning for warning in prepared(columns, inputs=("u",)).warnings if "Between rows" in warning]
        assert len(told) == count
