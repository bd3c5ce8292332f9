"""Batches that are computed as a network of workers may do it, for tests."""

import random
from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor

from atoll_coordinator.model import pipeline  # which knows all functions  # noqa: F401
from atoll_coordinator.model.batches import CANCELLED, FUNCTIONS


def compute(function: str, context: bytes, item: bytes) -> bytes:
    """Return what a function makes of a batch, in whatever process."""
    return FUNCTIONS[function](bytes(context), bytes(item))


class ScatteredBatches:
    """Computes batches out of order, some of them twice, so many at a time; by an `executor` if there is one."""

    threads = 1

    def __init__(self, workers: int, executor: Executor | None = None, *, is_over: bool = False) -> None:
        self.workers = workers
        self.calls: list[tuple[str, int]] = []
        self.contexts: set[bytes] = set()
        self.compared = 0
        self._executor = executor
        self._is_over = is_over
        self._draw = random.Random(workers)

    def map(
        self, function: str, context: bytes, items: Sequence[bytes], cancel_after: float | None = None
    ) -> list[bytes]:
        self.calls.append((function, len(items)))
        self.contexts.add(context)
        if self._is_over and cancel_after is not None:
            return [CANCELLED for _ in items]
        order = [place for place in range(len(items)) for _ in range(self._draw.choice((1, 1, 2)))]
        self._draw.shuffle(order)
        with ThreadPoolExecutor(max(self.workers, 1)) as threads:
            run = (self._executor or threads).submit
            futures = [(place, run(compute, function, context, items[place])) for place in order]
            made: dict[int, bytes] = {}
            for place, future in futures:
                done = future.result(timeout=120)
                assert made.setdefault(place, done) == done, "what is computed twice is equal to the byte"
        return [made[place] for place in range(len(items))]

    def note(self, compared: int) -> None:
        self.compared += compared
