"""A bus that counts messages and bytes by the kind in their keys: report, pull, status, ask and so on."""

from collections import Counter, defaultdict
from functools import lru_cache
from typing import Final

from atoll_core.errors import RemoteProtocolError
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Bus, Event, Message, Query, Reply
from atoll_core.wire.messages.views import Traffic

OTHER: Final = "other"
"""The kind of foreign keys."""


class MeteredBus:
    """A `Bus` around another one. Its owner counts received events by `count_received`."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._asked: dict[int, str] = {}
        self._counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
        self.subscribe = bus.subscribe  # these calls are not counted
        self.serve = bus.serve
        self.announce = bus.announce
        self.watch = bus.watch
        self.now = bus.now
        self.call_later = bus.call_later
        self.post = bus.post
        self.receive = bus.receive

    @property
    def dropped(self) -> int:
        return self._bus.dropped

    def count_received(self, event: Event) -> None:
        """Count an event that was received."""
        if isinstance(event, Message | Query):
            self._counts[kind_of(event.key)].update(messages_in=1, bytes_in=len(event.payload))
        elif isinstance(event, Reply):
            kind = self._asked.pop(event.token, OTHER)
            if event.payload is not None:
                self._counts[kind].update(messages_in=1, bytes_in=len(event.payload))

    def traffic(self) -> tuple[Traffic, ...]:
        """Return messages and bytes of payloads so far, kinds in alphabetical order."""
        return tuple(Traffic(kind=kind, **counts) for kind, counts in sorted(self._counts.items()))

    def put(self, key: str, payload: bytes) -> None:
        self._count_sent(key, payload)
        self._bus.put(key, payload)

    def get(self, key: str, payload: bytes = b"", timeout_s: float = 5.0) -> int:
        self._count_sent(key, payload)
        token = self._bus.get(key, payload, timeout_s)
        self._asked[token] = kind_of(key)
        return token

    def reply(self, query: Query, payload: bytes | None, party: str | None = None) -> None:
        self._count_sent(query.key, payload)
        self._bus.reply(query, payload, party)

    def _count_sent(self, key: str, payload: bytes | None) -> None:
        self._counts[kind_of(key)].update(messages_out=1, bytes_out=len(payload or b""))


@lru_cache(4096)
def kind_of(key: str) -> str:
    """Return the kind of a key in a word; `OTHER` for a foreign key."""
    try:
        parsed = topics.parse(key)
    except RemoteProtocolError:
        return OTHER
    match parsed:
        case topics.HelloKey():
            return "hello"
        case topics.ControlKey():
            return "control"
        case topics.StatesKey():
            return "state"
        case topics.BlobKey():
            return "blob"
    return parsed.part
