"""The writer does what it is given, in order, on a thread of its own."""

import threading

from atoll_coordinator.service.background.preparing import Writer


def test_works_are_done_in_the_order_in_which_they_came_and_not_here() -> None:
    done: list[tuple[int, int]] = []
    ready = threading.Event()
    writer = Writer()
    for number in range(20):
        writer(lambda number=number: done.append((number, threading.get_ident())))  # type: ignore[misc]
    writer(ready.set)
    assert ready.wait(30.0)
    assert [number for number, _ in done] == list(range(20))
    assert {thread for _, thread in done} != {threading.get_ident()}
    assert len({thread for _, thread in done}) == 1
