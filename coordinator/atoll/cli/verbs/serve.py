"""``coordinator serve``: router, coordinator and store for workers and clients of any machine."""

import argparse
import contextlib
import ipaddress
import os
import socket
import struct
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Final

from atoll.cli.exit_codes import DONE
from atoll.terminal.output import note, say
from atoll_core import VERSION
from atoll_core.errors import RefusedError, StoreError, UnreachableError, UsageError
from atoll_core.logs import configure
from atoll_core.signals import stopping
from atoll_core.wire.addresses import Address, Destination, destination, parse_address
from atoll_core.wire.connect_file import announced
from atoll_core.wire.security.access_control import Roster, read_roster
from atoll_core.wire.security.credentials import credentials_of

if TYPE_CHECKING:
    from atoll_coordinator.service.background.process_pool import ProcessPool
    from atoll_coordinator.service.store.store import Store
    from atoll_core.wire.bus.interface import Bus
    from atoll_core.wire.bus.zenoh_bus import ZenohBus

ANOTHER_LIMIT_S: Final = 0.5
"""How long another coordinator behind the same router is listened for."""

_EVERYWHERE: Final = ("0.0.0.0", "::")
_SIOCGIFADDR: Final = 0x8915


def serve(options: argparse.Namespace) -> int:
    """Serve until SIGTERM or Ctrl-C; return 0."""
    credentials = credentials_of(vars(options), os.environ, "connect" if options.router is not None else "serve")
    wanted = destination(options.router or options.listen, credentials)
    roster = roster_of(options.roster, wanted)
    configure(options.log_format, options.log_level)
    from atoll_coordinator.service.background.child_main import load_preparation
    from atoll_coordinator.service.background.process_pool import ProcessPool

    stop = threading.Event()
    with stopping(stop), contextlib.closing(ProcessPool()) as pool:
        pool.preload(load_preparation)  # loads while the rest of this is loaded: a restart has jobs that wait for it
        _serve(options, wanted, roster, pool, stop)
    note("coordinator: stopped; jobs and results are kept")
    return DONE


def _serve(
    options: argparse.Namespace, wanted: Destination, roster: Roster | None, pool: "ProcessPool", stop: threading.Event
) -> None:
    """Serve with this pool of processes until `stop` is set."""
    from atoll_coordinator.service.background.ports import Ports
    from atoll_coordinator.service.service import Service
    from atoll_coordinator.service.store.retention import Retention

    behind = options.router is not None
    with _opened(options.state) as store, _joined(options, wanted, roster) as bus:
        ports = Ports(pool, retention=Retention(*options.keep))
        service = Service(bus, store, ports=ports, roster=roster)
        service.start()
        here = Destination(parse_address(bus.endpoint), wanted.credentials)
        with announced(options.connect_file and Path(options.connect_file), addresses_of(here, behind)):
            say(greeting(here, options.state, roster, behind))
            service.work(stop)


def roster_of(file: str | None, at: Destination) -> Roster | None:
    """Return who may do what; None without a file. Raises UsageError."""
    if file is None:
        return None
    if at.credentials is None:
        raise UsageError(
            "--roster gives roles to the names in certificates, so it needs --tls-ca, --tls-cert and --tls-key"
        )
    return read_roster(Path(file))


def _joined(options: argparse.Namespace, wanted: Destination, roster: Roster | None) -> "ZenohBus":
    """Return a bus with a router of our own in it, or one that joined the router at ``options.router``.

    Raises:
        UsageError: nobody can listen at ``options.listen``, or another coordinator is behind that router.
        UnreachableError: the router did not answer in time.
        RefusedError: it does not accept our certificate, or we not its.
    """
    from atoll_core.wire.bus.zenoh_bus import open_client, open_router

    if options.router is None:
        return open_router(wanted, roster=roster)
    bus = open_client(wanted, wait_s=options.wait)
    try:
        refuse_another(bus, bus.endpoint)
    except BaseException:
        bus.close()
        raise
    return bus


def refuse_another(bus: "Bus", router: str) -> None:
    """Raise UsageError when a coordinator answers already behind `router`: workers could not tell the two apart."""
    from atoll.client.client import Client

    try:
        Client(bus, router).greet(ANOTHER_LIMIT_S)
    except UnreachableError:
        return
    except RefusedError:  # one of another version
        pass
    raise UsageError(f"a coordinator is there already behind the router {router}; stop it first, or use another router")


def _opened(state: str) -> "Store":
    """Open the store in the folder `state`; raises UsageError when it cannot be used, since another could be named."""
    from atoll_coordinator.service.store.store import Store

    try:
        return Store.open(Path(state))
    except StoreError as error:
        raise UsageError(str(error)) from error


def greeting(at: Destination, state: str, roster: Roster | None = None, is_behind_router: bool = False) -> str:
    """Return what a person needs who wants to use this coordinator: one line for each address to dial."""
    addresses = addresses_of(at, is_behind_router)
    manner = "is behind the router" if is_behind_router else "listens on"
    lines = [f"coordinator {VERSION} {manner} {at}, state in {state}", "start a worker with:"]
    lines += [f"  island-worker --connect {each}" for each in addresses]
    lines += ["submit a job with:", f"  coordinator submit DATA --connect {addresses[0]}"]
    return "\n".join([*lines, *warnings_of(at, roster)])


def warnings_of(at: Destination, roster: Roster | None) -> list[str]:
    """Return in plain words who can do what, where that is more than this machine's own programs."""
    if at.address.is_socket:
        return ["whoever may use that socket may submit, read and cancel jobs, and join as a worker"]
    if at.credentials is None and not is_loopback(at.address.host):
        return [
            f"NOT ENCRYPTED: whoever reaches port {at.address.port} may submit, read and cancel jobs, join as a",
            "worker or feed migrants in another's name; listen on a trusted network only, or on",
            "tls/HOST:PORT with --tls-ca, --tls-cert, --tls-key and --roster (deploy/tls/make-authority makes them)",
        ]
    if at.credentials is None:
        return []
    lines = [f"certificates: give each --tls-ca, --tls-cert and --tls-key; the authority is {at.credentials.authority}"]
    if roster is None:
        lines.append(
            "no roster: whoever has a certificate of that authority may compute, submit and cancel (see --roster)"
        )
    return lines


def is_loopback(host: str) -> bool:
    """Tell whether only this machine can reach a listener on `host`."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def addresses_of(at: Destination, is_behind_router: bool = False) -> list[str]:
    """Return the addresses to connect to, those for other machines first; with a certificate those that it names."""
    address, files = at.address, at.credentials
    if is_behind_router or address.is_socket:
        return [str(address)]
    hosts = (files.hosts if files is not None else ()) or heard_on(address.host)
    return [str(Address(address.protocol, host, address.port)) for host in hosts]


def heard_on(host: str) -> list[str]:
    """Return the addresses by which others reach a listener on `host`: all of this machine's for ``0.0.0.0``."""
    if host not in _EVERYWHERE:
        return [host]
    found = [address for _, name in socket.if_nameindex() if (address := _interface_address(name))]
    others = [address for address in found if not address.startswith("127.")]
    return [*others, "127.0.0.1"]


def _interface_address(name: str) -> str | None:
    """Return the IPv4 address of a network interface (Linux; elsewhere that of the host's name)."""
    with contextlib.suppress(OSError, ImportError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        if sys.platform == "linux":
            import fcntl

            answer = fcntl.ioctl(probe.fileno(), _SIOCGIFADDR, struct.pack("256s", name.encode()[:15]))
            return socket.inet_ntoa(answer[20:24])
        return socket.gethostbyname(socket.gethostname())
    return None
