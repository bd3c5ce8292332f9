"""The measurements that noisy searches are given: noise, fresh trajectories."""

import dataclasses

import numpy as np
import pytest

from benchmarks.harness.systems import table_of, trajectories
from benchmarks.noise.data import Key, case, fresh

KEY = Key("atoll", "bar_magnets", 0.1, 100)


def noise_of(key):
    made_case = case(key)
    clean = np.array([made_case.clean[name] for name in made_case.truths])
    return made_case.table.columns[1:] - clean, clean


def test_the_plain_case_is_what_the_other_benchmarks_measure():
    table = table_of(trajectories("bar_magnets", 0.1, 100, 0.1))
    np.testing.assert_array_equal(case(KEY).table.columns, table.columns)


def test_one_draw_of_noise_is_scaled_over_the_levels():
    small, _ = noise_of(dataclasses.replace(KEY, level=0.01))
    large, _ = noise_of(KEY)
    np.testing.assert_allclose(10.0 * small, large, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("system", ["lotka_volterra", "shear_flow"])
def test_a_fresh_trajectory_begins_where_none_was_measured(system):
    made_case = fresh(system, 100)
    starts = [values[0].tolist() for values in trajectories(system, 0.1, 100).values]
    assert made_case.states.shape == (100, 2)
    assert made_case.states[0].tolist() not in starts
    assert made_case.states.tolist() == fresh(system, 100).states.tolist()
    assert made_case.states.tolist() != fresh(system, 101).states.tolist()
