"""``coordinator serve``, ``router``, ``backup`` and ``restore``: services that run until they are stopped.

``serve`` runs a router, a coordinator and a store for workers and clients on any machine. ``router`` runs a router
without a coordinator. It has two uses: the workers of a site share one connection to the central router; or connections
stay open while the coordinator behind the router (`serve --router`) is restarted.
"""

import argparse
import contextlib
import ipaddress
import logging
import os
import socket
import struct
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from atoll.cli.exit_codes import DONE
from atoll.cli.verbs.web import web_process
from atoll.terminal.output import as_json, note, say
from atoll_core import VERSION
from atoll_core.errors import NotNowError, RefusedError, UnreachableError, UsageError
from atoll_core.logs import configure, fields
from atoll_core.machine import file_system, is_networked
from atoll_core.signals import raising_interrupts, reloading, stopping
from atoll_core.wire.addresses import Address, Destination, announced, bindable, destination, parse_address, resolved
from atoll_core.wire.security.credentials import credentials_of
from atoll_core.wire.security.roles import RoleBindings, read_role_bindings

if TYPE_CHECKING:
    from atoll_coordinator.service.scheduling.limits import Limits
    from atoll_coordinator.service.service_loop import Service
    from atoll_coordinator.service.store.store import Store
    from atoll_core.wire.bus.interface import Bus
    from atoll_core.wire.bus.zenoh_bus import ZenohBus

_EVERYWHERE: Final = ("0.0.0.0", "::")
_SIOCGIFADDR: Final = 0x8915
_LOCAL: Final = ("127.0.0.1", "localhost")


def read_options(options: argparse.Namespace, router: str | None = None) -> tuple[Destination, RoleBindings | None]:
    """Start logging; return an address and the roles. The address is the one to listen at or, if `router` is given, the
    address of this router. Raises UsageError."""
    credentials = credentials_of(vars(options), os.environ, "serve" if router is None else "connect")
    at = destination(options.listen if router is None else router, credentials, listens=router is None)
    if at.others:
        option = "--listen" if router is None else "--router"
        raise UsageError(f"{option} takes one address, but {len(at.addresses)} were given: {at}")
    if options.roster is not None and credentials is None:
        raise UsageError(
            "--roster gives roles to the names in certificates, so it needs --tls-ca, --tls-cert and --tls-key"
        )
    if router is None:
        _require_dialable(at)
    role_bindings = None if options.roster is None else read_role_bindings(Path(options.roster))
    configure(options.log_format, options.log_level)
    return at, role_bindings


def warnings_of(at: Destination, role_bindings: RoleBindings | None) -> list[str]:
    """Return warnings about access by other users or other machines."""
    if at.address.is_socket:
        return ["every user who can open that socket can submit, read and cancel jobs, and join as a worker"]
    if at.credentials is None and not is_loopback(at.address.host):
        return [
            f"NOT ENCRYPTED: anyone who can reach port {at.address.port} can submit, read and cancel jobs, join as a",
            "worker or send migrants under another name; listen on a trusted network only, or on",
            "tls/HOST:PORT with --tls-ca, --tls-cert, --tls-key and --roster (deploy/tls/make-authority makes them)",
        ]
    if at.credentials is None:
        return []
    lines = [f"every program needs --tls-ca, --tls-cert and --tls-key; the authority is {at.credentials.authority}"]
    if role_bindings is None:
        lines.append(
            "no roster: every owner of a certificate of that authority can compute, submit and cancel (see --roster)"
        )
    return lines


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach a listener on `host`."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def addresses_of(at: Destination, is_behind_router: bool = False) -> list[str]:
    """Return the addresses at which programs connect: first the addresses that other machines can reach. With a
    certificate, these are only its host names."""
    address = at.address
    if is_behind_router or address.is_socket:
        return [str(address)]
    return [str(Address(address.protocol, host, address.port)) for host in _dialable_hosts(at)]


def own_address_of(at: Destination, is_behind_router: bool = False) -> str:
    """Return the address at which programs of this machine connect to our listener.

    With a certificate, the host is one of its names. The name at which the listener listens is preferred, then a name
    of this machine, then the first name, which may belong to another machine.
    """
    address = at.address
    if is_behind_router or address.is_socket:
        return str(address)
    hosts = _dialable_hosts(at)
    host = next(
        (host for host in (address.host, *_LOCAL, *listener_addresses(address.host)) if host in hosts), hosts[0]
    )
    return str(Address(address.protocol, host, address.port))


