"""A coordinator on standby: waits for a store until the one that serves from it has died or hangs, then takes it over.

On one machine only: that a process has died is told by its lock, which the system takes from it at once. On a network
file system a lock may outlive its machine, and the shared memory of SQLite's WAL does not reach another one.
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
"""How long a coordinator may be without a beat, thirty of its ticks, before it is taken for hung: as long as it bears
the silence of a worker. To take over from one that is only slow costs unfinished preparing and refining, no answer."""

LOOK_S: Final = 0.25
"""How often it is looked: that much later at most a death is noticed."""


class Silence:
    """How long a lock has shown no beat. Pure; looks come in with their times, in seconds that only rise.

    Between two looks no more than twice `LOOK_S` counts: whoever was stopped itself has seen nothing meanwhile.
    """

    def __init__(self) -> None:
        self._beat: Beat | None = None
        self._looked_at: float | None = None
        self._silent_s = 0.0

    def look(self, beat: Beat | None, now: float) -> bool:
        """Take in a look (None: a lock that never beats); return whether its coordinator is taken for hung."""
        step = min(now - self._looked_at, 2 * LOOK_S) if self._looked_at is not None else 0.0
        self._silent_s = self._silent_s + step if beat == self._beat else 0.0
        self._beat, self._looked_at = beat, now
        return beat is not None and self._silent_s >= SILENCE_S


class Standby:
    """Waits for the store in a directory. What is said, at most once in a row, goes to `say`."""

    def __init__(
        self, directory: Path, stop: threading.Event, obstacle: Callable[[], str | None], say: Callable[[str], None]
    ) -> None:
        """Set up.

        Args:
            directory: of the store.
            stop: set when it is no longer to be waited.
            obstacle: why this coordinator could not serve while one that hangs is still there; None: it could.
            say: shows a sentence to people.
        """
        self._directory = directory
        self._stop = stop
        self._obstacle = obstacle
        self._say = say
        self._silence = Silence()
        self._said = ""

    def store(self) -> Store | None:
        """Return the store, open, once it is ours; None when `stop` was set before.

        Raises:
            StoreError: It is nobody's, and cannot be opened.
        """
        while not self._stop.is_set():
            store = self._free() or self._hung()
            if store is not None:
                return store
            self._stop.wait(LOOK_S)
        return None

    def _free(self) -> Store | None:
        """Return the store if no coordinator has its lock."""
        try:
            return Store.open(self._directory)
        except StoreInUseError as error:
            self._tell(
                f"{str(error).partition(';')[0]}; this one is on standby, and takes over when that one has ended or "
                f"has shown no sign of life for {SILENCE_S:.0f} s"
            )
        return None

    def _hung(self) -> Store | None:
        """Return the store if the coordinator that has its lock hangs, and ours could serve beside it."""
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
        except StoreError as error:  # it may hang in the midst of a transaction, and then SQLite's lock holds
            self._tell(
                f"the coordinator that serves {self._directory} hangs, and the store cannot be taken from it yet "
                f"({error}); end its process"
            )
        return None

    def _tell(self, sentence: str) -> None:
        if sentence != self._said:
            self._said = sentence
            self._say(sentence)
