"""The store's table of jobs, and what of them is whose. Every function is part of the caller's transaction."""

import sqlite3
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Final, cast

from atoll_core.errors import LocalProtocolError
from atoll_core.wire.messages.views import FINAL_STATES


@dataclass(frozen=True, slots=True)
class JobRecord:
    """One job as it is kept. `spec` is JSON; `submitted` and `finished` are ISO times; `elapsed` is seconds of work.
    `ended_at` is how many seconds the store had been served when it ended.

    `table_digest` names the uploaded table and `dataset_digest` the prepared dataset among the blobs. `priority` is
    from -10 to 10; each step doubles the job's share of what its user has of the workers. `submitter` is who submitted
    it, by the name in the certificate (None: nobody proved it); others see it when it is `shared`. A `paused` job waits
    until it is resumed. `prepared_digest` names among the blobs what preparing gave beside the dataset, until the job
    ends; `submitted_s` is how many seconds the store had been served when it came (None: an earlier version took it).
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
    prepared_digest: str | None = None
    submitted_s: float | None = None

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
_FIXED: Final = (
    "id", "spec", "table_digest", "submitted", "submitter", "submitted_s", "dataset_digest", "prepared_digest"
)  # fmt: skip
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


@dataclass(frozen=True, slots=True)
class Viewer:
    """Who looks at jobs: sees those of `name` and shared ones.

    What nobody proved to have submitted, before there was a roster, is seen by those alone who see all.
    """

    name: str | None

    @property
    def condition(self) -> str:
        """What holds of a row of jobs that is seen, with the name as its value."""
        return "(submitter = ? OR shared)"


_INDICES: Final = {
    ("all", "any"): "NOT INDEXED", ("all", "open"): "INDEXED BY open_jobs",
    ("all", "state"): "INDEXED BY jobs_by_state",
    ("own", "any"): "INDEXED BY jobs_by_submitter", ("own", "open"): "INDEXED BY open_jobs_by_submitter",
    ("own", "state"): "INDEXED BY jobs_by_submitter_and_state",
    ("shared", "any"): "INDEXED BY shared_jobs", ("shared", "open"): "INDEXED BY shared_open_jobs",
    ("shared", "state"): "INDEXED BY shared_jobs_by_state",
}  # fmt: skip
"""Whose jobs and which -> the index that has them in order: no row is read that is not answered."""

_WHOSE: Final = {"all": "TRUE", "own": "submitter = :name", "shared": "shared"}
_WHICH: Final = {"any": "TRUE", "open": _OPEN, "state": "state = :state"}


def page(  # noqa: PLR0913  # what a list is asked for by
    sql: sqlite3.Connection, prefix: str, is_open: bool, before: int | None, limit: int, viewer: Viewer | None = None,
    state: str | None = None,
) -> tuple[tuple[int, str], ...]:  # fmt: skip
    """Return numbers and ids of the last jobs, the last first, that begin with `prefix` and came before `before`.

    `is_open` leaves out those that have ended, `state` all that are in another one, `viewer` (None: sees all) what it
    does not see.
    """
    if is_open and state in FINAL_STATES:
        return ()
    which = "state" if state is not None else "open" if is_open else "any"
    further = ("AND number < :before " if before is not None else "") + (
        "AND id >= :prefix AND id < :beyond " if prefix else ""
    )
    parts = [
        f"SELECT * FROM (SELECT number, id FROM jobs {'' if prefix else _INDICES[whose, which]} "
        f"WHERE {_WHOSE[whose]} AND {_WHICH[which]} {further}ORDER BY number DESC LIMIT :limit)"
        for whose in (("all",) if viewer is None else ("own", "shared"))
    ]
    values = {
        "prefix": prefix, "beyond": prefix + _BEYOND, "before": before, "limit": limit, "state": state,
        "name": viewer.name if viewer is not None else None,
    }  # fmt: skip
    return tuple(sql.execute(f"{' UNION '.join(parts)} ORDER BY number DESC LIMIT :limit", values))


MAX_COUNTED: Final = 1000
"""Of so many jobs it is counted how many there are; more are more."""


def matches(sql: sqlite3.Connection, prefix: str, viewer: Viewer | None = None) -> int:
    """Return how many ids begin with `prefix`, of jobs that the viewer sees; at most `MAX_COUNTED`."""
    parts = [
        f"SELECT * FROM (SELECT id FROM jobs WHERE {_WHOSE[whose]} AND id >= :prefix AND id < :beyond LIMIT :most)"
        for whose in (("all",) if viewer is None else ("own", "shared"))
    ]
    values = {
        "prefix": prefix, "beyond": prefix + _BEYOND, "most": MAX_COUNTED,
        "name": viewer.name if viewer is not None else None,
    }  # fmt: skip
    (count,) = sql.execute(f"SELECT count(*) FROM ({' UNION '.join(parts)} LIMIT :most)", values).fetchone()
    return cast(int, count)


def is_seen(sql: sqlite3.Connection, job: str, viewer: Viewer) -> bool:
    """Tell whether there is a job of this id that the viewer sees."""
    query = f"SELECT 1 FROM jobs WHERE id = ? AND {viewer.condition}"
    return sql.execute(query, (job, viewer.name)).fetchone() is not None


def uses_table(sql: sqlite3.Connection, digest: str, viewer: Viewer) -> bool:
    """Tell whether a job that the viewer sees uses a table."""
    query = f"SELECT 1 FROM jobs WHERE table_digest = ? AND {viewer.condition} LIMIT 1"
    return sql.execute(query, (digest, viewer.name)).fetchone() is not None


_BEYOND: Final = "~"
"""Greater than every character of an id."""


def require(sql: sqlite3.Connection, job: str) -> JobRecord:
    """Return one job; raises LocalProtocolError when there is none of this id."""
    record = find(sql, job)
    if record is None:
        raise LocalProtocolError(f"job {job} is not in the store")
    return record


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
    """Give a job its final `state` and `result`; return False, changing nothing, when it had ended before.

    What preparing gave is not needed any more, and named no longer.
    """
    done = sql.execute(
        "UPDATE jobs SET state = ?, result = ?, result_bytes = ?, reason = ?, finished = ?, prepared_digest = NULL "
        f"WHERE id = ? AND {_OPEN}",
        (state, result, size_of(result), reason, finished, job),
    )
    return done.rowcount == 1


def size_of(result: str | None) -> int:
    """Return how many bytes a result takes."""
    return len((result or "").encode())


def result_bytes(sql: sqlite3.Connection, job: str) -> int:
    """Return how many bytes the result of a job takes."""
    row = sql.execute("SELECT result_bytes FROM jobs WHERE id = ?", (job,)).fetchone()
    return int(row[0]) if row else 0


def result(sql: sqlite3.Connection, job: str) -> str | None:
    """Return a job's result as JSON; None while there is none."""
    row = sql.execute("SELECT result FROM jobs WHERE id = ?", (job,)).fetchone()
    return cast(str | None, row[0]) if row else None


