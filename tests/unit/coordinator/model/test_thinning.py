"""Some of many rows stand for all: as many as asked for, of every part of whatever recurs."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from atoll_coordinator.model.thinning import lattice_step, thinned_places


@given(st.integers(1, 500))
def test_multiples_of_the_step_are_all_numbers_once(count):
    step = lattice_step(count)
    assert sorted(index * step % count for index in range(count)) == [*range(count)]
    assert math.gcd(step, count) == 1


@given(places=st.integers(0, 20_000), most=st.integers(1, 3000))
def test_there_are_about_as_many_as_asked_for_one_of_each_range(places, most):
    kept = thinned_places(places, most)
    assert len(kept) < 2 * most
    assert len(kept) >= min(places, most)
    assert (np.diff(kept) > 0).all()
    if len(kept):
        assert kept[0] >= 0
        assert kept[-1] < places
        assert np.diff(kept).max(initial=0) < 2 * max(1, places // most)


@pytest.mark.parametrize("rows", [10, 20, 50, 100, 101, 250, 1000])
def test_every_part_of_trajectories_is_met_as_often(rows):
    """Every fiftieth of 100,000 rows would be the first row of each trajectory of 50, and of 25."""
    counts = np.histogram(thinned_places(100_000, 2000) % rows, bins=5, range=(0, rows))[0]
    assert counts.sum() == 2000
    assert counts.min() > 300
