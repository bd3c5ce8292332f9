"""The store's tables of searches: checkpoints with states, archipelagos (terms, placements, cuts), and worker deaths.

Functions that take `sql` are part of the caller's transaction.
"""

import contextlib
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

from atoll_coordinator.service.store.jobs import JobStore, find, require, update
from atoll_coordinator.service.store.open_file import first_value
from atoll_coordinator.service.store.schema import ENDED
from atoll_core.wire.state_pieces import IslandState

MAX_FAILED: Final = 4
"""Number of the latest failed jobs whose last checkpoints are kept for examination."""


class Death(NamedTuple):
    """A worker process, by name and instance, died while it had islands of an archipelago under this term."""

    job: str
    variable: str
    term: int
    worker: str
    instance: str


class CheckpointStore(JobStore):
    """The part of the store that holds checkpoints, placements and cuts. Every method is one transaction."""

    def begin_terms(self, archipelagos: Sequence[tuple[str, str]], place: Callable[[int, int], bytes]) -> None:
        """Raise the terms of archipelagos and store their placements, all in one transaction.

        Args:
            archipelagos: The archipelagos, each as a job and a variable.
            place: Returns the placement of archipelago number `index` under its new `term`.
        """
        with self._transaction() as sql:
            for index, key in enumerate(archipelagos):
                _ensure_archipelago(sql, *key)
                raised = "UPDATE archipelagos SET term = term + 1 WHERE job = ? AND variable = ? RETURNING term"
                ((term,),) = sql.execute(raised, key).fetchall()
                placement = place(index, term)
                sql.execute("UPDATE archipelagos SET placement = ? WHERE job = ? AND variable = ?", (placement, *key))

    def commit_cuts(self, job: str, cuts: Mapping[str, bytes]) -> bool:
        """Store the ends of archipelagos, by variable.

        Return False if one of the archipelagos had ended before. Its first end stays; the other ends are stored.
        """
        with self._transaction() as sql:
            are_first = []
            for variable, cut in cuts.items():
                _ensure_archipelago(sql, job, variable)
                query = "UPDATE archipelagos SET cut = ? WHERE job = ? AND variable = ? AND cut IS NULL"
                are_first.append(sql.execute(query, (cut, job, variable)).rowcount == 1)
                forget_checkpoints(sql, job, variable)
                forget_deaths(sql, job, variable)
            return all(are_first)

    def cuts(self, job: str) -> dict[str, bytes]:
        """Return the stored cuts by variable."""
        return dict(self._rows("SELECT variable, cut FROM archipelagos WHERE job = ? AND cut IS NOT NULL", job))

    def has_search(self, job: str) -> bool:
        """Return whether a cut or a checkpoint of the job is stored."""
        with self._reading() as sql:
            return has_search(sql, job)

    def add_deaths(self, deaths: Sequence[Death]) -> None:
        """Store deaths that count for archipelagos until the archipelago has a newer checkpoint, or ends."""
        with self._transaction() as sql:
            sql.executemany("INSERT OR IGNORE INTO deaths VALUES (?, ?, ?, ?, ?)", deaths)

    def deaths(self, job: str) -> tuple[Death, ...]:
        """Return the deaths that count for archipelagos of a job, by variable, then by term."""
        columns = "job, variable, term, worker, instance"
        return tuple(
            Death(*row) for row in self._rows(f"SELECT {columns} FROM deaths WHERE job = ? ORDER BY {columns}", job)
        )

    def take_back_deaths(self, worker: str, instance: str) -> None:
        """Delete the death of a process that is alive after all."""
        with self._transaction() as sql:
            sql.execute("DELETE FROM deaths WHERE worker = ? AND instance = ?", (worker, instance))

    def commit_checkpoint(
        self, job: str, variable: str, epoch: int, progress: bytes, states: Mapping[int, IslandState], elapsed: float
    ) -> bool:
        """Store a checkpoint of an archipelago, and the `elapsed` seconds of its job; keep one earlier checkpoint.

        Earlier deaths no longer count. Return False, changing nothing, when the archipelago or its job has ended, or
        the job has been deleted.
        """
        key = (job, variable)
        with self._transaction() as sql:
            if find(sql, job) is None:
                return False
            _ensure_archipelago(sql, job, variable)
            ended = f"SELECT cut IS NOT NULL OR {ENDED} FROM archipelagos JOIN jobs ON jobs.id = job "
            if first_value(sql, f"{ended} WHERE job = ? AND variable = ?", *key):
                return False
            sql.execute("DELETE FROM checkpoints WHERE job = ? AND variable = ? AND epoch >= ?", (*key, epoch))
            sql.execute("INSERT INTO checkpoints VALUES (?, ?, ?, ?)", (*key, epoch, progress))
            rows = ((*key, epoch, island, state.digest, state.data) for island, state in states.items())
            sql.executemany("INSERT INTO states VALUES (?, ?, ?, ?, ?, ?)", rows)
            sql.execute(
                "DELETE FROM checkpoints WHERE job = ? AND variable = ? AND epoch NOT IN "
                "(SELECT epoch FROM checkpoints WHERE job = ? AND variable = ? ORDER BY epoch DESC LIMIT 2)",
                (*key, *key),
            )
            forget_deaths(sql, job, variable)
            update(sql, job, {"elapsed": elapsed})
            return True

    def checkpoints(self, job: str) -> dict[str, tuple[int, bytes]]:
        """Return epoch and progress of the last checkpoint by variable."""
        rows = self._rows("SELECT variable, epoch, progress FROM checkpoints WHERE job = ? ORDER BY epoch", job)
        return {variable: (epoch, progress) for variable, epoch, progress in rows}

    def whole_checkpoints(self, job: str, islands: int) -> dict[str, tuple[int, bytes]]:
        """Like `checkpoints`, but for each variable the last checkpoint with undamaged states."""
        whole: dict[str, tuple[int, bytes]] = {}
        with self._transaction() as sql:
            query = "SELECT variable, epoch, progress FROM checkpoints WHERE job = ? ORDER BY epoch DESC"
            for variable, epoch, progress in sql.execute(query, (job,)).fetchall():
                with contextlib.suppress(KeyError):
                    if variable not in whole and all(
                        _state(sql, job, variable, epoch, island).is_whole for island in range(islands)
                    ):
                        whole[variable] = (epoch, progress)
        return whole

    def state(self, job: str, variable: str, epoch: int, island: int) -> IslandState:
        """Return the state of an island at a checkpoint; raises KeyError when it is not stored."""
        with self._reading() as sql:
            return _state(sql, job, variable, epoch, island)


