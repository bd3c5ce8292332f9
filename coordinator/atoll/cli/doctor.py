"""The checks of ``coordinator doctor``: each yields findings with a subject, a fact and, if needed, advice."""

import argparse
import contextlib
import os
import platform
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from atoll.cli.exit_codes import DONE, FAILED
from atoll.terminal.output import as_json, say
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.errors import AtollError, DataError, UsageError
from atoll_core.machine import file_system, is_networked, usable_cores
from atoll_core.wire.addresses import Destination, addresses_in, bindable, destination, parse_address, why_unreachable
from atoll_core.wire.security.credentials import Credentials, credentials_of

if TYPE_CHECKING:
    from atoll_core.wire.messages.handshake import Welcome
    from atoll_core.wire.messages.views import WorkerView

Grade = Literal["fine", "warning", "problem"]

_MARKS: Final[dict[Grade, str]] = {"fine": "ok     ", "warning": "warning", "problem": "PROBLEM"}


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The finding `found` about `subject`; `advice` is "" if no action is needed."""

    subject: str
    grade: Grade
    found: str
    advice: str = ""


def fine(subject: str, fact: str) -> Diagnosis:
    """Return a finding that needs no action."""
    return Diagnosis(subject, "fine", fact)


def problem(subject: str, error: AtollError) -> Diagnosis:
    """Return the finding of an error, whose text has the fact and, after a semicolon, the advice."""
    fact, _, advice = error.on_command_line.partition("; ")
    return Diagnosis(subject, "problem", fact, advice)


def counted(count: int, noun: str) -> str:
    """Return a number with a noun, such as ``1 problem`` and ``2 processes``."""
    return f"{count} {noun}" + ("" if count == 1 else "es" if noun.endswith("s") else "s")


def as_text(findings: Sequence[Diagnosis]) -> str:
    """Return one line for each finding, one line for each advice, and a summary."""
    width = max(len(finding.subject) for finding in findings)
    lines = []
    for finding in findings:
        first, *rest = finding.found.splitlines() or [""]
        indent = " " * (len(_MARKS["fine"]) + width + 4)
        lines.append(f"{_MARKS[finding.grade]}  {finding.subject.ljust(width)}  {first}")
        lines += [indent + line for line in rest]
        lines += [f"{indent}-> {finding.advice}"] if finding.advice else []
    problems, warnings = (sum(finding.grade == grade for finding in findings) for grade in ("problem", "warning"))
    return "\n".join([*lines, f"{counted(problems, 'problem')}, {counted(warnings, 'warning')}"])


def as_tree(findings: Sequence[Diagnosis]) -> dict[str, object]:
    """Return the findings for JSON."""
    return {
        "fine": all(finding.grade != "problem" for finding in findings),
        "findings": [asdict(finding) for finding in findings],
    }


MB: Final = 1024 * 1024
GB: Final = 1024 * MB

WORKER_BYTES: Final = 300 * MB
"""Memory of one worker process with some thousand rows; measured: about 200 MB."""

FEW_FILES: Final = 1024
LITTLE_ROOM: Final = 100 * MB
SOME_ROOM: Final = GB

_MEMINFO: Final = Path("/proc/meminfo")
_CGROUP: Final = Path("/sys/fs/cgroup")


def check_versions(options: argparse.Namespace) -> Iterator[Diagnosis]:
    """Report the installed versions."""
    from importlib.metadata import version

    libraries = ", ".join(f"{name} {version(name)}" for name in ("eclipse-zenoh", "numpy", "numba"))
    fact = f"Atoll {VERSION} (protocol {PROTOCOL_VERSION}, engine {ENGINE_REVISION})"
    yield fine("versions", f"{fact}, Python {platform.python_version()}, {libraries}, {platform.machine()}")


def check_cores(options: argparse.Namespace) -> Iterator[Diagnosis]:
    """Report the default number of workers on this machine."""
    cores, reason = usable_cores(os.environ)
    yield fine("cores", f"{counted(cores, 'worker process')} by default: {reason}")


def check_memory(options: argparse.Namespace) -> Iterator[Diagnosis]:
    """Check that the available memory suffices for one worker per core."""
    free = available_memory()
    if free is None:
        yield fine("memory", "not known on this system")
        return
    cores, _ = usable_cores(os.environ)
    fact = f"{free / GB:.1f} GB available for {counted(cores, 'worker process')}"
    if free >= cores * WORKER_BYTES:
        yield fine("memory", fact)
    else:
        advice = f"start fewer: island-worker --processes {max(1, free // WORKER_BYTES)}"
        yield Diagnosis("memory", "warning" if free >= WORKER_BYTES else "problem", fact, advice)


def available_memory(meminfo: Path = _MEMINFO, cgroup: Path = _CGROUP) -> int | None:
    """Return the available bytes: the smaller of the amounts that the system and our control group have; None:
    unknown."""
    amounts = []
    with contextlib.suppress(OSError, ValueError, IndexError):
        lines = [line.split() for line in meminfo.read_text("ascii").splitlines()]
        amounts += [int(words[1]) * 1024 for words in lines if words[0] == "MemAvailable:"]
    with contextlib.suppress(OSError, ValueError):
        limit = int((cgroup / "memory.max").read_text("ascii"))
        amounts.append(limit - int((cgroup / "memory.current").read_text("ascii")))
    return min(amounts, default=None)


def check_open_files(options: argparse.Namespace) -> Iterator[Diagnosis]:
    """Check that a coordinator on this machine can open many connections."""
    try:
        import resource
    except ImportError:
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    fact = f"at most {soft}; the coordinator needs one for each worker and client"
    if soft == resource.RLIM_INFINITY or soft >= FEW_FILES:
        yield fine("open files", fact)
    else:
        most = "unlimited" if hard == resource.RLIM_INFINITY else str(hard)
        yield Diagnosis("open files", "warning", fact, f"before serve: ulimit -n {FEW_FILES} (at most {most} here)")


def check_kernels(options: argparse.Namespace) -> Iterator[Diagnosis]:
    """Check whether kernels are compiled, or can be compiled."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        fact = "NUMBA_DISABLE_JIT is set: kernels run as plain Python, a thousand times slower"
        yield Diagnosis("kernels", "warning", fact, "unset it for real work")
        return
    from atoll_core.compilation.cache import cache_directory, is_compiled, wheel_kernels
    from atoll_core.compilation.prebuilt import Kernels

    brought = wheel_kernels("atoll_island_worker")
    directory = brought.folder if isinstance(brought, Kernels) else cache_directory("atoll_island_worker")
    if is_compiled("atoll_island_worker"):
        yield fine("kernels", f"compiled, in {directory}")
        return
    existing = _existing(directory)
    if os.access(existing, os.W_OK | os.X_OK):
        yield fine(
            "kernels",
            f"not compiled yet; the first job compiles them into {directory} in about a minute of one processor",
        )
    else:
        fact = f"not compiled yet, and {existing} cannot be written"
        yield Diagnosis("kernels", "problem", fact, "set ATOLL_KERNEL_CACHE to a folder that can be written")


