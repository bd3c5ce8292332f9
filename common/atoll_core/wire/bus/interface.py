"""The bus: what every participant may rely on, whatever carries the messages. Clock and timers belong to it too.

Promises, kept by every implementation and checked by one contract suite (tests/contract):

*Threading.* A bus belongs to one owner thread, which alone calls `receive`. Everything that happens (a message, a
query, a reply, a participant coming or going, a timer, something posted) is handed to the owner as an event by
`receive`. `post` and `put` may be called from any thread. Nothing is ever called back.

*Delivery.* `put` reaches every matching subscriber at most once, or is lost without a sign (a cut link, a peer that
dies, a subscriber that does not exist yet). Puts of one participant on one key arrive in order; otherwise any order.
Payloads up to `MAX_PAYLOAD` are delivered whole; larger ones are a LocalProtocolError.

*Queries.* `get` asks whoever serves a key. It ends with exactly one Reply event carrying the token that `get` returned:
the answer, or `payload=None` when nobody serves the key, the answerer refused, or `timeout_s` passed.

*Presence.* A participant's `announce`d key is seen by watchers until the participant closes or dies; a watcher is also
told of those already there.

*Keys.* A key is a path of non-empty chunks, such as ``atoll/r1/workers/w3/inbox``. In an expression a chunk may be
``*`` (any one chunk) or ``**`` (any number of chunks, none included). A chunk that begins with ``@`` is only matched by
itself.

*Time.* `now` is monotonic seconds; timers fire once, not before their time.
"""

import itertools
from dataclasses import dataclass
from typing import Final, Protocol

from atoll_core.errors import LocalProtocolError

MAX_PAYLOAD: Final = 64 * 1024 * 1024
_RESERVED: Final = frozenset("*$?#")


@dataclass(frozen=True, slots=True)
class Message:
    """Somebody put `payload` on `key`, which matches one of our subscriptions."""

    key: str
    payload: bytes


@dataclass(frozen=True, slots=True)
class Query:
    """Somebody asks for `key`, which we serve; answer with `Bus.reply`, once, also from another thread.

    `handle` is the bus's own, and means nothing to others. `session` is what the asker's program says of itself, the
    same for all that it asks; empty where it says nothing.
    """

    key: str
    payload: bytes
    handle: object
    session: str = ""


@dataclass(frozen=True, slots=True)
class Reply:
    """The end of our `get`: the answer's bytes, or None when there was none in time."""

    token: int
    payload: bytes | None


@dataclass(frozen=True, slots=True)
class Presence:
    """A participant announced `key` (present) or went away."""

    key: str
    present: bool


@dataclass(frozen=True, slots=True)
class Link:
    """Our connection to the router came up or went down. A router's own bus is always up."""

    up: bool


@dataclass(frozen=True, slots=True)
class Timer:
    """The time of `call_at` or `call_later` has come; `name` is what was given there."""

    name: str


@dataclass(frozen=True, slots=True)
class Posted:
    """Another thread of this participant posted `item`."""

    item: object


Event = Message | Query | Reply | Presence | Link | Timer | Posted


class Bus(Protocol):
    """One participant's access to the bus."""

    @property
    def dropped(self) -> int:
        """How many messages and queries were lost because they came faster than they were received."""
        ...

    def put(self, key: str, payload: bytes) -> None:
        """Publish `payload` on `key` to whoever subscribes now. Never raises for an unreachable peer."""

    def subscribe(self, key_expression: str) -> None:
        """Receive Message events of every key that matches, from now until close."""

    def serve(self, key_expression: str) -> None:
        """Receive Query events of every key that matches, from now until close."""

    def get(self, key: str, payload: bytes = b"", timeout_s: float = 5.0) -> int:
        """Ask for `key`; return a token, unique for this bus, under which the one Reply event will come."""
        ...

    def reply(self, query: Query, payload: bytes | None, party: str | None = None) -> None:
        """Answer `query`; None means refused (the asker gets a Reply with None at once).

        Returns at once: threads of the bus send the answer. `party` is who asks, as far as that is known better than by
        `query.session`: parties take turns where answers have to wait, and a party of which too many wait is refused
        more.
        """

    def announce(self, key: str) -> None:
        """Show presence under `key` until close."""

    def watch(self, key_expression: str) -> None:
        """Receive Presence events of every matching key, those already present first."""

    def now(self) -> float:
        """Return monotonic seconds."""
        ...

    def call_later(self, delay_s: float, name: str) -> None:
        """Have a Timer event with `name` delivered after `delay_s`; a later call with the same name replaces it."""

    def post(self, item: object) -> None:
        """Have `item` delivered as a Posted event; for the compute thread."""

    def receive(self, timeout_s: float) -> Event | None:
        """Return the next event, waiting at most `timeout_s`; None when there was none."""


def check_key(key: str) -> str:
    """Return `key`; raises LocalProtocolError when it is not a legal concrete key."""
    if not all(_is_literal(chunk) for chunk in key.split("/")):
        raise LocalProtocolError(f"{key!r} is not a key: non-empty chunks without *, $, ?, # were expected")
    return key


def check_expression(expression: str) -> str:
    """Return `expression`; raises LocalProtocolError when it is not a legal key expression in canonical form."""
    chunks = expression.split("/")
    if not all(chunk in ("*", "**") or _is_literal(chunk) for chunk in chunks):
        raise LocalProtocolError(f"{expression!r} is not a key expression: chunks, * or ** were expected")
    if any(one == "**" and two in ("*", "**") for one, two in itertools.pairwise(chunks)):
        raise LocalProtocolError(f"{expression!r} is not canonical: write * before **, and ** once")
    return expression


def check_payload(key: str, payload: bytes) -> None:
    """Raise LocalProtocolError when `payload` is larger than what a bus carries."""
    if len(payload) > MAX_PAYLOAD:
        raise LocalProtocolError(f"{len(payload)} bytes for {key} are more than the {MAX_PAYLOAD} a bus carries")


def _is_literal(chunk: str) -> bool:
    return bool(chunk) and _RESERVED.isdisjoint(chunk)
