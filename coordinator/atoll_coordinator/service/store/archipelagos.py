"""The store's table of archipelagos: terms, placements, cuts. Every function is part of the caller's transaction."""

import sqlite3
from typing import cast

from atoll_coordinator.service.store import jobs as job_table


def ensure(sql: sqlite3.Connection, job: str, variable: str) -> None:
    """Add an archipelago unless it is there; raises LocalProtocolError when its job is not."""
    job_table.require(sql, job)
    sql.execute("INSERT OR IGNORE INTO archipelagos (job, variable) VALUES (?, ?)", (job, variable))


def raise_term(sql: sqlite3.Connection, job: str, variable: str) -> int:
    """Return the next term of an archipelago, 1 at first."""
    ensure(sql, job, variable)
    row = sql.execute(
        "UPDATE archipelagos SET term = term + 1 WHERE job = ? AND variable = ? RETURNING term", (job, variable)
    ).fetchall()
    return cast(int, row[0][0])


def place(sql: sqlite3.Connection, job: str, variable: str, placement: bytes) -> None:
    """Keep the placement of the archipelago's current term."""
    sql.execute("UPDATE archipelagos SET placement = ? WHERE job = ? AND variable = ?", (placement, job, variable))


def cut(sql: sqlite3.Connection, job: str, variable: str, contents: bytes) -> bool:
    """Keep the end of an archipelago; return False, changing nothing, when it had one before."""
    ensure(sql, job, variable)
    done = sql.execute(
        "UPDATE archipelagos SET cut = ? WHERE job = ? AND variable = ? AND cut IS NULL", (contents, job, variable)
    )
    return done.rowcount == 1


def cuts(sql: sqlite3.Connection, job: str) -> dict[str, bytes]:
    """Return the cuts by variable."""
    rows = sql.execute("SELECT variable, cut FROM archipelagos WHERE job = ? AND cut IS NOT NULL", (job,)).fetchall()
    return dict(rows)


def has_ended(sql: sqlite3.Connection, job: str, variable: str) -> bool:
    """Tell whether an archipelago is cut, or its job has ended."""
    ensure(sql, job, variable)
    row = sql.execute(
        "SELECT cut IS NOT NULL OR state IN ('done', 'failed', 'cancelled') FROM archipelagos JOIN jobs "
        "ON jobs.id = job WHERE job = ? AND variable = ?",
        (job, variable),
    ).fetchone()
    return bool(row[0])


def delete(sql: sqlite3.Connection, job: str) -> None:
    """Delete the archipelagos of a job."""
    sql.execute("DELETE FROM archipelagos WHERE job = ?", (job,))