def _require_dialable(at: Destination) -> None:
    """Raise UsageError if no name in the certificate resolves to the listener."""
    address = at.address
    if address.is_socket or _dialable_hosts(at):
        return
    names = ", ".join(dict.fromkeys(at.credentials.hosts)) if at.credentials is not None else ""
    anywhere = "::" if ":" in address.host else "0.0.0.0"
    raise UsageError(
        f"no client could connect to {address}: its certificate has the names {names}, but an IPv4 address or "
        f"a host name that resolves to {address.host} was expected; listen on "
        f"{Address(address.protocol, anywhere, address.port)}, or make a certificate with such a name "
        "(deploy/tls/make-authority DIR --coordinator HOST,...)"
    )


def _dialable_hosts(at: Destination) -> list[str]:
    """Return the hosts at which clients connect. With a certificate, these are its names that resolve to the listener.
    For a listener on all interfaces, names that do not resolve here are kept as well, because they may resolve on other
    machines. If other machines can reach the listener, but no name resolves to it, all names of other hosts are kept.
    """
    address = at.address
    if at.credentials is None:
        return listener_addresses(address.host)
    names = dict.fromkeys(at.credentials.hosts)
    named = [host for host in names if Address(address.protocol, host, address.port).is_dialable]
    resolving = [host for host in named if _resolves_to(host, address.host)]
    if address.host in _EVERYWHERE:
        return [host for host in named if host in resolving or resolved(host) is None]
    if resolving or is_loopback(address.host):
        return resolving
    return [host for host in named if not is_loopback(resolved(host) or host)]


def _resolves_to(host: str, listener: str) -> bool:
    """Return whether `host` resolves, on this machine, to the listener; False if it does not resolve."""
    there = resolved(host)
    if there is None:
        return False
    if listener in _EVERYWHERE:
        return listener == "::" or ":" not in there
    return there == resolved(listener)


def listener_addresses(host: str) -> list[str]:
    """Return the addresses of a listener on `host`: for ``0.0.0.0``, all addresses of this machine."""
    if host not in _EVERYWHERE:
        return [host]
    addresses = [address for _, name in socket.if_nameindex() if (address := _interface_address(name))]
    others = [address for address in addresses if not address.startswith("127.")]
    return [*others, "127.0.0.1"]


