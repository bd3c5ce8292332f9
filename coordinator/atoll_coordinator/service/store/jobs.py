"""The store's table of jobs, and the views of ended jobs.

Functions that take `sql` are part of the caller's transaction.
"""

import sqlite3
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Final

from atoll_coordinator.service.store.open_file import OpenFile, first_value
from atoll_coordinator.service.store.schema import ENDED, OPEN
from atoll_core.errors import LocalProtocolError
from atoll_core.wire.messages.views import FINAL_STATES


@dataclass(frozen=True, slots=True)
class JobRecord:
    """One stored job. `spec` is JSON; `submitted` and `finished` are ISO times; `elapsed` is in seconds.

    `table_digest`, `dataset_digest` and `prepared_digest` (kept until the job ends) name blobs: the uploaded table, the
    dataset of the search, and the rest of the prepared data. `priority` is from -10 to 10; each step doubles the job's
    share of the worker time of its user. `submitter` is the name in the certificate (None: there was none); other users
    see the job when it is `shared`. `submitted_s` and `ended_at` are seconds for which the store had been served when
    the job was submitted (None: by an earlier version) and ended.
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
        """Whether the fields have the right types: from a damaged file, SQLite returns values of any type."""
        texts = (self.id, self.name, self.spec, self.table_digest, self.submitted, self.state)
        return (
            all(isinstance(text, str) for text in texts)
            and isinstance(self.priority, int)
            and isinstance(self.elapsed, int | float)
        )


@dataclass(frozen=True, slots=True)
class Viewer:
    """A user who sees the jobs submitted under `name` and shared jobs, but no private jobs without a submitter."""

    name: str | None


_COLUMNS: Final = tuple(field.name for field in fields(JobRecord))
_SELECT: Final = f"SELECT {', '.join(_COLUMNS)} FROM jobs"
_FIXED: Final = (
    "id", "spec", "table_digest", "submitted", "submitter", "submitted_s", "dataset_digest", "prepared_digest"
)  # fmt: skip

_INDICES: Final = {
    ("all", "any"): "NOT INDEXED", ("all", "open"): "INDEXED BY open_jobs",
    ("all", "state"): "INDEXED BY jobs_by_state",
    ("own", "any"): "INDEXED BY jobs_by_submitter", ("own", "open"): "INDEXED BY open_jobs_by_submitter",
    ("own", "state"): "INDEXED BY jobs_by_submitter_and_state",
    ("shared", "any"): "INDEXED BY shared_jobs", ("shared", "open"): "INDEXED BY shared_open_jobs",
    ("shared", "state"): "INDEXED BY shared_jobs_by_state",
}  # fmt: skip
"""(Owner, selection) of a list of jobs -> index in the order of the list, so that only the listed rows are read."""

_WHOSE: Final = {"all": "TRUE", "own": "submitter = :name", "shared": "shared"}
_WHICH: Final = {"any": "TRUE", "open": OPEN, "state": "state = :state"}
_SEEN: Final = "(submitter = ? OR shared)"

MAX_COUNTED: Final = 1000
"""Jobs are counted up to this number."""

_BEYOND: Final = "~"
"""Greater than every character of an id."""


class JobStore(OpenFile):
    """The part of the store that holds jobs. Every method is one transaction."""

    def job(self, job: str) -> JobRecord | None:
        """Return one job; None for an unknown id."""
        with self._reading() as sql:
            return find(sql, job)

    def jobs(self) -> tuple[JobRecord, ...]:
        """Return all jobs, in the order of submission."""
        return tuple(JobRecord(*row) for row in self._rows(f"{_SELECT} ORDER BY number"))

    def open_jobs(self) -> tuple[JobRecord, ...]:
        """Return the jobs that have not ended, in the order of submission."""
        return tuple(JobRecord(*row) for row in self._rows(f"{_SELECT} WHERE {OPEN} ORDER BY number"))

    def job_page(
        self, prefix: str = "", *, is_open: bool = False, before: int | None = None, limit: int = 1,
        viewer: Viewer | None = None, state: str | None = None,
    ) -> tuple[tuple[int, str], ...]:  # fmt: skip
        """Return numbers and ids of the last submitted jobs, newest first; see `wire.messages.clients.ListJobs`.

        `is_open` leaves out ended jobs, `state` jobs in other states, `viewer` (None: all jobs) jobs that are not
        visible.
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
        with self._reading() as sql:
            return tuple(sql.execute(f"{' UNION '.join(parts)} ORDER BY number DESC LIMIT :limit", values))

    def count_jobs(self, prefix: str, viewer: Viewer | None = None) -> int:
        """Return the number, up to `MAX_COUNTED`, of jobs that the viewer sees and whose ids begin with `prefix`."""
        parts = [
            f"SELECT * FROM (SELECT id FROM jobs WHERE {_WHOSE[whose]} AND id >= :prefix AND id < :beyond LIMIT :most)"
            for whose in (("all",) if viewer is None else ("own", "shared"))
        ]
        values = {
            "prefix": prefix, "beyond": prefix + _BEYOND, "most": MAX_COUNTED,
            "name": viewer.name if viewer is not None else None,
        }  # fmt: skip
        with self._reading() as sql:
            (count,) = sql.execute(f"SELECT count(*) FROM ({' UNION '.join(parts)} LIMIT :most)", values).fetchone()
        return int(count)

    def is_seen(self, job: str, viewer: Viewer) -> bool:
        """Return whether there is a job of this id that the viewer sees."""
        return self._value(f"SELECT 1 FROM jobs WHERE id = ? AND {_SEEN}", job, viewer.name) is not None

    def uses_table(self, digest: str, viewer: Viewer) -> bool:
        """Return whether a job that the viewer sees uses a table."""
        query = f"SELECT 1 FROM jobs WHERE table_digest = ? AND {_SEEN} LIMIT 1"
        return self._value(query, digest, viewer.name) is not None

    def uses_table_of(self, digest: str, submitter: str | None) -> bool:
        """Return whether a job of this user uses a table; a table counts once for all jobs of a user."""
        query = "SELECT 1 FROM jobs WHERE table_digest = ? AND submitter IS ? LIMIT 1"
        return self._value(query, digest, submitter) is not None

    def submitter(self, job: str) -> str | None:
        """Return the user who submitted a job; None without a certificate."""
        submitter: str | None = self._value("SELECT submitter FROM jobs WHERE id = ?", job)
        return submitter

    def update_job(self, job: str, **changes: str | float | None) -> None:
        """Change fields of a job; raises LocalProtocolError for an unknown job and for a field that cannot change."""
        wrong = [name for name in changes if name not in _COLUMNS or name in _FIXED]
        if wrong or not changes:
            raise LocalProtocolError(f"fields {wrong} of job {job} cannot be changed")
        with self._transaction() as sql:
            require(sql, job)
            update(sql, job, changes)

    def result(self, job: str) -> str | None:
        """Return a job's result as JSON; None without a result."""
        result: str | None = self._value("SELECT result FROM jobs WHERE id = ?", job)
        return result

    def keep_views(self, views: Mapping[str, str]) -> None:
        """Store the views (JSON) of ended jobs by id; unknown ids are ignored."""
        with self._transaction() as sql:
            for job, view in views.items():
                keep_view(sql, job, view)

    def views(self, jobs: Iterable[str]) -> dict[str, str]:
        """Return the stored views (JSON) of ended jobs, by id."""
        with self._reading() as sql:
            found = {job: first_value(sql, "SELECT view FROM views WHERE job = ?", job) for job in jobs}
        return {job: view for job, view in found.items() if view is not None}

    def oldest_ended_job(self, of: Viewer | None = None) -> JobRecord | None:
        """Return the job that ended first, of all jobs or of one user's jobs; None: no job has ended."""
        with self._reading() as sql:
            return oldest_ended(sql, of)

    def is_deleted(self, job: str) -> bool:
        """Return whether a job of this id has been deleted."""
        return self._value("SELECT 1 FROM deleted_jobs WHERE id = ?", job) is not None


