"""The measurements that noisy searches are given: noise, fresh trajectories."""

import dataclasses

import numpy as np
import pytest

from benchmarks.harness.systems import SYSTEMS, TRUTH, table_of, trajectories
from benchmarks.noise.data import Key, case, fresh

KEY = Key("atoll", "bar_magnets", 0.1, 100)


def noise_of(key):
    made_case = case(key)
    clean = np.array([made_case.clean[name] for name in made_case.truths])
    return made_case.table.columns[1:] - clean, clean


def test_the_plain_case_is_what_the_other_benchmarks_measure():
    table = table_of(trajectories("bar_magnets", 0.1, 100, 0.1))
    np.testing.assert_array_equal(case(KEY).table.columns, table.columns)


@pytest.mark.slow
def test_noise_is_a_share_of_each_states_deviation():
    noise, clean = noise_of(KEY)
    assert clean.shape == (2, 400)
    assert noise.std(axis=1) == pytest.approx(0.1 * clean.std(axis=1), rel=0.15)


def test_one_draw_of_noise_is_scaled_over_the_levels():
    small, _ = noise_of(dataclasses.replace(KEY, level=0.01))
    large, _ = noise_of(KEY)
    np.testing.assert_allclose(10.0 * small, large, atol=1e-12)


def test_every_method_is_given_the_same_data():
    other = case(dataclasses.replace(KEY, method="pysindy"))
    np.testing.assert_array_equal(other.table.columns, case(KEY).table.columns)


def test_the_true_derivatives_are_those_of_the_field():
    made_case = case(KEY)
    a, b = made_case.clean["theta1"], made_case.clean["theta2"]
    np.testing.assert_allclose(made_case.slope("theta1"), 0.5 * np.sin(a - b) - np.sin(a), atol=1e-12)
    assert made_case.truths == TRUTH["bar_magnets"]


@pytest.mark.slow
@pytest.mark.parametrize("system", ["lotka_volterra", "shear_flow"])
def test_a_fresh_trajectory_begins_where_none_was_measured(system):
    made_case = fresh(system, 100)
    starts = [values[0].tolist() for values in trajectories(system, 0.1, 100).values]
    assert made_case.states.shape == (100, 2)
    assert made_case.states[0].tolist() not in starts
    assert made_case.states.tolist() == fresh(system, 100).states.tolist()
    assert made_case.states.tolist() != fresh(system, 101).states.tolist()


def test_lotka_volterra_keeps_its_fixed_initial_conditions():
    assert SYSTEMS["lotka_volterra"].draw is not None
    assert [tuple(states[0]) for states in trajectories("lotka_volterra", 0.1, 7).values] == [
        (1, 3),
        (4, 1),
        (8, 2),
        (3, 3),
    ]
