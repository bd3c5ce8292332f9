"""Islands are spread evenly and always in the same way."""

from hypothesis import given
from hypothesis import strategies as st

from coordinator.service.placement import spread

NAMES = st.lists(st.text("abc", min_size=1), min_size=1, unique=True)


@given(st.integers(1, 40), st.integers(0, 100), NAMES)
def test_no_worker_has_two_islands_more_than_another(islands: int, first: int, workers: list[str]) -> None:
    placed = spread(islands, first, workers)
    counts = [placed.count(worker) for worker in workers]
    assert len(placed) == islands
    assert max(counts) - min(counts) <= 1


@given(st.integers(1, 40), st.integers(0, 100), NAMES)
def test_the_order_in_which_workers_are_named_does_not_matter(islands: int, first: int, workers: list[str]) -> None:
    assert spread(islands, first, workers) == spread(islands, first, workers[::-1])


def test_variables_with_fewer_islands_than_workers_lie_on_different_workers() -> None:
    workers = ["a", "b", "c", "d"]
    assert spread(2, 0, workers) == ("a", "b")
    assert spread(2, 2, workers) == ("c", "d")
