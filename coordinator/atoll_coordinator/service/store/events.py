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
    rows = [(event.job, event.time, event.kind, event.contents) for event in events]
    sql.executemany("INSERT INTO events (job, time, kind, contents) VALUES (?, ?, ?, ?)", rows)
    for job in {event.job: None for event in events}:
        _thin(sql, job)


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
    order, conditions = "ASC" if after else "DESC", ["number > ?"]
    values: list[str | int | None] = [after]
    if job is not None:  # an OR would read all of them
        conditions, values = [*conditions, "job = ?"], [*values, job]
    if of_workers:
        conditions.append("kind = 'log'")
    if viewer is not None:
        of_nobody = "job IS NULL AND kind NOT IN ('deleted', 'broken', 'log')"
        conditions.append(f"({of_nobody} OR job IN (SELECT id FROM jobs WHERE {viewer.condition}))")
        values.append(viewer.name)
    rows = sql.execute(
        f"SELECT job, time, kind, contents, number FROM events WHERE {' AND '.join(conditions)} "
        f"ORDER BY number {order} LIMIT ?",
        (*values, limit),
    ).fetchall()
    return tuple(EventRecord(*row) for row in (rows if after else reversed(rows)))


def delete(sql: sqlite3.Connection, job: str) -> None:
    """Delete the events of a job; part of the caller's transaction."""
    sql.execute("DELETE FROM events WHERE job = ?", (job,))