def add(sql: sqlite3.Connection, job: JobRecord) -> bool:
    """Add a job; return False, changing nothing, when there is a job of this id."""
    values = tuple(getattr(job, name) for name in _COLUMNS)
    marks = ", ".join("?" * len(_COLUMNS))
    done = sql.execute(f"INSERT OR IGNORE INTO jobs ({', '.join(_COLUMNS)}) VALUES ({marks})", values)
    return done.rowcount == 1


def find(sql: sqlite3.Connection, job: str) -> JobRecord | None:
    """Return one job; None for an unknown id."""
    row = sql.execute(f"{_SELECT} WHERE id = ?", (job,)).fetchone()
    return JobRecord(*row) if row else None


def require(sql: sqlite3.Connection, job: str) -> JobRecord:
    """Return one job; raises LocalProtocolError for an unknown id."""
    record = find(sql, job)
    if record is None:
        raise LocalProtocolError(f"job {job} is not in the store")
    return record


def update(sql: sqlite3.Connection, job: str, changes: Mapping[str, str | float | None]) -> None:
    """Change fields of a job."""
    assignments = ", ".join(f"{name} = ?" for name in changes)
    sql.execute(f"UPDATE jobs SET {assignments} WHERE id = ?", (*changes.values(), job))


def end(
    sql: sqlite3.Connection, job: str, state: str, result: str | None, reason: str | None, finished: str | None
) -> bool:
    """Give a job its final `state` and `result`; return False, changing nothing, when it had ended before.

    The prepared data are no longer needed, so the job no longer names them.
    """
    done = sql.execute(
        "UPDATE jobs SET state = ?, result = ?, result_bytes = ?, reason = ?, finished = ?, prepared_digest = NULL "
        f"WHERE id = ? AND {OPEN}",
        (state, result, len((result or "").encode()), reason, finished, job),
    )
    return done.rowcount == 1


def keep_view(sql: sqlite3.Connection, job: str, view: str) -> None:
    """Store the view (JSON) of an ended job; without effect for an unknown job."""
    sql.execute("INSERT OR REPLACE INTO views SELECT id, ? FROM jobs WHERE id = ?", (view, job))


def oldest_ended(sql: sqlite3.Connection, viewer: Viewer | None = None) -> JobRecord | None:
    """Return the job that ended first, of all jobs or of one user's jobs; None: no job has ended."""
    own, name = ("AND submitter IS ? ", (viewer.name,)) if viewer is not None else ("", ())
    index = "ended_jobs_by_submitter" if viewer is not None else "ended_jobs"
    row = sql.execute(
        f"SELECT {', '.join(_COLUMNS)} FROM jobs INDEXED BY {index} WHERE {ENDED} {own}"
        "ORDER BY ended_at, coalesce(finished, submitted), number LIMIT 1",
        name,
    ).fetchone()
    return JobRecord(*row) if row else None


def delete(sql: sqlite3.Connection, job: str) -> None:
    """Delete a job; its id is remembered, so that no other job gets it."""
    sql.execute("DELETE FROM views WHERE job = ?", (job,))
    sql.execute("DELETE FROM jobs WHERE id = ?", (job,))
    sql.execute("INSERT OR IGNORE INTO deleted_jobs (id) VALUES (?)", (job,))
