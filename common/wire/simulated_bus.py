"""A bus in memory and in virtual time, with faults from a seeded plan: what tests stand on.

Every participant is a star's ray: it reaches the others through a router in the middle. Nothing runs in parallel and
nothing waits: the network holds one list of things that will happen, in the order of virtual time, and hands each to
its participant, either to the handler set by `SimulatedBus.handle_with` or into the inbox that `receive` reads. The
same seed, plan and participants give the same history.
"""

import heapq
import itertools
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Final, Self

from common.errors import LocalProtocolError
from common.seeding import Stream, stream_key
from common.wire.bus import Event, Link, Message, Posted, Presence, Query, Reply, Timer
from common.wire.faults import Plan
from common.wire.keys import check_expression, check_key, check_payload, matches

_MOST_AT_ONE_INSTANT: Final = 1_000_000

Action = Callable[[], None]


class SimulatedNetwork:
    """The router in the middle, the clock, and the list of what will happen."""

    def __init__(self, seed: int = 0, plan: Plan | None = None) -> None:
        self.plan: Final = plan or Plan()
        self._stream = Stream(stream_key(seed, "", -1, 0, "faults"))
        self._now = 0.0
        self._sequence = itertools.count()
        self._future: list[tuple[float, int, Action]] = []
        self._buses: dict[str, SimulatedBus] = {}
        self._has_router = True
        for partition in self.plan.partitions:
            self.at(partition.start_s, lambda name=partition.name: self.cut(name))  # type: ignore[misc]
            self.at(partition.end_s, lambda name=partition.name: self.heal(name))  # type: ignore[misc]
        for crash in self.plan.crashes:
            self.at(crash.at_s, lambda name=crash.name: self.crash(name))  # type: ignore[misc]

    @property
    def now(self) -> float:
        """Virtual seconds since the start."""
        return self._now

    def bus(self, name: str, is_router: bool = False) -> "SimulatedBus":
        """Return a new participant's bus; a name is free again when its former bearer has closed or crashed."""
        if name in self._buses:
            raise LocalProtocolError(f"the simulated network already has a participant {name!r}")
        bus = SimulatedBus(self, name, is_router)
        self._buses[name] = bus
        if is_router and not self._has_router:
            self._has_router = True
            self._links_change(up=True)
        return bus

    def at(self, time_s: float, action: Action) -> None:
        """Let `action` happen at `time_s`, between events: crashes, restarts, checks."""
        heapq.heappush(self._future, (max(time_s, self._now), next(self._sequence), action))

    def run(self, until_s: float, done: Callable[[], bool] | None = None) -> bool:
        """Let everything happen up to `until_s`, or until `done()`; return whether it was done."""
        at_this_instant, instant = 0, self._now
        while not (done and done()):
            if not self.step(until_s):
                return False
            at_this_instant = at_this_instant + 1 if self._now == instant else 0
            instant = self._now
            if at_this_instant > _MOST_AT_ONE_INSTANT:
                raise LocalProtocolError(f"participants keep each other busy without end at {instant} s")
        return True

    def step(self, until_s: float) -> bool:
        """Let the next thing happen; if there is none up to `until_s`, let the time pass and return False."""
        if not self._future or self._future[0][0] > until_s:
            self._now = max(self._now, until_s)
            return False
        self._now, _, action = heapq.heappop(self._future)
        action()
        return True

    def crash(self, name: str) -> None:
        """Let a participant die without a word. Unknown names are ignored: it may be dead already."""
        bus = self._buses.pop(name, None)
        if bus is not None:
            bus.closed = True
            self._router_gone(bus)
            self.at(self._now + self.plan.detection_s, self.refresh_presence)

    def cut(self, name: str) -> None:
        """Cut a participant off the router until `heal`."""
        self._set_link(name, up=False)

    def heal(self, name: str) -> None:
        """Connect a participant to the router again."""
        self._set_link(name, up=True)

    def is_linked(self, bus: "SimulatedBus") -> bool:
        """Return whether `bus` reaches the router now."""
        return self._has_router and bus.linked and not bus.closed

    def leave(self, bus: "SimulatedBus") -> None:
        """A participant closed its bus; the others are told at once."""
        if self._buses.get(bus.name) is bus:
            del self._buses[bus.name]
            self._router_gone(bus)
            self.at(self._now + self._delay(), self.refresh_presence)

    def publish(self, sender: "SimulatedBus", key: str, payload: bytes) -> None:
        """Carry a put to all who subscribe now."""
        for receiver in [each for each in self._buses.values() if each.wants(key)]:
            self._carry(sender, receiver, key, lambda to=receiver: to.deliver(Message(key, payload)))  # type: ignore[misc]

    def ask(self, asker: "SimulatedBus", question: "Question", key: str, payload: bytes) -> None:
        """Carry a question to the first participant who serves `key` when it arrives at the router."""
        if not self.is_linked(asker) and not asker.answers(key):
            self.at(self._now, lambda: question.finish(None))
        elif not self._is_lost():
            self.at(self._now + self._delay(), lambda: self._find_server(asker, question, key, payload))

    def answer(self, server: "SimulatedBus", question: "Question", payload: bytes | None) -> None:
        """Carry an answer back."""
        if server is question.asker or (self.is_linked(server) and not self._is_lost()):
            self.at(self._now + self._delay(), lambda: question.arrive(payload))

    def announced(self, bus: "SimulatedBus") -> None:
        """Tell watchers, after a delay, of whoever is there now. `bus` announced or watches something new."""
        self.at(self._now + self._delay(), self.refresh_presence)

    def refresh_presence(self) -> None:
        """Tell every watcher who came or went since it was last told."""
        present = {key: None for bus in self._buses.values() if self.is_linked(bus) for key in bus.tokens}
        for watcher in [each for each in self._buses.values() if self.is_linked(each)]:
            watcher.learn(present)

    def _find_server(self, asker: "SimulatedBus", question: "Question", key: str, payload: bytes) -> None:
        servers = (each for each in self._buses.values() if each.answers(key))
        server = next((each for each in servers if each is asker or self.is_linked(each)), None)
        if server is None:
            self.at(self._now + self._delay(), lambda: question.arrive(None))
        else:
            server.deliver(Query(key, payload, question))

    def _carry(self, sender: "SimulatedBus", receiver: "SimulatedBus", key: str, action: Action) -> None:
        if sender is receiver:
            self.at(self._now, action)
            return
        if not self.is_linked(sender) or self._is_lost():
            return
        arrival = max(self._now + self._delay(), receiver.latest.get((sender, key), 0.0))
        receiver.latest[sender, key] = arrival
        self.at(arrival, lambda: action() if self.is_linked(receiver) else None)
        if self.plan.duplicate and self._stream.uniform() < self.plan.duplicate:
            self.at(arrival + self._delay(), lambda: action() if self.is_linked(receiver) else None)

    def _delay(self) -> float:
        is_late = self.plan.late and self._stream.uniform() < self.plan.late
        low, high = self.plan.late_s if is_late else self.plan.delay_s
        return low + (high - low) * self._stream.uniform()

    def _is_lost(self) -> bool:
        return bool(self.plan.drop) and self._stream.uniform() < self.plan.drop

    def _set_link(self, name: str, up: bool) -> None:
        bus = self._buses.get(name)
        if bus is None or bus.linked == up:
            return
        if bus.is_router:
            raise LocalProtocolError(f"{name!r} is the router itself and cannot be cut off from it")
        bus.linked = up
        if self._has_router:
            bus.deliver(Link(up))
            self.at(self._now + (0.0 if up else self.plan.detection_s), self.refresh_presence)

    def _router_gone(self, bus: "SimulatedBus") -> None:
        if bus.is_router:
            self._has_router = False
            self._links_change(up=False)

    def _links_change(self, up: bool) -> None:
        for bus in list(self._buses.values()):
            if bus.linked and not bus.is_router:
                bus.deliver(Link(up))
        self.at(self._now, self.refresh_presence)


