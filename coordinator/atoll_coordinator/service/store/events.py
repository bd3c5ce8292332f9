"""The store's table of events, of bounded length. Functions that take `sql` are part of the caller's transaction."""

import sqlite3
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from atoll_coordinator.service.store.jobs import Viewer
from atoll_coordinator.service.store.open_file import OpenFile, first_value

MAX_EVENTS: Final = 2000
"""Number of events that are kept for each job, and of events without a job; older events are deleted."""

LEAST_COMMITS: Final = 500
"""Number of commits and log lines that are kept; beyond this number, commits and log lines are deleted before rarer
events."""

_COMMON: Final = "kind IN ('commit', 'log')"


@dataclass(frozen=True, slots=True)
class EventRecord:
    """One stored event. `time` is an ISO time, `contents` JSON; the store assigns rising `number`s.

    `job` is None if the event concerns no particular job.
    """

    job: str | None
    time: str
    kind: str
    contents: str
    number: int = 0


class EventStore(OpenFile):
    """The part of the store that holds events. Every method is one transaction."""

    def add_events(self, events: Iterable[EventRecord]) -> None:
        """Store events; beyond `MAX_EVENTS` of a job, or without a job, the oldest are deleted, commits first."""
        with self._transaction() as sql:
            add(sql, tuple(events))

    def events(
        self, job: str | None, after: int, limit: int, viewer: Viewer | None = None, *, of_workers: bool = False
    ) -> tuple[EventRecord, ...]:  # fmt: skip
        """Return at most `limit` events of `job` (None: all events), in order.

        These are the first events after number `after`, or if that is 0, the latest events. A `viewer` gets the events
        of visible jobs and of workers. Breakages, deletions and log lines without a known job are left out, because
        they may concern other users. `of_workers`: only log lines of workers.
        """
        order = "ASC" if after else "DESC"
        sources = ("TRUE",) if viewer is None else ("owner = :name AND owner IS NOT NULL", "shared")
        which = ("AND job = :job " if job is not None else "") + ("AND kind = 'log' " if of_workers else "")
        index = "INDEXED BY events_of_job" if job is not None else ""
        parts = (
            f"SELECT * FROM (SELECT job, time, kind, contents, number FROM events {index} WHERE {whose} {which}"
            f"AND number > :after ORDER BY number {order} LIMIT :limit)"
            for whose in sources
        )
        values = {"job": job, "after": after, "limit": limit, "name": viewer.name if viewer is not None else None}
        with self._reading() as sql:
            rows = sql.execute(f"{' UNION '.join(parts)} ORDER BY number {order} LIMIT :limit", values).fetchall()
        return tuple(EventRecord(*row) for row in (rows if after else reversed(rows)))


def add(sql: sqlite3.Connection, events: Sequence[EventRecord]) -> None:
    """Add events, in order, and delete the excess of each job."""
    rows = [(event.job, event.time, event.kind, event.contents, *_seen_by(sql, event)) for event in events]
    sql.executemany("INSERT INTO events (job, time, kind, contents, owner, shared) VALUES (?, ?, ?, ?, ?, ?)", rows)
    for job in {event.job: None for event in events}:
        _delete_excess(sql, job)


def _seen_by(sql: sqlite3.Connection, event: EventRecord) -> tuple[str | None, int]:
    """Return the owner of an event, and whether all users see it."""
    if event.job is None:
        return None, int(event.kind not in ("deleted", "broken", "log"))
    row = sql.execute("SELECT submitter, shared FROM jobs WHERE id = ?", (event.job,)).fetchone()
    return row if row is not None else (None, 0)


def _delete_excess(sql: sqlite3.Connection, job: str | None) -> None:
    """Delete the oldest events beyond `MAX_EVENTS`, first commits and log lines beyond `LEAST_COMMITS`."""
    excess = first_value(sql, "SELECT count(*) - ? FROM events WHERE job IS ?", MAX_EVENTS, job)
    if excess <= 0:
        return
    oldest = "SELECT number FROM events WHERE job IS ? AND {} ORDER BY number LIMIT ?"
    commits = first_value(sql, f"SELECT count(*) FROM events WHERE job IS ? AND {_COMMON}", job)
    spare = min(excess, max(0, commits - LEAST_COMMITS))
    for condition, number in ((_COMMON, spare), (f"NOT {_COMMON}", excess - spare)):
        sql.execute(f"DELETE FROM events WHERE number IN ({oldest.format(condition)})", (job, number))
