"""The measurements that noisy searches are given: noise, fresh trajectories."""

import dataclasses

import numpy as np

from benchmarks.harness.systems import table_of, trajectories
from benchmarks.noise.data import Key, case

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
