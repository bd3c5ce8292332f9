"""The store's table of jobs, and what of them is whose. Every function is part of the caller's transaction."""

import sqlite3
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Final, cast

from atoll_core.errors import LocalProtocolError


@dataclass(frozen=True, slots=True)
class JobRecord:
    """One job as it is kept. `spec` is JSON; `submitted` and `finished` are ISO times; `elapsed` is seconds of work.
    `ended_at` is how many seconds the store had been served when it ended.

    `table_digest` names the uploaded table and `dataset_digest` the prepared dataset among the blobs. `priority` is
    from -10 to 10; each step doubles the job's share of what its user has of the workers. `submitter` is who submitted
    it, by the name in the certificate (None: nobody proved it); others see it when it is `shared`. A `paused` job waits
    until it is resumed.
    """

    id: str
    name: str
    spec: str
    table_digest: str
    submitted: str
    state: str = "queued"
    reason: str | None = None
    dataset_digest: str | None = None
    elapsed: float = 0.0
    finished: str | None = None
    priority: int = 0
    ended_at: float = 0.0
    submitter: str | None = None
    shared: int = 0
    paused: int = 0

    @property
    def is_sound(self) -> bool:
        """Whether all has the types that it was written with: SQLite keeps whatever a damaged store holds."""
        texts = (self.id, self.name, self.spec, self.table_digest, self.submitted, self.state)
        return (
            all(isinstance(text, str) for text in texts)
            and isinstance(self.priority, int)
            and isinstance(self.elapsed, int | float)
        )


_COLUMNS: Final = tuple(field.name for field in fields(JobRecord))
_FIXED: Final = ("id", "spec", "table_digest", "submitted", "submitter")
_OPEN: Final = "state NOT IN ('done', 'failed', 'cancelled')"
_ENDED: Final = "state IN ('done', 'failed', 'cancelled')"
"""Word by word the conditions of the indices of `schema`, which are used for no other."""


def add(sql: sqlite3.Connection, job: JobRecord) -> bool:
    """Add a job; return False, changing nothing, when a job of this id is there already."""
    values = tuple(getattr(job, name) for name in _COLUMNS)
    marks = ", ".join("?" * len(_COLUMNS))
    done = sql.execute(f"INSERT OR IGNORE INTO jobs ({', '.join(_COLUMNS)}) VALUES ({marks})", values)
    return done.rowcount == 1


def find(sql: sqlite3.Connection, job: str) -> JobRecord | None:
    """Return one job; None for an unknown id."""
    row = sql.execute(f"SELECT {', '.join(_COLUMNS)} FROM jobs WHERE id = ?", (job,)).fetchone()
    return JobRecord(*row) if row else None


def read_open(sql: sqlite3.Connection) -> tuple[JobRecord, ...]:
    """Return the jobs that have not ended, in the order in which they came."""
    rows = sql.execute(f"SELECT {', '.join(_COLUMNS)} FROM jobs WHERE {_OPEN} ORDER BY number").fetchall()
    return tuple(JobRecord(*row) for row in rows)


def read_all(sql: sqlite3.Connection) -> tuple[JobRecord, ...]:
    """Return all jobs, in the order in which they came."""
    rows = sql.execute(f"SELECT {', '.join(_COLUMNS)} FROM jobs ORDER BY number").fetchall()
    return tuple(JobRecord(*row) for row in rows)


def page(
    sql: sqlite3.Connection, prefix: str, is_open: bool, before: int | None, limit: int
) -> tuple[tuple[int, str], ...]:
    """Return numbers and ids of the last jobs, the last first, that begin with `prefix` and came before `before`."""
    conditions: list[str] = []
    values: list[str | int] = []
    if prefix:
        conditions, values = ["id >= ? AND id < ?"], [prefix, prefix + _BEYOND]
    if is_open:
        conditions.append(_OPEN)
    if before is not None:
        conditions, values = [*conditions, "number < ?"], [*values, before]
    where = f"WHERE {' AND '.join(conditions)}" if conditions else ""
    return tuple(sql.execute(f"SELECT number, id FROM jobs {where} ORDER BY number DESC LIMIT ?", (*values, limit)))


