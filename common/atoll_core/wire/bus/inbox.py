"""What waits for the owner of a real bus: events that other threads hand in, and timers."""

import math
import queue
import threading
from typing import Final

from atoll_core.wire.bus.interface import MAX_PAYLOAD, Event, Message, Query, Reply

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
