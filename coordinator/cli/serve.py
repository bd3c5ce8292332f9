"""``coordinator serve``: router, coordinator and store for workers and clients of any machine."""

import argparse
import contextlib
import logging
import socket
import struct
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Final

from common import VERSION
from common.errors import RefusedError, StoreError, UnreachableError, UsageError
from common.wire.addresses import Address, parse_address
from common.wire.connect_file import announced
from coordinator.cli.exits import DONE
from coordinator.cli.output import note, say
from coordinator.cli.signals import stopping

if TYPE_CHECKING:
    from common.wire.bus import Bus
    from common.wire.zenoh_bus import ZenohBus
    from coordinator.service.store import Store

ANOTHER_LIMIT_S: Final = 0.5
"""How long another coordinator behind the same router is listened for."""

_EVERYWHERE: Final = ("0.0.0.0", "::")
_SIOCGIFADDR: Final = 0x8915


def serve(options: argparse.Namespace) -> int:
    """Serve until SIGTERM or Ctrl-C; return 0."""
    parse_address(options.router or options.listen)
    configure_log()
    from coordinator.service.service import Service

    stop = threading.Event()
    with stopping(stop), _opened(options.state) as store, _joined(options) as bus:
        service = Service(bus, store)
        service.start()
        here = parse_address(bus.endpoint)
        with announced(options.connect_file and Path(options.connect_file), addresses_of(here)):
            say(greeting(here, options.state, options.router is not None))
            service.work(stop)
    note("coordinator: stopped; jobs and results are kept")
    return DONE


def _joined(options: argparse.Namespace) -> "ZenohBus":
    """Return a bus with a router of our own in it, or one that joined the router at ``options.router``.

    Raises:
        UsageError: nobody can listen at ``options.listen``, or another coordinator is behind that router.
        UnreachableError: the router did not answer in time.
    """
    from common.wire.zenoh_bus import open_client, open_router

    if options.router is None:
        return open_router(options.listen)
    bus = open_client(options.router, wait_s=options.wait)
    try:
        refuse_another(bus, bus.endpoint)
    except BaseException:
        bus.close()
        raise
    return bus


def refuse_another(bus: "Bus", router: str) -> None:
    """Raise UsageError when a coordinator answers already behind `router`: workers could not tell the two apart."""
    from coordinator.client import Client

    try:
        Client(bus, router).greet(ANOTHER_LIMIT_S)
    except UnreachableError:
        return
    except RefusedError:  # one of another version
        pass
    raise UsageError(f"a coordinator is there already behind the router {router}; stop it first, or use another router")


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


def greeting(here: Address, state: str, is_behind_router: bool = False) -> str:
    """Return what a person needs who wants to use this coordinator: one line for each address heard on."""
    addresses = addresses_of(here)
    manner = "is behind the router" if is_behind_router else "listens on"
    lines = [f"coordinator {VERSION} {manner} {here}, state in {state}", "start a worker with:"]
    lines += [f"  island-worker --connect {address}" for address in addresses]
    lines += ["submit a job with:", f"  coordinator submit DATA --connect {addresses[0]}"]
    if here.host in _EVERYWHERE:
        lines.append("whoever reaches this port can use it: listen on a trusted network only")
    return "\n".join(lines)


def addresses_of(listen: Address) -> list[str]:
    """Return the addresses to connect to, those for other machines first."""
    return [str(Address(listen.protocol, host, listen.port)) for host in heard_on(listen.host)]


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
