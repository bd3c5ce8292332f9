"""Which worker is kept for which isolated archipelago, and thereby who may compute what. Pure and deterministic."""

from collections.abc import Mapping, Sequence

from atoll_coordinator.service.workers.membership import Membership

Key = tuple[str, str]
"""Job and variable of an archipelago."""


class Isolation:
    """A room of its own, one worker, for each isolated archipelago, as far as there are workers."""

    def __init__(self, membership: Membership) -> None:
        self._membership = membership
        self._rooms: dict[Key, str | None] = {}

    def furnish(self, isolated: Sequence[Key], others: int, load: Mapping[str, int]) -> None:
        """Give rooms to the isolated archipelagos, in order.

        Args:
            isolated: those not cut yet.
            others: how many archipelagos are open that are not isolated.
            load: of how many archipelagos each worker has islands.
        """
        ready = self._membership.ready()
        kept = {
            worker for worker in self._rooms.values() if worker is not None and not self._membership.is_lost(worker)
        }
        self._rooms = rooms(isolated, others > 0, sorted(kept.union(ready)), self._rooms, load)

    def admits(self, key: Key, worker: str) -> bool:
        """Tell whether an archipelago may be computed by that worker."""
        if key in self._rooms:
            return self._rooms[key] == worker
        return worker not in self._rooms.values()

    def waits(self, key: Key) -> bool:
        """Tell whether an archipelago is isolated and there is no worker to keep for it."""
        return key in self._rooms and self._rooms[key] is None

    def ready_for(self, key: Key) -> tuple[str, ...]:
        """Return the workers that can compute an archipelago now, sorted."""
        return tuple(worker for worker in self._membership.ready() if self.admits(key, worker))


def rooms(
    isolated: Sequence[Key], has_others: bool, workers: Sequence[str], before: Mapping[Key, str | None],
    load: Mapping[str, int],
) -> dict[Key, str | None]:  # fmt: skip
    """Return the worker kept for each isolated archipelago; None for one that must wait.

    Who has a room keeps it while its worker is among `workers`, all that are not lost. Others get the worker with the
    least to do. One worker at least is left for the archipelagos that are not isolated.
    """
    number = len(workers) - has_others
    chosen: dict[Key, str] = {}
    for key in isolated:
        worker = before.get(key)
        if worker is not None and worker in workers and len(chosen) < number:
            chosen[key] = worker
    for key in isolated:
        free = [worker for worker in workers if worker not in chosen.values()]
        if key not in chosen and len(chosen) < number:
            chosen[key] = min(free, key=lambda worker: (load.get(worker, 0), worker))
    return {key: chosen.get(key) for key in isolated}
