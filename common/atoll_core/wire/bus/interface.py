"""The bus: the guarantees for every participant, regardless of the implementation that carries the messages.

Coordinator, workers and clients are loops around `Bus.receive`: they take one event, change their state, and send.
They know nothing else of the network, so that tests run the real programs on a bus in virtual time with drawn faults
(`tests.simulation.bus`). Clock and timers belong to the bus for the same reason. One contract suite (tests/contract)
checks these promises on every implementation:

*Threading.* A bus belongs to one owner thread, and only this thread calls `receive`. All events (a message, a query, a
reply, a participant that comes or goes, a timer, an item posted by another thread) reach the owner by `receive`. `post`
and `put` may be called from any thread. There are no callbacks.

*Delivery.* `put` reaches every matching subscriber at most once, or is lost silently (a broken link, a peer that dies,
a subscriber that does not exist yet). Puts of one participant on one key arrive in order; otherwise any order is
possible. Payloads up to `MAX_PAYLOAD` are delivered whole; larger payloads raise a LocalProtocolError. The bus neither
acknowledges nor repeats: protocols above it ask again for missing messages (docs/protocol.md).

*Queries.* `get` asks the participant that serves a key. It ends with exactly one Reply event with the token that `get`
returned: the answer, or `payload=None` when no participant serves the key, the query was refused, or `timeout_s`
passed.

*Presence.* Watchers see an `announce`d key until its participant closes or dies; a new watcher also learns of the
participants that are present already.

*Keys.* A key is a path of non-empty chunks, such as ``atoll/r1/workers/w3/inbox``. In an expression a chunk may be
``*`` (any one chunk) or ``**`` (any number of chunks, including none). A chunk that begins with ``@`` matches only
itself.

*Time.* `now` is monotonic seconds; timers fire once, and not early.
"""

import itertools
from dataclasses import dataclass
from typing import Final, Protocol

from atoll_core.errors import LocalProtocolError

MAX_PAYLOAD: Final = 64 * 1024 * 1024
_RESERVED: Final = frozenset("*$?#")


@dataclass(frozen=True, slots=True)
class Message:
    """A put of `payload` on `key`, which matches one of our subscriptions."""

    key: str
    payload: bytes


@dataclass(frozen=True, slots=True)
class Query:
    """A query for `key`, which we serve; answer with `Bus.reply`, once, from any thread.

    `handle` is private to the bus. `session` identifies the asking program, empty where it is unknown.
    """

    key: str
    payload: bytes
    handle: object
    session: str = ""


@dataclass(frozen=True, slots=True)
class Reply:
    """The end of our `get`: the answer's bytes, or None without an answer in time."""

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
    """A timer of `call_later` is due; `name` is its name."""

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
        """Number of messages and queries that were lost because they arrived faster than they were received."""
        ...

    def put(self, key: str, payload: bytes) -> None:
        """Publish `payload` on `key` to present subscribers. Never raises for an unreachable peer."""

    def subscribe(self, key_expression: str) -> None:
        """Receive Message events of every key that matches, from now until close."""

    def serve(self, key_expression: str) -> None:
        """Receive Query events of every key that matches, from now until close."""

    def get(self, key: str, payload: bytes = b"", timeout_s: float = 5.0) -> int:
        """Ask for `key`; return the token, unique for this bus, of the one Reply event that will follow."""
        ...

    def reply(self, query: Query, payload: bytes | None, party: str | None = None) -> None:
        """Answer `query`; None means refused (the asker gets a Reply with None at once).

        Returns at once: threads of the bus send the answer. Parties take turns where answers have to wait, and a party
        with too many waiting answers is refused. `party` is the asking user where that is known, else `query.session`.
        """

    def announce(self, key: str) -> None:
        """Show presence under `key` until close."""

    def watch(self, key_expression: str) -> None:
        """Receive Presence events of every matching key, first of the participants that are present already."""

    def now(self) -> float:
        """Return monotonic seconds."""
        ...

    def call_later(self, delay_s: float, name: str) -> None:
        """Deliver a Timer event with `name` after `delay_s`; a later call with the same name replaces it."""

    def post(self, item: object) -> None:
        """Deliver `item` as a Posted event; for other threads of this participant."""

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
    """Raise LocalProtocolError when `payload` is larger than a bus can carry."""
    if len(payload) > MAX_PAYLOAD:
        raise LocalProtocolError(f"{len(payload)} bytes for {key} are more than the {MAX_PAYLOAD} a bus carries")


def _is_literal(chunk: str) -> bool:
    return bool(chunk) and _RESERVED.isdisjoint(chunk)