def check_state(options: argparse.Namespace) -> Iterator[Diagnosis]:
    """Check that a job store can be created in the state folder (by default the current folder)."""
    wanted = Path(options.state or ".").absolute()
    place = _existing(wanted)
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        fact = f"{place} cannot be written" if place.is_dir() else f"{place} is a file"
        yield Diagnosis("state folder", "problem", fact, "name another folder with --state")
        return
    free = shutil.disk_usage(place).free
    fact = f"{wanted}: {free / GB:.1f} GB free"
    if free >= SOME_ROOM:
        yield fine("state folder", fact)
    else:
        advice = "make room, or name a folder on another disk with --state"
        yield Diagnosis("state folder", "problem" if free < LITTLE_ROOM else "warning", fact, advice)
    kind = file_system(place)
    if is_networked(kind):
        fact = f"{place} is on a network file system ({kind})"
        advice = "keep the store on a disk of the coordinator's machine; SQLite needs locks that many such systems lack"
        yield Diagnosis("state folder", "warning", fact, advice)


def _existing(path: Path) -> Path:
    """Return `path`, or the nearest parent that exists."""
    return next(folder for folder in (path, *path.parents) if folder.exists())


LIMIT_S: Final = 3.0
"""How long a coordinator may take to answer."""

CLOCK_S: Final = 5.0
"""Largest accepted difference of clocks, in seconds. If the difference is larger, logs are hard to compare, and
certificates may seem invalid."""

SILENT_S: Final = 5.0

EXPIRY_S: Final = 30 * 86400.0
"""A certificate that expires within this time gets a warning."""


