"""Large answers of a real bus, sent by threads of its own: the owner waits for no asker that takes nothing.

Parties take turns. One party has one thread at most, since its answers share a line in most cases, so that askers that
have stopped keep no other party from its answers before as many parties have stopped as there are threads.
"""

import contextlib
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from atoll_core.errors import LocalProtocolError
from atoll_core.wire.bus.turns import Bounds, Turns

_SENDERS: Final = 4
"""Threads that send."""

MAX_OF_PARTY: Final = 8
"""Large answers of one party that may wait, an eighth of all: the same share as of questions."""

MAX_WAITING: Final = 64
"""Large answers of all parties that may wait. Who asks for one more is told to ask again."""

MAX_BYTES_OF_PARTY: Final = 64 * 1024**2
MAX_BYTES: Final = 8 * MAX_BYTES_OF_PARTY
"""Of answers that wait. One party may have the largest payload of a bus (`interface.MAX_PAYLOAD`) wait."""


class LargeAnswers:
    """Answers that wait for a thread that sends them, by party."""

    def __init__(self) -> None:
        self._turns = Turns[Callable[[], object]](
            Bounds(MAX_OF_PARTY, MAX_OF_PARTY, MAX_WAITING, MAX_BYTES_OF_PARTY, MAX_BYTES)
        )
        self._busy: set[str] = set()
        self._lock = threading.Lock()
        self._senders = ThreadPoolExecutor(_SENDERS, "sending large answers")  # has no thread before its first task

    def add(self, party: str, size: int, send: Callable[[], object]) -> bool:
        """Have `send` called by a thread when it is the turn of `party`; return False when too many answers wait."""
        with self._lock:
            if not self._turns.add(party, "", send, size):
                return False
        self._senders.submit(self._send)
        return True

    def _send(self) -> None:
        """Send what waits of parties of which no thread sends anything; what is left, their threads send."""
        while True:
            with self._lock:
                party, send = self._turns.take_of(self._busy)
                if send is None:
                    return
                self._busy.add(party)
            with contextlib.suppress(LocalProtocolError):  # the bus refused it, and the asker asks again
                send()
            with self._lock:
                self._busy.discard(party)
