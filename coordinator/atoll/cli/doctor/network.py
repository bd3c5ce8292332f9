"""What ``coordinator doctor`` looks at in the network: a port to listen on, a coordinator, its workers, its clock.

Light to import, because whether an address accepts connections may be asked twice a minute.
"""

import argparse
import os
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

from atoll.cli.doctor.finding import Finding, counted, fine, problem
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.errors import AtollError, UsageError
from atoll_core.wire.addresses import Destination, addresses_in, bindable, destination, parse_address, why_unreachable
from atoll_core.wire.security.credentials import Credentials, credentials_of

if TYPE_CHECKING:
    from atoll_core.wire.messages.handshake import Welcome
    from atoll_core.wire.messages.views import WorkerView

LIMIT_S: Final = 3.0
"""How long a coordinator may take to answer."""

CLOCK_S: Final = 5.0
"""Clocks that differ by more make logs of several machines hard to read, and certificates invalid too early."""

SILENT_S: Final = 5.0

EXPIRY_S: Final = 30 * 86400.0
"""A certificate that expires sooner is pointed out."""


def check_address(options: argparse.Namespace) -> Iterator[Finding]:
    """Whether the coordinator's address accepts connections, and nothing more."""
    text = options.connect or os.environ.get("ATOLL_CONNECT")
    if not text:
        yield Finding("address", "problem", "none was named", "give --connect tcp/HOST:PORT or set ATOLL_CONNECT")
        return
    try:
        addresses = addresses_in(text)
    except UsageError as error:
        yield Finding("address", "problem", str(error), "write it as `coordinator serve` printed it")
        return
    reasons = {address: why_unreachable(address, LIMIT_S) for address in addresses}
    is_enough = None in reasons.values()  # of the others each may be that of a coordinator on standby
    for address, reason in reasons.items():
        if reason is None:
            yield fine("address", f"{address} accepts connections")
        elif is_enough:
            yield fine("address", f"{address} does not ({reason}), as a coordinator on standby")
        else:
            yield Finding("address", "problem", f"{address} cannot be reached: {reason}", _advice(reason))


def _advice(reason: str) -> str:
    if "not known" in reason:
        return "check the name, or use the machine's number"
    if "refused" in reason:
        return "start `coordinator serve` there, on an address that others reach (not 127.0.0.1), or check the port"
    return "check that the machine is on and that no firewall keeps this port closed"


def check_listen(options: argparse.Namespace) -> Iterator[Finding]:
    """Whether a coordinator could listen at ``--listen``."""
    if options.listen is None:
        return
    try:
        address = parse_address(options.listen)
        bindable(address)
        yield fine("port", f"{address} is free")
    except UsageError as error:
        yield problem("port", error)


def check_certificates(options: argparse.Namespace) -> Iterator[Finding]:
    """Whether our certificate can be shown: key, authority, purpose, dates; for ``--listen`` also the names in it."""
    files = _shown(options)
    if files is not None:
        yield files if isinstance(files, Finding) else certificate_finding(files, time.time())


def certificate_finding(files: Credentials, now: float) -> Finding:
    """Say whose certificate this is and how long it will do; `now` is in seconds of Unix time."""
    hosts = f", for {', '.join(files.hosts)}" if files.hosts else ""
    if files.expires is None:
        return fine("certificate", f"of {files.name}{hosts}")
    left = files.expires - now
    fact = f"of {files.name}{hosts}, valid for {left / 86400.0:.0f} more days"
    if left >= EXPIRY_S:
        return fine("certificate", fact)
    advice = f"renew it in time: deploy/tls/make-authority DIR --renew {files.name}"
    return Finding("certificate", "warning", fact, advice)


def _shown(options: argparse.Namespace) -> Credentials | Finding | None:
    """Return what is to be shown to the other side, or what is wrong with it."""
    try:
        return credentials_of(vars(options), os.environ, "serve" if options.listen else "connect")
    except AtollError as error:
        return problem("certificate", error)


def check_coordinator(options: argparse.Namespace) -> Iterator[Finding]:
    """Whether the coordinator answers, fits us, and has workers."""
    text = options.connect or os.environ.get("ATOLL_CONNECT")
    if not text:
        yield fine("coordinator", "none was named (--connect or ATOLL_CONNECT), so none was examined")
        return
    findings = list(check_address(options))
    yield from findings
    files = _shown(options)
    if any(finding.grade == "problem" for finding in findings) or isinstance(files, Finding):
        return
    try:
        yield from _greeted(destination(text, files))
    except AtollError as error:
        yield problem("coordinator", error)


def _greeted(address: Destination) -> Iterator[Finding]:
    from atoll.client.client import connected

    with connected(address, LIMIT_S) as client:
        welcome, workers = client.welcome, client.workers()
    now = datetime.now(UTC)
    there = f"Atoll {welcome.version} (protocol {welcome.protocol}, engine {welcome.engine})"
    yield fine("coordinator", f"{there} answers")
    yield from version_findings(welcome)
    yield from clock_findings(welcome.clock, now)
    yield from worker_findings(workers, str(address))


def version_findings(welcome: "Welcome") -> Iterator[Finding]:
    """Say whether a worker of this installation would be taken; a client, which greeted, was."""
    versions = (welcome.version, welcome.protocol, welcome.engine)
    if versions != (VERSION, PROTOCOL_VERSION, ENGINE_REVISION):
        here = f"here is Atoll {VERSION} (protocol {PROTOCOL_VERSION}, engine {ENGINE_REVISION})"
        fact = f"{here}: workers would be refused"
        yield Finding("versions", "problem", fact, f"install Atoll {welcome.version} here, or this version there")


def clock_findings(clock: str, now: datetime) -> Iterator[Finding]:
    """Compare the coordinator's time of day with ours; it was on its way for less than `LIMIT_S`."""
    try:
        moment = datetime.fromisoformat(clock)
    except ValueError:
        return
    moment = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
    offset = (moment - now).total_seconds()
    if abs(offset) <= CLOCK_S:
        yield fine("clock", "agrees with the coordinator's")
        return
    fact = f"the coordinator's clock is {abs(offset):.0f} s {'ahead of' if offset > 0 else 'behind'} this machine's"
    yield Finding("clock", "warning", fact, "let both follow a time server: logs and certificates go by the clock")


def worker_findings(workers: "Sequence[WorkerView]", address: str) -> Iterator[Finding]:
    """Say which workers are there and which ones one should look after."""
    here = [worker for worker in workers if worker.state != "lost"]
    if not here:
        yield Finding("workers", "warning", "none is there", f"start one: island-worker --connect {address}")
        return
    yield fine("workers", f"{len(here)} on {counted(len({worker.host for worker in here}), 'machine')}")
    silent = [worker for worker in here if worker.silent > SILENT_S]
    if silent:
        fact = ", ".join(f"{one.worker} on {one.host} has been silent for {one.silent:.0f} s" for one in silent[:5])
        yield Finding("workers", "warning", fact, "look at these machines; their islands are placed anew soon")
    late = [worker for worker in here if worker.state == "compiling"]
    if late:
        fact = ", ".join(f"{worker.worker}: {worker.detail or 'getting ready'}" for worker in late[:5])
        yield fine("workers", f"not ready yet: {fact}")
