"""A bus that counts what goes through it, by kind: what the key says it is (report, mail, status, ask …)."""

from functools import lru_cache
from typing import Final

from atoll_core.errors import RemoteProtocolError
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Bus, Event, Message, Query, Reply
from atoll_core.wire.messages.views import Traffic

OTHER: Final = "other"
"""The kind of whatever lies under none of our keys."""


class MeteredBus:
    """A `Bus` around another one. Its owner counts what it receives by `count_received`."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._asked: dict[int, str] = {}
        self._counts: dict[str, list[int]] = {}
        self.subscribe = bus.subscribe  # what is not counted is the other's
        self.serve = bus.serve
        self.announce = bus.announce
        self.watch = bus.watch
        self.now = bus.now
        self.call_later = bus.call_later
        self.post = bus.post
        self.receive = bus.receive

    @property
    def dropped(self) -> int:
        """See `Bus.dropped`."""
        return self._bus.dropped

    def count_received(self, event: Event) -> None:
        """Count an event that was received."""
        if isinstance(event, Message | Query):
            self._count(kind_of(event.key), 0, len(event.payload))
        elif isinstance(event, Reply):
            kind = self._asked.pop(event.token, OTHER)
            if event.payload is not None:
                self._count(kind, 0, len(event.payload))

    def traffic(self) -> tuple[Traffic, ...]:
        """Return what has gone through, kinds in alphabetical order; bytes are those of payloads."""
        return tuple(
            Traffic(kind=kind, messages_in=counts[0], bytes_in=counts[1], messages_out=counts[2], bytes_out=counts[3])
            for kind, counts in sorted(self._counts.items())
        )

    def put(self, key: str, payload: bytes) -> None:
        """See `Bus.put`."""
        self._count(kind_of(key), 2, len(payload))
        self._bus.put(key, payload)

    def get(self, key: str, payload: bytes = b"", timeout_s: float = 5.0) -> int:
        """See `Bus.get`."""
        kind = kind_of(key)
        self._count(kind, 2, len(payload))
        token = self._bus.get(key, payload, timeout_s)
        self._asked[token] = kind
        return token

    def reply(self, query: Query, payload: bytes | None, party: str | None = None) -> None:
        """See `Bus.reply`."""
        self._count(kind_of(query.key), 2, len(payload or b""))
        self._bus.reply(query, payload, party)

    def _count(self, kind: str, place: int, size: int) -> None:
        counts = self._counts.setdefault(kind, [0, 0, 0, 0])
        counts[place] += 1
        counts[place + 1] += size


@lru_cache(4096)
def kind_of(key: str) -> str:
    """Return what a key is for, in a word: `OTHER` for one that is none of ours."""
    try:
        parsed = topics.parse(key)
    except RemoteProtocolError:
        return OTHER
    if isinstance(parsed, topics.WorkerKey):
        return parsed.part
    return _KINDS[type(parsed)]


_KINDS: Final[dict[type, str]] = {
    topics.HelloKey: "hello",
    topics.ControlKey: "control",
    topics.JobKey: "job",
    topics.PlacementKey: "placement",
    topics.StateKey: "state",
    topics.BlobKey: "blob",
    topics.MailKey: "mail",
    topics.ClientKey: "ask",
    topics.ChangesKey: "changes",
}
