"""A bus in memory and in virtual time, with faults from a seeded plan: what tests stand on.

Every participant is a star's ray: it reaches the others through a router in the middle. Nothing runs in parallel and
nothing waits: the network holds one list of things that will happen, in the order of virtual time, and hands each to
its participant, either to the handler set by `SimulatedBus.handle_with` or into the inbox that `receive` reads. The
same seed, plan and participants give the same history.

A participant may crash, hang (as a stopped process does: what comes waits for it, until its line is given up), be cut
off, or be busy. A router of its own is a participant that does nothing else.
"""

import heapq
import itertools
from collections.abc import Callable
from typing import Final

from atoll_core.errors import LocalProtocolError
from atoll_core.search.seeding import Stream, stream_key
from atoll_core.wire.bus.interface import Link, Message, Query
from tests.simulation.bus.fault_plan import Plan
from tests.simulation.bus.participant import Question, SimulatedBus

_MOST_AT_ONE_INSTANT: Final = 1_000_000

Action = Callable[[], None]


class SimulatedNetwork:
    """The router in the middle, the clock, and the list of what will happen. `plan` may be changed on the way."""

    def __init__(self, seed: int = 0, plan: Plan | None = None) -> None:
        self.plan = plan or Plan()
        self._stream = Stream(stream_key(seed, "", -1, 0, "faults"))
        self._now = 0.0
        self._sequence = itertools.count()
        self._future: list[tuple[float, int, Action]] = []
        self._buses: dict[str, SimulatedBus] = {}
        self._has_router = True
        self._router: SimulatedBus | None = None
        self._held: list[Action] = []
        for partition in self.plan.partitions:
            self.at(partition.start_s, lambda name=partition.name: self.disconnect(name))  # type: ignore[misc]
            self.at(partition.end_s, lambda name=partition.name: self.heal(name))  # type: ignore[misc]
        for crash in self.plan.crashes:
            self.at(crash.at_s, lambda name=crash.name: self.crash(name))  # type: ignore[misc]

    @property
    def now(self) -> float:
        """Virtual seconds since the start."""
        return self._now

    @property
    def participants(self) -> tuple[str, ...]:
        """Names of all who are there, hung or cut off ones included."""
        return tuple(self._buses)

    def bus(self, name: str, is_router: bool = False) -> SimulatedBus:
        """Return a new participant's bus; a name is free again when its former holder has closed or crashed."""
        if name in self._buses:
            raise LocalProtocolError(f"the simulated network already has a participant {name!r}")
        bus = SimulatedBus(self, name, is_router)
        self._buses[name] = bus
        if is_router:
            self._router = bus
            if not self._has_router:
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
            bus.closed, bus.died_at = True, bus.now()
            self._router_gone(bus)
            self.at(self._now + self.plan.detection_s, self.refresh_presence)

    def disconnect(self, name: str) -> None:
        """Disconnect a participant from the router until `heal`."""
        self._set_cut(name, True)

    def heal(self, name: str) -> None:
        """Connect a participant to the router again."""
        self._set_cut(name, False)

    def hang(self, name: str) -> None:
        """Stop a participant until `resume`; its line is given up after the lease. A router stops all traffic."""
        bus = self._buses.get(name)
        if bus is not None and not bus.is_hung:
            number = bus.hang()
            self.at(self._now + self.plan.lease_s, lambda: self._give_up(bus, number))

    def resume(self, name: str) -> None:
        """Let a participant go on that hangs."""
        bus = self._buses.get(name)
        if bus is None or not bus.is_hung:
            return
        bus.resume()
        if bus.is_router:
            self._resume_routing()
        elif bus.is_given_up:
            self._set_given_up(bus, False)

    def is_linked(self, bus: SimulatedBus) -> bool:
        """Return whether `bus` reaches the router now."""
        return self._has_router and bus.linked and not bus.closed

    def leave(self, bus: SimulatedBus) -> None:
        """A participant closed its bus; the others are told at once."""
        if self._buses.get(bus.name) is bus:
            del self._buses[bus.name]
            self._router_gone(bus)
            self.at(self._now + self._delay(), self.refresh_presence)

    def publish(self, sender: SimulatedBus, key: str, payload: bytes) -> None:
        """Carry a put to all who subscribe now."""
        for receiver in [bus for bus in self._buses.values() if bus.wants(key)]:
            self._carry(sender, receiver, key, lambda to=receiver: to.deliver(Message(key, payload)))  # type: ignore[misc]

    def ask(self, asker: SimulatedBus, question: Question, key: str, payload: bytes) -> None:
        """Carry a question to the first participant who serves `key` when it arrives at the router."""
        if not self.is_linked(asker) and not asker.answers(key):
            self.at(asker.now(), lambda: question.finish(None))
        elif not self._is_lost():
            self._pass(asker.now() + self._delay(), lambda: self._find_server(asker, question, key, payload))

    def answer(self, server: SimulatedBus, question: Question, payload: bytes | None) -> None:
        """Carry an answer back."""
        if server is question.asker or (self.is_linked(server) and not self._is_lost()):
            self._pass(server.now() + self._delay(), lambda: question.arrive(payload))

    def announced(self, bus: SimulatedBus) -> None:
        """Tell watchers, after a delay, of whoever is there now. `bus` announced or watches something new."""
        self.at(self._now + self._delay(), self.refresh_presence)

    def refresh_presence(self) -> None:
        """Tell every watcher who came or went since it was last told."""
        present = {key: None for bus in self._buses.values() if self.is_linked(bus) for key in bus.tokens}
        for watcher in [bus for bus in self._buses.values() if self.is_linked(bus)]:
            watcher.learn(present)

    def _find_server(self, asker: SimulatedBus, question: Question, key: str, payload: bytes) -> None:
        servers = (bus for bus in self._buses.values() if bus.answers(key))
        server = next((server for server in servers if server is asker or self.is_linked(server)), None)
        if server is None:
            self.at(self._now + self._delay(), lambda: question.arrive(None))
        else:
            server.deliver(Query(key, payload, question, f"{id(asker):x}"))

    def _carry(self, sender: SimulatedBus, receiver: SimulatedBus, key: str, action: Action) -> None:
        if sender is receiver:
            self.at(sender.now(), action)
            return
        if not self.is_linked(sender) or self._is_lost():
            return
        left_at = sender.now()
        arrival = max(left_at + self._delay(), receiver.latest.get((sender, key), 0.0))
        receiver.latest[sender, key] = arrival

        def arrive() -> None:
            if self.is_linked(receiver) and not self._was_unsent(sender, left_at):
                action()

        self._pass(arrival, arrive)
        if self.plan.duplicate and self._stream.uniform() < self.plan.duplicate:
            self._pass(arrival + self._delay(), arrive)

    def _pass(self, time_s: float, action: Action) -> None:
        """Let `action` happen at `time_s`, or, when the router hangs then, after that."""
        self.at(time_s, lambda: self._held.append(action) if self._is_router_hung() else action())

    def _is_router_hung(self) -> bool:
        return self._router is not None and self._router.is_hung

    def _was_unsent(self, sender: SimulatedBus, left_at: float) -> bool:
        """Tell whether what a participant said at `left_at` had not yet left it when it died."""
        return sender.died_at is not None and left_at > sender.died_at - self.plan.unsent_s

    def _delay(self) -> float:
        is_late = self.plan.late and self._stream.uniform() < self.plan.late
        low, high = self.plan.late_s if is_late else self.plan.delay_s
        return low + (high - low) * self._stream.uniform()

    def _is_lost(self) -> bool:
        return bool(self.plan.drop) and self._stream.uniform() < self.plan.drop

    def _set_cut(self, name: str, is_cut: bool) -> None:
        bus = self._buses.get(name)
        if bus is None or bus.is_cut == is_cut:
            return
        if bus.is_router:
            raise LocalProtocolError(f"{name!r} is the router itself and cannot be cut off from it")
        was_linked = bus.linked
        bus.is_cut = is_cut
        self._link_changed(bus, was_linked)

    def _set_given_up(self, bus: SimulatedBus, is_given_up: bool) -> None:
        was_linked = bus.linked
        bus.is_given_up = is_given_up
        self._link_changed(bus, was_linked)

    def _link_changed(self, bus: SimulatedBus, was_linked: bool) -> None:
        up = bus.linked
        if up != was_linked and self._has_router:
            bus.deliver(Link(up))
            self.at(self._now + (0.0 if up else self.plan.detection_s), self.refresh_presence)

    def _give_up(self, bus: SimulatedBus, hang: int) -> None:
        """A participant that hangs has not kept its line alive for a lease."""
        if not bus.is_hung or bus.hangs != hang or bus.closed:
            return
        if not bus.is_router:
            self._set_given_up(bus, True)
        elif self._has_router:
            self._has_router = False
            self._links_change(up=False)

    def _resume_routing(self) -> None:
        held, self._held = self._held, []
        for action in held:
            self.at(self._now, action)
        if not self._has_router:
            self._has_router = True
            self._links_change(up=True)

    def _router_gone(self, bus: SimulatedBus) -> None:
        if bus.is_router:
            self._held.clear()
            if self._has_router:
                self._has_router = False
                self._links_change(up=False)

    def _links_change(self, up: bool) -> None:
        for bus in list(self._buses.values()):
            if bus.linked and not bus.is_router:
                bus.deliver(Link(up))
        self.at(self._now, self.refresh_presence)
