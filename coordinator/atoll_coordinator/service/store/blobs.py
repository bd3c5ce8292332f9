"""The store's blobs (tables, datasets, prepared data): bytes in chunks of `CHUNK_SIZE` under their SHA-256.

A blob is complete when all of its chunks are stored. The table `uploads` lists each blob until a job uses it, so that a
search for unused blobs reads few rows. Functions that take `sql` are part of the caller's transaction.
"""

import hashlib
import sqlite3
from collections.abc import Iterable
from typing import Any, Final

from atoll_coordinator.service.store.open_file import OpenFile, first_value
from atoll_core.errors import RemoteProtocolError
from atoll_core.wire.messages.limits import CHUNK_SIZE, chunk_count

_UNUSED: Final = (
    "NOT EXISTS (SELECT 1 FROM jobs WHERE table_digest = digest) "
    "AND NOT EXISTS (SELECT 1 FROM jobs WHERE dataset_digest = digest) "
    "AND NOT EXISTS (SELECT 1 FROM jobs WHERE prepared_digest = digest)"
)


class BlobStore(OpenFile):
    """The part of the store that holds blobs. Every method is one transaction, unless its docstring says otherwise."""

    def has_blob(self, digest: str) -> bool:
        """Return whether the blob is stored completely."""
        return bool(self._value("SELECT complete FROM blobs WHERE digest = ?", digest))

    def is_begun(self, digest: str) -> bool:
        """Return whether there is a blob or an upload of this name, complete or not."""
        return self._value("SELECT 1 FROM blobs WHERE digest = ?", digest) is not None

    def blob_size(self, digest: str) -> int:
        """Return the size of a blob in bytes, 0 unless it is stored completely."""
        return int(self._value("SELECT size FROM blobs WHERE digest = ? AND complete", digest) or 0)

    def is_sound(self, digest: str) -> bool:
        """Return whether a blob is stored completely and undamaged; a damaged blob is deleted.

        It reads all bytes, one chunk per transaction. Call it in a separate thread: other threads wait for one chunk at
        most.
        """
        actual = hashlib.sha256()
        try:
            for index in range(chunk_count(self.blob_size(digest))):
                actual.update(self.get_chunk(digest, index))
        except KeyError:
            return False
        if actual.hexdigest() == digest:
            return True
        with self._transaction() as sql:
            stored = hashlib.sha256()
            for (data,) in sql.execute("SELECT data FROM chunks WHERE digest = ? ORDER BY number", (digest,)):
                stored.update(data)
            if stored.hexdigest() != digest:  # otherwise another thread has written it again
                _delete(sql, digest)
        return False

    def get_blob(self, digest: str) -> bytes:
        """Return a blob; raises KeyError when it is missing, incomplete or damaged (then it is deleted)."""
        if not self.is_sound(digest):
            raise KeyError(digest)
        return b"".join(self.get_chunk(digest, index) for index in range(chunk_count(self.blob_size(digest))))

    def get_chunk(self, digest: str, index: int) -> bytes:
        """Return chunk `index` (of `CHUNK_SIZE` bytes, the last one shorter) of a complete blob; raises KeyError."""
        query = "SELECT data FROM chunks JOIN blobs USING (digest) WHERE digest = ? AND number = ? AND complete"
        data: bytes | None = self._value(query, digest, index)
        if data is None:
            raise KeyError(f"{digest} {index}")
        return data

    def put_chunk(self, upload: str, index: int, data: bytes, digest: str | None = None) -> bool:
        """Store the next chunk of an upload; return False, changing nothing, when earlier chunks are missing.

        Chunk 0 begins the upload again. The last chunk has the `digest` of all bytes, which the caller has checked: the
        upload becomes the blob of this digest. A complete blob of this name or digest is not changed.
        """
        with self._transaction() as sql:
            if _is_complete(sql, upload):
                return True
            if index == 0:
                _delete(sql, upload)
                sql.execute("INSERT INTO blobs VALUES (?, 0, 0)", (upload,))
                sql.execute("INSERT INTO uploads VALUES (?)", (upload,))
            elif not _is_upload(sql, upload) or not _has_chunks(sql, upload, index):
                return False
            _add_chunk(sql, upload, index, data)
            if digest is not None:
                _rename_upload(sql, upload, digest)
            return True

    def blob_bytes(self) -> int:
        """Return the bytes of all blobs, unfinished uploads included."""
        return int(self._value("SELECT blob_bytes FROM realm"))

    def unused_blobs(self) -> tuple[str, ...]:
        """Return the digests of all blobs, complete or not, that no job uses."""
        return tuple(digest for (digest,) in self._rows(f"SELECT digest FROM uploads WHERE {_UNUSED}"))

    def delete_unused_blobs(self, digests: Iterable[str]) -> None:
        """Delete the given blobs, complete or not, unless a job uses them."""
        with self._transaction() as sql:
            delete_unused(sql, digests)

    def _write_blob(self, digest: str, data: bytes) -> None:
        """Write a missing blob, one chunk per transaction. `finish` completes it in the caller's transaction.

        Until then the blob does not count as an upload: clients cannot add to it, and it is not deleted as unused.
        """
        if self.has_blob(digest) and self.is_sound(digest):
            return
        with self._transaction() as sql:
            if not _is_complete(sql, digest):
                _delete(sql, digest)
                sql.execute("INSERT INTO blobs VALUES (?, 0, 0)", (digest,))
        for index in range(chunk_count(len(data))):
            with self._transaction() as sql:
                if _is_written(sql, digest) and _has_chunks(sql, digest, index):
                    _add_chunk(sql, digest, index, data[index * CHUNK_SIZE : (index + 1) * CHUNK_SIZE])


