"""What only a real network can show: opening, refusing, waiting, ending. A bus's promises are in tests/contract."""

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from atoll_core.errors import UnreachableError, UsageError
from atoll_core.wire.addresses import bindable, own_address, parse_address
from atoll_core.wire.bus import queues, zenoh_bus
from atoll_core.wire.bus.interface import MAX_PAYLOAD, Event, Link, Message, Query, Reply
from atoll_core.wire.bus.zenoh_bus import ZenohBus, open_client, open_router, sockets_of

LIMIT_S = 30.0


@pytest.fixture
def router() -> Iterator[ZenohBus]:
    with open_router("tcp/127.0.0.1:0") as bus:
        yield bus


def first(bus: ZenohBus, kind: type[Event]) -> Event:
    end = bus.now() + LIMIT_S
    while bus.now() < end:
        event = bus.receive(0.1)
        if isinstance(event, kind):
            return event
    raise AssertionError(f"no {kind.__name__} came")


def test_an_absent_coordinator_is_said_with_address_time_and_reason() -> None:
    address = bindable(parse_address("tcp/127.0.0.1:0"))
    with pytest.raises(UnreachableError) as caught:
        open_client(str(address), wait_s=0.3)
    assert str(caught.value) == (
        f"no coordinator answers at {address} within 0.3 s: connection refused; "
        "check the address, or start one with `coordinator serve`"
    )


def test_what_listens_but_is_no_coordinator_is_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zenoh_bus, "_ATTEMPT_MS", 300)
    with socket.create_server(("127.0.0.1", 0)) as stranger:
        address = f"tcp/127.0.0.1:{stranger.getsockname()[1]}"
        with pytest.raises(UnreachableError, match="did not answer as a coordinator does"):
            open_client(address)


@pytest.mark.parametrize(
    ("path", "value"), [("transport/no_such_thing", 1), ("transport/unicast/max_sessions", "many")]
)
def test_a_setting_that_zenoh_does_not_know_is_a_usage_error(path: str, value: object) -> None:
    with pytest.raises(UsageError, match=path):
        open_router("tcp/127.0.0.1:0", {path: value})


def test_a_flood_loses_nothing(router: ZenohBus) -> None:
    router.subscribe("flood/*")
    number = 4000

    def flood(bus: ZenohBus, key: str) -> None:
        for number_sent in range(number):
            bus.put(key, number_sent.to_bytes(1000, "big"))

    with open_client(router.endpoint) as one, open_client(router.endpoint) as two:
        for bus, key in ((one, "flood/1"), (two, "flood/2")):
            bus.get("flood/barrier", timeout_s=5.0)  # its end tells that the router has heard of this client
            first(bus, Reply)
            threading.Thread(target=flood, args=(bus, key)).start()
        heard: dict[str, list[int]] = {"flood/1": [], "flood/2": []}
        for _ in range(2 * number):
            event = first(router, Message)
            assert isinstance(event, Message)
            heard[event.key].append(int.from_bytes(event.payload, "big"))
    assert heard == {"flood/1": list(range(number)), "flood/2": list(range(number))}


