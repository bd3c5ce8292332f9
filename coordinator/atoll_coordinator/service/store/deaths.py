"""The store's table of deaths that count as suspicion of poison. Every function is part of the caller's transaction."""

import sqlite3
from collections.abc import Sequence
from typing import NamedTuple


class Death(NamedTuple):
    """A worker process, by name and instance, died that had islands of an archipelago under that term."""

    job: str
    variable: str
    term: int
    worker: str
    instance: str


def add(sql: sqlite3.Connection, deaths: Sequence[Death]) -> None:
    """Keep deaths; what is kept already stays."""
    sql.executemany("INSERT OR IGNORE INTO deaths VALUES (?, ?, ?, ?, ?)", deaths)


def read(sql: sqlite3.Connection, job: str) -> tuple[Death, ...]:
    """Return the deaths that count for archipelagos of a job, by variable, then by term."""
    columns = "job, variable, term, worker, instance"
    rows = sql.execute(f"SELECT {columns} FROM deaths WHERE job = ? ORDER BY {columns}", (job,)).fetchall()
    return tuple(Death(*row) for row in rows)


def take_back(sql: sqlite3.Connection, worker: str, instance: str) -> None:
    """Forget the death of a process, which lives after all."""
    sql.execute("DELETE FROM deaths WHERE worker = ? AND instance = ?", (worker, instance))


def forget(sql: sqlite3.Connection, job: str, variable: str | None = None) -> None:
    """Forget what counts for an archipelago, or for all of a job (None)."""
    sql.execute("DELETE FROM deaths WHERE job = ? AND (? IS NULL OR variable = ?)", (job, variable, variable))
