"""Blobs that tests put into a store."""

import hashlib

from atoll_coordinator.service.store.store import Store
from atoll_core.wire.messages.limits import CHUNK_SIZE, chunk_count


def put_blob(store: Store, data: bytes) -> str:
    """Store `data` as a complete upload; return its digest."""
    digest, last = hashlib.sha256(data).hexdigest(), chunk_count(len(data)) - 1
    for index in range(last + 1):
        piece = data[index * CHUNK_SIZE : (index + 1) * CHUNK_SIZE]
        store.put_chunk(digest, index, piece, digest if index == last else None)
    return digest