def test_a_message_larger_than_ours_is_not_read_and_changes_nothing(
    router: ZenohBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("atoll_core.wire.bus.interface.MAX_PAYLOAD", 2 * MAX_PAYLOAD)
    router.subscribe("large")
    with open_client(router.endpoint) as stranger:
        stranger.get("barrier", timeout_s=5.0)
        first(stranger, Reply)
        stranger.put("large", bytes(MAX_PAYLOAD + 2 * 1024 * 1024))
        assert repeated_until_read(stranger, router, b"small") == Message("large", b"small")


def repeated_until_read(stranger: ZenohBus, router: ZenohBus, payload: bytes) -> Event:
    """Return the first message read while `payload` is sent again and again: a busy machine may cut a long one off."""
    end = router.now() + LIMIT_S
    while router.now() < end:
        stranger.put("large", payload)
        event = router.receive(1.0)
        if isinstance(event, Message):
            return event
    raise AssertionError("nothing came")


def started(script: str, *arguments: str) -> subprocess.Popen[str]:
    imports = "import os, sys\nfrom atoll_core.wire.bus.zenoh_bus import open_client, open_router\n"
    return subprocess.Popen([sys.executable, "-c", imports + script, *arguments], stdout=subprocess.PIPE, text=True)


RECEIVING = """
import os
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # who runs the tests in the background ignores it
with open_router("tcp/127.0.0.1:0") as bus:
    try:
        bus.subscribe("a/**")
        bus.serve("b/**")
        os.write(1, b"ready\\n")
        while True:
            bus.receive(1.0)
    except KeyboardInterrupt:
        os.write(1, b"interrupted\\n")
"""


def test_ctrl_c_while_receiving_is_served_and_the_process_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RUST_LOG", "debug")
    with started(RECEIVING) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGINT)
        assert process.stdout.read() == "interrupted\n"  # and nothing that zenoh has to say
        assert process.wait(LIMIT_S) == 0


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["raise SystemExit(7)", "sys.exit(7)", "os._exit(7)"])
def test_a_process_that_forgets_to_close_its_bus_ends_all_the_same(ending: str, router: ZenohBus) -> None:
    script = f"bus = open_client(sys.argv[1]); bus.subscribe('a/**'); bus.serve('b/**'); bus.watch('c/*'); {ending}"
    with started(script, router.endpoint) as process:
        assert process.wait(LIMIT_S) == 7


def test_closing_does_not_wait_for_a_session_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zenoh_bus, "_CLOSE_LIMIT_S", 0.05)
    over = threading.Event()

    class Hanging:
        def close(self) -> None:
            over.wait(LIMIT_S)

    bus = ZenohBus(Hanging(), "tcp/a:1", is_router=True)  # type: ignore[arg-type]
    bus.close()
    over.set()


def test_a_bus_may_be_closed_while_another_thread_puts(router: ZenohBus) -> None:
    bus = open_client(router.endpoint)
    stop = threading.Event()
    errors: list[BaseException] = []

    def put() -> None:
        try:
            while not stop.is_set():
                bus.put("a", bytes(1000))
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=put)
    thread.start()
    bus.close()
    bus.close()
    stop.set()
    thread.join(LIMIT_S)
    assert errors == []


def network_listeners() -> set[str]:
    """Return the sockets of this process that listen to a network."""
    mine = set()
    for descriptor in list(Path("/proc/self/fd").iterdir()):
        with suppress(OSError):  # that of the folder itself is closed by now
            mine.add(str(descriptor.readlink()))
    tables = [Path(f"/proc/self/net/{name}").read_text() for name in ("tcp", "tcp6", "udp", "udp6")]
    rows = [row.split() for table in tables for row in table.splitlines()]
    return {row[1] for row in rows if row[3] in ("0A", "07") and f"socket:[{row[9]}]" in mine}


@pytest.mark.skipif(sys.platform != "linux", reason="/proc tells who listens")
def test_a_router_at_an_address_of_its_own_listens_to_no_network_and_answers() -> None:
    before = network_listeners()
    with own_address() as address, open_router(str(address)) as router:
        assert network_listeners() == before
        router.serve("atoll/hello")
        with open_client(str(address), wait_s=LIMIT_S) as client:
            client.get("atoll/hello")
            assert first(router, Query)
    assert not Path(address.host).parent.exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")
def test_another_user_reaches_no_router_at_an_address_of_its_own() -> None:
    with own_address() as address, open_router(str(address)):
        be_somebody = "import os, socket; os.setgroups([]); os.setgid(65534); os.setuid(65534)"
        program = f"{be_somebody}; socket.socket(socket.AF_UNIX).connect({address.host!r})"
        done = subprocess.run([sys.executable, "-S", "-c", program], capture_output=True, text=True)
    assert "PermissionError" in done.stderr


