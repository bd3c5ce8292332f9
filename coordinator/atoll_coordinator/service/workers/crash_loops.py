"""Crash loops: archipelagos whose workers die again and again, and what follows from that.

A death counts for each archipelago that the dead worker had islands of, and once for each term at most: a host that
loses its power takes many workers at once, which says nothing about their islands. After three terms in a row that
ended by a death, without a commit in between, an archipelago is quarantined: one worker computes it, and nothing else.
After two more its job fails. Harmless archipelagos that shared a worker with it are quarantined as well, until their
next commit.
"""

from typing import Final, Literal

from atoll_coordinator.service.monitoring.event_log import EventLog
from atoll_coordinator.service.search.archipelago import ArchipelagoKey
from atoll_coordinator.service.store.searches import Death
from atoll_coordinator.service.store.store import Store

QUARANTINE_AFTER: Final = 3
FAIL_AFTER: Final = 5
"""Terms in a row that ended by a death."""

CrashLoopState = Literal["healthy", "suspicious", "quarantined", "failed"]

Process = tuple[str, str]
"""Name and instance of a worker process."""


class CrashLoop:
    """The deaths of workers of one archipelago since its last commit."""

    def __init__(self) -> None:
        self._processes: dict[int, set[Process]] = {}
        self._committed = 0

    @property
    def deaths(self) -> int:
        """How many terms have ended by a death."""
        return len(self._processes)

    @property
    def state(self) -> CrashLoopState:
        """What follows from the deaths."""
        if self.deaths >= FAIL_AFTER:
            return "failed"
        if self.deaths >= QUARANTINE_AFTER:
            return "quarantined"
        return "suspicious" if self.deaths else "healthy"

    def has_counted(self, process: Process) -> bool:
        """Tell whether the death of a process is counted here."""
        return any(process in processes for processes in self._processes.values())

    def add_death(self, term: int, process: Process) -> bool:
        """Add the death of a process that had islands under `term`; return whether it is the first of that term."""
        if self.state == "failed":
            return False
        is_first = term not in self._processes
        self._processes.setdefault(term, set()).add(process)
        return is_first

    def withdraw(self, process: Process) -> bool:
        """Take back the death of a process that is alive; return whether a term counts no more by that."""
        terms = [term for term, processes in self._processes.items() if processes == {process}]
        for processes in self._processes.values():
            processes.discard(process)
        if self.state == "failed":
            return False
        for term in terms:
            del self._processes[term]
        return bool(terms)

    def add_commit(self, epoch: int) -> None:
        """Forget the deaths, if the commit is newer than all before: after a death, epochs are computed again."""
        if epoch > self._committed and self.state != "failed":
            self._committed = epoch
            self._processes.clear()


class CrashLoops:
    """The crash loops of all archipelagos. Deaths that count are kept in the store until a commit."""

    def __init__(self, store: Store, events: EventLog) -> None:
        self._store = store
        self._events = events
        self._loops: dict[ArchipelagoKey, CrashLoop] = {}
        self._unsaved: list[Death] = []

    def loop(self, key: ArchipelagoKey) -> CrashLoop:
        """Return the crash loop of an archipelago."""
        return self._loops.get(key) or CrashLoop()

    def recover(self, job: str) -> None:
        """Take over the deaths that were counted for a job before the coordinator was started again."""
        for death in self._store.deaths(job):
            loop = self._loops.setdefault((death.job, death.variable), CrashLoop())
            loop.add_death(death.term, (death.worker, death.instance))

    def add_death(self, key: ArchipelagoKey, term: int, process: Process, why: str) -> str | None:
        """Count a death for an archipelago; return the reason for which its job fails, if it does."""
        loop = self._loops.setdefault(key, CrashLoop())
        is_first = loop.add_death(term, process)
        if loop.state != "failed":  # else its job ends now, and that is durable
            self._unsaved.append(Death(*key, term, *process))
        if not is_first:
            return None
        if loop.deaths == QUARANTINE_AFTER:
            self._events.record_quarantine(key)
        if loop.state != "failed":
            return None
        return (
            f"the islands of {key[1]} end the workers that compute them: in {FAIL_AFTER} placements in a row workers "
            f"were lost before there was a commit, in the last {FAIL_AFTER - QUARANTINE_AFTER} they computed nothing "
            f"else (the last was {process[0]}: {why}); look at that worker's own log, at its memory, and at the data"
        )

    def add_commit(self, key: ArchipelagoKey, epoch: int) -> None:
        """Forget the deaths of an archipelago that has a new commit; a quarantine ends."""
        loop = self.loop(key)
        was_quarantined = loop.state == "quarantined"
        loop.add_commit(epoch)
        if was_quarantined and loop.state == "healthy":
            self._events.record_release(key)

    def withdraw(self, process: Process) -> None:
        """Take back the death of a process that is alive."""
        counting = {key: loop for key, loop in self._loops.items() if loop.has_counted(process)}
        for key, loop in counting.items():
            if loop.withdraw(process):
                self._events.record_withdrawn_death(key, process[0])
        self._unsaved = [death for death in self._unsaved if (death.worker, death.instance) != process]
        if counting:
            self._store.take_back_deaths(*process)

    def save(self) -> None:
        """Make the deaths durable that were counted, before the islands are placed anew."""
        if self._unsaved:
            deaths, self._unsaved = self._unsaved, []
            self._store.add_deaths(deaths)

    def forget(self, job: str) -> None:
        """Forget a job that has ended."""
        self._loops = {key: loop for key, loop in self._loops.items() if key[0] != job}
        self._unsaved = [death for death in self._unsaved if death.job != job]
