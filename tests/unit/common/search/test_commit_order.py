"""Slices: where they end, in which order they count, and what counts of each island at a hit."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from atoll_core.search.commit_order import CommitOrder, Position

COMMIT_ORDER = CommitOrder(generations=95, stride=10, joining=3)
ENDS = (10, 20, 30, 40, 50, 60, 70, 80, 90, 95)


@pytest.mark.parametrize(
    ("reached", "stride", "generations", "ends"),
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
    reached: int, stride: int, generations: int, ends: tuple[int, ...]
) -> None:
    assert CommitOrder(generations=generations, stride=stride, joining=1).ends(reached) == ends


def ordered(*positions: Position) -> list[Position]:
    return sorted(positions[::2] + positions[1::2], key=COMMIT_ORDER.rank)


def test_slices_count_by_epoch_then_generation_then_island() -> None:
    order = [Position(1, 10, 0), Position(1, 10, 5), Position(1, 20, 0), Position(2, 10, 2)]
    assert ordered(*order) == order


def test_in_the_first_epoch_islands_count_group_by_group() -> None:
    order = [Position(0, 10, 0), Position(0, 10, 2), Position(0, 95, 0), Position(0, 10, 3), Position(1, 10, 0)]
    assert ordered(*order) == order


@given(st.integers(0, 2), st.sampled_from(ENDS), st.integers(0, 7), st.integers(0, 7))
def test_what_counts_at_a_hit_is_what_does_not_come_after_it(
    epoch: int, generation: int, hit_island: int, island: int
) -> None:
    hit = Position(epoch, generation, hit_island)
    counted = [end for end in ENDS if COMMIT_ORDER.rank(Position(epoch, end, island)) <= COMMIT_ORDER.rank(hit)]
    assert COMMIT_ORDER.needed(hit, island) == max(counted, default=0)
