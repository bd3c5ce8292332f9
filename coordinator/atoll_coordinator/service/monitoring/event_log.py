"""Events of jobs and workers, and log lines of workers: in the program's log at once, in the store soon after.

No decision depends on events, so they are written together, a few times a second. A coordinator that is killed loses
the events of the last half second and no other data.
"""

import json
import logging
from collections.abc import Callable, Mapping
from typing import Any, Final

from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.search.archipelago import Checkpoint
from atoll_coordinator.service.search.ending import Cut
from atoll_coordinator.service.store.events import EventRecord
from atoll_coordinator.service.store.jobs import Viewer
from atoll_coordinator.service.store.store import Store
from atoll_core.logs import fields
from atoll_core.wire.messages.views import WARNINGS, EventKind, EventView
from atoll_core.wire.messages.workers import Placement, WorkerLog

_LOG = logging.getLogger("coordinator")

MAX_REFUSALS: Final = 1000
"""Largest number of different refusals of workers that are recorded, so that refusals cannot fill the log."""

RATE: Final = 40.0
"""Log lines per second that are accepted from one worker in the long run: twice the rate of a worker."""

BURST: Final = 400

MAX_WORKERS: Final = 10_000
"""Workers whose lines are counted at a time: the largest number of sessions of the router."""

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
        self.on_event: Callable[[EventKind, str | None], object] = lambda kind, job: None
        """Called with kind and job of each recorded event."""

    def record(self, kind: EventKind, text: str, job: str | None = None, **values: Value) -> None:
        """Record an event: a sentence, and fields such as `variable`, `island`, `epoch`, `term` or `worker`."""
        given = {name: value for name, value in values.items() if value is not None}
        level = logging.WARNING if kind in WARNINGS else logging.INFO
        _LOG.log(level, kind, extra=fields(job=job, **given, text=text))
        self._pending.append(EventRecord(job, self._clock(), kind, json.dumps({"text": text, **given})))
        self.on_event(kind, job)

    def add_line(self, job: str | None, contents: Mapping[str, Any], time: str | None = None) -> None:
        """Record a line of a worker's log for a job (None: no particular job); `time` is ISO, None: now."""
        self._pending.append(EventRecord(job, time or self._clock(), "log", json.dumps(dict(contents))))
        self.on_event("log", job)

    def flush(self) -> None:
        """Write pending events to the store."""
        if self._pending:
            pending, self._pending = self._pending, []
            self._store.add_events(pending)

    def read(
        self, job: str | None, after: int, limit: int, viewer: Viewer | None = None, *, of_workers: bool = False
    ) -> tuple[EventView, ...]:  # fmt: skip
        """Return the events of a job, or all, after an event number; see `Store.events`.

        Events whose kind this version does not know are left out.
        """
        self.flush()
        records = self._store.events(job, after, limit, viewer, of_workers=of_workers)
        views = (view_of(record) for record in records)
        return tuple(view for view in views if view is not None)

    def record_end(self, job: Job) -> None:
        """Record that a job has ended, and write pending events at once."""
        kinds: dict[str, EventKind] = {"failed": "failed", "cancelled": "cancelled"}
        self.record(kinds.get(job.state, "done"), job.reason or job.state, job.id, fault=job.fault)
        self.flush()

    def record_placement(self, placement: Placement) -> None:
        """Record a new placement of an archipelago."""
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

    def record_refusal(self, worker: str, reason: str) -> None:
        """Record that a worker was refused, once for each reason."""
        if (worker, reason) not in self._refusals and len(self._refusals) < MAX_REFUSALS:
            self._refusals.add((worker, reason))
            self.record("refused", reason, worker=worker)


def view_of(record: EventRecord) -> EventView | None:
    """Return the view of a stored event; None if this version does not know its kind."""
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


class WorkerLogs:
    """Records log lines of workers as events of the kind `log`, up to a rate."""

    def __init__(self, events: EventLog) -> None:
        self.dropped = 0
        """Lines beyond the limits, dropped by workers or here."""
        self._events = events
        self._allowances: dict[str, tuple[float, float]] = {}

    def take(self, worker: str, message: WorkerLog, known_jobs: set[str], now: float) -> None:
        """Record a worker's lines about known jobs, and lines that concern no particular job."""
        allowance, at = self._allowances.get(worker, (float(BURST), now))
        allowance = min(float(BURST), allowance + RATE * (now - at))
        wanted = [line for line in message.lines if line.job is None or line.job in known_jobs]
        taken = wanted[: int(allowance)]
        if worker not in self._allowances and len(self._allowances) >= MAX_WORKERS:
            self._allowances.clear()
        self._allowances[worker] = (allowance - len(taken), now)
        for line in taken:
            contents = line.model_dump(exclude={"job", "time"}, exclude_none=True)
            self._events.add_line(line.job, contents | {"worker": worker}, line.time)
        dropped = message.dropped + len(wanted) - len(taken)
        if dropped:
            self.dropped += dropped
            for job in {line.job: None for line in taken} or (None,):
                text = f"about {dropped} lines of this worker's log exceeded the limit and are missing"
                self._events.add_line(job, {"text": text, "worker": worker, "level": "warning"})
