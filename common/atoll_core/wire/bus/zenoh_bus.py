"""The bus over zenoh: an embedded router for the coordinator, client sessions for all others. The only import of zenoh.

Zenoh's callbacks only put events into one inbox; the owner thread takes them out. Callbacks run on zenoh's own threads
(``indirect=False``), so that no thread of ours can keep a process from ending. Never fork after opening a bus.

Settings and their reasons: There is no discovery, since there is one address to dial. There is no shared memory, since
it may drop messages silently and fills /dev/shm. Senders block under load (BLOCK), since the default drops messages.
Queues are large enough for bursts. A sender waits at most `_WAIT_FOR_PEER_US` for a peer that reads nothing. The lease
is short enough to notice a lost machine within seconds. The size of messages is limited.

While one thread waits for a peer that reads nothing, other threads serve all other peers: the outbox sends answers, and
a router gets more threads than zenoh starts by default. Closing a socket must not wait either. Zenoh sets SO_LINGER to
10 s on each TCP socket. The thread that closes a socket is one of the few threads that read messages for all clients:
if the other side reads nothing, ``close`` blocks this thread for 10 s. Zenoh has no setting for this, so
`LingerRemover` resets the option on each socket when its link comes up. ``close`` then returns at once, and the
operating system still sends the buffered data. A later version of zenoh may make this unnecessary; only a test with
clients that read nothing can show it.
"""

import contextlib
import itertools
import json
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self, cast

import zenoh
from zenoh.handlers import Callback

from atoll_core.errors import LocalProtocolError, UnreachableError, UsageError
from atoll_core.signals import interrupts_held_back
from atoll_core.wire.addresses import Address, Destination, bindable, check_certificates, destination, why_unreachable
from atoll_core.wire.bus.interface import (
    MAX_PAYLOAD,
    Event,
    Link,
    Message,
    Posted,
    Presence,
    Query,
    Reply,
    Timer,
    check_expression,
    check_key,
    check_payload,
)
from atoll_core.wire.bus.queues import Inbox, Outbox, Timers
from atoll_core.wire.messages.limits import MAX_MESSAGE
from atoll_core.wire.security.roles import RoleBindings, access_control
from atoll_core.wire.topics import HELLO, ROOT

_FOLDERS: Final = (Path("/proc/self/fd"), Path("/dev/fd"))
_OFF: Final = struct.pack("ii", 0, 0)
_SCAN_PAUSE_S: Final = 0.05
"""Pause between two scans of all sockets, so that a thousand clients that connect at once cause few scans."""


