"""Pools that run the tasks of a service in this process, for tests."""

import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def call(work: Callable[[], None]) -> None:
    """Do a piece of work on the caller's thread."""
    work()


def start_thread(work: Callable[[], None]) -> None:
    """Do a piece of work on a thread of its own."""
    threading.Thread(target=work, daemon=True).start()


class LocalPool:
    """Runs every task as `start` does it. Nothing is loaded ahead, and nothing can be cancelled."""

    def __init__(self, start: Callable[[Callable[[], None]], None] = call) -> None:
        self._start = start

    def submit(
        self, job: str, function: Callable[[], T], on_result: Callable[[T], None], on_failure: Callable[[str], None],
        *, is_queued: bool = False,
    ) -> None:  # fmt: skip
        self._start(lambda: on_result(function()))

    def preload(self, function: Callable[[], None]) -> None:
        pass

    def cancel(self, job: str) -> None:
        pass

    def close(self) -> None:
        pass