def check_address(options: argparse.Namespace) -> Iterator[Diagnosis]:
    """Check only that the coordinator's address accepts connections."""
    text = options.connect or os.environ.get("ATOLL_CONNECT")
    if not text:
        yield Diagnosis(
            "address", "problem", "no address was given", "give --connect tcp/HOST:PORT or set ATOLL_CONNECT"
        )
        return
    try:
        addresses = addresses_in(text)
    except UsageError as error:
        yield Diagnosis("address", "problem", str(error), "write it as `coordinator serve` printed it")
        return
    reasons = {address: why_unreachable(address, LIMIT_S) for address in addresses}
    is_enough = None in reasons.values()  # the other addresses may belong to a coordinator on standby
    for address, reason in reasons.items():
        if reason is None:
            yield fine("address", f"{address} accepts connections")
        elif is_enough:
            yield fine(
                "address",
                f"{address} does not accept connections ({reason}); it may belong to a coordinator on standby",
            )
        else:
            yield Diagnosis("address", "problem", f"{address} cannot be reached: {reason}", _advice(reason))


def _advice(reason: str) -> str:
    if "not known" in reason:
        return "check the name, or use the machine's IP address"
    if "refused" in reason:
        return (
            "start `coordinator serve` there, at an address that other machines reach (not 127.0.0.1); check the port"
        )
    return "check that the machine is on and that no firewall keeps this port closed"


def check_listen(options: argparse.Namespace) -> Iterator[Diagnosis]:
    """Check that a coordinator could listen at ``--listen``."""
    if options.listen is None:
        return
    try:
        address = parse_address(options.listen)
        bindable(address)
        yield fine("port", f"{address} is free")
    except UsageError as error:
        yield problem("port", error)


def check_certificates(options: argparse.Namespace) -> Iterator[Diagnosis]:
    """Check our certificate: key, authority, purpose and dates; for ``--listen`` also its host names."""
    files = _own_credentials(options)
    if files is not None:
        yield files if isinstance(files, Diagnosis) else certificate_finding(files, time.time())


def certificate_finding(files: Credentials, now: float) -> Diagnosis:
    """Report the name in a certificate and how long it is valid; `now` is Unix time in seconds."""
    hosts = f", for {', '.join(files.hosts)}" if files.hosts else ""
    if files.expires is None:
        return fine("certificate", f"of {files.name}{hosts}")
    left = files.expires - now
    fact = f"of {files.name}{hosts}, valid for {left / 86400.0:.0f} more days"
    if left >= EXPIRY_S:
        return fine("certificate", fact)
    advice = f"renew it in time: deploy/tls/make-authority DIR --renew {files.name}"
    return Diagnosis("certificate", "warning", fact, advice)


def _own_credentials(options: argparse.Namespace) -> Credentials | Diagnosis | None:
    """Return our credentials, a finding if they cannot be used, or None if no certificate was given."""
    try:
        return credentials_of(vars(options), os.environ, "serve" if options.listen else "connect")
    except AtollError as error:
        return problem("certificate", error)


def check_coordinator(options: argparse.Namespace) -> Iterator[Diagnosis]:
    """Check that the coordinator answers, has a compatible version, and has workers."""
    text = options.connect or os.environ.get("ATOLL_CONNECT")
    if not text:
        yield fine("coordinator", "not checked: no address was given (--connect or ATOLL_CONNECT)")
        return
    findings = list(check_address(options))
    yield from findings
    files = _own_credentials(options)
    if any(finding.grade == "problem" for finding in findings) or isinstance(files, Diagnosis):
        return
    try:
        yield from _greeting_findings(destination(text, files))
    except AtollError as error:
        yield problem("coordinator", error)


def _greeting_findings(address: Destination) -> Iterator[Diagnosis]:
    from atoll.client.client import connected

    with connected(address, LIMIT_S) as client:
        welcome, workers = client.welcome, client.workers()
    now = datetime.now(UTC)
    there = f"Atoll {welcome.version} (protocol {welcome.protocol}, engine {welcome.engine})"
    yield fine("coordinator", f"{there} answers")
    yield from version_findings(welcome)
    yield from clock_findings(welcome.clock, now)
    yield from worker_findings(workers, str(address))


