"""Uploads of tables, and what becomes of those that no job uses: each has a lease, which every message about it renews.

They count neither in the retention of jobs nor are they deleted while they go on, but where the disk is nearly full:
a store that cannot be written ends the coordinator, and with it everybody's search.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from atoll_coordinator.service.store.jobs import Viewer
from atoll_coordinator.service.store.open_file import Room
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import RefusedError
from atoll_core.wire.messages.clients import Upload, Uploaded
from atoll_core.wire.messages.limits import CHUNK_LIMIT_S, CHUNK_SIZE, chunk_count

MAX_STORED_BYTES: Final = 16 * 1024**3
"""Uploads are refused when all tables and datasets together would take more than this."""

LEAST_RESERVE: Final = 256 * 1024**2
MOST_RESERVE: Final = 2 * 1024**3
RESERVED_SHARE: Final = 0.05
MOST_RESERVED_SHARE: Final = 0.25
"""Bytes and shares of the disk that uploads leave to checkpoints and results; on small disks the last one decides."""

LEASE_S: Final = 5 * CHUNK_LIMIT_S
"""A client that goes on says something within `CHUNK_LIMIT_S`, or gives up; the factor is for one that tries again."""

CHECK_INTERVAL_S: Final = 60.0
"""How often uploads whose leases are over are looked for."""


@dataclass(frozen=True, slots=True)
class _Shown:
    """Which chunks of a table somebody has shown to have; `size` is that of the table, in bytes."""

    size: int
    chunks: set[int]


class Uploads:
    """All tables that are uploaded or have been, and that no job uses yet."""

    def __init__(self, store: Store, now: Callable[[], float]) -> None:
        """`now` gives the bus's seconds. What the store has already counts as heard of at the first look."""
        self._store = store
        self._now = now
        self._heard: dict[str, float] = {}
        self._check_at = 0.0
        self._shown: dict[tuple[str, str | None], _Shown] = {}

    def take(self, upload: Upload, user: str | None = None, viewer: Viewer | None = None) -> Uploaded:
        """Keep a chunk, or only tell which are missing; raises RefusedError for what is damaged or does not fit.

        A `viewer` that sees no job with this table is told that all of it is missing that its `user` has not shown:
        whoever knows a digest alone has not the data, and is not to learn that they are there.
        """
        if upload.data is not None and hashlib.sha256(upload.data).hexdigest() != upload.sha256:
            raise RefusedError(f"part {upload.index + 1} of an upload was damaged on its way; send it again")
        self._check_room(upload)
        self._heard[upload.blob] = self._now()
        if upload.data is not None:
            self._store.put_chunk(upload.blob, upload.size, upload.index, upload.data)
        missing = self._store.missing_chunks(upload.blob, upload.size)
        shown = self._shown.setdefault((upload.blob, user), _Shown(upload.size, set()))
        if upload.data is not None and self._store.has_chunk(upload.blob, upload.index, upload.data):
            shown.chunks.add(upload.index)
        if viewer is not None and (missing or not self._store.uses_table(upload.blob, viewer)):
            missing = tuple(n for n in range(chunk_count(upload.size)) if n in missing or n not in shown.chunks)
        return Uploaded(blob=upload.blob, missing=missing)

    def renew(self, digest: str) -> None:
        """Take in that somebody still wants a table that no job uses."""
        if digest in self._heard:
            self._heard[digest] = self._now()

    def has(self, digest: str, user: str | None, viewer: Viewer | None) -> bool:
        """Tell whether a table is there as far as a user may know: it has shown all of it, or sees a job with it."""
        if viewer is None or self._store.uses_table(digest, viewer):
            return True
        shown = self._shown.get((digest, user))
        return shown is not None and len(shown.chunks) == chunk_count(shown.size)

    def pending_bytes(self, user: str | None, but: str) -> int:
        """Return how many bytes a user has begun to upload and not submitted yet, but for the table `but`."""
        own = ((digest, shown.size) for (digest, name), shown in self._shown.items() if name == user and digest != but)
        return sum(size for digest, size in own if not self._store.uses_table_of(digest, user))

    def expire(self) -> None:
        """Delete uploads whose leases are over, if it is time to look for them; all of them on a disk nearly full."""
        room = self._store.room()
        if room is not None and room.free < reserve_of(room) / 2:
            self._delete_all()
        elif self._now() >= self._check_at:
            self._delete_expired()

    def _delete_expired(self) -> None:
        now = self._now()
        self._check_at = now + CHECK_INTERVAL_S
        going_on = {digest for (digest, _), shown in self._shown.items() if shown.chunks}  # of others' tables, perhaps
        self._heard = {digest: self._heard.get(digest, now) for digest in going_on.union(self._store.unused_blobs())}
        expired = [digest for digest, heard in self._heard.items() if now - heard > LEASE_S]
        self._shown = {key: shown for key, shown in self._shown.items() if key[0] in self._heard.keys() - expired}
        if expired:
            self._store.delete_unused_blobs(expired)

    def _delete_all(self) -> None:
        """Delete all uploads that no job uses; who is at it is told that all of it is missing."""
        unused, self._heard, self._shown = self._store.unused_blobs(), {}, {}
        if unused:
            self._store.delete_unused_blobs(unused)

    def _check_room(self, upload: Upload) -> None:
        """Raise RefusedError for an upload that does not fit, also without those that were given up."""
        if self._refusal(upload) is None:
            return
        self._delete_expired()
        refusal = self._refusal(upload)
        if refusal is not None:
            raise RefusedError(
                f"{refusal}; an upload of {upload.size} bytes does not fit: delete jobs that "
                "have ended (coordinator delete ID), have the coordinator started with a smaller --keep, or try again "
                f"in {LEASE_S / 60:.0f} minutes, when uploads that were given up are deleted"
            )

    def _refusal(self, upload: Upload) -> str | None:
        """Return why there is no room for what is missing of an upload; None: there is."""
        if self._store.has_blob(upload.blob):
            return None
        others = self._store.blob_bytes(upload.blob)
        if others + upload.size > MAX_STORED_BYTES:
            return (
                f"the coordinator's store holds {others} bytes of tables and datasets and takes at most "
                f"{MAX_STORED_BYTES}"
            )
        room = self._store.room()
        missing = min(upload.size, CHUNK_SIZE * len(self._store.missing_chunks(upload.blob, upload.size)))
        if room is None or room.free - missing >= reserve_of(room):
            return None
        return (
            f"the coordinator's disk has room for {room.free} bytes more, of which {reserve_of(room)} are kept for the "
            "jobs that are there"
        )


def reserve_of(room: Room) -> int:
    """Return how many bytes of a disk uploads leave free."""
    wanted = min(max(RESERVED_SHARE * room.total, LEAST_RESERVE), MOST_RESERVE)
    return round(min(wanted, MOST_RESERVED_SHARE * room.total))
