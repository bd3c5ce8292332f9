"""``coordinator serve``: router, coordinator and store for workers and clients of any machine."""

import argparse
import contextlib
import ipaddress
import logging
import os
import socket
import struct
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Final

from common import VERSION
from common.errors import StoreError, UsageError
from common.wire.access import Roster, read_roster
from common.wire.addresses import Address, Destination, destination, parse_address
from common.wire.credentials import credentials_of
from coordinator.cli.exits import DONE
from coordinator.cli.output import note, say
from coordinator.cli.signals import stopping

if TYPE_CHECKING:
    from coordinator.service.store import Store

_EVERYWHERE: Final = ("0.0.0.0", "::")
_SIOCGIFADDR: Final = 0x8915


def serve(options: argparse.Namespace) -> int:
    """Serve until SIGTERM or Ctrl-C; return 0."""
    wanted = destination(options.listen, credentials_of(vars(options), os.environ, "serve"))
    roster = _roster(options.roster, wanted)
    configure_log()
    from common.wire.zenoh_bus import open_router
    from coordinator.service.service import Service

    stop = threading.Event()
    with stopping(stop), _opened(options.state) as store, open_router(wanted, roster=roster) as bus:
        service = Service(bus, store, roster=roster)
        say(greeting(Destination(parse_address(bus.endpoint), wanted.credentials), options.state, roster))
        service.run(stop)
    note("coordinator: stopped; jobs and results are kept")
    return DONE


def _roster(file: str | None, listen: Destination) -> Roster | None:
    if file is None:
        return None
    if listen.credentials is None:
        raise UsageError(
            "--roster gives roles to the names in certificates, so it needs --tls-ca, --tls-cert and --tls-key"
        )
    return read_roster(Path(file))


def _opened(state: str) -> "Store":
    """Open the store in the folder `state`; raises UsageError when it cannot be used, since another could be named."""
    from coordinator.service.store import Store

    try:
        return Store.open(Path(state))
    except StoreError as error:
        raise UsageError(str(error)) from error


def configure_log() -> None:
    """Send the log to stderr, one line an event."""
    logging.basicConfig(
        level=logging.INFO, stream=sys.stderr, format="%(asctime)s %(levelname)s %(name)s %(message)s", force=True
    )


def greeting(listen: Destination, state: str, roster: Roster | None = None) -> str:
    """Return what a person needs who wants to use this coordinator: one line for each address to dial."""
    address, files = listen.address, listen.credentials
    hosts = heard_on(address.host) if files is None else files.hosts
    addresses = [Address(address.protocol, host, address.port) for host in hosts]
    lines = [f"coordinator {VERSION} listens on {listen}, state in {state}", "start a worker with:"]
    lines += [f"  island-worker --connect {each}" for each in addresses]
    lines += ["submit a job with:", f"  coordinator submit DATA --connect {addresses[0]}"]
    return "\n".join([*lines, *_warnings(listen, roster)])


def _warnings(listen: Destination, roster: Roster | None) -> list[str]:
    """Return in plain words who can do what, where that is more than this machine's own programs."""
    if listen.credentials is None and not is_loopback(listen.address.host):
        return [
            f"NOT ENCRYPTED: whoever reaches port {listen.address.port} may submit, read and cancel jobs, join as a",
            "worker or feed migrants in another's name; listen on a trusted network only, or on",
            "tls/HOST:PORT with --tls-ca, --tls-cert, --tls-key and --roster (deploy/tls/make-authority makes them)",
        ]
    if listen.credentials is None:
        return []
    lines = [
        f"certificates: give each --tls-ca, --tls-cert and --tls-key; the authority is {listen.credentials.authority}"
    ]
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