def matches(sql: sqlite3.Connection, prefix: str) -> int:
    """Return how many ids begin with `prefix`."""
    (count,) = sql.execute("SELECT count(*) FROM jobs WHERE id >= ? AND id < ?", (prefix, prefix + _BEYOND)).fetchone()
    return cast(int, count)


_BEYOND: Final = "~"
"""Greater than every character of an id."""


def require(sql: sqlite3.Connection, job: str) -> None:
    """Raise LocalProtocolError when there is no such job."""
    if sql.execute("SELECT 1 FROM jobs WHERE id = ?", (job,)).fetchone() is None:
        raise LocalProtocolError(f"job {job} is not in the store")


def require_changeable(job: str, names: Collection[str]) -> None:
    """Raise LocalProtocolError unless all of these are fields that can change, and there is one."""
    wrong = [name for name in names if name not in _COLUMNS or name in _FIXED]
    if wrong or not names:
        raise LocalProtocolError(f"fields {wrong} of job {job} cannot be changed")


def update(sql: sqlite3.Connection, job: str, changes: Mapping[str, str | float | None]) -> None:
    """Change fields of a job that can change."""
    assignments = ", ".join(f"{name} = ?" for name in changes)
    sql.execute(f"UPDATE jobs SET {assignments} WHERE id = ?", (*changes.values(), job))


def end(
    sql: sqlite3.Connection, job: str, state: str, result: str | None, reason: str | None, finished: str | None
) -> bool:
    """Give a job its final `state` and `result`; return False, changing nothing, when it had ended before."""
    done = sql.execute(
        f"UPDATE jobs SET state = ?, result = ?, result_bytes = ?, reason = ?, finished = ? WHERE id = ? AND {_OPEN}",
        (state, result, len((result or "").encode()), reason, finished, job),
    )
    return done.rowcount == 1


def result(sql: sqlite3.Connection, job: str) -> str | None:
    """Return a job's result as JSON; None while there is none."""
    row = sql.execute("SELECT result FROM jobs WHERE id = ?", (job,)).fetchone()
    return cast(str | None, row[0]) if row else None


def keep_view(sql: sqlite3.Connection, job: str, view: str) -> None:
    """Keep what people are shown of a job that has ended, as JSON; without effect when there is no such job."""
    sql.execute("INSERT OR REPLACE INTO views SELECT id, ? FROM jobs WHERE id = ?", (view, job))


def views(sql: sqlite3.Connection, jobs: Iterable[str]) -> dict[str, str]:
    """Return what people are shown of those jobs of which it has been kept, as JSON, by id."""
    found = ((job, sql.execute("SELECT view FROM views WHERE job = ?", (job,)).fetchone()) for job in jobs)
    return {job: cast(str, row[0]) for job, row in found if row is not None}


def submitter(sql: sqlite3.Connection, job: str) -> str | None:
    """Return who submitted a job; None when nobody proved it."""
    row = sql.execute("SELECT submitter FROM jobs WHERE id = ?", (job,)).fetchone()
    return cast(str | None, row[0]) if row else None


def oldest_ended(sql: sqlite3.Connection) -> JobRecord | None:
    """Return the job that ended first of those that have ended; None when there is none."""
    row = sql.execute(
        f"SELECT {', '.join(_COLUMNS)} FROM jobs WHERE {_ENDED} "
        "ORDER BY ended_at, coalesce(finished, submitted), number LIMIT 1"
    ).fetchone()
    return JobRecord(*row) if row else None


def delete(sql: sqlite3.Connection, job: str) -> None:
    """Delete a job; its id is remembered, and given to no other job."""
    sql.execute("DELETE FROM views WHERE job = ?", (job,))
    sql.execute("DELETE FROM jobs WHERE id = ?", (job,))
    sql.execute("INSERT OR IGNORE INTO deleted_jobs (id) VALUES (?)", (job,))


def is_deleted(sql: sqlite3.Connection, job: str) -> bool:
    """Tell whether there was a job of this id that has been deleted."""
    return sql.execute("SELECT 1 FROM deleted_jobs WHERE id = ?", (job,)).fetchone() is not None
