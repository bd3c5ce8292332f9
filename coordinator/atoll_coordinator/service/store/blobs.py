"""The store's tables of blobs and their chunks, by digest. Every function is part of the caller's transaction."""

import hashlib
import sqlite3
from collections.abc import Iterable
from typing import Final, cast

from atoll_core.errors import RemoteProtocolError
from atoll_core.wire.messages.limits import CHUNK_SIZE, chunk_count


def add(sql: sqlite3.Connection, digest: str, data: bytes) -> None:
    """Add a blob, whole; one that is there and damaged is replaced."""
    if is_complete(sql, digest) and keep_if_sound(sql, digest):
        return
    _delete(sql, digest)
    sql.execute("INSERT INTO blobs VALUES (?, ?, 1)", (digest, len(data)))
    _count(sql, len(data))
    sql.execute("INSERT OR IGNORE INTO uploads VALUES (?)", (digest,))
    pieces = ((digest, n, data[n * CHUNK_SIZE : (n + 1) * CHUNK_SIZE]) for n in range(chunk_count(len(data))))
    sql.executemany("INSERT INTO chunks VALUES (?, ?, ?)", pieces)


def is_begun(sql: sqlite3.Connection, digest: str) -> bool:
    """Return whether there is a blob or an upload of this name, whole or not."""
    return sql.execute("SELECT 1 FROM blobs WHERE digest = ?", (digest,)).fetchone() is not None


def begin(sql: sqlite3.Connection, digest: str) -> None:
    """Begin to write a blob that is not there, in place of an upload of that name that has not come to its end.

    It is no upload: neither clients add to it, nor is it deleted while it is written.
    """
    if not is_complete(sql, digest):
        _delete(sql, digest)
        sql.execute("INSERT INTO blobs VALUES (?, 0, 0)", (digest,))


def append(sql: sqlite3.Connection, digest: str, index: int, data: bytes) -> None:
    """Add the next chunk of a blob that `begin` began; without effect where that was deleted meanwhile."""
    if is_begun(sql, digest) and not _is_upload(sql, digest) and _has_chunks(sql, digest, index):
        _add_chunk(sql, digest, index, data)


def finish(sql: sqlite3.Connection, digest: str, size: int) -> bool:
    """Return whether a blob of `size` bytes is there; when all of it was written, it is whole from now on, and used."""
    if not is_complete(sql, digest):
        is_written = is_begun(sql, digest) and not _is_upload(sql, digest)
        if not is_written or not _has_chunks(sql, digest, chunk_count(size)):
            return False
        sql.execute("UPDATE blobs SET complete = 1 WHERE digest = ?", (digest,))
    take(sql, digest)
    return True


def _is_upload(sql: sqlite3.Connection, digest: str) -> bool:
    return sql.execute("SELECT 1 FROM uploads WHERE digest = ?", (digest,)).fetchone() is not None


def take(sql: sqlite3.Connection, digest: str) -> None:
    """Take in that a job uses a blob from now on."""
    sql.execute("DELETE FROM uploads WHERE digest = ?", (digest,))


def keep_if_sound(sql: sqlite3.Connection, digest: str) -> bool:
    """Return whether the bytes of a blob have its digest; forget it if not."""
    actual = hashlib.sha256()
    for (data,) in sql.execute("SELECT data FROM chunks WHERE digest = ? ORDER BY number", (digest,)):
        actual.update(data)
    if actual.hexdigest() == digest:
        return True
    _delete(sql, digest)
    return False


def is_complete(sql: sqlite3.Connection, digest: str) -> bool:
    """Return whether a blob is there, whole."""
    row = sql.execute("SELECT complete FROM blobs WHERE digest = ?", (digest,)).fetchone()
    return bool(row and row[0])


def size(sql: sqlite3.Connection, digest: str) -> int:
    """Return the size of a blob in bytes; raises KeyError when it is not there, whole."""
    row = sql.execute("SELECT size FROM blobs WHERE digest = ? AND complete", (digest,)).fetchone()
    if row is None:
        raise KeyError(digest)
    return cast(int, row[0])


def chunk(sql: sqlite3.Connection, digest: str, index: int) -> bytes:
    """Return a chunk of a blob; raises KeyError when the blob is not there, whole, or has no such chunk."""
    row = sql.execute(
        "SELECT data FROM chunks JOIN blobs USING (digest) WHERE digest = ? AND number = ? AND complete",
        (digest, index),
    ).fetchone()
    if row is None:
        raise KeyError(f"{digest} {index}")
    return cast(bytes, row[0])


