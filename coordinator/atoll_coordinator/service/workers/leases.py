"""How patient one is with the workers of an archipelago whose work is slow. Pure.

A worker that is given up although it only was slow would be given up again and again, and its islands never get on. So
each time that happens without a commit since the last time, the archipelago's workers have twice the time.
"""

from collections.abc import Iterable
from typing import Final

from atoll_coordinator.service.workers.quarantine import Key

MAX_PATIENCE: Final = 64.0


class Leases:
    """By archipelago, the factor on every lease of its workers."""

    def __init__(self) -> None:
        self._patience: dict[Key, float] = {}
        self._is_evicted: dict[Key, bool] = {}

    def evicted(self, key: Key) -> None:
        """Note that a worker of this archipelago was given up for its silence, or since it did not get on."""
        if self._is_evicted.get(key, False):
            self._patience[key] = min(MAX_PATIENCE, 2.0 * self._patience.get(key, 1.0))
        self._is_evicted[key] = True

    def committed(self, key: Key) -> None:
        """Note that this archipelago gets on."""
        self._is_evicted[key] = False

    def patience(self, keys: Iterable[Key]) -> float:
        """Return the factor for a worker that has islands of these archipelagos."""
        return max((self._patience.get(key, 1.0) for key in keys), default=1.0)

    def forget(self, job: str) -> None:
        """Forget a job that has ended."""
        for table in (self._patience, self._is_evicted):
            for key in [key for key in table if key[0] == job]:
                del table[key]
