"""The search among sums of more and of fewer terms, whatever they are fitted to."""

from dataclasses import dataclass

import numpy as np
import pytest

from atoll_coordinator.model.sparse.elimination import improved, on_the_way, selected_forward, shortest, without_one


@dataclass(frozen=True)
class Fit:
    """Terms whose description is the longer the farther their sum is from ten."""

    kept: tuple[int, ...]

    @property
    def nats(self):
        return abs(sum(self.kept) - 10) + 0.5 * len(self.kept)


def test_terms_leave_as_long_as_that_is_shorter_by_more_than_the_least_gain():
    def fewer(fit):
        return map(Fit, without_one(fit.kept))

    assert improved(Fit((1, 2, 7, 3)), fewer).kept == (1, 2, 7)
    assert improved(Fit((1, 2, 7, 3)), fewer, 4.0).kept == (1, 2, 7, 3)


def test_every_sum_on_the_way_may_be_the_shortest():
    way = list(on_the_way(Fit((1, 2, 7, 3)), lambda fit: Fit(fit.kept[1:]) if fit.kept[1:] else None))
    assert [len(fit.kept) for fit in way] == [4, 3, 2, 1]
    assert shortest([None, *way]) is way[2]
    assert shortest([None]) is None


def test_a_single_term_stays_and_long_sums_are_left_alone():
    assert list(without_one((1,))) == []
    assert list(without_one((1, 2, 3), 2)) == []
    assert list(without_one((1, 2), 2)) == [(2,), (1,)]


def test_the_column_that_explains_most_comes_first():
    generator = np.random.default_rng(3)
    columns = generator.normal(size=(6, 100))
    columns[5] = columns[0]
    side = 5.0 * columns[4] + columns[1]
    steps = list(selected_forward(columns, side))
    chosen = [place for place, _ in steps]
    assert chosen[:2] == [4, 1]
    assert steps[1][1] < 1e-20 * float(side @ side)
    assert not {0, 5} <= set(chosen)


def test_nothing_is_chosen_where_no_column_is_left():
    assert list(selected_forward(np.array([[1.0, 1.0]]), np.array([1.0, 2.0]))) == [(0, pytest.approx(0.5))]