def require_fitting(size: int, index: int, data: bytes) -> None:
    """Raise RemoteProtocolError unless `data` can be chunk `index` of an upload of `size` bytes."""
    expected = min(CHUNK_SIZE, size - index * CHUNK_SIZE)
    if not 0 <= index < chunk_count(size) or len(data) != expected:
        raise RemoteProtocolError(f"chunk {index} of {len(data)} bytes does not fit an upload of {size} bytes")


def put_chunk(sql: sqlite3.Connection, upload: str, index: int, data: bytes, digest: str | None) -> bool:
    """Add the next chunk of an upload; with a `digest`, which its bytes have, the upload is that blob from now on.

    Return False, changing nothing, when the chunks before it are not there.
    """
    if is_complete(sql, upload):
        return True
    if index == 0:
        _delete(sql, upload)
        sql.execute("INSERT INTO blobs VALUES (?, 0, 0)", (upload,))
        sql.execute("INSERT INTO uploads VALUES (?)", (upload,))
    elif not _is_upload(sql, upload) or not _has_chunks(sql, upload, index):
        return False
    _add_chunk(sql, upload, index, data)
    if digest is not None:
        _finish(sql, upload, digest)
    return True


def _add_chunk(sql: sqlite3.Connection, digest: str, index: int, data: bytes) -> None:
    sql.execute("INSERT INTO chunks VALUES (?, ?, ?)", (digest, index, data))
    sql.execute("UPDATE blobs SET size = size + ? WHERE digest = ?", (len(data), digest))
    _count(sql, len(data))


def _has_chunks(sql: sqlite3.Connection, upload: str, count: int) -> bool:
    (there,) = sql.execute("SELECT count(*) FROM chunks WHERE digest = ?", (upload,)).fetchone()
    return cast(int, there) == count


def _finish(sql: sqlite3.Connection, upload: str, digest: str) -> None:
    """Turn a whole upload into the blob of that digest, unless it is there already."""
    if upload == digest:
        sql.execute("UPDATE blobs SET complete = 1 WHERE digest = ?", (digest,))
        return
    if not is_complete(sql, digest):
        _delete(sql, digest)  # an unfinished upload, of somebody else
        (size,) = sql.execute("SELECT size FROM blobs WHERE digest = ?", (upload,)).fetchone()
        sql.execute("INSERT INTO blobs VALUES (?, ?, 1)", (digest, size))
        _count(sql, size)
        sql.execute("INSERT INTO uploads VALUES (?)", (digest,))
        sql.execute("UPDATE chunks SET digest = ? WHERE digest = ?", (digest, upload))
    _delete(sql, upload)


def total_bytes(sql: sqlite3.Connection) -> int:
    """Return how many bytes are stored of all blobs, unfinished uploads included."""
    (total,) = sql.execute("SELECT blob_bytes FROM realm").fetchone()
    return cast(int, total)


# Every blob is among `uploads` until a job takes it; so only few are asked whether a job uses them after all.
_UNUSED: Final = (
    "NOT EXISTS (SELECT 1 FROM jobs WHERE table_digest = digest) "
    "AND NOT EXISTS (SELECT 1 FROM jobs WHERE dataset_digest = digest) "
    "AND NOT EXISTS (SELECT 1 FROM jobs WHERE prepared_digest = digest)"
)


def unused(sql: sqlite3.Connection) -> tuple[str, ...]:
    """Return the digests of the blobs that no job uses: unfinished uploads, and those that were not submitted."""
    return tuple(digest for (digest,) in sql.execute(f"SELECT digest FROM uploads WHERE {_UNUSED}").fetchall())


def delete_unused(sql: sqlite3.Connection, digests: Iterable[str]) -> None:
    """Delete those of these blobs that no job uses."""
    for digest in digests:
        _delete(sql, digest, _UNUSED)


def _delete(sql: sqlite3.Connection, digest: str, condition: str = "TRUE") -> None:
    deleted = sql.execute(f"DELETE FROM blobs WHERE digest = ? AND {condition} RETURNING size", (digest,)).fetchall()
    _count(sql, -sum(size for (size,) in deleted))


def _count(sql: sqlite3.Connection, size: int) -> None:
    """Take in that all blobs have so many bytes more, or fewer."""
    if size:
        sql.execute("UPDATE realm SET blob_bytes = blob_bytes + ?", (size,))
