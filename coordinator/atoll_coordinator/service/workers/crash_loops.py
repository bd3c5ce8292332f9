"""Archipelagos whose workers are lost repeatedly: crash loops, quarantine, and longer leases.

A death counts for each archipelago that had islands on the dead worker, at most once per term: when a host loses power,
many workers die at once, and their islands are not the cause. After three successive terms that ended by a death,
without a commit in between, an archipelago is quarantined: one worker is reserved for it and computes no other islands.
After two more such terms its job fails. Harmless archipelagos that shared a worker with it are quarantined as well,
until their next commit.

A slow worker with too short a lease would be treated as lost again and again, without progress. So from the second loss
without a commit in between, each loss doubles the leases of the archipelago's workers.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, Literal

from atoll_coordinator.service.monitoring.breakages import JobGuard, unguarded
from atoll_coordinator.service.monitoring.event_log import EventLog
from atoll_coordinator.service.search.archipelago import Archipelago, ArchipelagoKey
from atoll_coordinator.service.store.checkpoints import Death
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.workers.membership import Membership

QUARANTINE_AFTER: Final = 3
FAIL_AFTER: Final = 5
"""Numbers of successive terms that ended by a death, after which an archipelago is quarantined or its job fails."""

MAX_FACTOR: Final = 64.0
"""Largest factor on leases."""

CrashLoopState = Literal["healthy", "suspicious", "quarantined", "failed"]

Process = tuple[str, str]
"""Name and instance of a worker process."""


class CrashLoop:
    """The deaths of workers of one archipelago since its last commit, and the factor on the leases of its workers."""

    def __init__(self) -> None:
        self.lease_factor = 1.0
        self._processes: dict[int, set[Process]] = {}
        self._committed = 0
        self._is_evicted = False

    @property
    def deaths(self) -> int:
        """Number of terms that ended by a death."""
        return len(self._processes)

    @property
    def state(self) -> CrashLoopState:
        """The state that follows from the deaths."""
        if self.deaths >= FAIL_AFTER:
            return "failed"
        if self.deaths >= QUARANTINE_AFTER:
            return "quarantined"
        return "suspicious" if self.deaths else "healthy"

    def has_counted(self, process: Process) -> bool:
        """Return whether the death of a process is counted."""
        return any(process in processes for processes in self._processes.values())

    def add_death(self, term: int, process: Process) -> bool:
        """Add the death of a process that had islands under `term`; return whether it is the term's first death."""
        if self.state == "failed":
            return False
        is_first = term not in self._processes
        self._processes.setdefault(term, set()).add(process)
        return is_first

    def add_eviction(self) -> None:
        """Double the leases, if a worker was lost before and there was no commit in between."""
        if self._is_evicted:
            self.lease_factor = min(MAX_FACTOR, 2.0 * self.lease_factor)
        self._is_evicted = True

    def withdraw(self, process: Process) -> bool:
        """Withdraw the death of a process that is alive; return whether a term no longer counts as ended by a death."""
        terms = [term for term, processes in self._processes.items() if processes == {process}]
        for processes in self._processes.values():
            processes.discard(process)
        if self.state == "failed":
            return False
        for term in terms:
            del self._processes[term]
        return bool(terms)

    def add_commit(self, epoch: int) -> None:
        """Forget the deaths if the commit is later than all before: epochs are computed again after a death."""
        self._is_evicted = False
        if epoch > self._committed and self.state != "failed":
            self._committed = epoch
            self._processes.clear()