def require_fitting(size: int, index: int, data: bytes) -> None:
    """Raise RemoteProtocolError unless `data` can be chunk `index` of an upload of `size` bytes."""
    expected = min(CHUNK_SIZE, size - index * CHUNK_SIZE)
    if not 0 <= index < chunk_count(size) or len(data) != expected:
        raise RemoteProtocolError(f"chunk {index} of {len(data)} bytes does not fit an upload of {size} bytes")


def finish(sql: sqlite3.Connection, digest: str, size: int) -> bool:
    """Mark a blob of `size` bytes as complete and used; return False when not all of it is stored."""
    if not _is_complete(sql, digest):
        if not _is_written(sql, digest) or not _has_chunks(sql, digest, chunk_count(size)):
            return False
        sql.execute("UPDATE blobs SET complete = 1 WHERE digest = ?", (digest,))
    take(sql, digest)
    return True


def take(sql: sqlite3.Connection, digest: str) -> None:
    """Record that a job uses a blob from now on."""
    sql.execute("DELETE FROM uploads WHERE digest = ?", (digest,))


def delete_unused(sql: sqlite3.Connection, digests: Iterable[str]) -> None:
    """Delete the given blobs unless a job uses them."""
    for digest in digests:
        _delete(sql, digest, _UNUSED)


def _is_complete(sql: sqlite3.Connection, digest: str) -> bool:
    return bool(first_value(sql, "SELECT complete FROM blobs WHERE digest = ?", digest))


def _is_upload(sql: sqlite3.Connection, digest: str) -> bool:
    return first_value(sql, "SELECT 1 FROM uploads WHERE digest = ?", digest) is not None


def _is_written(sql: sqlite3.Connection, digest: str) -> bool:
    """Return whether `_write_blob` has begun this blob."""
    return first_value(sql, "SELECT 1 FROM blobs WHERE digest = ?", digest) is not None and not _is_upload(sql, digest)


def _has_chunks(sql: sqlite3.Connection, digest: str, count: int) -> bool:
    stored: Any = first_value(sql, "SELECT count(*) FROM chunks WHERE digest = ?", digest)
    return bool(stored == count)


def _add_chunk(sql: sqlite3.Connection, digest: str, index: int, data: bytes) -> None:
    sql.execute("INSERT INTO chunks VALUES (?, ?, ?)", (digest, index, data))
    sql.execute("UPDATE blobs SET size = size + ? WHERE digest = ?", (len(data), digest))
    _count_bytes(sql, len(data))


def _rename_upload(sql: sqlite3.Connection, upload: str, digest: str) -> None:
    """Turn a complete upload into the blob of this digest, unless this blob is already stored."""
    if upload == digest:
        sql.execute("UPDATE blobs SET complete = 1 WHERE digest = ?", (digest,))
        return
    if not _is_complete(sql, digest):
        _delete(sql, digest)  # another user's unfinished upload
        size = first_value(sql, "SELECT size FROM blobs WHERE digest = ?", upload)
        sql.execute("INSERT INTO blobs VALUES (?, ?, 1)", (digest, size))
        _count_bytes(sql, size)
        sql.execute("INSERT INTO uploads VALUES (?)", (digest,))
        sql.execute("UPDATE chunks SET digest = ? WHERE digest = ?", (digest, upload))
    _delete(sql, upload)


def _delete(sql: sqlite3.Connection, digest: str, condition: str = "TRUE") -> None:
    deleted = sql.execute(f"DELETE FROM blobs WHERE digest = ? AND {condition} RETURNING size", (digest,)).fetchall()
    _count_bytes(sql, -sum(size for (size,) in deleted))


def _count_bytes(sql: sqlite3.Connection, size: int) -> None:
    if size:
        sql.execute("UPDATE realm SET blob_bytes = blob_bytes + ?", (size,))
