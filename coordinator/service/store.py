"""The coordinator's memory: what it must still know after its own end. SQLite; every method is one transaction.

Any thread may call. When a method returns, what it wrote is on the disk (``synchronous=FULL``): what is announced
afterwards is never taken back. Contents are opaque here: JSON text and bytes whose meaning others know.
"""

import contextlib
import hashlib
import sqlite3
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from types import TracebackType
from typing import Final, Self, cast

from common.errors import LocalProtocolError, RemoteProtocolError, StoreError
from common.wire.messages import CHUNK_SIZE, chunk_count
from common.wire.pieces import State
from common.wire.views import StoreView
from coordinator.service.event_table import EventRecord, append_events, read_events
from coordinator.service.schema import Lock, connect, translated


@dataclass(frozen=True, slots=True)
class JobRecord:
    """One job as it is kept. `spec` is JSON; `submitted` and `finished` are ISO times; `elapsed` is seconds of work.

    `table_digest` names the uploaded table and `dataset_digest` the prepared dataset among the blobs. `priority` is
    from -10 to 10; each step doubles the job's share of the workers.
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


_COLUMNS: Final = tuple(field.name for field in fields(JobRecord))
_FIXED: Final = ("id", "spec", "table_digest", "submitted", "priority")


class Store:
    """An open store; a context manager. `realm` is its random name, `incarnation` counts how often it was opened."""

    realm: Final[str]
    incarnation: Final[int]

    def __init__(self, connection: sqlite3.Connection, lock: Lock | None, directory: Path | None) -> None:
        self._connection = connection
        self._lock_on_directory = lock
        self._directory = directory
        self._lock = threading.RLock()
        self._timing = StoreView()
        self.realm, self.incarnation = connection.execute("SELECT id, incarnation FROM realm").fetchone()

    @classmethod
    def open(cls, directory: Path | None) -> Self:
        """Open the store in `directory`, making it if need be; None: in memory, gone when closed.

        Raises:
            StoreError: another coordinator serves from it, it is damaged, of a newer version, or cannot be written.
        """
        if directory is None:
            return cls(connect(None), None, None)
        lock = Lock(directory)
        try:
            return cls(connect(directory), lock, directory)
        except BaseException:
            lock.release()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the store and let others open it. Repeatable."""
        with self._lock:
            self._connection.close()
            if self._lock_on_directory is not None:
                self._lock_on_directory.release()
                self._lock_on_directory = None

    def check(self) -> None:
        """Raise StoreError when another coordinator has opened the store since."""
        with self._transaction():
            pass

    def timing(self) -> StoreView:
        """Return how many transactions there were since the store was opened, and how long they took."""
        with self._lock:
            return self._timing

    # jobs

    def add_job(self, job: JobRecord) -> bool:
        """Keep a new job; return False, changing nothing, when a job of this id is kept already."""
        values = tuple(getattr(job, name) for name in _COLUMNS)
        marks = ", ".join("?" * len(_COLUMNS))
        with self._transaction() as sql:
            done = sql.execute(f"INSERT OR IGNORE INTO jobs ({', '.join(_COLUMNS)}) VALUES ({marks})", values)
            return done.rowcount == 1

    def job(self, job: str) -> JobRecord | None:
        """Return one job; None for an unknown id."""
        with self._transaction() as sql:
            row = sql.execute(f"SELECT {', '.join(_COLUMNS)} FROM jobs WHERE id = ?", (job,)).fetchone()
        return JobRecord(*row) if row else None

    def jobs(self) -> tuple[JobRecord, ...]:
        """Return all jobs, in the order in which they came."""
        with self._transaction() as sql:
            rows = sql.execute(f"SELECT {', '.join(_COLUMNS)} FROM jobs ORDER BY number").fetchall()
        return tuple(JobRecord(*row) for row in rows)

    def keep_submitter(self, job: str, name: str) -> None:
        """Keep who submitted a job, by the name in the certificate; what is kept already stays."""
        with self._transaction() as sql:
            sql.execute("INSERT OR IGNORE INTO submitters VALUES (?, ?)", (job, name))

    def submitter(self, job: str) -> str | None:
        """Return who submitted a job; None when nobody proved it."""
        with self._transaction() as sql:
            row = sql.execute("SELECT name FROM submitters WHERE job = ?", (job,)).fetchone()
        return row[0] if row else None

    def update_job(self, job: str, only_in: Collection[str] | None = None, **changes: str | float | None) -> bool:
        """Change fields of a job; return False, changing nothing, when its state is not in `only_in` (if given).

        Raises:
            LocalProtocolError: there is no such job or field, or the field cannot change.
        """
        wrong = [name for name in changes if name not in _COLUMNS or name in _FIXED]
        if wrong or not changes:
            raise LocalProtocolError(f"fields {wrong} of job {job} cannot be changed")
        with self._transaction() as sql:
            if not self._is_in(sql, job, only_in):
                return False
            assignments = ", ".join(f"{name} = ?" for name in changes)
            sql.execute(f"UPDATE jobs SET {assignments} WHERE id = ?", (*changes.values(), job))
            return True

    def commit_result(
        self, job: str, state: str, result: str | None, reason: str | None = None, finished: str | None = None
    ) -> bool:
        """Make a job's final `state` and `result` (JSON) durable and forget its checkpoints.

        Return False when it had ended before: the first end wins.
        """
        with self._transaction() as sql:
            self._is_in(sql, job, None)
            done = sql.execute(
                "UPDATE jobs SET state = ?, result = ?, reason = ?, finished = ? "
                "WHERE id = ? AND state NOT IN ('done', 'failed', 'cancelled')",
                (state, result, reason, finished, job),
            )
            sql.execute("DELETE FROM checkpoints WHERE job = ?", (job,))
            return done.rowcount == 1

    def result(self, job: str) -> str | None:
        """Return a job's result as JSON; None while there is none."""
        with self._transaction() as sql:
            row = sql.execute("SELECT result FROM jobs WHERE id = ?", (job,)).fetchone()
        return cast(str | None, row[0]) if row else None

    # archipelagos

    def raise_term(self, job: str, variable: str) -> int:
        """Return the next term of an archipelago, 1 at first; no term is ever issued twice."""
        with self._transaction() as sql:
            self._ensure_archipelago(sql, job, variable)
            row = sql.execute(
                "UPDATE archipelagos SET term = term + 1 WHERE job = ? AND variable = ? RETURNING term", (job, variable)
            ).fetchall()
            return cast(int, row[0][0])

    def begin_terms(self, archipelagos: Sequence[tuple[str, str]], place: Callable[[int, int], bytes]) -> None:
        """Raise the terms of archipelagos and make their placements durable, all or none of them, at the cost of one.

        Args:
            archipelagos: by job and variable.
            place: returns the placement of number `index` of them under its new `term`.
        """
        with self._transaction() as sql:
            for index, (job, variable) in enumerate(archipelagos):
                self._ensure_archipelago(sql, job, variable)
                row = sql.execute(
                    "UPDATE archipelagos SET term = term + 1 WHERE job = ? AND variable = ? RETURNING term",
                    (job, variable),
                ).fetchall()
                sql.execute(
                    "UPDATE archipelagos SET placement = ? WHERE job = ? AND variable = ?",
                    (place(index, cast(int, row[0][0])), job, variable),
                )

    def commit_placement(self, job: str, variable: str, placement: bytes) -> None:
        """Make the placement of the archipelago's current term durable."""
        with self._transaction() as sql:
            self._ensure_archipelago(sql, job, variable)
            sql.execute(
                "UPDATE archipelagos SET placement = ? WHERE job = ? AND variable = ?", (placement, job, variable)
            )

    def placements(self, job: str) -> dict[str, tuple[int, bytes | None]]:
        """Return term and placement by variable."""
        with self._transaction() as sql:
            rows = sql.execute("SELECT variable, term, placement FROM archipelagos WHERE job = ?", (job,)).fetchall()
        return {variable: (term, placement) for variable, term, placement in rows}

    def commit_cut(self, job: str, variable: str, cut: bytes) -> bool:
        """Make the end of an archipelago durable; return False when it had one before: first wins."""
        with self._transaction() as sql:
            self._ensure_archipelago(sql, job, variable)
            done = sql.execute(
                "UPDATE archipelagos SET cut = ? WHERE job = ? AND variable = ? AND cut IS NULL", (cut, job, variable)
            )
            sql.execute("DELETE FROM checkpoints WHERE job = ? AND variable = ?", (job, variable))
            return done.rowcount == 1

    def cuts(self, job: str) -> dict[str, bytes]:
        """Return the committed cuts by variable."""
        with self._transaction() as sql:
            rows = sql.execute(
                "SELECT variable, cut FROM archipelagos WHERE job = ? AND cut IS NOT NULL", (job,)
            ).fetchall()
        return dict(rows)

    # events

    def add_events(self, events: Iterable[EventRecord]) -> None:
        """Keep what has happened; of each job, and of no job in particular, the last `MAX_EVENTS` are kept."""
        with self._transaction() as sql:
            append_events(sql, tuple(events))

    def events(self, job: str | None, after: int, limit: int) -> tuple[EventRecord, ...]:
        """Return what happened to a job, or at all (None), after the event of that number; `limit` of it at most.

        With `after` 0 these are the last ones, otherwise those that come next.
        """
        with self._transaction() as sql:
            return read_events(sql, job, after, limit)

    # checkpoints

    def commit_checkpoint(
        self, job: str, variable: str, epoch: int, progress: bytes, states: Mapping[int, State], elapsed: float
    ) -> bool:
        """Make a checkpoint of an archipelago durable, and `elapsed` of its job; keep the one before, but no older one.

        Return False, changing nothing, when the archipelago or its job has ended.
        """
        with self._transaction() as sql:
            if self._has_ended(sql, job, variable):
                return False
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
            sql.execute("UPDATE jobs SET elapsed = ? WHERE id = ?", (elapsed, job))
            return True

    def checkpoints(self, job: str) -> dict[str, tuple[int, bytes]]:
        """Return epoch and progress of the last checkpoint by variable."""
        with self._transaction() as sql:
            rows = sql.execute(
                "SELECT variable, epoch, progress FROM checkpoints WHERE job = ? ORDER BY epoch", (job,)
            ).fetchall()
        return {variable: (epoch, progress) for variable, epoch, progress in rows}

    def state(self, job: str, variable: str, epoch: int, island: int) -> State:
        """Return the state of an island at a checkpoint; raises KeyError when it is not there."""
        with self._transaction() as sql:
            row = sql.execute(
                "SELECT data, digest FROM states WHERE job = ? AND variable = ? AND epoch = ? AND island = ?",
                (job, variable, epoch, island),
            ).fetchone()
        if row is None:
            raise KeyError(f"{job} {variable} {epoch} {island}")
        return State(*row)

    # blobs

    def put_blob(self, data: bytes) -> str:
        """Keep `data`; return its digest (SHA-256, hex) under which it is found again."""
        digest = hashlib.sha256(data).hexdigest()
        with self._transaction() as sql:
            if not self._is_complete(sql, digest):
                sql.execute("INSERT OR REPLACE INTO blobs VALUES (?, ?, 1)", (digest, len(data)))
                pieces = (
                    (digest, n, data[n * CHUNK_SIZE : (n + 1) * CHUNK_SIZE]) for n in range(chunk_count(len(data)))
                )
                sql.executemany("INSERT INTO chunks VALUES (?, ?, ?)", pieces)
        return digest

    def has_blob(self, digest: str) -> bool:
        """Return whether the blob is there, whole."""
        with self._transaction() as sql:
            return self._is_complete(sql, digest)

    def blob_size(self, digest: str) -> int:
        """Return the size of a blob in bytes; raises KeyError when it is not there, whole."""
        with self._transaction() as sql:
            row = sql.execute("SELECT size FROM blobs WHERE digest = ? AND complete", (digest,)).fetchone()
        if row is None:
            raise KeyError(digest)
        return cast(int, row[0])

    def get_blob(self, digest: str) -> bytes:
        """Return a blob; raises KeyError when it is not there, whole."""
        size = self.blob_size(digest)
        return b"".join(self.get_chunk(digest, index) for index in range(chunk_count(size)))

    def get_chunk(self, digest: str, index: int) -> bytes:
        """Return chunk `index` (of `CHUNK_SIZE` bytes, the last one shorter) of a blob; raises KeyError."""
        with self._transaction() as sql:
            row = sql.execute(
                "SELECT data FROM chunks JOIN blobs USING (digest) WHERE digest = ? AND number = ? AND complete",
                (digest, index),
            ).fetchone()
        if row is None:
            raise KeyError(f"{digest} {index}")
        return cast(bytes, row[0])

    def missing_chunks(self, digest: str, size: int) -> tuple[int, ...]:
        """Return which chunks of a blob of `size` bytes are still to be put; none when it is there, whole."""
        with self._transaction() as sql:
            if self._is_complete(sql, digest):
                return ()
            rows = sql.execute("SELECT number FROM chunks WHERE digest = ?", (digest,)).fetchall()
        there = {number for (number,) in rows}
        return tuple(number for number in range(chunk_count(size)) if number not in there)

    def put_chunk(self, digest: str, size: int, index: int, data: bytes) -> bool:
        """Keep one chunk of an upload; return whether the blob is whole now. Putting it again changes nothing.

        Raises:
            RemoteProtocolError: index, sizes or, with the last chunk, the digest do not fit; a blob whose digest is
                wrong is forgotten.
        """
        expected = min(CHUNK_SIZE, size - index * CHUNK_SIZE)
        if not 0 <= index < chunk_count(size) or len(data) != expected:
            raise RemoteProtocolError(f"chunk {index} of {len(data)} bytes does not fit an upload of {size} bytes")
        with self._transaction() as sql:
            if self._is_complete(sql, digest):
                return True
            self._begin_upload(sql, digest, size)
            sql.execute("INSERT OR IGNORE INTO chunks VALUES (?, ?, ?)", (digest, index, data))
            (count,) = sql.execute("SELECT count(*) FROM chunks WHERE digest = ?", (digest,)).fetchone()
            whole = bool(count == chunk_count(size))
            fits = not whole or self._finish_upload(sql, digest)
        if not fits:
            raise RemoteProtocolError(
                f"an upload of {size} bytes does not have the digest {digest} it was announced with"
            )
        return whole

    def blob_bytes(self) -> int:
        """Return how many bytes all blobs have, announced ones included."""
        with self._transaction() as sql:
            (total,) = sql.execute("SELECT coalesce(sum(size), 0) FROM blobs").fetchone()
        return cast(int, total)

    def drop_blob(self, digest: str) -> None:
        """Forget a blob or what has come of it; without effect when there is none."""
        with self._transaction() as sql:
            sql.execute("DELETE FROM blobs WHERE digest = ?", (digest,))

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._lock, translated(self._directory):
            began = time.perf_counter()
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                self._check_incarnation()
                yield self._connection
                self._connection.execute("COMMIT")
                self._count(time.perf_counter() - began)
            except BaseException:
                if self._connection.in_transaction:  # SQLite rolls back by itself when the disk is full
                    self._connection.execute("ROLLBACK")
                raise

    def _check_incarnation(self) -> None:
        """Raise StoreError when somebody else has opened the store since: nothing is written over another's work."""
        (incarnation,) = self._connection.execute("SELECT incarnation FROM realm").fetchone()
        if incarnation != self.incarnation:
            raise StoreError(
                f"another coordinator (incarnation {incarnation}) has taken over the store {self._directory}; "
                f"this one (incarnation {self.incarnation}) ends"
            )

    def _has_ended(self, sql: sqlite3.Connection, job: str, variable: str) -> bool:
        self._ensure_archipelago(sql, job, variable)
        row = sql.execute(
            "SELECT cut IS NOT NULL OR state IN ('done', 'failed', 'cancelled') FROM archipelagos JOIN jobs "
            "ON jobs.id = job WHERE job = ? AND variable = ?",
            (job, variable),
        ).fetchone()
        return bool(row[0])

    def _count(self, seconds: float) -> None:
        before = self._timing
        self._timing = StoreView(
            transactions=before.transactions + 1,
            total_s=before.total_s + seconds,
            worst_s=max(before.worst_s, seconds),
        )

    def _is_in(self, sql: sqlite3.Connection, job: str, states: Collection[str] | None) -> bool:
        row = sql.execute("SELECT state FROM jobs WHERE id = ?", (job,)).fetchone()
        if row is None:
            raise LocalProtocolError(f"job {job} is not in the store")
        return states is None or row[0] in states

    def _ensure_archipelago(self, sql: sqlite3.Connection, job: str, variable: str) -> None:
        self._is_in(sql, job, None)
        sql.execute("INSERT OR IGNORE INTO archipelagos (job, variable) VALUES (?, ?)", (job, variable))

    def _is_complete(self, sql: sqlite3.Connection, digest: str) -> bool:
        row = sql.execute("SELECT complete FROM blobs WHERE digest = ?", (digest,)).fetchone()
        return bool(row and row[0])

    def _begin_upload(self, sql: sqlite3.Connection, digest: str, size: int) -> None:
        sql.execute("INSERT OR IGNORE INTO blobs VALUES (?, ?, 0)", (digest, size))
        (known,) = sql.execute("SELECT size FROM blobs WHERE digest = ?", (digest,)).fetchone()
        if known != size:
            raise RemoteProtocolError(f"an upload of {size} bytes was announced before as one of {known} bytes")

    def _finish_upload(self, sql: sqlite3.Connection, digest: str) -> bool:
        found = hashlib.sha256()
        for (data,) in sql.execute("SELECT data FROM chunks WHERE digest = ? ORDER BY number", (digest,)):
            found.update(data)
        if found.hexdigest() == digest:
            sql.execute("UPDATE blobs SET complete = 1 WHERE digest = ?", (digest,))
            return True
        sql.execute("DELETE FROM blobs WHERE digest = ?", (digest,))
        return False
