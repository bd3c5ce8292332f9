"""The promises of `atoll_core.wire.bus.interface`, one test each, kept by the zenoh bus and the simulated one alike."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Protocol, TypeVar

import pytest

from atoll_core.errors import LocalProtocolError
from atoll_core.wire.bus.interface import MAX_PAYLOAD, Bus, Event, Link, Message, Posted, Presence, Query, Reply, Timer
from atoll_core.wire.bus.zenoh_bus import ZenohBus, open_client, open_router
from tests.simulation.bus.network import SimulatedNetwork

E = TypeVar("E", bound=Event)
LIMIT_S = 30.0


class World(Protocol):
    """Where participants come from: always one router, and any number of clients."""

    def router(self) -> Bus: ...
    def client(self) -> Bus: ...
    def restart_router(self) -> Bus: ...


class ZenohWorld:
    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self._router = stack.enter_context(open_router("tcp/127.0.0.1:0"))

    def router(self) -> ZenohBus:
        return self._router

    def client(self) -> ZenohBus:
        return self._stack.enter_context(open_client(self._router.endpoint, wait_s=5.0))

    def restart_router(self) -> ZenohBus:
        endpoint = self._router.endpoint
        self._router.close()
        self._router = self._stack.enter_context(open_router(endpoint))
        return self._router


class SimulatedWorld:
    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self._network = SimulatedNetwork(seed=1)
        self._router = self._network.bus("router", is_router=True)
        self._clients = 0

    def router(self) -> Bus:
        return self._router

    def client(self) -> Bus:
        self._clients += 1
        return self._stack.enter_context(self._network.bus(f"client{self._clients}"))

    def restart_router(self) -> Bus:
        self._router.close()
        self._router = self._network.bus("router", is_router=True)
        return self._router


@pytest.fixture(scope="module", params=[ZenohWorld, SimulatedWorld], ids=["zenoh", "simulated"])
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    with ExitStack() as stack:
        yield request.param(stack)


@pytest.fixture
def prefix(request: pytest.FixtureRequest) -> str:
    """Keys of one test alone, since the tests share a router."""
    return "test/" + request.node.originalname


def first(bus: Bus, kind: type[E], wanted: Callable[[E], bool] = lambda event: True, limit_s: float = LIMIT_S) -> E:
    """Return the first event of a kind, dropping others; fails when none comes."""
    end = time.monotonic() + limit_s
    for _ in range(10_000):
        event = bus.receive(0.1)
        if isinstance(event, kind) and wanted(event):
            return event
        if time.monotonic() > end:
            break
    raise AssertionError(f"no {kind.__name__} came")


def all_until(bus: Bus, last: Callable[[Event], bool]) -> list[Event]:
    """Return all events up to and with the `last`."""
    events = [first(bus, object)]  # type: ignore[type-var]
    while not last(events[-1]):
        events.append(first(bus, object))  # type: ignore[type-var]
    return events


def connect(sender: Bus, receiver: Bus, key: str) -> None:
    """Put on `key` until `receiver`, who subscribes to it, gets it: from then on puts arrive."""
    for _ in range(300):
        sender.put(key, b"hello?")
        sender.put(key, b"last")
        end = receiver.now() + 0.1
        while receiver.now() < end:
            event = receiver.receive(0.1)
            if isinstance(event, Message) and event.payload == b"last":
                return
    raise AssertionError(f"nothing put on {key} arrives")


def test_a_put_reaches_every_matching_subscriber_and_no_other(world: World, prefix: str) -> None:
    one, two, sender = world.client(), world.client(), world.client()
    for bus, expression in ((one, "/a/*"), (two, "/**"), (world.router(), "/a/b")):
        bus.subscribe(prefix + expression)
        connect(sender, bus, prefix + "/a/b")
    sender.put(prefix + "/c", b"1")
    sender.put(prefix + "/a/b", b"2")
    for bus in (one, world.router()):
        events = all_until(bus, lambda event: event == Message(prefix + "/a/b", b"2"))
        assert Message(prefix + "/c", b"1") not in events
    received = {first(two, Message, lambda event: event.payload in (b"1", b"2")) for _ in range(2)}
    assert received == {Message(prefix + "/c", b"1"), Message(prefix + "/a/b", b"2")}


def test_a_put_reaches_also_the_one_who_put_it(world: World, prefix: str) -> None:
    bus = world.client()
    bus.subscribe(prefix)
    bus.put(prefix, b"mine")
    assert first(bus, Message) == Message(prefix, b"mine")
    assert bus.receive(0.05) is None


def test_puts_of_one_participant_on_one_key_arrive_in_order_and_once(world: World, prefix: str) -> None:
    sender, receiver = world.client(), world.client()
    receiver.subscribe(prefix + "/*")
    connect(sender, receiver, prefix + "/a")
    connect(sender, receiver, prefix + "/b")
    for number in range(500):
        sender.put(prefix + "/ab"[0] + "ab"[number % 2], b"%d" % number)
    numbers = [first(receiver, Message, lambda event: event.payload.isdigit()) for _ in range(500)]
    for parity, letter in enumerate("ab"):
        mine = [int(event.payload) for event in numbers if event.key == f"{prefix}/{letter}"]
        assert mine == list(range(parity, 500, 2))


def test_the_largest_payload_is_delivered_whole_and_a_larger_one_is_refused(world: World, prefix: str) -> None:
    sender, receiver = world.client(), world.client()
    receiver.subscribe(prefix)
    connect(sender, receiver, prefix)
    payload = bytes(range(256)) * (MAX_PAYLOAD // 256)
    messages: list[Message] = []
    for _ in range(3):  # a put may be lost where the network is slower than the sender
        sender.put(prefix, payload)
        with contextlib.suppress(AssertionError):
            messages.append(first(receiver, Message, limit_s=LIMIT_S / 3))
            break
    assert [message.payload == payload for message in messages] == [True]
    for act in (sender.put, sender.get):
        with pytest.raises(LocalProtocolError, match="more than"):
            act(prefix, payload + b"x")


def test_a_put_that_nobody_hears_is_lost_without_a_sign(world: World, prefix: str) -> None:
    sender = world.client()
    sender.put(prefix, b"1")
    assert sender.receive(0.05) is None


def test_a_closed_bus_neither_sends_nor_receives_nor_raises(world: World, prefix: str) -> None:
    sender, receiver, other = world.client(), world.client(), world.client()
    for bus in (receiver, other):
        bus.subscribe(prefix)
        connect(sender, bus, prefix)
    while receiver.receive(0.05):
        pass
    with receiver:
        pass
    sender.put(prefix, b"1")
    first(other, Message, lambda event: event.payload == b"1")
    assert receiver.receive(0.05) is None
    with receiver:
        receiver.put(prefix, b"2")
    assert other.receive(0.05) is None


def test_other_threads_may_put_and_post(world: World, prefix: str) -> None:
    bus, receiver = world.client(), world.client()
    receiver.subscribe(prefix)
    connect(bus, receiver, prefix)

    def work() -> None:
        bus.put(prefix, b"1")
        bus.post("done")

    thread = threading.Thread(target=work)
    thread.start()
    thread.join(LIMIT_S)
    assert first(bus, Posted) == Posted("done")
    assert first(receiver, Message, lambda event: event.payload == b"1")


def test_a_question_reaches_who_serves_its_key_and_the_answer_comes_back(world: World, prefix: str) -> None:
    asker, server = world.client(), world.client()
    server.serve(prefix + "/*")
    ready(asker, server, prefix + "/a")
    token = asker.get(prefix + "/b", b"what?", timeout_s=LIMIT_S)
    query = first(server, Query)
    assert (query.key, query.payload) == (prefix + "/b", b"what?")
    server.reply(query, b"that")
    assert first(asker, Reply) == Reply(token, b"that")
    assert asker.receive(0.05) is None


def ready(asker: Bus, server: Bus, key: str) -> None:
    """Ask until `server`, who serves `key`, is found."""
    for _ in range(300):
        token = asker.get(key, timeout_s=1.0)
        query = server.receive(0.05)
        if isinstance(query, Query):
            server.reply(query, b"here")
        if first(asker, Reply, lambda event, token=token: event.token == token).payload == b"here":  # type: ignore[misc]
            return
    raise AssertionError(f"nobody answers for {key}")


def test_an_answer_may_be_given_by_another_thread_and_in_any_order(world: World, prefix: str) -> None:
    asker, server = world.client(), world.client()
    server.serve(prefix)
    ready(asker, server, prefix)
    tokens = [asker.get(prefix, b"%d" % number, timeout_s=LIMIT_S) for number in range(3)]
    queries = {query.payload: query for query in [first(server, Query) for _ in range(3)]}
    for payload in (b"2", b"0", b"1"):
        thread = threading.Thread(target=server.reply, args=(queries[payload], payload))
        thread.start()
        thread.join(LIMIT_S)
    replies = {first(asker, Reply) for _ in range(3)}
    assert replies == {Reply(token, b"%d" % number) for number, token in enumerate(tokens)}


def test_all_questions_of_one_bus_are_of_one_session_and_those_of_another_of_another(world: World, prefix: str) -> None:
    server, one, other = world.router(), world.client(), world.client()
    server.serve(prefix + "/*")
    sessions = []
    for number, asker in enumerate((one, one, other)):
        token = asker.get(f"{prefix}/{number}")
        query = first(server, Query)
        server.reply(query, b"")
        first(asker, Reply, lambda event, token=token: event.token == token)  # type: ignore[misc]
        sessions.append(query.session)
    assert sessions[0] == sessions[1] != sessions[2]
    assert all(sessions)


def test_a_question_that_nobody_serves_ends_at_once_with_none(world: World, prefix: str) -> None:
    asker = world.client()
    token = asker.get(prefix, timeout_s=10 * LIMIT_S)
    assert first(asker, Reply) == Reply(token, None)


def test_a_refused_question_ends_at_once_with_none(world: World, prefix: str) -> None:
    asker, server = world.client(), world.client()
    server.serve(prefix)
    ready(asker, server, prefix)
    token = asker.get(prefix, timeout_s=10 * LIMIT_S)
    server.reply(first(server, Query), None)
    assert first(asker, Reply) == Reply(token, None)


def test_a_question_without_an_answer_ends_after_its_time_with_none_and_a_late_answer_is_dropped(
    world: World, prefix: str
) -> None:
    asker, server = world.client(), world.client()
    server.serve(prefix)
    ready(asker, server, prefix)
    start = asker.now()
    token = asker.get(prefix, timeout_s=0.3)
    query = first(server, Query)
    assert first(asker, Reply) == Reply(token, None)
    assert asker.now() >= start + 0.3
    server.reply(query, b"late")
    assert asker.receive(0.05) is None


def test_of_several_who_serve_a_key_one_answers(world: World, prefix: str) -> None:
    asker, servers = world.client(), [world.client(), world.client()]
    for server in servers:
        server.serve(prefix)
        ready_any(asker, servers, prefix)
    token = asker.get(prefix, timeout_s=1.0)
    for server in servers:
        query = server.receive(0.2)
        if isinstance(query, Query):
            server.reply(query, b"here")
    assert first(asker, Reply) == Reply(token, b"here")
    assert asker.receive(0.05) is None


def ready_any(asker: Bus, servers: list[Bus], key: str) -> None:
    for _ in range(300):
        token = asker.get(key, timeout_s=0.5)
        for server in servers:
            query = server.receive(0.02)
            if isinstance(query, Query):
                server.reply(query, b"here")
        if first(asker, Reply, lambda event, token=token: event.token == token).payload == b"here":  # type: ignore[misc]
            return
    raise AssertionError(f"nobody answers for {key}")


def test_watchers_see_who_comes_and_who_leaves(world: World, prefix: str) -> None:
    watcher, worker = world.router(), world.client()
    watcher.watch(prefix + "/*")
    worker.announce(prefix + "/w1")
    assert first(watcher, Presence) == Presence(prefix + "/w1", True)
    with worker:
        pass
    assert first(watcher, Presence) == Presence(prefix + "/w1", False)


def test_a_watcher_is_told_of_those_already_there(world: World, prefix: str) -> None:
    early, worker, late = world.client(), world.client(), world.client()
    early.watch(prefix + "/*")
    worker.announce(prefix + "/w1")
    first(early, Presence)
    late.watch(prefix + "/*")
    assert first(late, Presence) == Presence(prefix + "/w1", True)


def test_a_timer_fires_once_and_not_before_its_time(world: World) -> None:
    bus = world.client()
    start = bus.now()
    bus.call_later(0.05, "later")
    bus.call_later(0.0, "now")
    assert first(bus, Timer) == Timer("now")
    assert first(bus, Timer) == Timer("later")
    assert bus.now() >= start + 0.05
    assert bus.receive(0.05) is None


def test_setting_a_timer_again_replaces_it(world: World) -> None:
    bus = world.client()
    bus.call_later(0.01, "one")
    bus.call_later(0.1, "two")
    bus.call_later(0.2, "one")
    assert [first(bus, Timer).name for _ in range(2)] == ["two", "one"]
    assert bus.receive(0.05) is None


def test_receive_waits_no_longer_than_told_and_no_shorter(world: World) -> None:
    bus = world.client()
    start = bus.now()
    assert bus.receive(0.0) is None
    assert bus.receive(0.05) is None
    assert bus.now() >= start + 0.05


def test_what_is_posted_comes_in_order(world: World) -> None:
    bus = world.client()
    for number in range(10):
        bus.post(number)
    assert [first(bus, Posted).item for _ in range(10)] == list(range(10))


@pytest.mark.parametrize("key", ["", "/a", "a/", "a//b", "a/*", "a/**", "a?b", "a#b", "a$*"])
def test_a_wrong_key_is_our_own_error(world: World, key: str) -> None:
    bus = world.client()
    for act in (lambda: bus.put(key, b""), lambda: bus.get(key), lambda: bus.announce(key)):
        with pytest.raises(LocalProtocolError, match="is not a key"):
            act()


@pytest.mark.parametrize("expression", ["", "/a", "a//b", "a/b*", "a/**/**", "a/**/*", "a$*"])
def test_a_wrong_key_expression_is_our_own_error(world: World, expression: str) -> None:
    bus = world.client()
    for act in (bus.subscribe, bus.serve, bus.watch):
        with pytest.raises(LocalProtocolError, match=r"key expression|canonical"):
            act(expression)


def test_a_client_is_told_when_the_router_goes_and_comes_back_and_goes_on_where_it_was(
    world: World, prefix: str
) -> None:
    client = world.client()
    client.subscribe(prefix + "/a")
    client.announce(prefix + "/alive")
    router = world.restart_router()
    assert first(client, Link) == Link(False)
    assert first(client, Link) == Link(True)
    connect(router, client, prefix + "/a")
    router.watch(prefix + "/alive")
    assert first(router, Presence) == Presence(prefix + "/alive", True)
