"""The event log: what happens to jobs and workers, as a line of the program's log at once and in the store soon after.

Events inform people and decide nothing, so they are written together, a few times a second; a coordinator that is
killed loses the last half second of them and nothing else.
"""

import json
import logging
from collections.abc import Callable, Mapping
from typing import Any, Final

from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.search.archipelago import ArchipelagoKey, Checkpoint
from atoll_coordinator.service.search.cut import Cut
from atoll_coordinator.service.store.events import EventRecord
from atoll_coordinator.service.store.jobs import Viewer
from atoll_coordinator.service.store.store import Store
from atoll_core.logs import fields
from atoll_core.wire.messages.clients import Submit
from atoll_core.wire.messages.handshake import Hello
from atoll_core.wire.messages.views import WARNINGS, EventKind, EventView
from atoll_core.wire.messages.workers import Placement

_LOG = logging.getLogger("coordinator")

MAX_REFUSALS: Final = 1000
"""Refusals of workers that are recorded, each once, so that a flood of them does not fill the log."""

_COLUMNS: Final = ("variable", "island", "epoch", "term", "worker")
_MAX_NAMES: Final = 8

Value = str | int | float | None


class EventLog:
    """The events of one coordinator."""

    def __init__(self, store: Store, clock: Callable[[], str]) -> None:
        """`clock` gives the time of day as ISO text."""
        self._store = store
        self._clock = clock
        self._pending: list[EventRecord] = []
        self._refusals: set[tuple[str, str]] = set()
        self.told: Callable[[EventKind, str | None], object] = lambda kind, job: None
        """Called with the kind and the job of each event, when it has been recorded."""

    def record(self, kind: EventKind, text: str, job: str | None = None, **values: Value) -> None:
        """Record an event: a sentence and fields, such as `variable`, `island`, `epoch`, `term` or `worker`."""
        given = {name: value for name, value in values.items() if value is not None}
        level = logging.WARNING if kind in WARNINGS else logging.INFO
        _LOG.log(level, kind, extra=fields(job=job, **given, text=text))
        self._pending.append(EventRecord(job, self._clock(), kind, json.dumps({"text": text, **given})))
        self.told(kind, job)

    def add_line(self, job: str | None, contents: Mapping[str, Any], time: str | None = None) -> None:
        """Record a line of a worker's log, which has been logged there; `time` is ISO, None: now."""
        self._pending.append(EventRecord(job, time or self._clock(), "log", json.dumps(dict(contents))))
        self.told("log", job)

    def flush(self) -> None:
        """Write the events that are not in the store yet."""
        if self._pending:
            pending, self._pending = self._pending, []
            self._store.add_events(pending)

    def read(
        self, job: str | None, after: int, limit: int, viewer: Viewer | None = None, *, of_workers: bool = False
    ) -> tuple[EventView, ...]:  # fmt: skip
        """Return the events of a job, or all, after the one of that number; see `Store.events`.

        What another version has recorded in words that this one does not know is left out.
        """
        self.flush()
        records = self._store.events(job, after, limit, viewer, of_workers=of_workers)
        views = (view_of(record) for record in records)
        return tuple(view for view in views if view is not None)

    # ---------------------------------------------------------------------------------------------- jobs

    def record_start(self, cluster: str, incarnation: int) -> None:
        """Record that the coordinator has started."""
        self.record("started", "the coordinator is ready", realm=cluster, incarnation=incarnation)

    def record_submission(self, body: Submit) -> None:
        """Record that a job was submitted."""
        self.record("submitted", f"submitted as {body.name!r}", body.job, priority=body.priority)

    def record_preparation(self, job: Job) -> None:
        """Record that the data of a job are prepared."""
        sought = ", ".join(job.archipelagos)
        self.record("prepared", f"data are prepared; sought: {sought or 'nothing'}", job.id)

    def record_refining(self, job: str) -> None:
        """Record that the search of a job has ended and its equations are being refined."""
        self.record("refining", "all searches have ended; its equations are being refined", job)

    def record_end(self, job: Job) -> None:
        """Record that a job has ended, and write that at once."""
        kinds: dict[str, EventKind] = {"failed": "failed", "cancelled": "cancelled"}
        self.record(kinds.get(job.state, "done"), job.reason or job.state, job.id, fault=job.fault)
        self.flush()

    # -------------------------------------------------------------------------------------- archipelagos

    def record_placement(self, placement: Placement) -> None:
        """Record that a term of an archipelago has begun."""
        workers = sorted(set(placement.workers))
        names = ", ".join(workers[:_MAX_NAMES]) + " …" * (len(workers) > _MAX_NAMES)
        self.record(
            "placed",
            f"{len(placement.workers)} islands on {len(workers)} worker{'s' * (len(workers) > 1)}: {names}",
            placement.job,
            variable=placement.variable,
            term=placement.term,
            epoch=placement.epoch,
            workers=len(workers),
        )

    def record_broken_placement(self, key: ArchipelagoKey) -> None:
        """Record that an archipelago has lost its placement."""
        text = "a worker of its placement is lost, or kept for another archipelago"
        self.record("unplaced", text, key[0], variable=key[1])

    def record_commit(self, checkpoint: Checkpoint) -> None:
        """Record that a checkpoint is durable."""
        self.record(
            "commit",
            f"the checkpoint of epoch {checkpoint.epoch} is durable",
            checkpoint.job,
            variable=checkpoint.variable,
            epoch=checkpoint.epoch,
            term=checkpoint.term,
            islands=len(checkpoint.states),
            bytes=checkpoint.size,
        )

    def record_cut(self, job: str, cut: Cut) -> None:
        """Record that the search of one equation has ended."""
        text = f"the search has ended after {cut.epochs} epochs: {cut.why}"
        self.record("cut", text, job, variable=cut.variable, epoch=max(0, cut.epochs - 1), why=cut.why)

    def record_quarantine(self, key: ArchipelagoKey) -> None:
        """Record that an archipelago is quarantined."""
        text = "three times in a row a worker died that computed its islands; they get one worker for themselves"
        self.record("isolated", text, key[0], variable=key[1])

    def record_release(self, key: ArchipelagoKey) -> None:
        """Record that a commit has ended the quarantine of an archipelago."""
        self.record("pardoned", "it gets on, and is isolated no more", key[0], variable=key[1])

    def record_withdrawn_death(self, key: ArchipelagoKey, worker: str) -> None:
        """Record that a worker whose death was counted for an archipelago is alive."""
        text = f"worker {worker} is alive after all; its loss does not count"
        self.record("pardoned", text, key[0], variable=key[1], worker=worker)

    # ------------------------------------------------------------------------------------------- workers

    def record_refusal(self, worker: str, reason: str) -> None:
        """Record that a worker was refused, once for each reason."""
        if (worker, reason) not in self._refusals and len(self._refusals) < MAX_REFUSALS:
            self._refusals.add((worker, reason))
            self.record("refused", reason, worker=worker)

    def record_joining(self, hello: Hello) -> None:
        """Record that a worker has joined."""
        self.record("worker-joined", f"process {hello.pid} on {hello.host or 'an unnamed host'}", worker=hello.name)

    def record_return(self, worker: str) -> None:
        """Record that a lost worker is there again."""
        self.record("worker-back", "it is there again, as the same process", worker=worker)


def view_of(record: EventRecord) -> EventView | None:
    """Return a stored event as people are shown it; None for one that is not in the words of this version."""
    try:
        contents: dict[str, Any] = json.loads(record.contents)
        named = {name: contents.pop(name, None) for name in _COLUMNS}
        return EventView.model_validate(
            {
                "number": record.number, "time": record.time, "event": record.kind, "text": contents.pop("text", ""),
                "job": record.job, **named, "details": contents,
            }
        )  # fmt: skip
    except (ValueError, TypeError, AttributeError):
        return None