class LingerRemover:
    """A thread that resets SO_LINGER on the sockets of a router; call `link_is_up` for each new link."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._is_due = threading.Event()
        self._is_closed = threading.Event()
        threading.Thread(target=self._run, name="lingering sockets", daemon=True).start()

    def link_is_up(self, _event: object = None) -> None:
        """Scan for new sockets soon. From any thread; returns at once."""
        self._is_due.set()

    def close(self) -> None:
        """End the thread. Repeatable."""
        self._is_closed.set()
        self._is_due.set()

    def _run(self) -> None:
        while self._is_due.wait() and not self._is_closed.is_set():
            self._is_due.clear()
            for each in sockets_of(self._port):
                with contextlib.suppress(OSError):
                    each.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _OFF)
            self._is_closed.wait(_SCAN_PAUSE_S)


def sockets_of(port: int) -> Iterator[socket.socket]:
    """Yield this process's TCP sockets with the local port `port`, each as a duplicate of its descriptor, which is
    closed after use. On Windows none is found."""
    folder = next((folder for folder in _FOLDERS if folder.is_dir()), None)
    for name in [path.name for path in folder.iterdir()] if folder is not None else []:
        try:
            copy = os.dup(int(name))  # refers to the same socket even when zenoh closes its descriptor meanwhile
        except OSError:
            continue
        try:
            found = socket.socket(fileno=copy)
        except OSError:  # no socket
            os.close(copy)
            continue
        with found:
            if found.family in (socket.AF_INET, socket.AF_INET6) and found.type == socket.SOCK_STREAM:
                with contextlib.suppress(OSError):
                    if found.getsockname()[1] == port:
                        yield found


_WAIT_FOR_PEER_US: Final = 1_000_000
_GIVEN_UP: Final = 0.9
"""If an answer took at least this share of `_WAIT_FOR_PEER_US`, zenoh has probably given it up and is closing the link;
a further wait of `_CLOSING_S` is short in comparison."""

_CLOSING_S: Final = 0.1
_LEASE_MS: Final = 4_000
_ATTEMPT_MS: Final = 3_000
_SHORTEST_PAUSE_S: Final = 0.01
_LONGEST_PAUSE_S: Final = 0.2
_PAUSE_SHARE: Final = 0.02
"""Pause between two attempts to connect: this share of the time already waited, within both limits. So a worker that is
started together with its coordinator connects at once, and one that waits for long asks five times in a second."""
_QUICK_S: Final = 0.1
_SLOW_S: Final = 1.0
_CLOSE_LIMIT_S: Final = 5.0
_FREE_PORT_ATTEMPTS: Final = 20
_RUNTIME: Final = "ZENOH_RUNTIME"
_THREADS: Final = 8
"""Number of reading threads of a router, and of its writing threads. Each link that is closing may block one thread."""

_SCOUTING_MS: Final = 1
"""Time for scouting, which is off; by default a router opens half a second late for it."""
_OVERHEAD: Final = 1024 * 1024  # key and attributes of a message, with room to spare

Settings = Mapping[str, object]

_SIZE_LIMITS: Final = {
    64 * 1024: (HELLO, f"{HELLO}/*"),
    1024 * 1024: (f"{ROOT}/*/worker/*/status", f"{ROOT}/*/worker/*/log"),
    MAX_MESSAGE: (
        f"{ROOT}/*/worker/*/report",
        f"{ROOT}/*/worker/*/to/*",
        f"{ROOT}/*/control/**",
        f"{ROOT}/*/client/*/ask",
        f"{ROOT}/*/client/*/changes",
    ),
}
"""By largest size in bytes: the keys of the puts and queries with this limit. A router drops larger messages unread."""


def open_router(
    listen: str | Destination, settings: Settings | None = None, role_bindings: RoleBindings | None = None
) -> "ZenohBus":
    """Start a router listening on `listen` (port 0: any free port, see `ZenohBus.endpoint`) and return its bus.

    Args:
        listen: an address such as ``tcp/0.0.0.0:7447``, or a destination with credentials.
        settings: further zenoh settings by path, such as ``{"transport/unicast/max_sessions": 100}``.
        role_bindings: permissions by the names in certificates; None: every participant may send anything.

    Raises:
        UsageError: no router can listen there, or a setting is unknown to zenoh.
    """
    wanted = listen if isinstance(listen, Destination) else destination(listen)
    further = _tls_settings(wanted)
    if role_bindings is not None:
        further["access_control"] = access_control(role_bindings)
    further.update(settings or {})
    for attempt in itertools.count(1):
        address = bindable(wanted.address)
        try:
            with _allow_more_threads():
                session = zenoh.open(_config("router", [str(address)], [], further))
            bus = ZenohBus(session, str(address), is_router=True)
            if not address.is_socket:
                bus._lingering = LingerRemover(address.port)
                session.info.declare_link_events_listener(_directly(bus._lingering.link_is_up))
                bus._lingering.link_is_up()
            return bus
        except zenoh.ZError as error:  # another program may have taken the port since it was found to be free
            if wanted.address.port or wanted.address.is_socket or attempt == _FREE_PORT_ATTEMPTS:
                raise UsageError(f"cannot listen on {address}: {_reason(error)}") from error
    raise AssertionError


def open_client(connect: str | Destination, wait_s: float = 0.0, settings: Settings | None = None) -> "ZenohBus":
    """Connect to the router at `connect`, trying again for `wait_s` seconds, and return a bus.

    If the router goes away, the bus reconnects by itself, to it or to another address of `connect`; Link events tell
    the owner.

    Raises:
        UnreachableError: no coordinator answered in time.
        RefusedError: one side does not accept the other's certificate; trying again would not help.
        UsageError: `connect` is no address, or a setting is unknown to zenoh.
    """
    to = connect if isinstance(connect, Destination) else destination(connect)
    further = {**_tls_settings(to), **(settings or {})}
    began = time.monotonic()
    end = began + wait_s
    while True:
        reasons: list[str] = []
        for place, address in enumerate(to.addresses):
            in_turn = [str(each) for each in (*to.addresses[place:], *to.addresses[:place])]
            opened = _dial(address, to, _config("client", [], in_turn, further))
            if isinstance(opened, ZenohBus):
                return opened
            reasons.append(opened)
        if time.monotonic() >= end:
            waited = f" within {wait_s:g} s" if wait_s > 0.0 else ""
            reason = ", ".join(dict.fromkeys(reasons))
            raise UnreachableError(
                f"no coordinator answers at {to}{waited}: {reason}; "
                "check the address, or start one with `coordinator serve`"
            )
        now = time.monotonic()
        pause_s = min(_LONGEST_PAUSE_S, max(_SHORTEST_PAUSE_S, _PAUSE_SHARE * (now - began)))
        time.sleep(min(pause_s, max(0.0, end - now)))


def _dial(address: Address, to: Destination, config: zenoh.Config) -> "ZenohBus | str":
    """Return a bus connected to `address`, or the reason why not; raises RefusedError where retrying would not help."""
    reason = why_unreachable(address)
    if reason is None and to.credentials is not None:
        reason = check_certificates(address, to.credentials, _QUICK_S)
    if reason is not None:
        return reason
    try:
        return ZenohBus(zenoh.open(config), str(address), is_router=False)
    except zenoh.ZError:
        slow = check_certificates(address, to.credentials, _SLOW_S)
        return slow or "the program that listens there did not answer as a coordinator does"


class ZenohBus:
    """One zenoh session as a `Bus`; `endpoint` is the address listened on or connected to."""

    def __init__(self, session: zenoh.Session, endpoint: str, is_router: bool) -> None:
        self.endpoint: Final = endpoint
        self._session = session
        self._inbox = Inbox()
        self._timers = Timers()
        self._tokens = itertools.count(1)
        self._kept: list[object] = []  # liveliness tokens vanish with their Python objects
        self._outbox = Outbox()
        self._lingering: LingerRemover | None = None
        if not is_router:
            session.info.declare_transport_events_listener(_directly(self._on_transport))
            if not session.info.routers_zid():  # lost between opening and listening
                self._inbox.add(Link(False))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Send waiting answers and leave the bus; gives up after some seconds rather than hang. Repeatable."""

        def leave() -> None:
            self._outbox.close()
            self._call(self._session.close)

        closer = threading.Thread(target=leave, name="closing the bus", daemon=True)
        closer.start()
        closer.join(_CLOSE_LIMIT_S)
        if self._lingering is not None:
            self._lingering.close()

    def put(self, key: str, payload: bytes) -> None:
        check_payload(key, payload)
        self._call(lambda: self._session.put(check_key(key), payload, **_FIRMLY))

    def subscribe(self, key_expression: str) -> None:
        check_expression(key_expression)
        self._call(lambda: self._session.declare_subscriber(key_expression, _directly(self._on_sample)))

    def serve(self, key_expression: str) -> None:
        check_expression(key_expression)
        self._call(lambda: self._session.declare_queryable(key_expression, _directly(self._on_query), complete=True))

    def get(self, key: str, payload: bytes = b"", timeout_s: float = 5.0) -> int:
        check_payload(key, payload)
        check_key(key)
        token = next(self._tokens)
        is_open = threading.Semaphore(1)

        def finish(payload: bytes | None) -> None:
            if is_open.acquire(blocking=False):  # exactly one Reply for each query
                self._inbox.add(Reply(token, payload))

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                finish(reply.ok.payload.to_bytes())

        handler = Callback(on_reply, lambda: finish(None), indirect=False)
        options = {"payload": payload, "timeout": timeout_s, "consolidation": zenoh.ConsolidationMode.NONE, **_FIRMLY}
        options["source_info"] = zenoh.SourceInfo(self._session.id, token % 2**32)
        if not self._call(lambda: self._session.get(key, handler, **options)):
            finish(None)
        return token

    def reply(self, query: Query, payload: bytes | None, party: str | None = None) -> None:
        if payload is not None:
            check_payload(query.key, payload)
        party = party if party is not None else query.session
        if not self._add(query, payload, party) and not (payload and self._add(query, None, party)):
            self._call(_handle(query).drop)  # far too many answers wait: the asker's own timeout ends the query

    def _add(self, query: Query, payload: bytes | None, party: str) -> bool:
        return self._outbox.add(party, len(payload or b""), lambda: self._reply(query, payload))

    def _reply(self, query: Query, payload: bytes | None) -> None:
        """Send an answer and the end of its query; called by a thread of the outbox.

        If an asker reads nothing, zenoh gives up the link to this asker, and closes the link in the background. If the
        end were sent before the link is closed, this thread would wait for the same time once more, and threads of
        zenoh that serve all links would be blocked.
        """
        handle = _handle(query)
        begin = time.monotonic()
        if payload is not None:
            self._call(lambda: handle.reply(query.key, payload))
        else:
            self._call(lambda: handle.reply_err(b""))
        if (time.monotonic() - begin) * 1e6 > _GIVEN_UP * _WAIT_FOR_PEER_US:
            time.sleep(_CLOSING_S)
        self._call(handle.drop)

    def announce(self, key: str) -> None:
        check_key(key)
        self._call(lambda: self._kept.append(self._session.liveliness().declare_token(key)))

    def watch(self, key_expression: str) -> None:
        check_expression(key_expression)
        handler = _directly(self._on_presence)
        self._call(lambda: self._session.liveliness().declare_subscriber(key_expression, handler, history=True))

    @property
    def dropped(self) -> int:
        return self._inbox.dropped

    def now(self) -> float:
        return time.monotonic()

    def call_later(self, delay_s: float, name: str) -> None:
        self._timers.add(time.monotonic() + delay_s, name)

    def post(self, item: object) -> None:
        self._inbox.add(Posted(item))

    def receive(self, timeout_s: float) -> Event | None:
        """See `Bus.receive`. A signal (Ctrl-C) is served while waiting."""
        end = time.monotonic() + timeout_s
        while True:
            name = self._timers.pop_due(time.monotonic())
            if name is not None:
                return Timer(name)
            wake = min(end, self._timers.next_time())
            event = self._inbox.take(wake - time.monotonic())
            if event is not None or (wake == end and time.monotonic() >= end):
                return event

    def _call(self, act: Callable[[], object]) -> bool:
        """Let zenoh `act`; return False when the session is closed: messages are then lost silently.

        Zenoh may call us back meanwhile, and an interrupt that is raised in a callback would be lost.
        """
        is_main = threading.current_thread() is threading.main_thread()
        try:
            with interrupts_held_back() if is_main else contextlib.nullcontext():
                act()
        except zenoh.ZError as error:
            if not self._session.is_closed():
                raise LocalProtocolError(f"zenoh refused a call: {_reason(error)}") from error
            return False
        return True

    def _on_sample(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            self._inbox.add(Message(str(sample.key_expr), sample.payload.to_bytes()))

    def _on_query(self, query: zenoh.Query) -> None:
        payload = query.payload.to_bytes() if query.payload is not None else b""
        source = query.source_info
        self._inbox.add(Query(str(query.key_expr), payload, query, str(source.source_id.zid) if source else ""))

    def _on_presence(self, sample: zenoh.Sample) -> None:
        self._inbox.add(Presence(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

    def _on_transport(self, event: zenoh.TransportEvent) -> None:
        self._inbox.add(Link(event.kind == zenoh.SampleKind.PUT))


_FIRMLY: Final[dict[str, Any]] = {  # keywords of several functions of zenoh, whose types differ
    "congestion_control": zenoh.CongestionControl.BLOCK,
    "priority": zenoh.Priority.DATA,
}


def _handle(query: Query) -> zenoh.Query:
    return cast(zenoh.Query, query.handle)  # see `_on_query`


def _directly(callback: Callable[[Any], None]) -> Any:
    return Callback(callback, indirect=False)


@contextlib.contextmanager
def _allow_more_threads() -> Iterator[None]:
    """Let zenoh start more threads, unless the user has set their number.

    The environment variable `ZENOH_RUNTIME` sets this number; zenoh reads the variable when it starts its first thread.

    By default one thread writes on all links and two threads read from them. Each of these threads waits while it
    closes the link of a client that reads nothing.
    """
    if _RUNTIME in os.environ:
        yield
        return
    os.environ[_RUNTIME] = f"(rx: (worker_threads: {_THREADS}), tx: (worker_threads: {_THREADS}))"
    try:
        yield
    finally:
        del os.environ[_RUNTIME]  # programs that are started from here have no router


def _config(mode: str, listen: list[str], connect: list[str], settings: Settings) -> zenoh.Config:
    sizes = {"control": 2, "real_time": 2, "interactive_high": 2, "interactive_low": 2}
    sizes |= {"data_high": 4, "data": 16, "data_low": 4, "background": 4}
    patience = {"block": {"wait_before_close": _WAIT_FOR_PEER_US}, "drop": {"wait_before_drop": 20_000}}
    link_tx = {"lease": _LEASE_MS, "queue": {"size": sizes, "congestion_control": patience}}
    retry = {"period_init_ms": 100, "period_max_ms": 1_000, "period_increase_factor": 2}
    taken_in = {"flows": ["ingress"], "messages": ["put", "query"]}
    filters = [
        {"id": f"at most {size}", **taken_in, "key_exprs": keys, "size_limit": size}
        for size, keys in _SIZE_LIMITS.items()
    ]
    tree = {
        "mode": mode,
        "low_pass_filter": filters if mode == "router" else [],
        "listen": {"endpoints": listen},
        "connect": {"endpoints": connect, "timeout_ms": _ATTEMPT_MS, "exit_on_failure": True, "retry": retry},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}, "delay": _SCOUTING_MS},
        "transport": {
            "shared_memory": {"enabled": False},
            "unicast": {"max_sessions": 10_000, "open_timeout": _ATTEMPT_MS, "accept_timeout": 10_000},
            "link": {"tx": link_tx, "rx": {"max_message_size": MAX_PAYLOAD + _OVERHEAD}},
        },
    }
    config = zenoh.Config.from_json5(json.dumps(tree))
    for path, value in settings.items():
        try:
            config.insert_json5(path, json.dumps(value))
        except zenoh.ZError as error:
            raise UsageError(f"zenoh does not accept the setting {path!r}: {_reason(error)}") from error
    return config


def _tls_settings(to: Destination) -> dict[str, object]:
    """Return the settings for TLS with certificates on both sides; no other protocol is then allowed."""
    files = to.credentials
    if files is None:
        return {}
    certificate, key = str(files.certificate), str(files.key)
    tls = {
        "root_ca_certificate": str(files.authority),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
        "listen_certificate": certificate,
        "listen_private_key": key,
        "connect_certificate": certificate,
        "connect_private_key": key,
    }
    return {"transport/link/tls": tls, "transport/link/protocols": [to.address.protocol]}


def _reason(error: zenoh.ZError) -> str:
    """Return zenoh's message without the positions in its source code."""
    text = str(error).split(" at /")[0].strip().splitlines()
    return text[0][:200] if text else "no reason was given"
