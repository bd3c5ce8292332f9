"""The store's tables of what is held for whom: bytes of each user's jobs, kept as they change, so that nobody adds up.

A blob counts once for a user, however many jobs use it, and once for all users together (`ALL`). It is *live* for a
user while a job of the user uses it that has not ended. It is *freeable* for all users whose ended jobs use it when no
job that has not ended does, whoever submitted that: only then deleting ended jobs frees it. Every function is part of
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
    `freeable` those that deleting ended jobs frees: of blobs that only ended jobs use, of any user, and of results.
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
    owners = (owner or "", ALL)
    _count_freeable(sql, digest, kind, -1)
    for whose in owners:
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
        )  # fmt: skip
    _count_freeable(sql, digest, kind, 1)
    _forget_empty(sql, owners)


def add_result(sql: sqlite3.Connection, owner: str | None, size: int) -> None:
    """Take in that the results of a user have so many bytes more, or fewer."""
    owners = (owner or "", ALL)
    for whose in owners:
        _add(sql, whose, results=size)
    _forget_empty(sql, owners)


def _count_freeable(sql: sqlite3.Connection, digest: str, kind: Kind, sign: int) -> None:
    """Add a blob to what is freeable of all whose ended jobs use it, or (-1) take it from there: as its uses are now.

    It costs as much as users use the same blob.
    """
    sql.execute(
        "INSERT INTO holdings SELECT owner, 0, 0, 0, ? * size FROM uses WHERE digest = ? AND kind = ? AND ended > 0 "
        "AND NOT EXISTS (SELECT 1 FROM uses WHERE owner = ? AND digest = ? AND kind = ? AND live > 0) "
        "ON CONFLICT DO UPDATE SET freeable = freeable + excluded.freeable",
        (sign, digest, kind, ALL, digest, kind),
    )


def _size(sql: sqlite3.Connection, digest: str) -> int:
    row = sql.execute("SELECT size FROM blobs WHERE digest = ?", (digest,)).fetchone()
    return int(row[0]) if row is not None else 0


def _add(sql: sqlite3.Connection, owner: str, *, tables: int = 0, results: int = 0, live: int = 0) -> None:
    changes = (tables, results, live)
    if any(changes):
        sql.execute(
            "INSERT INTO holdings VALUES (?, ?, ?, ?, 0) ON CONFLICT DO UPDATE SET tables = tables + excluded.tables, "
            "results = results + excluded.results, live = live + excluded.live",
            (owner, *changes),
        )


def _forget_empty(sql: sqlite3.Connection, owners: tuple[str, str]) -> None:
    sql.execute("DELETE FROM holdings WHERE owner IN (?, ?) AND NOT (tables OR results OR live OR freeable)", owners)
