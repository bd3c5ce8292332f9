"""One participant of a simulated network: its bus, its own time, and what waits while it hangs or is busy."""

import itertools
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

from atoll_core.errors import LocalProtocolError
from atoll_core.wire.bus.interface import (
    Event,
    Posted,
    Presence,
    Query,
    Reply,
    Timer,
    check_expression,
    check_key,
    check_payload,
)
from tests.simulation.bus.matching import matches

if TYPE_CHECKING:
    from tests.simulation.bus.network import SimulatedNetwork


@dataclass(eq=False)
class Question:
    """One `get` under way; it ends once."""

    network: "SimulatedNetwork"
    asker: "SimulatedBus"
    token: int
    is_open: bool = field(default=True)

    def arrive(self, payload: bytes | None) -> None:
        """An answer reached the asker, if the asker is still connected."""
        if self.network.is_linked(self.asker):
            self.finish(payload)

    def finish(self, payload: bytes | None) -> None:
        """End with `payload` unless it has ended before."""
        if self.is_open:
            self.is_open = False
            self.asker.asking -= 1
            self.asker.deliver(Reply(self.token, payload))


class SimulatedBus:
    """One participant of a simulated network; an `atoll_core.wire.bus.interface.Bus` in virtual time.

    Its own time runs ahead of the network's while it is busy (`spend`): what it says then leaves later, and what comes
    waits. While it hangs, everything waits.
    """

    def __init__(self, network: "SimulatedNetwork", name: str, is_router: bool) -> None:
        self.name: Final = name
        self.is_router: Final = is_router
        self.is_cut = False
        self.is_given_up = False
        self.is_hung = False
        self.hangs = 0
        self.asking = 0
        self.closed = False
        self.died_at: float | None = None
        self.tokens: list[str] = []
        self.latest: dict[tuple[SimulatedBus, str], float] = {}
        self._network = network
        self._handler: Callable[[Event], None] | None = None
        self._inbox: deque[Event] = deque()
        self._backlog: deque[Event] = deque()
        self._is_draining = False
        self._busy_until = 0.0
        self._subscribed: list[str] = []
        self._wanted: dict[str, bool] = {}
        self._served: list[str] = []
        self._watched: list[str] = []
        self._known: dict[str, None] = {}
        self._gets = itertools.count(1)
        self._timers: dict[str, int] = {}
        self._timer_numbers = itertools.count()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def linked(self) -> bool:
        """Whether its line to the router is whole."""
        return not (self.is_cut or self.is_given_up)

    def close(self) -> None:
        """Leave the network. Repeatable."""
        self.closed = True
        self._network.leave(self)

    def handle_with(self, handler: Callable[[Event], None]) -> None:
        """Have every event from now on given to `handler` at its virtual time, those that wait already first."""
        self._handler = handler
        while self._inbox:
            event = self._inbox.popleft()
            self._network.at(self._network.now, lambda event=event: self.deliver(event))  # type: ignore[misc]

    def put(self, key: str, payload: bytes) -> None:
        """See `Bus.put`."""
        check_key(key)
        check_payload(key, payload)
        if not self.closed:
            self._network.publish(self, key, payload)

    def subscribe(self, key_expression: str) -> None:
        """See `Bus.subscribe`."""
        self._subscribed.append(check_expression(key_expression))
        self._wanted.clear()

    def serve(self, key_expression: str) -> None:
        """See `Bus.serve`."""
        self._served.append(check_expression(key_expression))

    def get(self, key: str, payload: bytes = b"", timeout_s: float = 5.0) -> int:
        """See `Bus.get`."""
        check_key(key)
        check_payload(key, payload)
        question = Question(self._network, self, next(self._gets))
        self.asking += 1
        self._network.at(self.now() + timeout_s, lambda: question.finish(None))
        self._network.ask(self, question, key, payload)
        return question.token

    def reply(self, query: Query, payload: bytes | None, party: str | None = None) -> None:
        """See `Bus.reply`."""
        check_payload(query.key, payload or b"")
        if not self.closed:
            self._network.answer(self, query.handle, payload)

    def announce(self, key: str) -> None:
        """See `Bus.announce`."""
        self.tokens.append(check_key(key))
        self._network.announced(self)

    def watch(self, key_expression: str) -> None:
        """See `Bus.watch`."""
        self._watched.append(check_expression(key_expression))
        self._network.announced(self)

    @property
    def dropped(self) -> int:
        """See `Bus.dropped`: here everything is received."""
        return 0

    def now(self) -> float:
        """See `Bus.now`."""
        return max(self._network.now, self._busy_until)

    def spend(self, seconds: float) -> None:
        """Let the participant be busy for so long, from its own now on."""
        self._busy_until = self.now() + seconds

    def hang(self) -> int:
        """Take nothing in until `resume`; return which of its hangs this is."""
        self.is_hung = True
        self.hangs += 1
        return self.hangs

    def resume(self) -> None:
        """Go on with what has come meanwhile."""
        self.is_hung = False
        self._drain_later()

    def call_later(self, delay_s: float, name: str) -> None:
        """See `Bus.call_later`."""
        number = self._timers[name] = next(self._timer_numbers)
        self._network.at(self.now() + delay_s, lambda: self._ring(name, number))

    def post(self, item: object) -> None:
        """See `Bus.post`. Only from the one thread that runs the network."""
        self._network.at(self._network.now, lambda: self.deliver(Posted(item)))

    def receive(self, timeout_s: float) -> Event | None:
        """See `Bus.receive`. Lets virtual time pass; for participants without a handler."""
        if self._handler is not None:
            raise LocalProtocolError(f"{self.name!r} has a handler and cannot receive")
        end = self._network.now + timeout_s
        while not self._inbox:
            if not self._network.step(end):
                return None
        return self._inbox.popleft()

    def deliver(self, event: Event) -> None:
        """Deliver `event` to the participant, as soon as it can take it; nothing reaches a closed bus."""
        if self.closed:
            return
        if self.is_hung or self._backlog or self._busy_until > self._network.now:
            self._backlog.append(event)
            self._drain_later()
        else:
            self._take(event)

    def wants(self, key: str) -> bool:
        """Return whether a put on `key` is for this participant."""
        wanted = self._wanted.get(key)
        if wanted is None:
            wanted = self._wanted[key] = any(matches(expression, key) for expression in self._subscribed)
        return wanted

    def answers(self, key: str) -> bool:
        """Return whether this participant serves `key`."""
        return any(matches(expression, key) for expression in self._served)

    def learn(self, present: dict[str, None]) -> None:
        """Be told what changed since the last time, of what is watched."""
        watched = {key: None for key in present if any(matches(pattern, key) for pattern in self._watched)}
        changes = [(key, False) for key in self._known if key not in watched]
        changes += [(key, True) for key in watched if key not in self._known]
        self._known = watched
        for key, is_present in changes:
            self.deliver(Presence(key, is_present))

    def _ring(self, name: str, number: int) -> None:
        if self._timers.get(name) == number:
            del self._timers[name]
            self.deliver(Timer(name))

    def _take(self, event: Event) -> None:
        if self._handler is not None:
            self._handler(event)
        else:
            self._inbox.append(event)

    def _drain_later(self) -> None:
        if not self._is_draining and not self.is_hung:
            self._is_draining = True
            self._network.at(self.now(), self._drain)

    def _drain(self) -> None:
        self._is_draining = False
        while self._backlog and not (self.closed or self.is_hung or self._busy_until > self._network.now):
            self._take(self._backlog.popleft())
        if self._backlog and not self.closed:
            self._drain_later()
