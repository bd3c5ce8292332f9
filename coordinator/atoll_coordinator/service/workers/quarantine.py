"""Which worker is reserved for which quarantined archipelago, and thereby who may compute what. Pure."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from atoll_coordinator.service.monitoring.breakages import JobGuard, unguarded
from atoll_coordinator.service.search.archipelago import Archipelago, ArchipelagoKey
from atoll_coordinator.service.workers.crash_loops import CrashLoops
from atoll_coordinator.service.workers.membership import Membership


class Quarantine:
    """One worker of its own for each quarantined archipelago, as far as there are workers."""

    def __init__(self, membership: Membership, crash_loops: CrashLoops) -> None:
        self._membership = membership
        self._crash_loops = crash_loops
        self._reserved: dict[ArchipelagoKey, str | None] = {}

    def reserve(self, archipelagos: Sequence[Archipelago], guarded: JobGuard = unguarded) -> None:
        """Reserve workers for the quarantined ones of all open archipelagos, in order; each is looked at `guarded`."""
        keys = [archipelago.key for archipelago in archipelagos]
        quarantined: list[ArchipelagoKey] = []
        for key in keys:
            with guarded(key[0]):
                quarantined += [key] if self._crash_loops.loop(key).state == "quarantined" else []
        load = Counter(worker for archipelago in archipelagos for worker in archipelago.workers)
        workers = {worker for worker in self._reserved.values() if worker and not self._membership.is_lost(worker)}
        self._reserved = reserve_workers(
            quarantined,
            len(keys) > len(quarantined),
            sorted(workers.union(self._membership.ready())),
            self._reserved,
            load,
        )

    def allows(self, key: ArchipelagoKey, worker: str) -> bool:
        """Tell whether an archipelago may be computed by that worker."""
        if key in self._reserved:
            return self._reserved[key] == worker
        return worker not in self._reserved.values()

    def waiting(self, archipelagos: Iterable[Archipelago]) -> list[str]:
        """Return the variables of the quarantined ones for which there is no worker."""
        return [archipelago.variable for archipelago in archipelagos if self._reserved.get(archipelago.key, "") is None]

    def ready_for(self, key: ArchipelagoKey) -> tuple[str, ...]:
        """Return the workers that can compute an archipelago now, sorted."""
        return tuple(worker for worker in self._membership.ready() if self.allows(key, worker))


def reserve_workers(
    quarantined: Sequence[ArchipelagoKey], has_others: bool, workers: Sequence[str],
    reserved: Mapping[ArchipelagoKey, str | None], load: Mapping[str, int],
) -> dict[ArchipelagoKey, str | None]:  # fmt: skip
    """Return the worker reserved for each quarantined archipelago; None for one that must wait.

    Args:
        quarantined: those that are open, in the order in which they are served.
        has_others: whether other archipelagos are open; one worker at least is left for them.
        workers: all that are not lost.
        reserved: what was reserved before; an archipelago keeps its worker while that is among `workers`.
        load: of how many archipelagos each worker has islands; the one with the least is taken.
    """
    number = len(workers) - has_others
    chosen: dict[ArchipelagoKey, str] = {}
    for key in quarantined:
        worker = reserved.get(key)
        if worker is not None and worker in workers and len(chosen) < number:
            chosen[key] = worker
    for key in quarantined:
        free = [worker for worker in workers if worker not in chosen.values()]
        if key not in chosen and len(chosen) < number:
            chosen[key] = min(free, key=lambda worker: (load.get(worker, 0), worker))
    return {key: chosen.get(key) for key in quarantined}
