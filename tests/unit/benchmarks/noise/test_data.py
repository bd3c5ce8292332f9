"""The measurements that noisy searches are given: noise, manners of sampling, fresh trajectories."""

import dataclasses

import numpy as np
import pytest

from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix
from benchmarks.harness.systems import SYSTEMS, TABLE_III, TRUTH, table_of, trajectories
from benchmarks.judging.forms import compare
from benchmarks.noise.data import LENGTHS, VARIANTS, Key, case, fresh
from benchmarks.noise.odd_systems import ODD

KEY = Key("atoll", "plain", "bar_magnets", 0.1, 100)


def noise_of(key):
    its = case(key)
    clean = np.array([its.clean[name] for name in its.truths])
    return its.table.columns[1:] - clean, clean


def test_the_plain_case_is_what_the_other_benchmarks_measure():
    table = table_of(trajectories("bar_magnets", 0.1, 100, 0.1))
    np.testing.assert_array_equal(case(KEY).table.columns, table.columns)


@pytest.mark.slow
@pytest.mark.parametrize("variant", [each for each in VARIANTS if each != "missing"])
def test_noise_is_a_share_of_each_states_deviation(variant):
    noise, clean = noise_of(dataclasses.replace(KEY, variant=variant))
    assert clean.shape == (2, 400)
    assert noise.std(axis=1) == pytest.approx(0.1 * clean.std(axis=1), rel=0.15)


def test_one_draw_of_noise_is_scaled_over_the_levels():
    small, _ = noise_of(dataclasses.replace(KEY, level=0.01))
    large, _ = noise_of(KEY)
    np.testing.assert_allclose(10.0 * small, large, atol=1e-12)


def test_every_method_is_given_the_same_data():
    other = case(dataclasses.replace(KEY, method="pysindy"))
    np.testing.assert_array_equal(other.table.columns, case(KEY).table.columns)


def test_uneven_times_ascend_at_random():
    table = case(dataclasses.replace(KEY, variant="uneven")).table
    steps = np.diff(table.column("t")[:100])
    assert steps.min() > 0.0
    assert steps.std() > 0.05


def test_trajectories_may_differ_in_length():
    table = case(dataclasses.replace(KEY, variant="lengths")).table
    assert np.diff([*table.starts, table.rows]).tolist() == list(LENGTHS)


def test_three_of_ten_rows_miss_one_cell():
    its = case(dataclasses.replace(KEY, variant="missing"))
    empty = np.isnan(its.table.columns)
    assert its.data == {"missing": "drop"}
    assert empty.sum(axis=0).max() == 1
    assert empty.sum() == 120
    assert not empty[0].any()


def test_the_true_derivatives_are_those_of_the_field():
    its = case(KEY)
    a, b = its.clean["theta1"], its.clean["theta2"]
    np.testing.assert_allclose(its.slope("theta1"), 0.5 * np.sin(a - b) - np.sin(a), atol=1e-12)
    assert its.truths == TRUTH["bar_magnets"]


@pytest.mark.slow
@pytest.mark.parametrize("system", ["lotka_volterra", "shear_flow"])
def test_a_fresh_trajectory_begins_where_none_was_measured(system):
    its = fresh(system, 100)
    starts = [values[0].tolist() for values in trajectories(system, 0.1, 100).values]
    assert its.states.shape == (100, 2)
    assert its.states[0].tolist() not in starts
    assert its.states.tolist() == fresh(system, 100).states.tolist()
    assert its.states.tolist() != fresh(system, 101).states.tolist()


def test_lotka_volterra_keeps_its_fixed_initial_conditions():
    assert SYSTEMS["lotka_volterra"].draw is not None
    assert [tuple(each[0]) for each in trajectories("lotka_volterra", 0.1, 7).values] == [
        (1, 3),
        (4, 1),
        (8, 2),
        (3, 3),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("system", TABLE_III)
def test_odd_systems_have_the_forms_of_the_paper_with_other_constants(system):
    its = case(Key("atoll", "odd", system, 0.0, 100))
    for name, truth in its.truths.items():
        paper = TRUTH[system][name]
        verdict = compare(truth, paper, its.clean, 0.1)
        assert verdict.is_right, (name, verdict.reason)
        assert verdict.constants_error > 0.005


@pytest.mark.parametrize("system", TABLE_III)
def test_odd_systems_move_as_their_equations_say(system):
    point = (1.3, 0.7)
    for (name, truth), value in zip(ODD[system].truth.items(), ODD[system].field(*point), strict=True):
        names = tuple(ODD[system].truth)
        found = values_of(from_infix(truth, names), np.array([[each] for each in point]))
        assert found == pytest.approx([value], rel=1e-12), name
