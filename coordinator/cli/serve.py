"""``coordinator serve``: router, coordinator and store for workers and clients of any machine."""

import argparse
import contextlib
import socket
import struct
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Final

from common import VERSION
from common.errors import StoreError, UsageError
from common.logs import configure
from common.wire.addresses import Address, parse_address
from coordinator.cli.exits import DONE
from coordinator.cli.output import note, say
from coordinator.cli.signals import stopping

if TYPE_CHECKING:
    from coordinator.service.store import Store

_EVERYWHERE: Final = ("0.0.0.0", "::")
_SIOCGIFADDR: Final = 0x8915


def serve(options: argparse.Namespace) -> int:
    """Serve until SIGTERM or Ctrl-C; return 0."""
    wanted = parse_address(options.listen)
    configure(options.log_format, options.log_level)
    from common.wire.zenoh_bus import open_router
    from coordinator.service.service import Service

    stop = threading.Event()
    with stopping(stop), _opened(options.state) as store, open_router(str(wanted)) as bus:
        service = Service(bus, store)
        say(greeting(parse_address(bus.endpoint), options.state))
        service.run(stop)
    note("coordinator: stopped; jobs and results are kept")
    return DONE


def _opened(state: str) -> "Store":
    """Open the store in the folder `state`; raises UsageError when it cannot be used, since another could be named."""
    from coordinator.service.store import Store

    try:
        return Store.open(Path(state))
    except StoreError as error:
        raise UsageError(str(error)) from error


def greeting(listen: Address, state: str) -> str:
    """Return what a person needs who wants to use this coordinator: one line for each address heard on."""
    addresses = [Address(listen.protocol, host, listen.port) for host in heard_on(listen.host)]
    lines = [f"coordinator {VERSION} listens on {listen}, state in {state}", "start a worker with:"]
    lines += [f"  island-worker --connect {address}" for address in addresses]
    lines += ["submit a job with:", f"  coordinator submit DATA --connect {addresses[0]}"]
    if listen.host in _EVERYWHERE:
        lines.append("whoever reaches this port can use it: listen on a trusted network only")
    return "\n".join(lines)


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