def test_a_client_with_several_addresses_finds_whoever_listens_and_goes_over_to_another() -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        nobody = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with open_router("tcp/127.0.0.1:0") as second:
        other = open_router("tcp/127.0.0.1:0")
        try:
            with open_client(f"{nobody},{other.endpoint},{second.endpoint}", wait_s=10.0) as client:
                assert client.endpoint == other.endpoint
                other.close()
                assert [first(client, Link), first(client, Link)] == [Link(False), Link(True)]
        finally:
            other.close()


def test_the_owner_sends_no_answer_itself(router: ZenohBus, monkeypatch: pytest.MonkeyPatch) -> None:
    """An answer that is not taken keeps a thread; when its party asks for too much it is told to ask again. Small
    answers go out meanwhile, and those of other parties; those that wait go out in the end."""
    is_sent, is_taken, owner = threading.Event(), threading.Event(), threading.get_ident()
    send = router._reply

    def reply(query: Query, payload: bytes | None) -> None:
        assert threading.get_ident() != owner
        if payload is not None and len(payload) >= queues.LARGE and query.key == "asked/stopped":
            is_sent.set()
            is_taken.wait(LIMIT_S)
        send(query, payload)

    monkeypatch.setattr(router, "_reply", reply)
    router.serve("asked/*")
    with open_client(router.endpoint, wait_s=LIMIT_S) as stopped, open_client(router.endpoint, wait_s=LIMIT_S) as other:

        def ask(client: ZenohBus, name: str, size: int) -> int:
            token = client.get(f"asked/{name}", timeout_s=LIMIT_S)
            router.reply(first(router, Query), bytes(size))  # type: ignore[arg-type]
            return token

        def answers(client: ZenohBus, count: int) -> dict[int, int | None]:
            """Return the sizes of the next answers by their tokens."""
            replies = [first(client, Reply) for _ in range(count)]
            return {reply.token: len(reply.payload) if reply.payload else None for reply in replies}  # type: ignore[attr-defined]

        first_one = ask(stopped, "stopped", queues.LARGE)
        assert is_sent.wait(LIMIT_S)
        waiting = [ask(stopped, "stopped", queues.LARGE) for _ in range(queues.MAX_LARGE_OF_PARTY + 1)]
        small = ask(stopped, "stopped", 5)
        assert answers(stopped, 2) == {waiting[-1]: None, small: 5}
        for _ in range(2 * queues.MAX_LARGE_OF_PARTY):
            token = ask(other, "other", queues.LARGE)
            assert answers(other, 1) == {token: queues.LARGE}
        is_taken.set()
        assert answers(stopped, len(waiting)) == dict.fromkeys([first_one, *waiting[:-1]], queues.LARGE)


def test_answers_that_wait_are_sent_before_a_bus_closes() -> None:
    with open_router("tcp/127.0.0.1:0") as router:
        router.serve("asked")
        with open_client(router.endpoint, wait_s=LIMIT_S) as client:
            tokens = {client.get("asked", timeout_s=LIMIT_S) for _ in range(queues.MAX_LARGE_OF_PARTY)}
            for _ in tokens:
                router.reply(first(router, Query), bytes(queues.LARGE))  # type: ignore[arg-type]
            router.close()
            replies = [first(client, Reply) for _ in tokens]
    assert {(reply.token, len(reply.payload)) for reply in replies} == {(token, queues.LARGE) for token in tokens}  # type: ignore[attr-defined]


@pytest.mark.skipif(sys.platform == "win32", reason="there no socket is found by its descriptor")
def test_no_socket_of_a_router_waits_in_close(router: ZenohBus) -> None:
    """Zenoh has each wait 10 s for an other side that takes nothing, in a thread that reads what everybody sends."""
    port = parse_address(router.endpoint).port
    with open_client(router.endpoint, wait_s=LIMIT_S), open_client(router.endpoint, wait_s=LIMIT_S):
        end = router.now() + LIMIT_S
        while (waiting := lingering_of(port)) != [0] * 3:
            assert router.now() < end, waiting
            router.receive(0.02)


def lingering_of(port: int) -> list[int]:
    """Return whether each socket of a router in this process waits: the one that listens, and those of its links."""
    read = socket.SOL_SOCKET, socket.SO_LINGER
    return [each.getsockopt(*read) for each in sockets_of(port)]
