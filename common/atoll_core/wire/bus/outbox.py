"""Answers of a real bus on their way out, sent by threads of its own: the owner waits for no asker that takes nothing.

An answer to a client that has stopped waits inside zenoh until the bus gives the client up. Small answers and large
ones have threads of their own. Parties take turns. One party has one thread of each kind at most, since its answers
share a link in most cases: stopped clients keep other parties from their answers only when as many parties have stopped
as there are threads.
"""

import contextlib
import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from atoll_core.errors import LocalProtocolError
from atoll_core.wire.bus.turns import Bounds, Turns

_LOG: Final = logging.getLogger(__name__)

LARGE: Final = 256 * 1024
"""Bytes from which on an answer is a large one."""

THREADS: Final = 16
"""Threads of each kind. They are started when there are answers for them."""

MAX_LARGE_OF_PARTY: Final = 8
"""Large answers of one party that may wait. Who asks for one more is told to ask again."""

_MAX_LARGE: Final = THREADS * MAX_LARGE_OF_PARTY
_MAX_SMALL_OF_PARTY: Final = 4096
_MAX_SMALL: Final = 8 * _MAX_SMALL_OF_PARTY
_MAX_BYTES_OF_PARTY: Final = 64 * 1024**2
_MAX_BYTES: Final = 8 * _MAX_BYTES_OF_PARTY
"""Of answers of a kind that wait. One party may have the largest payload of a bus (`interface.MAX_PAYLOAD`) wait."""


class Outbox:
    """Answers that wait for a thread that sends them, by party; large ones and small ones."""

    def __init__(self) -> None:
        self._small = _Senders(
            "sending answers",
            Bounds(_MAX_SMALL_OF_PARTY, _MAX_SMALL_OF_PARTY, _MAX_SMALL, _MAX_BYTES_OF_PARTY, _MAX_BYTES),
        )
        self._large = _Senders(
            "sending large answers",
            Bounds(MAX_LARGE_OF_PARTY, MAX_LARGE_OF_PARTY, _MAX_LARGE, _MAX_BYTES_OF_PARTY, _MAX_BYTES),
        )

    def add(self, party: str, size: int, send: Callable[[], object]) -> bool:
        """Have `send` called by a thread when it is the turn of `party`; return False when too many answers wait."""
        return (self._large if size >= LARGE else self._small).add(party, size, send)

    def close(self) -> None:
        """Return when all answers that wait have been sent or given up; later ones are lost. Repeatable."""
        self._small.close()
        self._large.close()


class _Senders:
    """Threads that send the answers of one kind."""

    def __init__(self, name: str, bounds: Bounds) -> None:
        self._turns = Turns[Callable[[], object]](bounds)
        self._busy: set[str] = set()
        self._lock = threading.Lock()
        self._threads = ThreadPoolExecutor(THREADS, name)  # has no thread before its first task

    def add(self, party: str, size: int, send: Callable[[], object]) -> bool:
        with self._lock:
            if not self._turns.add(party, "", send, size):
                return False
        with contextlib.suppress(RuntimeError):  # closed
            self._threads.submit(self._send)
        return True

    def close(self) -> None:
        self._threads.shutdown()

    def _send(self) -> None:
        """Send what waits of parties of which no thread sends anything; what is left, their threads send."""
        while True:
            with self._lock:
                party, send = self._turns.take_of(self._busy)
                if send is None:
                    return
                self._busy.add(party)
            try:
                send()
            except LocalProtocolError:  # the bus refused it, and the asker asks again
                pass
            except Exception:  # it may end this answer, but no later one of the party
                _LOG.exception("an answer could not be sent")
            finally:
                with self._lock:
                    self._busy.discard(party)