def version_findings(welcome: "Welcome") -> Iterator[Diagnosis]:
    """Report a problem if the coordinator would refuse workers of this version."""
    versions = (welcome.version, welcome.protocol, welcome.engine)
    if versions != (VERSION, PROTOCOL_VERSION, ENGINE_REVISION):
        here = f"here is Atoll {VERSION} (protocol {PROTOCOL_VERSION}, engine {ENGINE_REVISION})"
        fact = f"{here}: the coordinator would refuse workers from here"
        yield Diagnosis(
            "versions",
            "problem",
            fact,
            f"install the same version on both machines, such as Atoll {welcome.version} here",
        )


def clock_findings(clock: str, now: datetime) -> Iterator[Diagnosis]:
    """Compare the coordinator's clock with our clock; the answer took less than `LIMIT_S` seconds."""
    try:
        moment = datetime.fromisoformat(clock)
    except ValueError:
        return
    moment = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
    offset = (moment - now).total_seconds()
    if abs(offset) <= CLOCK_S:
        yield fine("clock", "agrees with the coordinator's clock")
        return
    direction = "ahead of" if offset > 0 else "behind"
    fact = f"the coordinator's clock is {abs(offset):.0f} s {direction} the clock of this machine"
    yield Diagnosis(
        "clock", "warning", fact, "synchronise both with a time server: logs and certificates need correct clocks"
    )


def worker_findings(workers: "Sequence[WorkerView]", address: str) -> Iterator[Diagnosis]:
    """Report the workers, and the names of silent workers and of workers that are not ready."""
    here = [worker for worker in workers if worker.state != "lost"]
    if not here:
        yield Diagnosis(
            "workers", "warning", "the coordinator has no workers", f"start one: island-worker --connect {address}"
        )
        return
    yield fine("workers", f"{len(here)} on {counted(len({worker.host for worker in here}), 'machine')}")
    silent = [worker for worker in here if worker.silent > SILENT_S]
    if silent:
        fact = ", ".join(f"{one.worker} on {one.host} has been silent for {one.silent:.0f} s" for one in silent[:5])
        yield Diagnosis("workers", "warning", fact, "check these machines; their islands will soon move to others")
    late = [worker for worker in here if worker.state == "compiling"]
    if late:
        fact = ", ".join(f"{worker.worker}: {worker.detail or 'getting ready'}" for worker in late[:5])
        yield fine("workers", f"not ready yet: {fact}")


Check = Callable[[argparse.Namespace], Iterable[Diagnosis]]


def doctor(options: argparse.Namespace) -> int:
    """Run all checks and print the findings; return 1 if there is a problem, else 0."""
    findings = examine(options, [check_address] if options.quick else CHECKS)
    say(as_json(as_tree(findings)) if options.json else as_text(findings))
    return FAILED if any(finding.grade == "problem" for finding in findings) else DONE


def examine(options: argparse.Namespace, checks: Sequence[Check]) -> list[Diagnosis]:
    """Return the findings of these checks."""
    findings: list[Diagnosis] = []
    for check in checks:
        try:
            findings += list(check(options))
        except Exception as error:  # the other checks run nevertheless
            name = check.__name__.removeprefix("check_")
            fact = f"the check failed ({type(error).__name__}: {error})"
            findings.append(Diagnosis(name, "problem", fact, "report this; the other findings are valid"))
    return findings


def check_data(options: argparse.Namespace) -> Iterator[Diagnosis]:
    """Read the data files as ``submit`` does, but without smoothing."""
    if not options.data:
        return
    from atoll.cli.parser import parse
    from atoll.cli.request import request_of
    from atoll_coordinator.data.columns.examination import examine
    from atoll_coordinator.data.outline import describe
    from atoll_coordinator.data.reading.files import read_table

    given = {name: value for name, value in vars(options).items() if name != "verb"}
    try:
        request = request_of(argparse.Namespace(**{**vars(parse(["submit", *options.data])), **given}))
        table = read_table([Path(name) for name in options.data], request.config.data)
        text = describe(table, request.config, has_warnings=False)
        examined = examine(table, request.config)
    except (DataError, UsageError) as error:
        yield problem("data", error)
        return
    yield fine("data", text)
    for found in examined.findings:
        yield Diagnosis("data", "warning", found.found, found.advice)
    for remark in examined.measurements.warnings[len(examined.findings) :]:
        yield Diagnosis("data", "warning", remark, "check that this is intended")


CHECKS: Sequence[Check] = (
    check_versions,
    check_cores,
    check_memory,
    check_open_files,
    check_kernels,
    check_state,
    check_certificates,
    check_listen,
    check_coordinator,
    check_data,
)
"""All checks, in order."""
