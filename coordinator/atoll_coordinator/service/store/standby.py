"""A standby coordinator: waits until the coordinator that serves a store has died or hangs, then takes over the store.

Both coordinators must run on one machine. The serving process has a lock, which the operating system releases when the
process dies. A network file system is not supported: there a lock may stay after its machine is gone, and SQLite's WAL
needs memory that all processes of the store share.
"""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from atoll_coordinator.service.store.lock import Beat, Lock, StoreInUseError, last_beat
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import StoreError

SILENCE_S: Final = 15.0
"""A coordinator without a beat for this time (thirty ticks) is treated as hung; a silent worker is treated as lost
after the same time. If the coordinator is only slow, unfinished preparing and refining is repeated, and no result is
lost."""

LOOK_S: Final = 0.25
"""Seconds between two readings of the lock: the longest delay before a death is noticed."""


class Silence:
    """Measures for how long a lock has had no beat. Pure; times are arguments, in monotonic seconds.

    Between two readings of the lock at most twice `LOOK_S` counts: while this process itself was stopped, it could not
    see beats.
    """

    def __init__(self) -> None:
        self._beat: Beat | None = None
        self._looked_at: float | None = None
        self._silent_s = 0.0

    def look(self, beat: Beat | None, now: float) -> bool:
        """Add a reading of the lock (None: no beats); return whether its coordinator is treated as hung."""
        step = min(now - self._looked_at, 2 * LOOK_S) if self._looked_at is not None else 0.0
        self._silent_s = self._silent_s + step if beat == self._beat else 0.0
        self._beat, self._looked_at = beat, now
        return beat is not None and self._silent_s >= SILENCE_S


class Standby:
    """Waits for the store in a directory. A message goes to `say`, unless it equals the last message."""

    def __init__(
        self, directory: Path, stop: threading.Event, obstacle: Callable[[], str | None], say: Callable[[str], None]
    ) -> None:
        """Set up.

        Args:
            directory: The directory of the store.
            stop: Is set to end the wait.
            obstacle: Returns why this coordinator cannot serve while the hung coordinator exists; None: it can.
            say: Shows a message to the user.
        """
        self._directory = directory
        self._stop = stop
        self._obstacle = obstacle
        self._say = say
        self._silence = Silence()
        self._said = ""

    def store(self) -> Store | None:
        """Wait for the store and return it, opened; None: `stop` was set first.

        Raises:
            StoreError: No coordinator has the store, but it cannot be opened.
        """
        while not self._stop.is_set():
            store = self._take_free_store() or self._take_hung_store()
            if store is not None:
                return store
            self._stop.wait(LOOK_S)
        return None

    def _take_free_store(self) -> Store | None:
        """Return the store if no coordinator has its lock."""
        try:
            return Store.open(self._directory)
        except StoreInUseError as error:
            self._tell(
                f"{str(error).partition(';')[0]}; this one is on standby and takes over when the other has ended or "
                f"has shown no sign of life for {SILENCE_S:.0f} s"
            )
        return None

    def _take_hung_store(self) -> Store | None:
        """Return the store if its coordinator hangs and this coordinator can serve in its presence; else None."""
        beat = last_beat(self._directory)
        if not self._silence.look(beat, time.monotonic()) or beat is None:
            return None
        obstacle = self._obstacle()
        if obstacle is not None:
            self._tell(
                f"the coordinator that serves {self._directory} hangs, but its place cannot be taken: {obstacle}"
            )
            return None
        lock = Lock.seize(self._directory, beat)
        if lock is None:
            return None
        try:
            return Store.open(self._directory, lock=lock)
        except StoreError as error:  # a coordinator that hangs within a transaction has SQLite's lock
            self._tell(
                f"the coordinator that serves {self._directory} hangs, and the store cannot be taken from it yet "
                f"({error}); end its process"
            )
        return None

    def _tell(self, sentence: str) -> None:
        if sentence != self._said:
            self._said = sentence
            self._say(sentence)
