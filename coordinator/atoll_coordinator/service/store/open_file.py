"""The store's file while it is open: ownership, transactions, their durations, and free space.

Methods may be called from any thread. The changes of a transaction are on the disk (``synchronous=FULL``) when it ends.
"""

import contextlib
import shutil
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from atoll_coordinator.service.store.lock import Lock
from atoll_coordinator.service.store.schema import FILE_NAME, connect, connect_to_read, translated
from atoll_core.errors import StoreError
from atoll_core.wire.messages.views import StoreView


@dataclass(frozen=True, slots=True)
class Room:
    """Bytes that may still be written, and the size of the disk."""

    free: int
    total: int


class OpenFile:
    """An open store file; a context manager. `cluster` is its random name, `incarnation` the number of openings."""

    cluster: Final[str]
    incarnation: Final[int]

    def __init__(
        self, connection: sqlite3.Connection, lock: Lock | None, directory: Path | None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        """`now` gives monotonic seconds."""
        self._connection = connection
        self._lock_on_directory = lock
        self._directory = directory
        self._lock = threading.RLock()
        self._reader = connect_to_read(directory) if directory is not None else None
        self._reading_lock = threading.RLock()
        self._timing = StoreView()
        self._timing_lock = threading.Lock()
        self._now = now
        columns = "id, incarnation, served"
        self.cluster, self.incarnation, served = connection.execute(f"SELECT {columns} FROM realm").fetchone()
        self._served_since = now() - float(served)

    @classmethod
    def open(cls, directory: Path | None, now: Callable[[], float] = time.monotonic, lock: Lock | None = None) -> Self:
        """Open the store in `directory`, creating it if necessary; None: in memory, lost on closing.

        `lock` is the lock on the directory if the caller has it already; closing the store releases it.

        Raises:
            StoreError: Another coordinator uses the store, or it is damaged, of a newer version, or not writable.
        """
        if directory is None:
            return cls(connect(None), None, None, now)
        lock = lock or Lock(directory)
        try:
            return cls(connect(directory), lock, directory, now)
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
        """Close the store and release its lock. Repeatable."""
        with self._lock, self._reading_lock:
            if self._reader is not None:
                self._reader.close()
            self._connection.close()
            if self._lock_on_directory is not None:
                self._lock_on_directory.release()
                self._lock_on_directory = None

    def check(self) -> None:
        """Raise StoreError when another coordinator has opened the store since."""
        with self._transaction():
            pass

    def beat(self) -> None:
        """Show a standby coordinator that this one runs; raise StoreError if another coordinator has taken over."""
        if self._lock_on_directory is None:
            return
        self._lock_on_directory.beat()
        if self._lock.acquire(blocking=False):  # otherwise a transaction is in progress, which checks by itself
            try:
                with translated(self._directory):
                    self._check_incarnation(self._connection)
            finally:
                self._lock.release()

    @property
    def served_s(self) -> float:
        """Seconds for which coordinators have served the store; the age of ended jobs is counted in this time."""
        return self._now() - self._served_since

    def keep_served(self) -> None:
        """Store `served_s`. After a kill, the time since the last call is lost, so that ended jobs count as younger."""
        with self._transaction() as sql:
            sql.execute("UPDATE realm SET served = ?", (self.served_s,))

    def timing(self) -> StoreView:
        """Return number and durations of the transactions since the store was opened."""
        with self._timing_lock:
            return self._timing

    def size_bytes(self) -> int:
        """Return the size of the store's file in bytes; 0 in memory."""
        try:
            return (self._directory / FILE_NAME).stat().st_size if self._directory is not None else 0
        except OSError:
            return 0

    def room(self) -> Room | None:
        """Return the free space on the disk and in the file's unused pages; None: in memory, or unknown."""
        if self._directory is None:
            return None
        try:
            disk = shutil.disk_usage(self._directory)
        except OSError:
            return None
        with self._reading() as sql:
            free, size = (sql.execute(f"PRAGMA {name}").fetchone()[0] for name in ("freelist_count", "page_size"))
        return Room(disk.free + free * size, disk.total)

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._lock, translated(self._directory):
            began = time.perf_counter()
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                self._check_incarnation(self._connection)
                yield self._connection
                self._connection.execute("COMMIT")
                self._count(time.perf_counter() - began)
            except BaseException:
                if self._connection.in_transaction:  # SQLite rolls back by itself when the disk is full
                    self._connection.execute("ROLLBACK")
                raise

    @contextlib.contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        """Yield a separate connection for reading, which does not wait while another thread writes many megabytes."""
        reader = self._reader
        if reader is None:  # in memory there is one connection
            with self._transaction() as sql:
                yield sql
            return
        with self._reading_lock, translated(self._directory):
            began = time.perf_counter()
            reader.execute("BEGIN")
            try:
                self._check_incarnation(reader)
                yield reader
            finally:
                reader.execute("ROLLBACK")
            self._count(time.perf_counter() - began)

    def _value(self, query: str, *values: object) -> Any:
        """Return the first value of the first row that a query reads; None without a row."""
        with self._reading() as sql:
            return first_value(sql, query, *values)

    def _rows(self, query: str, *values: object) -> list[Any]:
        """Return the rows that a query reads."""
        with self._reading() as sql:
            return sql.execute(query, values).fetchall()

    def _check_incarnation(self, connection: sqlite3.Connection) -> None:
        """Raise StoreError if another coordinator has opened the store since: its changes must not be overwritten."""
        (incarnation,) = connection.execute("SELECT incarnation FROM realm").fetchone()
        if incarnation != self.incarnation:
            raise StoreError(
                f"another coordinator (incarnation {incarnation}) has taken over the store {self._directory}; "
                f"this one (incarnation {self.incarnation}) ends"
            )

    def _count(self, seconds: float) -> None:
        with self._timing_lock:
            before = self._timing
            self._timing = StoreView(
                transactions=before.transactions + 1,
                total_s=before.total_s + seconds,
                worst_s=max(before.worst_s, seconds),
            )


def first_value(sql: sqlite3.Connection, query: str, *values: object) -> Any:
    """Return the first value of the first row; None without a row."""
    row = sql.execute(query, values).fetchone()
    return row[0] if row is not None else None
