"""Uploads of tables that no job uses yet. Each upload has a lease, which every message about it renews.

Uploads do not count in the retention of jobs. When the disk is nearly full, all uploads are deleted, including
unfinished uploads. Otherwise the store could not be written, which would end the coordinator and all searches.
"""

import hashlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from atoll_coordinator.service.store.blobs import require_fitting
from atoll_coordinator.service.store.jobs import Viewer
from atoll_coordinator.service.store.open_file import Room
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import RefusedError, RemoteProtocolError
from atoll_core.wire.messages.clients import Upload, Uploaded
from atoll_core.wire.messages.limits import CHUNK_LIMIT_S, chunk_count

MAX_STORED_BYTES: Final = 16 * 1024**3
"""Largest number of bytes of all tables and datasets; uploads beyond it are refused."""

MOST_OF_USER: Final = 1_000
MOST_OF_ALL: Final = 20_000
"""Largest number of tables that are uploaded and not submitted, of one user (or session) and of all users. Even a small
table takes 3 kB of memory."""

LEAST_RESERVE: Final = 256 * 1024**2
MOST_RESERVE: Final = 2 * 1024**3
RESERVED_SHARE: Final = 0.05
MOST_RESERVED_SHARE: Final = 0.25
"""Bounds of the space that is reserved for checkpoints and results: the share `RESERVED_SHARE` of the disk, within the
two bounds in bytes, but at most the share `MOST_RESERVED_SHARE`."""

LEASE_S: Final = 5 * CHUNK_LIMIT_S
"""An active client sends a message within `CHUNK_LIMIT_S`; the factor allows for retries."""

CHECK_INTERVAL_S: Final = 60.0
"""Seconds between two searches for uploads whose leases have ended."""


@dataclass(eq=False, slots=True)
class _Upload:
    """The part of a table that a client has sent: the first `count` chunks, `sent` bytes with the SHA-256 `hash`.

    The store has these chunks under the name `key` until all `size` bytes have arrived and have the digest. The last
    message about the upload was `heard` at this time, in seconds of the bus.
    """

    user: str | None
    digest: str
    size: int
    key: str
    heard: float
    count: int = 0
    sent: int = 0
    hash: "hashlib._Hash" = field(default_factory=hashlib.sha256)

    @property
    def is_whole(self) -> bool:
        return self.sent == self.size