class CrashLoops:
    """The crash loops of all archipelagos. Deaths that count are stored until a commit."""

    def __init__(self, store: Store, events: EventLog) -> None:
        self._store = store
        self._events = events
        self._loops: dict[ArchipelagoKey, CrashLoop] = {}
        self._unsaved: list[Death] = []

    def loop(self, key: ArchipelagoKey) -> CrashLoop:
        """Return the crash loop of an archipelago."""
        return self._loops.get(key) or CrashLoop()

    def recover(self, job: str) -> None:
        """Restore the deaths that were counted for a job before a restart of the coordinator."""
        for death in self._store.deaths(job):
            loop = self._loops.setdefault((death.job, death.variable), CrashLoop())
            loop.add_death(death.term, (death.worker, death.instance))

    def add_death(self, key: ArchipelagoKey, term: int, process: Process, why: str) -> str | None:
        """Count a death for an archipelago; return the reason if its job fails by it, otherwise None."""
        loop = self._loops.setdefault(key, CrashLoop())
        loop.add_eviction()
        is_first = loop.add_death(term, process)
        if loop.state != "failed":  # otherwise its job ends now, and the end is stored
            self._unsaved.append(Death(*key, term, *process))
        if not is_first:
            return None
        if loop.deaths == QUARANTINE_AFTER:
            text = "workers of its islands died three times in succession; one worker now computes only these islands"
            self._events.record("isolated", text, key[0], variable=key[1])
        if loop.state != "failed":
            return None
        return (
            f"the islands of {key[1]} seem to kill their workers: in {FAIL_AFTER} successive placements a worker was "
            f"lost before a commit, and in the last {FAIL_AFTER - QUARANTINE_AFTER} it computed no other islands (the "
            f"last worker was {process[0]}: {why}); look at the log of this worker, at its memory, and at the data"
        )

    def add_commit(self, key: ArchipelagoKey, epoch: int) -> None:
        """Forget the deaths of an archipelago that has a new commit; a quarantine ends."""
        loop = self.loop(key)
        was_quarantined = loop.state == "quarantined"
        loop.add_commit(epoch)
        if was_quarantined and loop.state == "healthy":
            self._events.record(
                "pardoned", "it makes progress again, and other islands may share its worker", key[0], variable=key[1]
            )

    def withdraw(self, process: Process) -> None:
        """Withdraw the death of a process that is alive."""
        counting = {key: loop for key, loop in self._loops.items() if loop.has_counted(process)}
        for key, loop in counting.items():
            if loop.withdraw(process):
                text = f"worker {process[0]} is alive after all; its loss does not count"
                self._events.record("pardoned", text, key[0], variable=key[1], worker=process[0])
        self._unsaved = [death for death in self._unsaved if (death.worker, death.instance) != process]
        if counting:
            self._store.take_back_deaths(*process)

    def lease_factors(self, archipelagos: Iterable[Archipelago]) -> dict[str, float]:
        """Return the factor on each worker's lease: the largest factor of the archipelagos with islands on it."""
        factors: dict[str, float] = {}
        for archipelago in archipelagos:
            for worker in archipelago.workers:
                factors[worker] = max(factors.get(worker, 1.0), self.loop(archipelago.key).lease_factor)
        return factors

    def save(self) -> None:
        """Store the counted deaths, before the islands are placed again."""
        if self._unsaved:
            deaths, self._unsaved = self._unsaved, []
            self._store.add_deaths(deaths)

    def forget(self, job: str) -> None:
        """Forget a job that has ended."""
        self._loops = {key: loop for key, loop in self._loops.items() if key[0] != job}
        self._unsaved = [death for death in self._unsaved if death.job != job]


class Quarantine:
    """Reserves one worker for each quarantined archipelago, while there are enough workers. Pure."""

    def __init__(self, membership: Membership, crash_loops: CrashLoops) -> None:
        self._membership = membership
        self._crash_loops = crash_loops
        self._reserved: dict[ArchipelagoKey, str | None] = {}

    def reserve(self, archipelagos: Sequence[Archipelago], guarded: JobGuard = unguarded) -> None:
        """Reserve workers for the quarantined archipelagos, in order; each archipelago is checked under `guarded`."""
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
        """Return whether a worker may compute an archipelago."""
        if key in self._reserved:
            return self._reserved[key] == worker
        return worker not in self._reserved.values()

    def waiting(self, archipelagos: Iterable[Archipelago]) -> list[str]:
        """Return the variables of quarantined archipelagos without a worker."""
        return [archipelago.variable for archipelago in archipelagos if self._reserved.get(archipelago.key, "") is None]

    def ready_for(self, key: ArchipelagoKey) -> tuple[str, ...]:
        """Return the workers that can compute an archipelago now, sorted."""
        return tuple(worker for worker in self._membership.ready() if self.allows(key, worker))


def reserve_workers(
    quarantined: Sequence[ArchipelagoKey], has_others: bool, workers: Sequence[str],
    reserved: Mapping[ArchipelagoKey, str | None], load: Mapping[str, int],
) -> dict[ArchipelagoKey, str | None]:  # fmt: skip
    """Return the worker reserved for each quarantined archipelago; None: it must wait.

    Args:
        quarantined: the open quarantined archipelagos, in the order in which they get workers.
        has_others: whether other archipelagos are open; at least one worker is kept for them.
        workers: all workers that are not lost.
        reserved: previous reservations; an archipelago keeps its worker if that is among `workers`.
        load: number of archipelagos of each worker; the worker with the fewest is chosen.
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
