"""By how much the leases of slow archipelagos' workers are longer. Pure.

A worker that is given up although it is only slow would be given up again and again, and its islands would never get
on. So each time that happens without a commit since the last time, the archipelago's workers have twice the time.
"""

from collections.abc import Iterable
from typing import Final

from atoll_coordinator.service.search.archipelago import Archipelago, ArchipelagoKey

MAX_FACTOR: Final = 64.0


class LeaseBackoff:
    """By archipelago, the factor on every lease of its workers."""

    def __init__(self) -> None:
        self._factors: dict[ArchipelagoKey, float] = {}
        self._is_evicted: dict[ArchipelagoKey, bool] = {}

    def add_eviction(self, key: ArchipelagoKey) -> None:
        """Take in that a worker of this archipelago was given up."""
        if self._is_evicted.get(key, False):
            self._factors[key] = min(MAX_FACTOR, 2.0 * self._factors.get(key, 1.0))
        self._is_evicted[key] = True

    def add_commit(self, key: ArchipelagoKey) -> None:
        """Take in that this archipelago has a new commit."""
        self._is_evicted[key] = False

    def factors(self, archipelagos: Iterable[Archipelago]) -> dict[str, float]:
        """Return the factor of each worker that has islands of these archipelagos: the largest of theirs."""
        factors: dict[str, float] = {}
        for archipelago in archipelagos:
            for worker in archipelago.workers:
                factors[worker] = max(factors.get(worker, 1.0), self._factors.get(archipelago.key, 1.0))
        return factors

    def forget(self, job: str) -> None:
        """Forget a job that has ended."""
        for table in (self._factors, self._is_evicted):
            for key in [key for key in table if key[0] == job]:
                del table[key]