@dataclass(eq=False)
class Question:
    """One `get` under way; it ends once."""

    network: SimulatedNetwork
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
            self.asker.deliver(Reply(self.token, payload))


class SimulatedBus:
    """One participant of a simulated network; a `common.wire.bus.Bus` in virtual time."""

    def __init__(self, network: SimulatedNetwork, name: str, is_router: bool) -> None:
        self.name: Final = name
        self.is_router: Final = is_router
        self.linked = True
        self.closed = False
        self.tokens: list[str] = []
        self.latest: dict[tuple[SimulatedBus, str], float] = {}
        self._network = network
        self._handler: Callable[[Event], None] | None = None
        self._inbox: deque[Event] = deque()
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
        self._network.at(self._network.now + timeout_s, lambda: question.finish(None))
        self._network.ask(self, question, key, payload)
        return question.token

    def reply(self, query: Query, payload: bytes | None) -> None:
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
        return self._network.now

    def call_later(self, delay_s: float, name: str) -> None:
        """See `Bus.call_later`."""
        number = self._timers[name] = next(self._timer_numbers)
        self._network.at(self._network.now + delay_s, lambda: self._ring(name, number))

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
        """Hand `event` to the participant now; nothing reaches a closed bus."""
        if self.closed:
            return
        if self._handler is not None:
            self._handler(event)
        else:
            self._inbox.append(event)

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
        watched = {key: None for key in present if any(matches(each, key) for each in self._watched)}
        changes = [(key, False) for key in self._known if key not in watched]
        changes += [(key, True) for key in watched if key not in self._known]
        self._known = watched
        for key, is_present in changes:
            self.deliver(Presence(key, is_present))

    def _ring(self, name: str, number: int) -> None:
        if self._timers.get(name) == number:
            del self._timers[name]
            self.deliver(Timer(name))
