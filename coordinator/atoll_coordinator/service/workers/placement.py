"""Which worker computes which island. Pure and deterministic; it decides about time only, never about bits."""

from collections.abc import Sequence
from typing import Final

from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.workers.membership import Membership
from atoll_coordinator.service.workers.quarantine import Isolation

REPLACE_WITHIN_S: Final = 5.0
"""A worker that joins this soon after a placement takes part in it: the little that was computed is computed again."""

EXPECT_S: Final = 10.0
"""How long the first ready worker waits for the others that are expected."""


def spread(islands: int, first: int, workers: Sequence[str]) -> tuple[str, ...]:
    """Return for each island its worker: evenly, in turn over the sorted workers.

    Args:
        islands: how many there are.
        first: islands placed before (of the job's other variables), so that the turn goes on where it stopped and
            variables with fewer islands than workers come to lie on different workers.
        workers: at least one, names unique.
    """
    order = sorted(workers)
    return tuple(order[(first + island) % len(order)] for island in range(islands))


class Placer:
    """Decides when an archipelago is placed, and on whom, from who is there now."""

    def __init__(self, membership: Membership, expected_workers: int = 1, isolation: Isolation | None = None) -> None:
        """No island is placed before `expected_workers` are ready, or have been waited for long enough.

        `isolation` says who may be placed where; without it everybody may be placed anywhere.
        """
        self._membership = membership
        self._isolation = isolation or Isolation(membership)
        self._expected = expected_workers
        self._first_ready_at: float | None = None

    def is_broken(self, archipelago: Archipelago) -> bool:
        """Tell whether islands of this placement have nobody to compute them, or may not be where they are."""
        key = (archipelago.job, archipelago.variable)
        workers = set(archipelago.placement.workers) if archipelago.placement is not None else ()
        return any(self._membership.is_lost(each) or not self._isolation.admits(key, each) for each in workers)

    def is_left(self, archipelago: Archipelago) -> bool:
        """Tell whether a worker of this placement has said that it will end soon."""
        placement = archipelago.placement
        return placement is not None and any(self._membership.is_leaving(worker) for worker in placement.workers)

    def is_worth_planning(self, archipelago: Archipelago) -> bool:
        """Tell whether more workers could be used than are, from a checkpoint on."""
        ready = self._isolation.ready_for((archipelago.job, archipelago.variable))
        return archipelago.may_plan and self._could_use(archipelago, len(ready))

    def is_young(self, archipelago: Archipelago, now: float) -> bool:
        """Tell whether little has been computed since the archipelago was placed."""
        return now - archipelago.placed_at <= REPLACE_WITHIN_S

    def choose(self, archipelago: Archipelago, first: int, now: float) -> tuple[str, ...] | None:
        """Return a new placement, or None when the archipelago keeps the one it has or must wait.

        Args:
            archipelago: not cut yet.
            first: islands of the job's variables before this one.
            now: the bus's seconds.
        """
        present = self._membership.ready()
        if not present or not self._is_quorate(len(present), now):
            return None
        ready = self._isolation.ready_for((archipelago.job, archipelago.variable))
        if not ready:
            return None
        if archipelago.placement is not None and not (
            self.is_young(archipelago, now) and self._could_use(archipelago, len(ready))
        ):
            return None
        return spread(archipelago.collector.limits.islands, first, ready)

    def _could_use(self, archipelago: Archipelago, ready: int) -> bool:
        """Tell whether more workers are ready than are used."""
        used = len(set(archipelago.placement.workers)) if archipelago.placement is not None else 0
        return min(ready, archipelago.collector.limits.islands) > used

    def _is_quorate(self, ready: int, now: float) -> bool:
        if self._first_ready_at is None:
            self._first_ready_at = now
        if ready >= self._expected or now - self._first_ready_at >= EXPECT_S:
            self._expected = 1
        return ready >= self._expected