def _interface_address(name: str) -> str | None:
    """Return the IPv4 address of a network interface. On other systems than Linux, return the address of the host's
    name."""
    with contextlib.suppress(OSError, ImportError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        if sys.platform == "linux":
            import fcntl

            answer = fcntl.ioctl(probe.fileno(), _SIOCGIFADDR, struct.pack("256s", name.encode()[:15]))
            return socket.inet_ntoa(answer[20:24])
        return socket.gethostbyname(socket.gethostname())
    return None


_LOG = logging.getLogger(__name__)

CHECK_INTERVAL_S: Final = 5.0
"""Seconds between two checks of the router whether a coordinator answers."""

CHECK_LIMIT_S: Final = 1.0
_REMIND_S: Final = 60.0


def router(options: argparse.Namespace) -> int:
    """Pass messages on until SIGTERM or Ctrl-C; return 0."""
    wanted, role_bindings = read_options(options)
    credentials = wanted.credentials
    wanted_there = [destination(text, credentials) for text in options.connect]
    upstream = [str(address) for there in wanted_there for address in there.addresses]
    from atoll_core.wire.bus.zenoh_bus import open_router

    stop = threading.Event()
    with stopping(stop), open_router(wanted, upstream_settings(upstream), role_bindings) as bus:
        here = Destination(parse_address(bus.endpoint), credentials)
        with announced(options.connect_file and Path(options.connect_file), addresses_of(here)):
            say(router_greeting(here, upstream, role_bindings))
            _log_coordinator(bus, credentials.name if credentials is not None else "client", stop)
    note("coordinator router: stopped")
    return DONE


def upstream_settings(upstream: list[str]) -> dict[str, object]:
    """Return the settings of a router that connects to other routers, retries, and does not wait for them."""
    if not upstream:
        return {}
    return {"connect/endpoints": upstream, "connect/timeout_ms": -1, "connect/exit_on_failure": False}


def router_greeting(here: Destination, upstream: list[str], role_bindings: RoleBindings | None = None) -> str:
    """Return the commands that start workers and a coordinator at this router."""
    passes = f", passes on to {', '.join(upstream)}" if upstream else ""
    lines = [f"router of Atoll {VERSION} listens on {here}{passes}", "start a worker with:"]
    lines += [f"  island-worker --connect {address}" for address in addresses_of(here)]
    if not upstream:
        lines += ["start a coordinator with:", f"  coordinator serve --router {addresses_of(here)[0]} --state DIR"]
    return "\n".join([*lines, *warnings_of(here, role_bindings)])


def _log_coordinator(bus: "ZenohBus", principal: str, stop: threading.Event) -> None:
    """Log when a coordinator is found or lost, until `stop` is set; a router without a coordinator is useless."""
    known: str | None = None
    reminded_at = -_REMIND_S
    while not stop.is_set():
        cluster, now = coordinator_behind(bus, principal), time.monotonic()
        if cluster is not None and cluster != known:
            _LOG.info("coordinator found", extra=fields(realm=cluster))
        elif cluster is None and (known is not None or now - reminded_at >= _REMIND_S):
            _LOG.warning("no coordinator answers behind this router yet")
            reminded_at = now
        known = cluster
        stop.wait(CHECK_INTERVAL_S)


def coordinator_behind(bus: "Bus", principal: str = "client") -> str | None:
    """Return the cluster of the coordinator that answers on `bus`; None without an answer, or if it refuses us."""
    from atoll.client.client import Client

    try:
        return Client(bus, "this router", principal).greet(CHECK_LIMIT_S)
    except (UnreachableError, RefusedError):
        return None


def backup(options: argparse.Namespace) -> int:
    """Copy the store in ``options.state`` into the file ``options.file``; the store may be in use."""
    from atoll_coordinator.service.store.backup import back_up

    target = Path(options.file)
    with raising_interrupts():
        copy = back_up(Path(options.state), target)
    facts = {"file": str(target), "cluster": copy.cluster, "jobs": copy.jobs, "bytes": copy.size}
    text = f"{target}: a copy of {options.state}, checked; jobs {copy.jobs}, {copy.size / 1e6:.1f} MB"
    say(as_json(facts) if options.json else text)
    return DONE


def restore(options: argparse.Namespace) -> int:
    """Make the store in ``options.state`` from the copy ``options.file``."""
    from atoll_coordinator.service.store.backup import restore as restored

    with raising_interrupts():
        store = restored(Path(options.file), Path(options.state), replaces=options.replace)
    former = str(store.former) if store.former is not None else None
    facts = {
        "state": options.state, "cluster": store.cluster, "of": store.copy.cluster, "jobs": store.copy.jobs,
        "former": former, "aside": [str(path) for path in store.aside],
    }  # fmt: skip
    lines = [
        f"{options.state}: restored from {options.file}, jobs {store.copy.jobs}; start it with: "
        f"coordinator serve --state {options.state}",
        f"it is now cluster {store.cluster}; if a coordinator still serves {store.copy.cluster} elsewhere, both "
        "coordinators continue the same jobs without contact with each other; stop one of them",
    ]
    lines += [f"the old store is now {former}; remove it when you no longer need it"] if former is not None else []
    if store.aside and former is None:
        lines.append(
            "the folder had SQLite files with the last writes of a store that is missing; these files are now "
            f"{', '.join(map(str, store.aside))}; to open that store, move these files into its folder and give them "
            "its file name, with their present endings"
        )
    say(as_json(facts) if options.json else "\n".join(lines))
    return DONE


ANOTHER_LIMIT_S: Final = 0.5
"""How long another coordinator behind the same router may take to answer."""

PREDECESSOR_CHECKS: Final = 10
"""After the takeover of a store: how many times to check whether the former coordinator of the store has ended."""


def serve(options: argparse.Namespace) -> int:
    """Serve until SIGTERM or Ctrl-C; return 0. SIGHUP makes it read limits and roster again.

    Raises UsageError (exit code 2) for unusable options. Temporary errors have other exit codes, so that a supervisor
    restarts the program: StoreError and NotNowError (1), UnreachableError (3).
    """
    wanted, role_bindings = read_options(options, options.router)
    limits = _limits(options)
    if options.http is not None and role_bindings is not None and options.http_users is None:
        raise UsageError(
            "--http was given with --roster, but without --http-users FILE; give this option: its file has the users "
            "of the page"
        )
    if options.standby:
        refuse_network(Path(options.state))
    from atoll_coordinator.service.monitoring.metrics import served
    from atoll_coordinator.service.service_loop import Service
    from atoll_coordinator.service.store.retention import Retention
    from atoll_coordinator.service.store.store import Store
    from atoll_coordinator.service.tasks.background import Dependencies

    behind, stop, reload = options.router is not None, threading.Event(), threading.Event()

    def reload_policy() -> None:
        if reload.is_set():
            reload.clear()
            _reload_policy(service, options)

    with stopping(stop), reloading(reload) if options.limits or options.roster else contextlib.nullcontext():
        store = _wait_for_store(options, wanted, stop) if options.standby else Store.open(Path(options.state))
        if store is None:
            note("coordinator: stopped on standby; another coordinator serves this store")
            return DONE
        with served(options.metrics) as metrics, store, _open_bus(options, wanted, role_bindings) as bus:
            dependencies = Dependencies(retention=Retention(*options.keep))
            service = Service(bus, store, dependencies=dependencies, role_bindings=role_bindings, metrics=metrics)
            service.set_policy(limits, role_bindings)
            service.start()
            here = Destination(parse_address(bus.endpoint), wanted.credentials)
            with (
                announced(options.connect_file and Path(options.connect_file), addresses_of(here, behind)),
                web_process(own_address_of(here, behind), options.http, wanted.credentials, options.http_users),
            ):
                say(greeting(here, options.state, role_bindings, behind))
                service.work(stop, reload_policy)
    note("coordinator: stopped; jobs and results are kept")
    return DONE


def _limits(options: argparse.Namespace) -> "Limits":
    """Return the limits of users; raises UsageError."""
    from atoll_coordinator.service.scheduling.limits import NO_LIMITS, read_limits

    return read_limits(Path(options.limits)) if options.limits is not None else NO_LIMITS


def _reload_policy(service: "Service", options: argparse.Namespace) -> None:
    """Read limits and roster again and apply them; if they cannot be read, the old ones stay in force."""
    try:
        limits = _limits(options)
        role_bindings = read_role_bindings(Path(options.roster)) if options.roster is not None else None
    except UsageError as error:
        _LOG.warning("limits and roster cannot be read; the old ones stay in force", extra=fields(reason=str(error)))
        return
    service.set_policy(limits, role_bindings)
    _LOG.info("limits and roster were read again")


def _open_bus(options: argparse.Namespace, wanted: Destination, role_bindings: RoleBindings | None) -> "ZenohBus":
    """Return a bus with its own router, or a bus that joined the router at ``options.router``.

    Raises UsageError if no program can listen there, NotNowError if another program listens there or another
    coordinator is behind that router, UnreachableError if the router does not answer in time, and RefusedError if one
    side does not accept the certificate of the other.
    """
    from atoll_core.wire.bus.zenoh_bus import open_client, open_router

    if options.router is None:
        return open_router(wanted, role_bindings=role_bindings)
    bus = open_client(wanted, wait_s=options.wait)
    try:
        for left in reversed(range(PREDECESSOR_CHECKS if options.standby else 1)):
            try:
                refuse_another(bus, bus.endpoint)
                break
            except NotNowError:  # the former coordinator of the store ends at its next tick
                if not left:
                    raise
    except BaseException:
        bus.close()
        raise
    return bus


def _wait_for_store(options: argparse.Namespace, wanted: Destination, stop: threading.Event) -> "Store | None":
    """Wait until no other coordinator serves the store in ``options.state``, and return the store; None: `stop` was set
    before."""
    from atoll_coordinator.service.store.standby import Standby

    def obstacle() -> str | None:
        """Return why we cannot listen at our address, None if we can; behind a router no address is needed."""
        try:
            if options.router is None:
                bindable(wanted.address)
        except UsageError as error:
            return str(error)
        return None

    return Standby(Path(options.state), stop, obstacle, lambda sentence: note(f"coordinator: {sentence}")).store()


def refuse_network(state: Path) -> None:
    """Raise UsageError if the store is on a network file system, which may hide that another coordinator ends or
    writes."""
    kind = file_system(state.absolute())
    if is_networked(kind):
        raise UsageError(
            f"--standby needs the store on a disk of this machine, but {state} is on a network file system ({kind}), "
            "where a lock may remain after its machine has died, and machines do not share SQLite's memory; use a copy "
            "(coordinator backup, Litestream) for other machines"
        )


def refuse_another(bus: "Bus", router: str) -> None:
    """Raise NotNowError if another coordinator answers behind `router`: workers could not distinguish the two."""
    from atoll.client.client import Client

    try:
        Client(bus, router).greet(ANOTHER_LIMIT_S)
    except UnreachableError:
        return
    except RefusedError:  # a coordinator of another version
        pass
    raise NotNowError(
        f"another coordinator already answers behind the router {router}; stop it first, or use another router"
    )


def greeting(
    at: Destination, state: str, role_bindings: RoleBindings | None = None, is_behind_router: bool = False
) -> str:
    """Return the commands that start workers and submit jobs, one line for each address."""
    addresses = addresses_of(at, is_behind_router)
    manner = "is behind the router" if is_behind_router else "listens on"
    lines = [f"coordinator {VERSION} {manner} {at}, state in {state}", "start a worker with:"]
    lines += [f"  island-worker --connect {address}" for address in addresses]
    lines += ["submit a job with:", f"  coordinator submit DATA --connect {addresses[0]}"]
    return "\n".join([*lines, *warnings_of(at, role_bindings)])