def keep_view(sql: sqlite3.Connection, job: str, view: str) -> None:
    """Keep what people are shown of a job that has ended, as JSON; without effect when there is no such job."""
    sql.execute("INSERT OR REPLACE INTO views SELECT id, ? FROM jobs WHERE id = ?", (view, job))


def share_view(sql: sqlite3.Connection, job: str, is_shared: bool) -> None:
    """Have what is kept of a job to be shown say whether it is shared."""
    sql.execute(
        "UPDATE views SET view = json_set(view, '$.shared', json(?)) WHERE job = ? AND json_valid(view)",
        ("true" if is_shared else "false", job),
    )


def views(sql: sqlite3.Connection, jobs: Iterable[str]) -> dict[str, str]:
    """Return what people are shown of those jobs of which it has been kept, as JSON, by id."""
    found = ((job, sql.execute("SELECT view FROM views WHERE job = ?", (job,)).fetchone()) for job in jobs)
    return {job: cast(str, row[0]) for job, row in found if row is not None}


def submitter(sql: sqlite3.Connection, job: str) -> str | None:
    """Return who submitted a job; None when nobody proved it."""
    row = sql.execute("SELECT submitter FROM jobs WHERE id = ?", (job,)).fetchone()
    return cast(str | None, row[0]) if row else None


def uses_table_of(sql: sqlite3.Connection, digest: str, submitter: str | None) -> bool:
    """Tell whether a job of this user uses a table."""
    query = "SELECT 1 FROM jobs WHERE table_digest = ? AND submitter IS ? LIMIT 1"
    return sql.execute(query, (digest, submitter)).fetchone() is not None


def oldest_ended(sql: sqlite3.Connection, viewer: Viewer | None = None) -> JobRecord | None:
    """Return the job that ended first of those that have ended, of all or of a user's own; None: there is none."""
    own, name = ("AND submitter IS ? ", (viewer.name,)) if viewer is not None else ("", ())
    index = "ended_jobs_by_submitter" if viewer is not None else "ended_jobs"
    row = sql.execute(
        f"SELECT {', '.join(_COLUMNS)} FROM jobs INDEXED BY {index} WHERE {_ENDED} {own}"
        "ORDER BY ended_at, coalesce(finished, submitted), number LIMIT 1",
        name,
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