class Uploads:
    """Tables that users are uploading, or have uploaded, and that no job uses yet.

    Each user must send all bytes of a table, in order, even if the store has the table from another user. Only bytes
    that were sent count, and not the announced size.
    """

    def __init__(self, store: Store, now: Callable[[], float]) -> None:
        """`now` returns seconds of the bus. Blobs that are already stored belong to no user: see `delete_all`."""
        self._store = store
        self._now = now
        self._heard: dict[str, float] = {}
        self._check_at = 0.0
        self._uploads: dict[tuple[str, str | None, str], _Upload] = {}
        self._sent: Counter[str | None] = Counter()
        self._begun: Counter[tuple[str | None, str]] = Counter()
        self._keys: set[str] = set()

    def take(self, upload: Upload, user: str | None, viewer: Viewer | None, session: str) -> Uploaded:
        """Store a chunk if it is the next one, and return the missing chunks.

        For a `viewer` who sees no job with this table, all chunks that its `user` has not sent count as missing: a
        digest must not reveal that the store has the data. Without a user, this holds for each `session`.

        Raises:
            RefusedError: The chunk is damaged, or there is no space for the upload.
            RemoteProtocolError: The chunk does not fit the upload, or the complete upload has another digest.
        """
        if upload.data is not None:
            if hashlib.sha256(upload.data).hexdigest() != upload.sha256:
                raise RefusedError(f"part {upload.index + 1} of an upload was damaged in transit; send it again")
            require_fitting(upload.size, upload.index, upload.data)
        upload_id = self._id_of(upload.blob, user, session)
        if self.has(upload.blob, user, viewer, session) and self._store.has_blob(upload.blob):
            self.renew(upload.blob)
            return Uploaded(blob=upload.blob, missing=())
        own = self._uploads.get(upload_id)
        if own is not None and own.is_whole:  # it was deleted in the meantime
            self._forget(upload_id)
            own = None
        if own is not None:
            own.heard = self._now()
        self._check_room(upload, own)
        if upload.data is not None:
            own = self._take_chunk(upload_id, own, upload, upload.data)
        count = own.count if own is not None and own.size == upload.size else 0
        return Uploaded(blob=upload.blob, missing=tuple(range(count, chunk_count(upload.size))))

    def _take_chunk(
        self, upload_id: tuple[str, str | None, str], own: _Upload | None, upload: Upload, data: bytes
    ) -> _Upload | None:
        """Store a chunk if it is the next one; return the upload. Chunk 0 with another size begins a new upload."""
        if upload.index == 0 and (own is None or own.size != upload.size):
            self._forget(upload_id)
            own = self._begin(upload_id, upload)
        if own is None or own.size != upload.size or own.count != upload.index:
            return own
        digest = own.hash.copy()
        digest.update(data)
        is_last = own.sent + len(data) == own.size
        if is_last and digest.hexdigest() != own.digest:
            self._forget(upload_id)
            raise RemoteProtocolError(f"an upload of {own.size} bytes does not have the announced digest {own.digest}")
        if not self._store.put_chunk(own.key, upload.index, data, own.digest if is_last else None):
            self._forget(upload_id)  # it was deleted in the meantime
            return None
        own.hash, own.count, own.sent = digest, own.count + 1, own.sent + len(data)
        self._sent[own.user] += len(data)
        if own.is_whole:
            self._keys.discard(own.key)
            self._heard[own.digest] = self._now()
        return own

    def _begin(self, upload_id: tuple[str, str | None, str], upload: Upload) -> _Upload:
        """Begin an upload; it has its own name if the same table is stored or another user is uploading it."""
        digest, user, session = upload_id
        own, total = self._begun[user, session], len(self._uploads)
        if own >= MOST_OF_USER or total >= MOST_OF_ALL:
            raise RefusedError(
                f"you have uploaded {own} tables without submitting them (all users: {total}), and the limits are "
                f"{MOST_OF_USER} and {MOST_OF_ALL}; submit jobs with them, or try again in {LEASE_S / 60:.0f} minutes, "
                "when abandoned uploads are deleted"
            )
        self._begun[user, session] += 1
        key = f"{digest} {user or session}" if digest in self._keys or self._store.is_begun(digest) else digest
        begun = self._uploads[upload_id] = _Upload(user, digest, upload.size, key, self._now())
        self._keys.add(key)
        return begun

    def _forget(self, upload_id: tuple[str, str | None, str]) -> None:
        """Forget an upload, and delete its chunks unless it is complete."""
        own = self._uploads.pop(upload_id, None)
        if own is None:
            return
        self._sent[own.user] -= own.sent
        if not self._sent[own.user]:
            del self._sent[own.user]
        self._begun[upload_id[1:]] -= 1
        if not self._begun[upload_id[1:]]:
            del self._begun[upload_id[1:]]
        if not own.is_whole:
            self._keys.discard(own.key)
            if own.count and not self._store.has_blob(own.key):
                self._store.delete_unused_blobs([own.key])

    @staticmethod
    def _id_of(digest: str, user: str | None, session: str) -> tuple[str, str | None, str]:
        return digest, user, "" if user is not None else session

    def renew(self, digest: str) -> None:
        """Renew the lease of a table that no job uses."""
        self._heard[digest] = self._now()

    def has(self, digest: str, user: str | None, viewer: Viewer | None, session: str) -> bool:
        """Return whether a user has sent a whole table, or sees a job with it; always true without a viewer."""
        own = self._uploads.get(self._id_of(digest, user, session))
        return viewer is None or (own is not None and own.is_whole) or self._store.uses_table(digest, viewer)

    def end(self, digest: str, user: str | None, session: str) -> None:
        """Record that a job of a user uses a table, which is then no longer an upload."""
        self._forget(self._id_of(digest, user, session))

    def pending_bytes(self, user: str | None, but: str, session: str) -> tuple[int, int]:
        """Return the bytes that a user, and all users, have uploaded and not submitted, without the user's table
        `but`."""
        own = self._uploads.get(self._id_of(but, user, session))
        left_out = own.sent if own is not None else 0
        return self._sent[user] - left_out, self._sent.total() - left_out

    def expire(self) -> None:
        """Delete uploads whose leases have ended, at intervals; if the disk is nearly full, delete all uploads."""
        room = self._store.room()
        if room is not None and room.free < reserve_of(room) / 2:
            self.delete_all()
        elif self._now() >= self._check_at:
            self._delete_expired()

    def _delete_expired(self) -> None:
        now = self._now()
        self._check_at = now + CHECK_INTERVAL_S
        for upload_id, own in [*self._uploads.items()]:
            heard = max(own.heard, self._heard.get(own.digest, 0.0) if own.is_whole else 0.0)
            if now - heard > LEASE_S:
                self._forget(upload_id)
        lasting = {own.digest if own.is_whole else own.key for own in self._uploads.values()}
        self._heard = {key: self._heard.get(key, now) for key in self._store.unused_blobs()}
        expired = [key for key, heard in self._heard.items() if now - heard > LEASE_S and key not in lasting]
        if expired:
            self._store.delete_unused_blobs(expired)

    def delete_all(self) -> None:
        """Delete all uploads that no job uses; their clients learn that all chunks are missing, and upload again.

        Also called when a coordinator starts, because the store does not record which user has sent which bytes.
        """
        unused, self._heard = self._store.unused_blobs(), {}
        self._uploads, self._sent, self._begun, self._keys = {}, Counter(), Counter(), set()
        if unused:
            self._store.delete_unused_blobs(unused)

    def _check_room(self, upload: Upload, own: _Upload | None) -> None:
        """Raise RefusedError if there is no space for an upload, even after expired uploads are deleted."""
        sent = own.sent if own is not None and own.size == upload.size else 0
        if self._refusal(upload.size - sent) is None:
            return
        self._delete_expired()
        refusal = self._refusal(upload.size - sent)
        if refusal is not None:
            raise RefusedError(
                f"{refusal}; an upload of {upload.size} bytes does not fit: delete ended jobs (coordinator delete ID), "
                "ask for the coordinator to be restarted with a smaller --keep, or try again in "
                f"{LEASE_S / 60:.0f} minutes, when abandoned uploads are deleted"
            )

    def _refusal(self, missing: int) -> str | None:
        """Return why there is no space for this number of bytes; None: there is space."""
        stored = self._store.blob_bytes()
        if stored + missing > MAX_STORED_BYTES:
            return (
                f"the coordinator's store has {stored} bytes of tables and datasets, and at most {MAX_STORED_BYTES} "
                "are allowed"
            )
        room = self._store.room()
        if room is None or room.free - missing >= reserve_of(room):
            return None
        return (
            f"the coordinator's disk has {room.free} free bytes, of which {reserve_of(room)} are reserved for existing "
            "jobs"
        )


def reserve_of(room: Room) -> int:
    """Return the bytes of a disk that uploads must not use."""
    wanted = min(max(RESERVED_SHARE * room.total, LEAST_RESERVE), MOST_RESERVE)
    return round(min(wanted, MOST_RESERVED_SHARE * room.total))
