"""`Batches` over an executor, for work that the caller's own thread divides, such as the profiles of an analysis."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from atoll.executors.dispatcher import Dispatcher
from atoll.executors.executors import Adapted, adapted, workers_of
from atoll.executors.tasks import what_to_do
from atoll_coordinator.model.batches import CANCELLED, Spread
from atoll_core.errors import AtollError


class ExecutorBatches:
    """Computes batches on an executor; implements `atoll_coordinator.model.batches.Batches`.

    Several threads may call `map`: each call has its own dispatcher.
    """

    threads: Final = 1

    def __init__(self, executor: Adapted) -> None:
        """Use an executor with all its workers."""
        self._executor = executor
        self.workers: Final = workers_of(executor.executor)

    def map(
        self, function: str, context: bytes, items: Sequence[bytes], cancel_after: float | None = None
    ) -> list[bytes]:
        """See `atoll_coordinator.model.batches.Batches.map`; raises AtollError if a batch cannot be computed."""
        with Dispatcher(self._executor, self.workers) as dispatcher:
            for place, item in enumerate(items):
                dispatcher.submit(place, "batch", (function, item), context)
            results: dict[int, bytes] = {}
            for computed in dispatcher.results(cancel_after):
                if computed.sentence:
                    raise AtollError(computed.sentence + what_to_do(computed.failure))
                results[computed.tag] = computed.value
        return [results.get(place, CANCELLED) for place in range(len(items))]

    def note(self, compared: int) -> None:
        """Do nothing: there is no display."""


@contextmanager
def spread_over(executor: object) -> Iterator[Spread]:
    """Context manager: a `Spread` over what the user gave as executor; raises UsageError, see `executors.adapted`."""
    used, is_done = adapted(executor), False
    try:
        yield Spread(ExecutorBatches(used))
        is_done = True
    finally:
        used.close(is_done=is_done)
