"""The queues of a real bus: items that wait by party (`Turns`), incoming events (`Inbox`), timers, answers (`Outbox`).

A party is a user, or without certificates a session on the bus, since one session may use thousands of client names.
Parties take turns, and so do the clients of one party, so that no party can delay the others by sending more.

The owner of a bus never waits for a client that reads nothing: answers are sent by threads of the outbox. An answer to
a stopped client blocks inside zenoh until the bus closes the client's link. Therefore small and large answers have
separate threads. A party has at most one thread of each kind, because its answers usually share one link. So stopped
clients delay other parties only if as many parties have stopped clients as there are threads.
"""

import contextlib
import logging
import math
import queue
import threading
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Container
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from atoll_core.errors import LocalProtocolError
from atoll_core.wire.bus.interface import MAX_PAYLOAD, Event, Message, Query, Reply

T = TypeVar("T")
_LOG: Final = logging.getLogger(__name__)

INBOX_BYTES: Final = 8 * MAX_PAYLOAD
_LONGEST_WAIT_S: Final = 3600.0
_EVENT_BYTES: Final = 200

LARGE: Final = 256 * 1024
"""An answer of at least this number of bytes is large."""

THREADS: Final = 16
"""Number of threads for small answers, and of threads for large answers. A thread is started when there are answers for
it."""

MAX_LARGE_OF_PARTY: Final = 8
"""Large answers of one party that may wait. Further requests of the party are refused, and it asks again."""

_MAX_SMALL_OF_PARTY: Final = 4096
_MAX_BYTES_OF_PARTY: Final = 64 * 1024**2
"""Largest number of bytes of a party's waiting answers, small and large answers counted separately: as much as the
largest payload (`interface.MAX_PAYLOAD`)."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits of waiting items of a client, of a party and of all, and of their bytes for a party and for all."""

    of_client: int
    of_party: int
    of_all: int
    bytes_of_party: int
    bytes_of_all: int


class Turns(Generic[T]):
    """Waiting items by party and client; parties take turns, and so do the clients of a party. Pure."""

    def __init__(self, bounds: Bounds) -> None:
        self.refused = 0
        """Number of items that were refused because too many waited."""
        self._bounds = bounds
        self._lines: OrderedDict[str, OrderedDict[str, deque[tuple[T, int]]]] = OrderedDict()
        self._waiting: Counter[str] = Counter()
        self._bytes: Counter[str] = Counter()
        self._all_waiting = self._all_bytes = 0

    def __len__(self) -> int:
        return self._all_waiting

    def add(self, party: str, client: str, item: T, size: int = 0) -> bool:
        """Append an item of `size` bytes; return False when too much waits already."""
        bounds = self._bounds
        clients = self._lines.get(party, OrderedDict())
        if (
            self._all_waiting >= bounds.of_all
            or self._all_bytes + size > bounds.bytes_of_all
            or self._waiting[party] >= bounds.of_party
            or self._bytes[party] + size > bounds.bytes_of_party
            or len(clients.get(client, ())) >= bounds.of_client
        ):
            self.refused += 1
            return False
        clients.setdefault(client, deque()).append((item, size))
        self._lines[party] = clients
        self._count(party, 1, size)
        return True

    def take(self) -> T | None:
        """Return the next item of the party whose turn it is; the party goes to the end."""
        return self.take_of()[1]

    def take_of(self, but: Container[str] = ()) -> tuple[str, T | None]:
        """Return the party whose turn it is, except parties in `but`, and its next item; None: nothing waits."""
        party = next((party for party in self._lines if party not in but), None)
        if party is None:
            return "", None
        clients = self._lines.pop(party)
        client, items = clients.popitem(last=False)
        item, size = items.popleft()
        if items:
            clients[client] = items
        if clients:
            self._lines[party] = clients
        self._count(party, -1, -size)
        return party, item

    def _count(self, party: str, items: int, size: int) -> None:
        self._waiting[party] += items
        self._bytes[party] += size
        self._all_waiting += items
        self._all_bytes += size
        if not self._waiting[party]:
            del self._waiting[party], self._bytes[party]


class Inbox:
    """Events on their way to the owner. Messages and queries beyond `INBOX_BYTES` are lost, as a put may be."""

    def __init__(self) -> None:
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._bytes = 0
        self.dropped = 0

    def add(self, event: Event) -> None:
        """Add an event; from any thread, never blocking."""
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


def _size(event: Event) -> int:
    payload = event.payload if isinstance(event, Message | Query | Reply) else None
    return _EVENT_BYTES + len(payload or b"")


class Timers:
    """Named timers, each with at most one time."""

    def __init__(self) -> None:
        self._times: dict[str, float] = {}

    def add(self, time_s: float, name: str) -> None:
        """Set timer `name` to `time_s`; an earlier setting of the same name is replaced."""
        self._times[name] = time_s

    def next_time(self) -> float:
        """Return the time of the first timer; infinity without one."""
        return min(self._times.values(), default=math.inf)

    def pop_due(self, now: float) -> str | None:
        """Remove and return the first timer whose time is `now` or earlier."""
        due = [(time_s, name) for name, time_s in self._times.items() if time_s <= now]
        if not due:
            return None
        _, name = min(due)
        del self._times[name]
        return name


class Outbox:
    """Answers of each party that wait for a sending thread; large and small answers wait separately."""

    def __init__(self) -> None:
        self._small = _Senders("sending answers", _MAX_SMALL_OF_PARTY, 8 * _MAX_SMALL_OF_PARTY)
        self._large = _Senders("sending large answers", MAX_LARGE_OF_PARTY, THREADS * MAX_LARGE_OF_PARTY)

    def add(self, party: str, size: int, send: Callable[[], object]) -> bool:
        """Have `send` called by a thread when it is the turn of `party`; return False when too many answers wait."""
        return (self._large if size >= LARGE else self._small).add(party, size, send)

    def close(self) -> None:
        """Return when all waiting answers have been sent or given up; later answers are lost. Repeatable."""
        self._small.close()
        self._large.close()


class _Senders:
    """Threads that send answers."""

    def __init__(self, name: str, of_party: int, of_all: int) -> None:
        bounds = Bounds(of_party, of_party, of_all, _MAX_BYTES_OF_PARTY, 8 * _MAX_BYTES_OF_PARTY)
        self._turns = Turns[Callable[[], object]](bounds)
        self._busy: set[str] = set()
        self._lock = threading.Lock()
        self._threads = ThreadPoolExecutor(THREADS, name)  # starts no thread before its first task
        self.close = self._threads.shutdown

    def add(self, party: str, size: int, send: Callable[[], object]) -> bool:
        with self._lock:
            if not self._turns.add(party, "", send, size):
                return False
        with contextlib.suppress(RuntimeError):  # closed
            self._threads.submit(self._send)
        return True

    def _send(self) -> None:
        """Send waiting answers of parties that no other thread serves now; the other threads send the rest."""
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
            except Exception:  # an error ends this answer, but not later answers
                _LOG.exception("an answer could not be sent")
            finally:
                with self._lock:
                    self._busy.discard(party)
