"""Has checkpoints gathered and written while the search goes on. Knows no bus: it asks through an outlet."""

from collections.abc import Iterable
from typing import Final, Protocol

from common.wire.codec import encode
from common.wire.messages import Commit, PullStates, States
from coordinator.service.archipelago import Archipelago, Checkpoint
from coordinator.service.job import Job

MOST_ASKS: Final = 4
"""Questions for states under way at the same time; with 4 MB an answer, what may come in at once."""


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

    def look(self, jobs: Iterable[Job], now: float) -> None:
        """Ask for the states that are due, and have written what is complete."""
        for job in jobs:
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

    def written(self, job: Job | None, checkpoint: Checkpoint, now: float) -> Commit | None:
        """Take in that a checkpoint is durable; return what the workers are to be told."""
        archipelago = job.archipelagos.get(checkpoint.variable) if job is not None else None
        return archipelago.committed(checkpoint, now) if archipelago is not None else None

    def _ask(self, archipelago: Archipelago) -> None:
        for worker, pull in archipelago.asks(MOST_ASKS - self._under_way):
            self._under_way += 1
            self._outlet.pull(worker, pull)