def has_search(sql: sqlite3.Connection, job: str) -> bool:
    """Return whether a cut or a checkpoint of the job is stored."""
    query = (
        "SELECT EXISTS (SELECT 1 FROM archipelagos WHERE job = :job AND cut IS NOT NULL) "
        "OR EXISTS (SELECT 1 FROM checkpoints WHERE job = :job)"
    )
    return bool(sql.execute(query, {"job": job}).fetchone()[0])


def keep_last_checkpoints(sql: sqlite3.Connection, job: str) -> None:
    """Keep only the last checkpoint of each archipelago of a failed job, for the latest `MAX_FAILED` such jobs."""
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


def forget_checkpoints(sql: sqlite3.Connection, job: str, variable: str | None = None) -> None:
    """Delete the checkpoints of an archipelago; None: of all archipelagos of a job."""
    sql.execute("DELETE FROM checkpoints WHERE job = ? AND (? IS NULL OR variable = ?)", (job, variable, variable))


def forget_deaths(sql: sqlite3.Connection, job: str, variable: str | None = None) -> None:
    """Delete the deaths that count for an archipelago; None: for all archipelagos of a job."""
    sql.execute("DELETE FROM deaths WHERE job = ? AND (? IS NULL OR variable = ?)", (job, variable, variable))


def _ensure_archipelago(sql: sqlite3.Connection, job: str, variable: str) -> None:
    require(sql, job)
    sql.execute("INSERT OR IGNORE INTO archipelagos (job, variable) VALUES (?, ?)", (job, variable))


def _state(sql: sqlite3.Connection, job: str, variable: str, epoch: int, island: int) -> IslandState:
    query = "SELECT data, digest FROM states WHERE job = ? AND variable = ? AND epoch = ? AND island = ?"
    row = sql.execute(query, (job, variable, epoch, island)).fetchone()
    if row is None:
        raise KeyError(f"{job} {variable} {epoch} {island}")
    return IslandState(*row)
