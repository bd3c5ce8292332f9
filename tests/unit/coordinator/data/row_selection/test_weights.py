"""Rows count by their weights: in smoothing, in what the search is given, in fits of models."""

import numpy as np
import pytest

from atoll_coordinator.data.outline import describe
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.searched_rows import select_weighty_rows
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.pools import Pool
from atoll_core.config import DataConfig, JobConfig, SpaceConfig
from atoll_core.errors import DataError, UsageError
from tests.unit.coordinator.data.tables import oscillator, table_of
from tests.unit.coordinator.model.fitting import entry

ROWS = 300
BAD_NOISE = 0.5


def noisy(seed=0):
    """Return an oscillator whose every third row has ten times the error, with its inverse variances."""
    columns = oscillator(ROWS)
    is_bad = np.arange(ROWS) % 3 == 1
    noise = np.where(is_bad, BAD_NOISE, 0.1 * BAD_NOISE)
    rng = np.random.default_rng(seed)
    columns |= {name: columns[name] + noise * rng.standard_normal(ROWS) for name in ("x", "y")}
    return columns | {"w": 7.0 / noise**2}


def prepared(columns, weights="w", **options):
    return prepare(table_of(columns), JobConfig(data=DataConfig(weights=weights, **options)))


def slope_errors(preparation):
    trajectory = preparation.recording.trajectories[0]
    return float(np.std(trajectory.slopes[0] - oscillator(ROWS)["y"]))


def test_weights_improve_what_is_smoothed():
    columns = noisy()
    alike = {name: values for name, values in columns.items() if name != "w"}
    assert slope_errors(prepared(columns)) < 0.6 * slope_errors(prepared(alike, None))


def test_the_noise_is_that_of_a_row_of_mean_weight():
    recording = prepared(noisy()).recording
    weights = recording.trajectories[0].weights
    assert weights.mean() == pytest.approx(1.0)
    for smoothing in recording.smoothing:
        assert smoothing.method == "loess"
        assert smoothing.noise / np.sqrt(weights.max()) == pytest.approx(0.1 * BAD_NOISE, rel=0.15)


def test_robust_smoothing_knows_that_a_row_of_little_weight_may_be_far_off():
    recording = prepared(noisy(), robust=True).recording
    assert sum(smoothing.outliers for smoothing in recording.smoothing) <= 6
    columns = noisy()
    columns["x"][100] += 1.5 * BAD_NOISE
    columns["x"][102] += 1.5 * BAD_NOISE
    (trajectory,) = prepared(columns, robust=True).recording.trajectories
    assert trajectory.robustness_weights[0, 102] == 0.0
    assert trajectory.robustness_weights[0, 100] > 0.0


def test_rows_without_weight_are_as_if_they_had_not_been_measured():
    columns = oscillator(100)
    columns["w"] = np.where(np.arange(100) % 4 == 2, 0.0, 2.0)
    columns["x"][2] = np.nan
    columns["y"][6] = 1e6
    preparation = prepared(columns)
    left = {name: values[columns["w"] > 0.0] for name, values in columns.items() if name != "w"}
    other = prepared(left, None)
    assert preparation.dataset.digest == other.dataset.digest
    assert preparation.recording.trajectories[0].weights is None
    assert preparation.dataset.warnings[0] == "25 of 100 rows have no weight and are left out."


def test_equal_weights_change_nothing():
    columns = oscillator(100)
    alike = prepared(columns, None)
    preparation = prepared(columns | {"w": np.full(100, 0.3)})
    assert preparation.dataset.digest == alike.dataset.digest
    assert {smoothing.method for smoothing in preparation.recording.smoothing} == {"interpolation"}


def test_labels_of_little_weight_are_left_out_of_the_search():
    rng = np.random.default_rng(2)
    columns = {"x": rng.uniform(1.0, 2.0, 50), "w": np.ones(50)}
    columns["y"] = 3.0 * columns["x"]
    columns["w"][:5] = [0.03, 0.05, 0.03, 0.0, 1.0]
    preparation = prepared(columns, target="y")
    assert preparation.dataset.inputs.shape == (1, 47)
    assert preparation.counted.inputs.shape == (1, 49)
    assert preparation.weights.shape == (49,)
    assert preparation.dataset.warnings == (
        "1 of 50 rows have no weight and are left out.",
        "2 of 49 rows have little weight and are left out of the search; fits use them with their weight.",
    )
    assert prepared(columns, None, target="y", states=("x",)).weights is None


def test_fits_count_every_row_by_its_weight():
    """The oracle: weighted least squares of all rows, of which the first two weigh too little for the search."""
    rng = np.random.default_rng(5)
    x = np.linspace(0.4, 6.0, 30)
    weights = 10.0 * x**2
    weights[:2] = 0.5, 1.0
    y = 1.5 + 4.0 / x + rng.standard_normal(30) / np.sqrt(weights)
    config = JobConfig(data=DataConfig(weights="w", target="y"), space=SpaceConfig(operators=("+", "-", "*", "/")))
    preparation = prepare(table_of({"x": x, "y": y, "w": weights}), config)
    assert preparation.dataset.inputs.shape == (1, 28)
    sought = preparation.dataset.problem("y")
    pools = {"y": Pool((entry("1.0 + 3.0/x", sought),))}
    known = refine_all(preparation, config, pools).equations["y"].constants

    design = np.stack([np.ones(30), 1.0 / x], axis=1)
    normal = design.T @ (weights[:, None] * design)
    expected = np.linalg.solve(normal, design.T @ (weights * y))
    variance = float((weights * (y - design @ expected) ** 2).sum()) / 28
    errors = np.sqrt(variance * np.diag(np.linalg.inv(normal)))
    assert sorted(constant.fitted for constant in known) == pytest.approx(sorted(expected), rel=1e-6)
    assert sorted(constant.std_error for constant in known) == pytest.approx(sorted(errors), rel=1e-6)


def test_most_rows_are_kept_whatever_their_weight():
    weights = np.array([1.0] * 60 + [1e-3] * 40)
    assert len(select_weighty_rows(weights, [*range(100)])) == 100
    weights[60:70] = 1e-4
    assert select_weighty_rows(weights, [*range(100)]) == [*range(60), *range(70, 100)]


@pytest.mark.parametrize(("value", "reason"), [(-1.0, "-1"), (np.nan, "an empty cell or NaN"), (np.inf, "inf")])
def test_wrong_weights_are_refused_in_one_sentence(value, reason):
    columns = noisy()
    columns["w"][2] = value
    with pytest.raises(DataError) as refusal:
        prepared(columns)
    assert str(refusal.value) == (
        f"the weights 'w' hold {reason} in row 3 (line 4 of a.csv); a weight is a number from 0 (a row that is not "
        "used) up, such as 1/variance"
    )


def test_the_column_of_weights_is_no_state_and_has_no_other_part():
    columns = noisy()
    assert prepared(columns).recording.states == ("x", "y")
    config = JobConfig(data=DataConfig(weights="w"))
    assert "weights: w" in describe(table_of(columns), config)
    with pytest.raises(UsageError, match="column 'w' is named by both states and weights"):
        prepared(columns, states=("x", "w"))
    with pytest.raises(DataError, match="there is no column 'v'"):
        prepared(columns, "v")
