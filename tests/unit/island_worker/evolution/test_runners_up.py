"""An island's runners-up: what is new, what is saved, and which losses are still useful."""

import math

import numpy as np

from atoll_core.search.pareto import FrontEntry
from atoll_island_worker.evolution.front import RunnersUp
from atoll_island_worker.evolution.structures import MOST_TERMS


def entry(complexity, error, code):
    return FrontEntry(complexity, error, error * error, 0, 10, 0, bytes([1, code, 0, 0, 0, 0]))


FRONT = (entry(3, 1.0, 1), entry(5, 0.5, 2))


def test_a_member_that_a_better_one_displaced_is_kept_but_was_reported():
    kept = RunnersUp(2)
    better = entry(3, 0.9, 5)
    assert kept.take((better, FRONT[1]), FRONT, (*FRONT, better)) == []
    assert kept.entries == (FRONT[0],)


def test_a_loss_is_useful_while_some_complexity_it_may_come_to_has_room():
    kept, sizes = RunnersUp(1), 30
    assert np.isinf(kept.limits(sizes)).all()
    largest = sizes + 2 * MOST_TERMS + 2
    kept.replace(entry(size, 100.0 - size, size) for size in range(3, largest))
    limits = kept.limits(sizes)
    assert limits[3] == 97.0
    assert limits[20] == 80.0
    assert math.isinf(limits[2])
    kept.replace(member for member in kept.entries if member.complexity != 12)
    limits = kept.limits(sizes)
    assert np.isinf(limits[2:13]).all()
    assert limits[13] == 87.0


def test_a_complexity_without_room_has_the_error_of_its_last_as_limit():
    kept = RunnersUp(2)
    kept.replace((entry(3, 1.1, 3), entry(3, 1.2, 4), entry(5, 0.6, 5)))
    assert kept.limit(3) == 1.2
    assert math.isinf(kept.limit(5))
    assert math.isinf(kept.limit(4))
