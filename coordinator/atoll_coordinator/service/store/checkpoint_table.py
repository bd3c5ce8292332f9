"""The store's tables of checkpoints and their states. Every function is part of the caller's transaction."""

import sqlite3
from collections.abc import Mapping
from typing import Final

from atoll_core.wire.state_pieces import IslandState

MAX_FAILED: Final = 4
"""Of so many failed jobs, the last ones, the last checkpoints are kept."""


def add(
    sql: sqlite3.Connection, job: str, variable: str, epoch: int, progress: bytes, states: Mapping[int, IslandState]
) -> None:
    """Keep a checkpoint of an archipelago, and the one before it, but no older one."""
    archipelago = (job, variable)
    sql.execute("DELETE FROM checkpoints WHERE job = ? AND variable = ? AND epoch >= ?", (*archipelago, epoch))
    sql.execute("INSERT INTO checkpoints VALUES (?, ?, ?, ?)", (*archipelago, epoch, progress))
    rows = ((*archipelago, epoch, island, state.digest, state.data) for island, state in states.items())
    sql.executemany("INSERT INTO states VALUES (?, ?, ?, ?, ?, ?)", rows)
    sql.execute(
        "DELETE FROM checkpoints WHERE job = ? AND variable = ? AND epoch NOT IN "
        "(SELECT epoch FROM checkpoints WHERE job = ? AND variable = ? ORDER BY epoch DESC LIMIT 2)",
        (*archipelago, *archipelago),
    )


def last(sql: sqlite3.Connection, job: str) -> dict[str, tuple[int, bytes]]:
    """Return epoch and progress of the last checkpoint by variable."""
    rows = sql.execute(
        "SELECT variable, epoch, progress FROM checkpoints WHERE job = ? ORDER BY epoch", (job,)
    ).fetchall()
    return {variable: (epoch, progress) for variable, epoch, progress in rows}


def last_whole(sql: sqlite3.Connection, job: str, islands: int) -> dict[str, tuple[int, bytes]]:
    """Return epoch and progress of the last checkpoint by variable of which all states are there and undamaged."""
    rows = sql.execute(
        "SELECT variable, epoch, progress FROM checkpoints WHERE job = ? ORDER BY epoch DESC", (job,)
    ).fetchall()
    checkpoints: dict[str, tuple[int, bytes]] = {}
    for variable, epoch, progress in rows:
        if variable not in checkpoints and _is_whole(sql, job, variable, epoch, islands):
            checkpoints[variable] = (epoch, progress)
    return checkpoints


def _is_whole(sql: sqlite3.Connection, job: str, variable: str, epoch: int, islands: int) -> bool:
    try:
        return all(state(sql, job, variable, epoch, island).is_whole for island in range(islands))
    except KeyError:
        return False


def state(sql: sqlite3.Connection, job: str, variable: str, epoch: int, island: int) -> IslandState:
    """Return the state of an island at a checkpoint; raises KeyError when it is not there."""
    row = sql.execute(
        "SELECT data, digest FROM states WHERE job = ? AND variable = ? AND epoch = ? AND island = ?",
        (job, variable, epoch, island),
    ).fetchone()
    if row is None:
        raise KeyError(f"{job} {variable} {epoch} {island}")
    return IslandState(*row)


def keep_last(sql: sqlite3.Connection, job: str) -> None:
    """Keep the last checkpoint of each archipelago of a job that has failed, to be looked at; none of older such jobs.

    Of `MAX_FAILED` failed jobs at most something is kept.
    """
    sql.execute(
        "DELETE FROM checkpoints WHERE job = ? AND epoch < "
        "(SELECT max(epoch) FROM checkpoints AS later WHERE later.job = checkpoints.job "
        "AND later.variable = checkpoints.variable)",
        (job,),
    )
    sql.execute(
        "DELETE FROM checkpoints WHERE job IN (SELECT id FROM jobs WHERE state = 'failed' "
        "AND id IN (SELECT job FROM checkpoints) ORDER BY finished DESC, number DESC LIMIT -1 OFFSET ?)",
        (MAX_FAILED,),
    )


def forget(sql: sqlite3.Connection, job: str, variable: str | None = None) -> None:
    """Forget the checkpoints of an archipelago, or of all of a job (None)."""
    sql.execute("DELETE FROM checkpoints WHERE job = ? AND (? IS NULL OR variable = ?)", (job, variable, variable))
