"""``coordinator router``: a router without a coordinator.

For a site of its own: workers dial their site's router, which alone dials the central one. Or in front of a
coordinator (`serve --router`), so that connections stay while that one is restarted.
"""

import argparse
import logging
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from atoll.cli.exit_codes import DONE
from atoll.cli.listener import addresses_of, read_options, warnings_of
from atoll.terminal.output import note, say
from atoll_core import VERSION
from atoll_core.errors import RefusedError, UnreachableError
from atoll_core.logs import fields
from atoll_core.signals import stopping
from atoll_core.wire.addresses import Destination, announced, destination, parse_address
from atoll_core.wire.security.roles import RoleBindings

if TYPE_CHECKING:
    from atoll_core.wire.bus.interface import Bus
    from atoll_core.wire.bus.zenoh_bus import ZenohBus

_LOG = logging.getLogger(__name__)

CHECK_INTERVAL_S: Final = 5.0
"""How often a coordinator is looked for until it is found, and after it was lost."""

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
            say(greeting(here, upstream, role_bindings))
            _log_coordinator(bus, credentials.name if credentials is not None else "client", stop)
    note("coordinator router: stopped")
    return DONE


def upstream_settings(upstream: list[str]) -> dict[str, object]:
    """Return the settings of a router that keeps dialling others and does not wait for them."""
    if not upstream:
        return {}
    return {"connect/endpoints": upstream, "connect/timeout_ms": -1, "connect/exit_on_failure": False}


def greeting(here: Destination, upstream: list[str], role_bindings: RoleBindings | None = None) -> str:
    """Return what a person needs who wants to use this router."""
    passes = f", passes on to {', '.join(upstream)}" if upstream else ""
    lines = [f"router of Atoll {VERSION} listens on {here}{passes}", "start a worker with:"]
    lines += [f"  island-worker --connect {address}" for address in addresses_of(here)]
    if not upstream:
        lines += ["start a coordinator with:", f"  coordinator serve --router {addresses_of(here)[0]} --state DIR"]
    return "\n".join([*lines, *warnings_of(here, role_bindings)])


def _log_coordinator(bus: "ZenohBus", principal: str, stop: threading.Event) -> None:
    """Log when a coordinator is there, and when it is not, until `stop` is set: a router without one is of no use."""
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
    """Return the cluster of the coordinator that answers on `bus`; None when there is none, or none that we know."""
    from atoll.client.client import Client

    try:
        return Client(bus, "this router", principal).greet(CHECK_LIMIT_S)
    except (UnreachableError, RefusedError):
        return None
