"""Has checkpoints gathered and written while the search goes on. Knows no bus: it asks through an outlet.

Of all states together no more are held than there is room for. The checkpoint that was begun first always goes on, once
nothing is being written, so that no one waits for ever, and one that is larger than the room goes through alone.
"""

from collections.abc import Iterable, Mapping
from typing import Final, Protocol

from atoll.wire.codec import encode
from atoll.wire.messages.limits import CHUNK_SIZE
from atoll.wire.messages.workers import Commit, PullStates, States
from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.search.archipelago import Archipelago, Checkpoint
from atoll_coordinator.service.workers.quarantine import Key

MOST_ASKS: Final = 4
"""Questions for states under way at the same time; with 4 MB an answer, what may come in at once."""

MOST_BYTES: Final = 256 * 1024**2
"""Of states held at the same time: gathered, asked for, or being written; and beyond that of one checkpoint."""


class KeeperOutlet(Protocol):
    """How a keeper reaches the others."""

    def pull(self, worker: str, body: PullStates) -> None:
        """Ask a worker for states; `Keeper.states_came` follows."""

    def write(self, checkpoint: Checkpoint, progress: bytes, elapsed: float) -> None:
        """Have a checkpoint written elsewhere; `Keeper.written` follows."""


class Keeper:
    """The checkpoints of all archipelagos that are on their way."""

    def __init__(self, outlet: KeeperOutlet) -> None:
        self._outlet = outlet
        self._under_way = 0
        self._gathered: dict[Key, int] = {}  # in the order in which they were begun
        self._written: dict[Key, int] = {}
        self.is_short = False  # some checkpoint waits for room

    @property
    def held(self) -> int:
        """Bytes of all states that are here."""
        return sum(self._gathered.values()) + sum(self._written.values())

    def look(self, jobs: Iterable[Job], now: float) -> None:
        """Ask for the states that are due, and have written what is complete."""
        live = {job.id: job for job in jobs}
        self._keep_only(live)
        self.is_short = False
        for job in live.values():
            for archipelago in job.open_archipelagos:
                self._look_at(job, archipelago, now)

    def look_at(self, job: Job | None, variable: str, now: float) -> None:
        """Do so for one archipelago, of which there is news: to look at all of them each time would take its time."""
        archipelago = job.archipelagos.get(variable) if job is not None and job.state == "running" else None
        if job is not None and archipelago is not None and archipelago.cut is None:
            self._look_at(job, archipelago, now)

    def _look_at(self, job: Job, archipelago: Archipelago, now: float) -> None:
        self._ask(archipelago)
        checkpoint = archipelago.checkpoint_due()
        if checkpoint is not None:
            key = (archipelago.job, archipelago.variable)
            self._gathered.pop(key, None)
            self._written[key] = checkpoint.size
            progress = encode(checkpoint.stored_progress(job.search_seconds(now)))
            self._outlet.write(checkpoint, progress, now - job.submitted_at)

    def states_came(self, job: Job | None, worker: str, asked: PullStates, body: States | None) -> None:
        """Take in the answer of a worker; None: there was none.

        Raises:
            RemoteProtocolError: A state was damaged on its way, and is asked for again.
        """
        self._under_way -= 1
        archipelago = job.archipelagos.get(asked.variable) if job is not None else None
        if archipelago is not None:
            archipelago.take_states(worker, asked, body)
            self._note(archipelago)

    def written(self, job: Job | None, checkpoint: Checkpoint, now: float) -> Commit | None:
        """Take in that a checkpoint is durable; return what the workers are to be told."""
        self._written.pop((checkpoint.job, checkpoint.variable), None)
        archipelago = job.archipelagos.get(checkpoint.variable) if job is not None else None
        return archipelago.committed(checkpoint, now) if archipelago is not None else None

    def _ask(self, archipelago: Archipelago) -> None:
        key = (archipelago.job, archipelago.variable)
        asks = archipelago.asks(self._most_for(key))
        if asks:
            self._gathered.setdefault(key, 0)
        for worker, pull in asks:
            self._under_way += 1
            self._outlet.pull(worker, pull)

    def _most_for(self, key: Key) -> int:
        """Return how many questions for states of an archipelago there is room for."""
        most = MOST_ASKS - self._under_way
        if not self._written and next(iter(self._gathered), key) == key:
            return most
        room = (MOST_BYTES - self.held) // CHUNK_SIZE - self._under_way
        self.is_short = self.is_short or room < most
        return min(most, room)

    def _note(self, archipelago: Archipelago) -> None:
        """Take notice of how much of an archipelago's checkpoint is here."""
        key, gathered = (archipelago.job, archipelago.variable), archipelago.gathered
        if gathered is None:
            self._gathered.pop(key, None)
        elif key in self._gathered:
            self._gathered[key] = gathered

    def _keep_only(self, live: Mapping[str, Job]) -> None:
        """Forget checkpoints that were given up: their archipelago has ended, or lost a worker."""
        for key in list(self._gathered):
            job = live.get(key[0])
            archipelago = job.archipelagos.get(key[1]) if job is not None and job.state == "running" else None
            if archipelago is None or archipelago.cut is not None or archipelago.gathered is None:
                del self._gathered[key]
