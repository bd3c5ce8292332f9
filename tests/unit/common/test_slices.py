"""Slices: where they end, in which order they count, and what counts of each island at a hit."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.slices import Position, slice_ends, slice_start


@pytest.mark.parametrize(
    ("generations", "stride", "last", "ends"),
    [
        (0, 10, 100, ()),
        (9, 10, 100, ()),
        (30, 10, 100, (10, 20, 30)),
        (25, 10, 25, (10, 20, 25)),
        (20, 10, 25, (10, 20)),
        (24, 10, 25, (10, 20)),
        (5, 10, 5, (5,)),
        (3, 1, 3, (1, 2, 3)),
    ],
)
def test_slices_end_at_multiples_of_the_stride_and_at_the_end_of_the_epoch(
    generations: int, stride: int, last: int, ends: tuple[int, ...]
) -> None:
    assert slice_ends(generations, stride, last) == ends


@given(st.integers(1, 300), st.integers(1, 40))
def test_a_slice_begins_where_the_one_before_ends(last: int, stride: int) -> None:
    ends = slice_ends(last, stride, last)
    assert [slice_start(end, stride) for end in ends] == [0, *ends[:-1]]


def test_slices_count_by_epoch_then_generation_then_island() -> None:
    order = [Position(0, 10, 0), Position(0, 10, 3), Position(0, 20, 0), Position(1, 10, 2)]
    assert sorted([order[2], order[0], order[3], order[1]]) == order


@given(st.integers(0, 9), st.integers(1, 10), st.integers(0, 9))
def test_what_counts_at_a_hit_is_what_does_not_come_after_it(hit_island: int, hit_slice: int, island: int) -> None:
    hit = Position(4, 10 * hit_slice, hit_island)
    counted = [end for end in slice_ends(100, 10, 100) if Position(4, end, island) <= hit]
    assert hit.needed(island, 10) == max(counted, default=0)
