"""Functions that anybody may compute: from values here, from bytes elsewhere, always the same."""

import threading

import pytest

from atoll_coordinator.model.batches import FUNCTIONS, BatchFunction, Spread, spreading
from atoll_coordinator.model.deadline import Deadline
from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from tests.batches import ScatteredBatches

BUILT: list[int] = []


def built(base: int) -> list[int]:
    BUILT.append(base)
    return [base]


ADD: BatchFunction[list[int], int, tuple[int, str]] = BatchFunction(
    "test: add", int, int, tuple[int, str], lambda base, item: (base[0] + item, "a"), built
)
SQUARE: BatchFunction[int, int, int] = BatchFunction("test: power", int, int, int, lambda power, item: item**power)
ITEMS = list(range(23))


def test_a_batch_is_what_is_made_of_each_item() -> None:
    made = FUNCTIONS["test: power"](b"\x02", SQUARE.encode([3, -4]))
    assert SQUARE.decode(made) == (9, 16)
    with pytest.raises(RemoteProtocolError):
        FUNCTIONS["test: power"](b"\x02", SQUARE.encode([3])[:-1])


def test_a_context_is_built_once_for_many_batches() -> None:
    BUILT.clear()
    for _ in range(3):
        assert ADD.decode(FUNCTIONS["test: add"](bytes([7]), ADD.encode([1]))) == ((8, "a"),)
    assert BUILT == [7]


@pytest.mark.parametrize("workers", [0, 1, 2, 3, 7])
@pytest.mark.parametrize("size", [1, 4, 100])
def test_work_is_the_same_wherever_it_is_spread(workers: int, size: int) -> None:
    batches = ScatteredBatches(workers)
    assert Spread(batches).map(SQUARE, lambda: 2, ITEMS, size) == [item**2 for item in ITEMS]
    assert bool(batches.calls) == (workers > 0)
    assert Spread(ScatteredBatches(workers)).map(SQUARE, lambda: 2, [], size) == []


def test_long_items_are_offered_before_there_is_a_worker() -> None:
    batches = ScatteredBatches(0)
    assert Spread(batches).map(SQUARE, lambda: 2, ITEMS, is_long=True) == [item**2 for item in ITEMS]
    assert batches.calls == [("test: power", len(ITEMS))]
    assert Spread().map(SQUARE, lambda: 2, ITEMS, is_long=True) == [item**2 for item in ITEMS]


def test_threads_of_this_process_compute_the_same() -> None:
    with spreading(None, 2, Deadline()) as spread:
        assert not spread.is_shared
        assert spread.map(SQUARE, lambda: 3, ITEMS) == [item**3 for item in ITEMS]


def test_threads_compute_parts_of_one_computation_at_the_same_time() -> None:
    meeting = threading.Barrier(2, timeout=20)

    def meet(part: int) -> int:
        meeting.wait()
        return part

    with spreading(None, 2, Deadline()) as spread:
        assert spread.divide(meet, ITEMS[:8]) == ITEMS[:8]


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_a_thread_whose_work_is_divided_waits_for_no_thread_that_does_other_work(threads: int) -> None:
    """Every thread of the pool divides its item, and the parts of the item, while no thread is idle."""

    def squares(item: int) -> list[int]:
        return spread.divide(lambda part: sum(spread.divide(lambda own: own * part, ITEMS[:item])), ITEMS)

    with spreading(None, threads, Deadline()) as spread:
        found = list(spread.map_threads(squares, ITEMS))
    assert found == [[part * sum(ITEMS[:item]) for part in ITEMS] for item in ITEMS]


def test_branches_go_on_at_the_same_time_only_where_others_take_their_batches() -> None:
    meeting = threading.Barrier(2, timeout=20)
    assert Spread(ScatteredBatches(2)).run_calls([meeting.wait, meeting.wait]) in ([0, 1], [1, 0])
    threads = {threading.get_ident()}
    assert set(Spread().run_calls([threading.get_ident] * 2)) == threads


def test_names_are_used_once() -> None:
    with pytest.raises(LocalProtocolError, match="two functions"):
        BatchFunction("test: power", int, int, int, lambda power, item: item)
