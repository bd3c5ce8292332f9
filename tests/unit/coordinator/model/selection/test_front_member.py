"""Selection by description length."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.description_length import log
from atoll_coordinator.model.pools import may_be_shown
from atoll_coordinator.model.selection.front_member import count_constants, front_length, select_shortest_description
from atoll_coordinator.model.sparse.atoms import expression_of, products, sum_of
from atoll_core.data.dataset import Target
from atoll_core.expression.program import MAX_NODES
from atoll_core.expression.text.parsing import from_infix
from atoll_core.search.pareto import FrontEntry


def entry(size: int, rmse: float, text: str = "x") -> FrontEntry:
    return FrontEntry(size, rmse, rmse * rmse, 0, 1, 0, from_infix(text, ["x"]).to_bytes())


def target(floor: float = 0.0, deviation: float = 1.0) -> Target:
    return Target("x", "dx/dt", np.zeros(100), floor, deviation)


def test_description_length_is_the_published_formula():
    expected = 50.0 * math.log(0.04) + 7 * math.log(8.0) + 1.5 * math.log(100.0)
    assert front_length(entry(7, 0.2), 100, 0.0, 1.0, 3) == pytest.approx(expected, rel=1e-15)


def test_errors_below_the_floor_earn_nothing():
    lengths = {front_length(entry(7, rmse), 100, 0.01, 5.0, 0) for rmse in (0.05, 0.01, 1e-9, 0.0)}
    assert len(lengths) == 1


def test_an_exact_equation_has_a_finite_length():
    expected = 50.0 * math.log(sys.float_info.min) + 3 * math.log(8.0)
    assert front_length(entry(3, 0.0), 100, 0.0, 0.0, 0) == pytest.approx(expected)


def test_a_better_error_is_worth_nodes_only_when_it_is_much_better():
    front = (entry(3, 0.5), entry(9, 0.1), entry(30, 0.099))
    assert select_shortest_description(front, 100, target()) == 1


def test_below_the_floor_the_smallest_wins():
    front = (entry(3, 0.5), entry(9, 1e-2), entry(11, 1e-4))
    assert select_shortest_description(front, 100, target(floor=0.02)) == 1


def test_a_member_that_meets_the_target_is_preferred_to_one_that_misses_it():
    front = (entry(3, 0.12), entry(9, 0.1))
    assert select_shortest_description(front, 20, target()) == 0
    assert select_shortest_description(front, 20, target(), target_error=0.1) == 1


def test_constants_cost():
    cheap, costly = entry(5, 0.1, "x + x*x"), entry(5, 0.1, "x*2.5 + 1.5")
    assert (count_constants(cheap.program), count_constants(costly.program)) == (0, 2)
    assert select_shortest_description((costly, cheap), 100, target()) == 1


def test_equals_are_decided_by_their_place():
    assert select_shortest_description((entry(5, 0.1), entry(5, 0.1)), 100, target()) == 0


def test_an_empty_front_has_no_selection():
    with pytest.raises(ValueError, match="empty"):
        select_shortest_description((), 100, target())


def test_scaling_the_target_does_not_change_the_choice():
    front = (entry(3, 0.5), entry(9, 0.1), entry(12, 0.02))
    scaled = tuple(replace(entry, error=entry.error * 1e6, mse=entry.mse * 1e12) for entry in front)
    assert select_shortest_description(front, 60, target(0.01)) == select_shortest_description(
        scaled, 60, target(0.01, 1e6)
    )


def test_the_logarithm_is_right_to_a_few_units_in_the_last_place():
    values = [2.0**k * m for k in range(-1000, 1000, 37) for m in (1.0, 1.1, 1.41, 1.42, 1.99)]
    assert all(abs(log(v) - math.log(v)) <= 4.5e-16 * max(1.0, abs(math.log(v))) for v in values)


@pytest.mark.parametrize(("largest", "may"), [(None, True), (3, True), (2, False)])
def test_what_is_larger_than_the_user_allows_is_not_shown(largest, may):
    assert may_be_shown(from_infix("2.0*x", ["x"]), largest) is may


def test_programs_that_are_larger_than_any_may_be_are_not_shown():
    terms = products(range(5), 4)
    program = sum_of([expression_of(term) for term in terms], [1.5 + number for number in range(len(terms))])
    assert len(program) > MAX_NODES
    assert not may_be_shown(program, None)


def test_constants_are_counted_among_operators_alone():
    """In the bytes of y alone its operator is followed by its number, which is 1 as the code of a constant is."""
    for text, count in (("2.5", 1), ("y", 0), ("2.5*x", 1), ("x + 2.5*y - 1.5", 2)):
        assert count_constants(from_infix(text, ["x", "y"]).to_bytes()) == count
