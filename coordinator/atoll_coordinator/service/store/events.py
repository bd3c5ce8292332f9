"""The store's table of events: what happened, in the order in which it did, and not without end."""

import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from atoll_coordinator.service.store.jobs import Viewer

MAX_EVENTS: Final = 2000
"""Events kept of each job, and of no job in particular; older ones are forgotten."""

LEAST_COMMITS: Final = 500
"""Of these events so many may be commits and lines of logs before anything rarer is forgotten for them."""

_COMMON: Final = "kind IN ('commit', 'log')"


@dataclass(frozen=True, slots=True)
class EventRecord:
    """One event as it is kept. `time` is an ISO time, `contents` JSON; `number` rises and is given by the store.

    `job` is None when it concerns no job in particular.
    """

    job: str | None
    time: str
    kind: str
    contents: str
    number: int = 0


def add(sql: sqlite3.Connection, events: Sequence[EventRecord]) -> None:
    """Add events, in order, and forget what is too much of each job; part of the caller's transaction."""
    rows = [(event.job, event.time, event.kind, event.contents, *_seen_by(sql, event)) for event in events]
    sql.executemany("INSERT INTO events (job, time, kind, contents, owner, shared) VALUES (?, ?, ?, ?, ?, ?)", rows)
    for job in {event.job: None for event in events}:
        _thin(sql, job)


def _seen_by(sql: sqlite3.Connection, event: EventRecord) -> tuple[str | None, int]:
    """Return whose an event is, and whether everybody sees it: what its job says, or an event of workers."""
    if event.job is None:
        return None, int(event.kind not in ("deleted", "broken", "log"))
    row = sql.execute("SELECT submitter, shared FROM jobs WHERE id = ?", (event.job,)).fetchone()
    return row if row is not None else (None, 0)


def share(sql: sqlite3.Connection, job: str, is_shared: bool) -> None:
    """Have everybody see the events of a job, or its submitter alone."""
    sql.execute("UPDATE events SET shared = ? WHERE job = ?", (int(is_shared), job))


def _thin(sql: sqlite3.Connection, job: str | None) -> None:
    """Forget the oldest events of a job beyond `MAX_EVENTS`: first commits and lines of logs, as long as there are
    `LEAST_COMMITS` of them."""
    (excess,) = sql.execute("SELECT count(*) - ? FROM events WHERE job IS ?", (MAX_EVENTS, job)).fetchone()
    if excess <= 0:
        return
    oldest = "SELECT number FROM events WHERE job IS ? AND {} ORDER BY number LIMIT ?"
    (commits,) = sql.execute(f"SELECT count(*) FROM events WHERE job IS ? AND {_COMMON}", (job,)).fetchone()
    spare = min(excess, max(0, commits - LEAST_COMMITS))
    for condition, number in ((_COMMON, spare), (f"NOT {_COMMON}", excess - spare)):
        sql.execute(f"DELETE FROM events WHERE number IN ({oldest.format(condition)})", (job, number))


def read(
    sql: sqlite3.Connection, job: str | None, after: int, limit: int, viewer: Viewer | None = None,
    of_workers: bool = False,
) -> tuple[EventRecord, ...]:  # fmt: skip
    """Return events of `job`, or of all (None), in order: the `limit` next ones after `after`, or the last ones (0).

    A `viewer` is told of the jobs it sees, and of workers; what broke, which jobs were deleted, and what workers log of
    no job that is known, may be others'. `of_workers`: only lines of workers' logs.
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
    rows = sql.execute(f"{' UNION '.join(parts)} ORDER BY number {order} LIMIT :limit", values).fetchall()
    return tuple(EventRecord(*row) for row in (rows if after else reversed(rows)))


def delete(sql: sqlite3.Connection, job: str) -> None:
    """Delete the events of a job; part of the caller's transaction."""
    sql.execute("DELETE FROM events WHERE job = ?", (job,))
