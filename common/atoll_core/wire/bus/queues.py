"""The queues of a real bus: items that wait by party (`Turns`), incoming events (`Inbox`), timers, answers (`Outbox`).

A party is a user, or without certificates a session on the bus, since one session may use thousands of client names.
Parties take turns, and so do the clients of one party, so that no party can delay the others by sending more.

The owner of a bus never waits for a client that reads nothing: answers are sent by threads of the outbox. An answer to
a stopped client blocks inside zenoh until the bus closes the client's link. Therefore small and large answers have
separate threads, and a party has at most one thread of each kind, because its answers usually share one link: stopped
clients delay other parties only when as many parties have stopped clients as there are threads.
"""

import contextlib
import logging
import math
import queue
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Container
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from atoll_core.errors import LocalProtocolError
from atoll_core.wire.bus.interface import MAX_PAYLOAD, Event, Message, Query, Reply

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Bounds:
    """How many things of one client, of one party and of all may wait, and bytes of one party and of all."""

    of_client: int
    of_party: int
    of_all: int
    bytes_of_party: int
    bytes_of_all: int


class _Line(Generic[T]):
    """What waits of one party, by client, with its sizes."""

    def __init__(self, bounds: Bounds) -> None:
        self.waiting = self.bytes = 0
        self._bounds = bounds
        self._clients: OrderedDict[str, deque[tuple[T, int]]] = OrderedDict()

    def has_room(self, client: str, size: int) -> bool:
        is_full = self.waiting >= self._bounds.of_party or self.bytes + size > self._bounds.bytes_of_party
        return not is_full and len(self._clients.get(client, ())) < self._bounds.of_client

    def add(self, client: str, item: T, size: int) -> None:
        self._clients.setdefault(client, deque()).append((item, size))
        self.waiting += 1
        self.bytes += size

    def take(self) -> tuple[T, int]:
        """Return what comes next of the client whose turn it is; the client goes to the end."""
        client, items = self._clients.popitem(last=False)
        item, size = items.popleft()
        if items:
            self._clients[client] = items
        self.waiting -= 1
        self.bytes -= size
        return item, size


class Turns(Generic[T]):
    """Lines of things that wait, by party."""

    def __init__(self, bounds: Bounds) -> None:
        self.refused = 0
        """How many were refused, since too many waited already."""
        self._bounds = bounds
        self._lines: OrderedDict[str, _Line[T]] = OrderedDict()
        self._waiting = self._bytes = 0

    def __len__(self) -> int:
        return self._waiting

    def add(self, party: str, client: str, item: T, size: int = 0) -> bool:
        """Let something of `size` bytes wait; return False when too much does."""
        line = self._lines.get(party) or _Line[T](self._bounds)
        is_full = self._waiting >= self._bounds.of_all or self._bytes + size > self._bounds.bytes_of_all
        if is_full or not line.has_room(client, size):
            self.refused += 1
            return False
        line.add(client, item, size)
        self._lines[party] = line
        self._waiting += 1
        self._bytes += size
        return True

    def take(self) -> T | None:
        """Return what comes next of the party whose turn it is; the party goes to the end."""
        return self.take_of()[1]

    def take_of(self, but: Container[str] = ()) -> tuple[str, T | None]:
        """Return whose turn it is of the parties that are not among `but`, and what comes next; None: nothing does."""
        party = next((party for party in self._lines if party not in but), None)
        if party is None:
            return "", None
        line = self._lines.pop(party)
        item, size = line.take()
        self._waiting -= 1
        self._bytes -= size
        if line.waiting:
            self._lines[party] = line
        return party, item


INBOX_BYTES: Final = 8 * MAX_PAYLOAD
_LONGEST_WAIT_S: Final = 3600.0
_EVENT_BYTES: Final = 200


class Inbox:
    """Events on their way to the owner. Messages and queries beyond `INBOX_BYTES` are lost, as a put may be."""

    def __init__(self) -> None:
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._bytes = 0
        self.dropped = 0

    def add(self, event: Event) -> None:
        """Hand in an event; from any thread, never blocking."""
        size = _size(event)
        with self._lock:
            if isinstance(event, Message | Query) and self._bytes + size > INBOX_BYTES:
                self.dropped += 1
                return
            self._bytes += size
        self._events.put(event)

    def take(self, timeout_s: float) -> Event | None:
        """Return the oldest event, waiting at most `timeout_s` (a wait may end early, with None)."""
        try:
            wait_s = min(timeout_s, _LONGEST_WAIT_S)
            event = self._events.get(timeout=wait_s) if wait_s > 0.0 else self._events.get_nowait()
        except queue.Empty:
            return None
        with self._lock:
            self._bytes -= _size(event)
        return event


class Timers:
    """Named alarms, each with at most one time."""

    def __init__(self) -> None:
        self._times: dict[str, float] = {}

    def add(self, time_s: float, name: str) -> None:
        """Set alarm `name` to `time_s`, whatever it was set to before."""
        self._times[name] = time_s

    def next_time(self) -> float:
        """Return the time of the first alarm; infinity when there is none."""
        return min(self._times.values(), default=math.inf)

    def pop_due(self, now: float) -> str | None:
        """Remove and return the first alarm whose time is `now` or earlier."""
        due = [(time_s, name) for name, time_s in self._times.items() if time_s <= now]
        if not due:
            return None
        _, name = min(due)
        del self._times[name]
        return name


def _size(event: Event) -> int:
    payload = event.payload if isinstance(event, Message | Query | Reply) else None
    return _EVENT_BYTES + len(payload or b"")


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
