"""The store's tables of what is held for whom: bytes of each user's jobs, kept as they change, so that nobody adds up.

A blob counts once for a user, however many jobs use it, and once for all users together (`ALL`). It is *live* while a
job uses it that has not ended, and *freeable* when only ended jobs do: these can be deleted. Every function is part of
the caller's transaction.
"""

import sqlite3
from dataclasses import dataclass
from typing import Final, Literal

ALL: Final = "*"
"""Owner of what all users hold together; no name in a certificate."""

Kind = Literal["table", "made"]
"""What a blob is: a table that was uploaded, which counts in what its user may store, or what was made of one."""


@dataclass(frozen=True, slots=True)
class Held:
    """Bytes that are held for a user, or for all together.

    `stored` are those of tables and results, which limits count; `live` those of blobs of jobs that have not ended;
    `freeable` those of blobs that only ended jobs use, and of results.
    """

    stored: int = 0
    live: int = 0
    freeable: int = 0


def read(sql: sqlite3.Connection, owner: str | None) -> Held:
    """Return what is held for a user (None: for nobody in particular) or for `ALL`."""
    row = sql.execute(
        "SELECT tables + results, live, freeable + results FROM holdings WHERE owner = ?", (owner or "",)
    ).fetchone()
    return Held(*row) if row is not None else Held()


def most_freeable(sql: sqlite3.Connection) -> str | None:
    """Return the user for whom most is held that can be freed, "" for nobody in particular; None: nothing can."""
    row = sql.execute(
        "SELECT owner FROM holdings WHERE owner <> ? AND freeable + results > 0 "
        "ORDER BY freeable + results DESC, owner LIMIT 1",
        (ALL,),
    ).fetchone()
    return row[0] if row is not None else None


def owners(sql: sqlite3.Connection) -> int:
    """Return for how many users something is held."""
    (number,) = sql.execute("SELECT count(*) FROM holdings WHERE owner <> ?", (ALL,)).fetchone()
    return int(number)


def use(sql: sqlite3.Connection, owner: str | None, digest: str, kind: Kind, *, live: int = 0, ended: int = 0) -> None:
    """Take in how many jobs more, or fewer, of a user use a blob: those that have not ended, and those that have."""
    for whose in (owner or "", ALL):
        row = sql.execute("SELECT size, live, ended FROM uses WHERE owner = ? AND digest = ? AND kind = ?",
                          (whose, digest, kind)).fetchone()  # fmt: skip
        size, was_live, was_ended = row or (_size(sql, digest), 0, 0)
        now_live, now_ended = was_live + live, was_ended + ended
        if now_live or now_ended:
            sql.execute("INSERT OR REPLACE INTO uses VALUES (?, ?, ?, ?, ?, ?)",
                        (whose, digest, kind, size, now_live, now_ended))  # fmt: skip
        else:
            sql.execute("DELETE FROM uses WHERE owner = ? AND digest = ? AND kind = ?", (whose, digest, kind))
        counted = kind == "table"
        _add(
            sql, whose,
            tables=size * counted * (bool(now_live or now_ended) - bool(was_live or was_ended)),
            live=size * (bool(now_live) - bool(was_live)),
            freeable=size * ((not now_live and now_ended > 0) - (not was_live and was_ended > 0)),
        )  # fmt: skip


def add_result(sql: sqlite3.Connection, owner: str | None, size: int) -> None:
    """Take in that the results of a user have so many bytes more, or fewer."""
    for whose in (owner or "", ALL):
        _add(sql, whose, results=size)


def _size(sql: sqlite3.Connection, digest: str) -> int:
    row = sql.execute("SELECT size FROM blobs WHERE digest = ?", (digest,)).fetchone()
    return int(row[0]) if row is not None else 0


def _add(
    sql: sqlite3.Connection, owner: str, *, tables: int = 0, results: int = 0, live: int = 0, freeable: int = 0
) -> None:  # fmt: skip
    changes = (tables, results, live, freeable)
    if not any(changes):
        return
    sql.execute(
        "INSERT INTO holdings VALUES (?, ?, ?, ?, ?) ON CONFLICT DO UPDATE SET tables = tables + excluded.tables, "
        "results = results + excluded.results, live = live + excluded.live, freeable = freeable + excluded.freeable",
        (owner, *changes),
    )
    sql.execute("DELETE FROM holdings WHERE owner = ? AND NOT (tables OR results OR live OR freeable)", (owner,))
