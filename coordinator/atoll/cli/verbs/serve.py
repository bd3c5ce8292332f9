"""``coordinator serve``: router, coordinator and store for workers and clients of any machine."""

import argparse
import contextlib
import logging
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Final

from atoll.cli.exit_codes import DONE
from atoll.cli.listener import addresses_of, own_address_of, read_options, warnings_of
from atoll.cli.web_process import web_process
from atoll.terminal.output import note, say
from atoll_core import VERSION
from atoll_core.errors import NotNowError, RefusedError, UnreachableError, UsageError
from atoll_core.logs import fields
from atoll_core.machine import file_system, is_networked
from atoll_core.signals import reloading, stopping
from atoll_core.wire.addresses import Destination, announced, bindable, parse_address
from atoll_core.wire.security.roles import RoleBindings, read_role_bindings

if TYPE_CHECKING:
    from atoll_coordinator.service.scheduling.limits import Limits
    from atoll_coordinator.service.service_loop import Service
    from atoll_coordinator.service.store.store import Store
    from atoll_core.wire.bus.interface import Bus
    from atoll_core.wire.bus.zenoh_bus import ZenohBus

_LOG = logging.getLogger("coordinator")

ANOTHER_LIMIT_S: Final = 0.5
"""How long another coordinator behind the same router is listened for."""

LEAVING_LOOKS: Final = 10
"""How often a coordinator that has taken a store over looks whether the one before it is gone: ten of its ticks."""


def serve(options: argparse.Namespace) -> int:
    """Serve until SIGTERM or Ctrl-C; return 0. A hang-up has limits and roster read again, where there are some.

    Raises UsageError (exit code 2) for options that cannot be used. What may pass has another exit code, so that a
    supervisor starts this again: StoreError and NotNowError (1), UnreachableError (3).
    """
    wanted, role_bindings = read_options(options, options.router)
    limits = _limits(options)
    if options.http is not None and role_bindings is not None and options.http_users is None:
        raise UsageError("--http shows nothing where there is a --roster, unless --http-users says who may see what")
    if options.standby:
        refuse_network(Path(options.state))
    from atoll_coordinator.service.monitoring.metrics import served
    from atoll_coordinator.service.service_loop import Service
    from atoll_coordinator.service.store.retention import Retention
    from atoll_coordinator.service.store.store import Store
    from atoll_coordinator.service.tasks.background import Dependencies

    behind, stop, reload = options.router is not None, threading.Event(), threading.Event()
    reads_again = reloading(reload) if options.limits or options.roster else contextlib.nullcontext()
    with stopping(stop), reads_again:
        store = _awaited(options, wanted, stop) if options.standby else Store.open(Path(options.state))
        if store is None:
            note("coordinator: stopped on standby; another one serves")
            return DONE
        with served(options.metrics) as metrics, store, _joined(options, wanted, role_bindings) as bus:
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
                service.work(stop, lambda: _read_again(service, options) if _take(reload) else None)
    note("coordinator: stopped; jobs and results are kept")
    return DONE


def _limits(options: argparse.Namespace) -> "Limits":
    """Return what users may have; raises UsageError."""
    from atoll_coordinator.service.scheduling.limits import NO_LIMITS, read_limits

    return read_limits(Path(options.limits)) if options.limits is not None else NO_LIMITS


def _take(event: threading.Event) -> bool:
    """Tell whether something has happened since the last call."""
    has_happened = event.is_set()
    event.clear()
    return has_happened


def _read_again(service: "Service", options: argparse.Namespace) -> None:
    """Let what limits and roster say now hold from now on; where they cannot be read, what they said before."""
    try:
        limits = _limits(options)
        role_bindings = read_role_bindings(Path(options.roster)) if options.roster is not None else None
    except UsageError as error:
        _LOG.warning("limits and roster stay as they were", extra=fields(reason=str(error)))
        return
    service.set_policy(limits, role_bindings)
    _LOG.info("limits and roster are read again")


def _joined(options: argparse.Namespace, wanted: Destination, role_bindings: RoleBindings | None) -> "ZenohBus":
    """Return a bus with a router of our own in it, or one that joined the router at ``options.router``.

    Raises UsageError where nobody can listen there, NotNowError where another program listens there, or another
    coordinator is behind that router; UnreachableError where that does not answer in time, RefusedError where one side
    does not accept the certificate of the other.
    """
    from atoll_core.wire.bus.zenoh_bus import open_client, open_router

    if options.router is None:
        return open_router(wanted, role_bindings=role_bindings)
    bus = open_client(wanted, wait_s=options.wait)
    try:
        for left in reversed(range(LEAVING_LOOKS if options.standby else 1)):
            try:
                refuse_another(bus, bus.endpoint)
                break
            except NotNowError:  # the one whose store was taken over ends at its next tick
                if not left:
                    raise
    except BaseException:
        bus.close()
        raise
    return bus


def _awaited(options: argparse.Namespace, wanted: Destination, stop: threading.Event) -> "Store | None":
    """Wait for the store in ``options.state`` until no other coordinator serves it; None when `stop` was set before."""
    from atoll_coordinator.service.store.standby import Standby

    def obstacle() -> str | None:
        """Say why we could not listen beside a coordinator that hangs; a router leads to whoever answers."""
        try:
            if options.router is None:
                bindable(wanted.address)
        except UsageError as error:
            return str(error)
        return None

    return Standby(Path(options.state), stop, obstacle, lambda sentence: note(f"coordinator: {sentence}")).store()


def refuse_network(state: Path) -> None:
    """Raise UsageError where a death or the writes of another coordinator cannot be told from here."""
    kind = file_system(state.absolute())
    if is_networked(kind):
        raise UsageError(
            f"--standby needs the store on a disk of this machine, but {state} is on a network file system ({kind}), "
            "where a lock may outlive its machine and SQLite's shared memory does not reach another one; use a copy "
            "(coordinator backup, Litestream) for other machines"
        )


def refuse_another(bus: "Bus", router: str) -> None:
    """Raise NotNowError when a coordinator answers already behind `router`: workers could not tell the two apart."""
    from atoll.client.client import Client

    try:
        Client(bus, router).greet(ANOTHER_LIMIT_S)
    except UnreachableError:
        return
    except RefusedError:  # one of another version
        pass
    raise NotNowError(
        f"a coordinator is there already behind the router {router}; stop it first, or use another router"
    )


def greeting(
    at: Destination, state: str, role_bindings: RoleBindings | None = None, is_behind_router: bool = False
) -> str:
    """Return what a person needs who wants to use this coordinator: one line for each address to dial."""
    addresses = addresses_of(at, is_behind_router)
    manner = "is behind the router" if is_behind_router else "listens on"
    lines = [f"coordinator {VERSION} {manner} {at}, state in {state}", "start a worker with:"]
    lines += [f"  island-worker --connect {address}" for address in addresses]
    lines += ["submit a job with:", f"  coordinator submit DATA --connect {addresses[0]}"]
    return "\n".join([*lines, *warnings_of(at, role_bindings)])
