"""Held-out trajectories: chosen as told, seen by nobody, recorded all the same."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_core.config import DataConfig, JobConfig
from atoll_core.errors import DataError, UsageError
from tests.unit.coordinator.data.tables import measurements_of, oscillator, table_of


def three(noise=0.05, numbers=(4.0, 7.0, 2.5), rows=60):
    """Return three trajectories, distinguished by the column `run`."""
    rng = np.random.default_rng(0)
    columns = {name: np.tile(values, 3) for name, values in oscillator(rows).items()}
    columns |= {name: columns[name] + noise * rng.standard_normal(3 * rows) for name in "xy"}
    columns["run"] = np.repeat(numbers, rows)
    return columns


def prepared(columns, preset="default", **options):
    return prepare(table_of(columns), JobConfig(preset=preset, data=DataConfig(trajectory="run", **options)))


@pytest.mark.parametrize(
    ("holdout", "expected"),
    [
        (None, (False, False, False)),
        (1, (False, False, True)),
        (2, (False, True, True)),
        ("run=4", (True, False, False)),
        ("run=2.5", (False, False, True)),
        ("run= 7.0", (False, True, False)),
    ],
)
def test_trajectories_are_chosen_by_number_or_by_value(holdout, expected):
    measurements = measurements_of(table_of(three()), DataConfig(trajectory="run", holdout=holdout))
    assert measurements.held_out == expected


@pytest.mark.parametrize(
    ("holdout", "kind", "words"),
    [
        (3, DataError, "there are 3 trajectories; leave at least one"),
        (9, DataError, "--holdout 9 would leave nothing"),
        ("run=5", DataError, "no trajectory has this value; there are 4, 7, 2.5"),
        ("run=a", DataError, "no trajectory has this value"),
        ("x=1", UsageError, "add --trajectory x, or give the number"),
        ("rum=4", DataError, "did you mean 'run'?"),
    ],
)
def test_what_cannot_be_held_out_is_refused(holdout, kind, words):
    with pytest.raises(kind) as raised:
        prepared(three(), holdout=holdout)
    assert words in str(raised.value)
    assert raised.value.exit_code == 2


def named(holdout):
    columns = three(numbers=(1.0, 2.0, 1.0))
    table = replace(table_of(columns), labels={"run": ("big one", "b2")})
    return measurements_of(table, DataConfig(trajectory="run", holdout=holdout))


@pytest.mark.parametrize(
    ("holdout", "expected"),
    [("run=b2", (False, True, False)), ("run = big one", (True, False, True)), (1, (False, False, True))],
)
def test_trajectories_with_names_are_chosen_by_them(holdout, expected):
    measured = named(holdout)
    assert measured.held_out == expected
    assert measured.trajectories.names == ("big one", "b2", "big one 2")


@pytest.mark.parametrize("preset", ["default", "paper"])
@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_what_is_held_out_changes_nothing_for_the_search(noise, robust, preset):
    """As if the trajectory had not been measured at all, even if it is wild."""
    columns = three(noise)
    columns["x"][150:] *= 40.0
    both = prepared(columns, preset, holdout=1, robust=robust).dataset
    alone = prepared({name: values[:120] for name, values in columns.items()}, preset, robust=robust).dataset
    assert np.abs(both.inputs - alone.inputs).max() < 1e-9
    for target, other in zip(both.targets, alone.targets, strict=True):
        assert target.values == pytest.approx(other.values, abs=1e-9)
        assert target.uncertainty == pytest.approx(other.uncertainty, rel=1e-6, abs=1e-14)


def test_held_out_trajectories_are_smoothed_and_recorded():
    preparation = prepared(three(), holdout="run=7")
    assert preparation.recording is not None
    assert [(trajectory.name, trajectory.held_out) for trajectory in preparation.recording.trajectories] == [
        ("4", False),
        ("7", True),
        ("2.5", False),
    ]
    held_out = preparation.recording.trajectories[1]
    assert np.std(held_out.smoothed[0] - oscillator(60)["x"]) < 0.04
    assert np.std(held_out.slopes[0] - oscillator(60)["y"]) < 0.2


def test_given_derivatives_may_be_held_out():
    columns = three() | {"dx": three()["y"], "dy": -three()["x"]}
    preparation = prepared(columns, states=("x", "y"), derivatives=("dx", "dy"), holdout=1)
    assert preparation.recording is None
    assert preparation.held_out is not None
    assert (preparation.dataset.inputs.shape, preparation.held_out.inputs.shape) == ((2, 120), (2, 60))
    assert preparation.held_out.targets[0].values.tolist() == columns["dx"][120:].tolist()
    assert preparation.held_out.targets[0].standard_deviation == preparation.dataset.targets[0].standard_deviation


def test_a_state_that_varies_only_where_it_is_held_out_is_constant():
    columns = three()
    columns["y"][:120] = 1.0
    with pytest.raises(DataError, match=r"state 'y' of a\.csv is constant"):
        prepared(columns, holdout=1)
