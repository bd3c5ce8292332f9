"""A disk in memory under the real store: what was committed outlives its coordinator, which can die at any call.

Every method of the store is one transaction, so a coordinator dies before one or after it, never in between.
"""

import sqlite3
from collections.abc import Callable
from typing import Any, Final

from atoll_coordinator.service.store.open_file import Room
from atoll_coordinator.service.store.schema import _prepare
from atoll_coordinator.service.store.store import Store
from atoll_core.config import Frozen
from atoll_core.errors import StoreError
from atoll_core.wire.codec import encode

READS: Final = frozenset({
    "job", "jobs", "open_jobs", "views", "job_page", "count_jobs", "submitter", "is_deleted", "result", "cuts",
    "checkpoints", "state", "whole_checkpoints", "events", "has_blob", "is_begun", "is_sound", "get_blob", "get_chunk",
    "blob_bytes", "deaths", "oldest_ended_job", "is_seen", "uses_table", "uses_table_of", "blob_size",
    "is_queue_paused", "cordons", "usage", "held", "count_holders",
    "first_to_delete", "has_search", "unused_blobs", "timing", "check", "close",
    "room", "beat", "size_bytes",
})  # fmt: skip
"""What needs no room: it answers on a full disk as well, and no coordinator dies of it."""

FULL: Final = "the job store cannot be written (the disk is full); make room, then start it again"


class Elsewhere(Frozen):
    """What another version of Atoll may have stored."""

    another: str = "version"


class CoordinatorDied(BaseException):
    """Raised in the middle of what the coordinator does; nothing of its own catches it."""


class Disk:
    """Keeps the database while no coordinator has it open.

    `slow_s`: how long an access takes now; `room`: what it answers who asks for room, None: it does not say.
    """

    def __init__(self) -> None:
        self.slow_s = 0.0
        self.is_full = False
        self.room: Room | None = None
        self.commits = 0
        self._connection = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
        self._death: tuple[int, bool] | None = None

    def open(self, spend: Callable[[float], None], now: Callable[[], float] = lambda: 0.0) -> "DiskStore":
        """Open the store as a new incarnation; `spend` lets the coordinator be busy, `now` gives seconds."""
        _prepare(self._connection, None)
        return DiskStore(self, Store(self._connection, None, None, now), spend)

    def close(self) -> None:
        self._connection.close()

    def die_at(self, commits: int, before: bool) -> None:
        """Let the coordinator die at so many commits from now, before or after it."""
        self._death = (self.commits + commits, before)

    def forget_death(self) -> None:
        self._death = None

    def is_deadly(self, before: bool) -> bool:
        """Tell whether the commit counted last is the one to die at, on this side of it."""
        if self._death is None or self._death != (self.commits, before):
            return False
        self._death = None
        return True

    def grow_old(self) -> int:
        """Turn what was stored of searches that go on into another version's; return of how many archipelagos."""
        live = "job IN (SELECT id FROM jobs WHERE state NOT IN ('done', 'failed', 'cancelled'))"
        words = encode(Elsewhere())
        changes = (
            f"UPDATE archipelagos SET cut = ? WHERE cut IS NOT NULL AND {live}",
            f"UPDATE checkpoints SET progress = ? WHERE {live}",
        )
        return sum(self._connection.execute(change, (words,)).rowcount for change in changes)

    def cuts(self) -> int:
        """Return how many archipelagos have ended."""
        (count,) = self._connection.execute("SELECT count(*) FROM archipelagos WHERE cut IS NOT NULL").fetchone()
        return int(count)

    def rows(self, table_part: str) -> int:
        """Return how many rows the tables have whose names contain `table_part`."""
        names = self._connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
        counts = [
            self._connection.execute(f"SELECT count(*) FROM {name}").fetchone()[0]
            for (name,) in names
            if table_part in name
        ]
        return sum(counts)


class DiskStore:
    """The real store as one incarnation of the coordinator has it; after that one's death it does nothing more."""

    def __init__(self, disk: Disk, store: Store, spend: Callable[[float], None]) -> None:
        self.is_dead = False
        self._disk = disk
        self._store = store
        self._spend = spend

    def room(self) -> Room | None:
        """Return what room there is."""
        return self._disk.room

    def beat(self) -> None:
        """Meet no disk: nothing is written, and there is no standby."""
        if self.is_dead:
            raise CoordinatorDied

    def __getattr__(self, name: str) -> Any:
        inner = getattr(self._store, name)
        if not callable(inner):
            return inner

        def call(*arguments: object, **named: object) -> object:
            self._meet(name, before=True)
            answer = inner(*arguments, **named)
            self._meet(name, before=False)
            return answer

        return call

    def _meet(self, name: str, before: bool) -> None:
        if self.is_dead:
            raise CoordinatorDied
        if before and self._disk.slow_s:
            self._spend(self._disk.slow_s)
        if name in READS:
            return
        if before and self._disk.is_full:
            raise StoreError(FULL)
        self._disk.commits += before
        if self._disk.is_deadly(before):
            raise CoordinatorDied
