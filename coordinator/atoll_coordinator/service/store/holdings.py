"""The store's tables of held bytes: the bytes of each user's jobs. They are updated with every change of jobs.

A blob counts once for a user, for any number of jobs, and once for all users together (`ALL`). It is *live* for a user
while an unfinished job of this user uses it. It is *freeable* for a user whose ended jobs use it, if no unfinished job
of any user uses it: in this case, deleting ended jobs frees its bytes. Functions that take `sql` are part of the
caller's transaction.
"""

import sqlite3
from dataclasses import dataclass
from typing import Final, Literal

from atoll_coordinator.service.store.open_file import OpenFile, first_value

ALL: Final = "*"
"""Owner of the sums over all users; no certificate can have this name."""

Kind = Literal["table", "made"]
"""An uploaded table, which counts towards a user's limit, or data prepared from a table."""


@dataclass(frozen=True, slots=True)
class Held:
    """Bytes that are held for a user, or for all users together.

    `stored`: tables and results, to which limits apply; `live`: blobs of jobs that have not ended; `freeable`: results,
    and blobs that only ended jobs use.
    """

    stored: int = 0
    live: int = 0
    freeable: int = 0


class HoldingStore(OpenFile):
    """The part of the store that counts the bytes held for each user. Every method is one transaction."""

    def held(self, owner: str | None) -> Held:
        """Return the bytes held for a user (None: for jobs without a submitter) or for `ALL` users together."""
        query = "SELECT tables + results, live, freeable + results FROM holdings WHERE owner = ?"
        rows = self._rows(query, owner or "")
        return Held(*rows[0]) if rows else Held()

    def count_holders(self) -> int:
        """Return the number of users with held bytes."""
        return int(self._value("SELECT count(*) FROM holdings WHERE owner <> ?", ALL))


def most_freeable(sql: sqlite3.Connection) -> str | None:
    """Return the user with the most freeable bytes, "" for jobs without a submitter; None: nothing is freeable."""
    owner: str | None = first_value(
        sql,
        "SELECT owner FROM holdings WHERE owner <> ? AND freeable + results > 0 "
        "ORDER BY freeable + results DESC, owner LIMIT 1",
        ALL,
    )
    return owner


def use(sql: sqlite3.Connection, owner: str | None, digest: str, kind: Kind, *, live: int = 0, ended: int = 0) -> None:
    """Change the numbers of jobs of a user that use a blob: `live` jobs, which have not ended, and `ended` jobs."""
    owners = (owner or "", ALL)
    _count_freeable(sql, digest, kind, -1)
    for whose in owners:
        key = (whose, digest, kind)
        row = sql.execute(
            "SELECT size, live, ended FROM uses WHERE owner = ? AND digest = ? AND kind = ?", key
        ).fetchone()
        size, was_live, was_ended = row or (
            int(first_value(sql, "SELECT size FROM blobs WHERE digest = ?", digest) or 0), 0, 0
        )  # fmt: skip
        now_live, now_ended = was_live + live, was_ended + ended
        if now_live or now_ended:
            sql.execute("INSERT OR REPLACE INTO uses VALUES (?, ?, ?, ?, ?, ?)", (*key, size, now_live, now_ended))
        else:
            sql.execute("DELETE FROM uses WHERE owner = ? AND digest = ? AND kind = ?", key)
        is_used, was_used = bool(now_live or now_ended), bool(was_live or was_ended)
        tables = size * (is_used - was_used) if kind == "table" else 0
        _add(sql, whose, tables=tables, live=size * (bool(now_live) - bool(was_live)))
    _count_freeable(sql, digest, kind, 1)
    _forget_empty(sql, owners)


def add_result(sql: sqlite3.Connection, owner: str | None, size: int) -> None:
    """Add bytes to the results of a user; a negative `size` subtracts."""
    owners = (owner or "", ALL)
    for whose in owners:
        _add(sql, whose, results=size)
    _forget_empty(sql, owners)


def _count_freeable(sql: sqlite3.Connection, digest: str, kind: Kind, sign: int) -> None:
    """Add a blob to the freeable bytes of all users whose ended jobs use it, if no live job uses it.

    With `sign` -1 the blob is subtracted. The cost grows with the number of users of the same blob.
    """
    sql.execute(
        "INSERT INTO holdings SELECT owner, 0, 0, 0, ? * size FROM uses WHERE digest = ? AND kind = ? AND ended > 0 "
        "AND NOT EXISTS (SELECT 1 FROM uses WHERE owner = ? AND digest = ? AND kind = ? AND live > 0) "
        "ON CONFLICT DO UPDATE SET freeable = freeable + excluded.freeable",
        (sign, digest, kind, ALL, digest, kind),
    )


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
