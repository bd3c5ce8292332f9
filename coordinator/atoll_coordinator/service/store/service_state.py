"""The store's tables of what admins set and users used up. Every function is part of the caller's transaction."""

import sqlite3
from collections.abc import Mapping
from typing import cast


def is_queue_paused(sql: sqlite3.Connection) -> bool:
    """Tell whether no job is to be taken up."""
    return bool(sql.execute("SELECT queue_paused FROM realm").fetchone()[0])


def pause_queue(sql: sqlite3.Connection, is_paused: bool) -> None:
    """Keep whether jobs are to be taken up."""
    sql.execute("UPDATE realm SET queue_paused = ?", (int(is_paused),))


def cordons(sql: sqlite3.Connection) -> dict[str, bool]:
    """Return the workers that are given no more islands, and whether they hand over those that they have."""
    return {worker: bool(is_draining) for worker, is_draining in sql.execute("SELECT worker, is_draining FROM cordons")}


def cordon(sql: sqlite3.Connection, worker: str, is_draining: bool | None) -> None:
    """Keep that a worker is cordoned, and perhaps drained; None: that it is neither any more."""
    sql.execute("DELETE FROM cordons WHERE worker = ?", (worker,))
    if is_draining is not None:
        sql.execute("INSERT INTO cordons VALUES (?, ?)", (worker, int(is_draining)))


def add_usage(sql: sqlite3.Connection, day: int, seconds: Mapping[str | None, float]) -> None:
    """Add task time to what users have used on a day; that of days before the one before is forgotten."""
    sql.executemany(
        "INSERT INTO usage VALUES (?, ?, ?) ON CONFLICT DO UPDATE SET seconds = seconds + excluded.seconds",
        [(user or "", day, spent) for user, spent in seconds.items()],
    )
    sql.execute("DELETE FROM usage WHERE day < ?", (day - 1,))


def usage(sql: sqlite3.Connection, day: int) -> dict[str | None, float]:
    """Return the seconds of task time that users have used on a day."""
    rows = sql.execute("SELECT submitter, seconds FROM usage WHERE day = ?", (day,)).fetchall()
    return {user or None: cast(float, seconds) for user, seconds in rows}
