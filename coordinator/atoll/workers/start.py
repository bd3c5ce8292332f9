"""`start_on` with the checks of its arguments, the program that it starts on each machine, and the handle that it
returns.
"""

import importlib
import subprocess
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from numbers import Integral, Real
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any, Final, Self, TypeVar

from atoll.client.local_processes import worker_command
from atoll_core.errors import AtollError, UnreachableError, UsageError
from atoll_core.quoting import shown
from atoll_core.wire.addresses import parse_address

STOP_LIMIT_S: Final = 10.0
"""Time limit in seconds for the end of the program after `grace_s`; it kills its workers 5 s after `grace_s`."""

ENDS: Final = {
    0: "the coordinator ended, or the workers were asked to end",
    2: "bad options, or refused by the coordinator",
    3: "the coordinator could not be reached",
}
"""Meanings of exit codes of the program; all other codes are failures."""


@dataclass(frozen=True)
class ProgramOptions:
    """Options of the program ``island-worker``, as plain values.

    `connect` is the coordinator's address. `tls` has the paths of the certificate files ``ca``, ``cert`` and ``key`` on
    the machines of the cluster. The coordinator may be unreachable for `wait_s` seconds. When the program is asked to
    end, it hands its islands over within `grace_s` seconds.
    """

    connect: str
    wait_s: float
    grace_s: float
    tls: Mapping[str, str] = field(default_factory=dict)


def drain_limit_s(options: ProgramOptions) -> float:
    """Return the time limit in seconds from the request to end the program to its end; then the program is killed."""
    return options.grace_s + STOP_LIMIT_S


class WorkerProgram:
    """The program with several worker processes: it restarts processes that die, and ends with this process.

    If this process is killed, the workers hand over their islands before they end, see ADR 0062.
    """

    def __init__(self, options: ProgramOptions, processes: int) -> None:
        """Start the program."""
        self.processes: Final = processes
        self._limit_s = drain_limit_s(options)
        command = worker_command(options.connect, None, processes, wait_s=options.wait_s, grace_s=options.grace_s)
        files = [word for name, file in options.tls.items() for word in (f"--tls-{name}", file)]
        # It inherits stdout and stderr, so that the cluster's logs have its output, and certificates in the
        # environment.
        self._process = subprocess.Popen(
            [*command, *files, "--supervise"], stdin=subprocess.DEVNULL, start_new_session=True
        )

    def exit_code(self) -> int | None:
        """Return the program's exit code, negative for a signal; None while it runs."""
        return self._process.poll()

    def drain(self) -> None:
        """Make the workers hand over their islands and end; kill them after a time limit. Repeatable."""
        self._process.terminate()
        try:
            self._process.wait(self._limit_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def ending(exit_code: int) -> str:
    """Return a clause on how a program has ended."""
    if exit_code < 0:
        return f"ended by signal {-exit_code}"
    return f"ended with exit code {exit_code}" + (f" ({ENDS[exit_code]})" if exit_code in ENDS else "")


@dataclass(frozen=True)
class MachineWorkers:
    """The program on one machine: its number of worker processes, and its exit code (None while it runs)."""

    processes: int
    exit_code: int | None


class Handle(ABC):
    """Island workers that were started on a cluster; a context manager that ends them."""

    @abstractmethod
    def machines(self) -> Mapping[str, MachineWorkers]:
        """Return the programs by the name of a machine in the cluster: the address of a Dask worker, the id of a Ray
        node.
        """

    @abstractmethod
    def close(self) -> None:
        """End all programs after they have handed over their islands. Repeatable. Machines that join later start no
        program."""

    def check(self) -> None:
        """Raise AtollError if the program has ended on a machine, with the meaning of its exit code."""
        for name, workers in self.machines().items():
            if workers.exit_code is not None:
                raise AtollError(
                    f"the island workers of {name} have {ending(workers.exit_code)}; see the log of the process "
                    "of that machine in the cluster"
                )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


A = TypeVar("A")


def limited(call: Callable[[], A], limit_s: float, what: str) -> A:
    """Return the result of `call`, or raise its error; raises UnreachableError with `what` after `limit_s` seconds.

    After a timeout the thread of the call continues to wait, and ends with this process at the latest.
    """
    answers: list[A] = []
    errors: list[BaseException] = []

    def act() -> None:
        try:
            answers.append(call())
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=act, name=f"waiting: {what}", daemon=True)
    thread.start()
    thread.join(limit_s)
    if errors:
        raise errors[0]
    if not answers:
        raise UnreachableError(
            f"{what} within {limit_s:g} s; one of its machines may hang: see the logs of the cluster"
        )
    return answers[0]


WAIT_S: Final = 60.0
"""Default time in seconds for which the coordinator may be unreachable, enough for a restart."""

GRACE_S: Final = 30.0
"""Default of ``island-worker --grace``."""

MOST_PROCESSES: Final = 1024
"""Maximum of ``island-worker --processes``."""

Start = Callable[[Any, ProgramOptions, int | None], Handle]
"""Starts workers on a cluster; arguments: client, options of the program, number of processes on each machine."""

_LONGEST_S: Final = 1e9
_TLS: Final = ("ca", "cert", "key")
_DASK_SCHEMES: Final = ("tcp", "tls", "ucx", "ws", "wss", "inproc")


def start_on(
    client: object,
    *,
    connect: str,
    workers: int | None = None,
    tls: Mapping[str, str | Path] | None = None,
    wait: float = WAIT_S,
    grace: float = GRACE_S,
) -> Handle:
    """Start island workers on the machines of a Dask or Ray cluster, including machines that join later.

    Each Dask worker or Ray node starts one program ``island-worker``, which ends with it. Each machine needs the same
    version of Atoll. A machine that leaves the cluster regularly hands over its islands first; if a machine is killed,
    one or two seconds of its work are repeated, and no result is lost.

    Args:
        client: a ``distributed.Client`` or a Dask scheduler's address such as ``tcp://host:8786``; or the module
            ``ray`` after ``ray.init``, or a Ray address such as ``auto`` or ``ray://host:10001``.
        connect: address at which the machines of the cluster reach the coordinator, such as ``tcp/host:7447``.
        workers: number of processes on each Dask worker or Ray node; None: its number of threads (Dask) or CPUs (Ray).
        tls: for an address ``tls/…``, the paths of the files ``ca``, ``cert`` and ``key`` on those machines; None: the
            paths in the environment of those machines.
        wait: seconds for which the coordinator may be unreachable.
        grace: time limit in seconds for handing over islands.

    Returns:
        A handle; its ``close()``, or the end of its ``with`` block, ends the workers.

    Raises:
        UsageError: an argument is wrong, or dask or ray is missing.
        AtollError: the cluster cannot start the workers.
    """
    options = _options(connect, tls, wait, grace)
    if workers is not None and (
        isinstance(workers, bool) or not isinstance(workers, Integral) or not 1 <= workers <= MOST_PROCESSES
    ):
        raise UsageError(f"workers must be a whole number from 1 to {MOST_PROCESSES}, but {shown(workers)} was given")
    number = None if workers is None else int(workers)
    if _is_dask(client):
        return _starter("dask", "distributed")(client, options, number)
    if isinstance(client, str) or (isinstance(client, ModuleType) and client.__name__ == "ray"):
        return _starter("ray", "ray")(client, options, number)
    raise UsageError(
        "a distributed.Client, the module ray, or the address of a cluster was expected as the first argument, but "
        f"{shown(client)} was given"
    )


def _is_dask(client: object) -> bool:
    if isinstance(client, str):
        scheme, separator, _ = client.partition("://")
        return bool(separator) and scheme in _DASK_SCHEMES
    return any(kind.__module__ == "distributed.client" and kind.__name__ == "Client" for kind in type(client).__mro__)


def _starter(name: str, package: str) -> Start:
    """Return the function that starts workers on one kind of cluster; raises UsageError if its package is missing."""
    try:
        importlib.import_module(package)
    except ImportError as error:
        raise UsageError(
            f"{package} is not installed, but workers on such a cluster need it; run: pip install 'atoll[{name}]'"
        ) from error
    start: Start = importlib.import_module(f"atoll.workers.{name}_cluster").start
    return start


def _options(connect: object, tls: object, wait: object, grace: object) -> ProgramOptions:
    if not isinstance(connect, str):
        raise UsageError(f"connect must be an address such as 'tcp/HOST:7447', but {shown(connect)} was given")
    address = parse_address(connect)
    if tls is not None and not (isinstance(tls, Mapping) and set(tls) == set(_TLS)):
        raise UsageError(f"tls must have the files {', '.join(_TLS)} by these names, but {shown(tls)} was given")
    if tls is not None and address.protocol not in ("tls", "quic"):
        raise UsageError(f"{address} is not encrypted, but tls was given; write tls/HOST:PORT, or leave out tls")
    files = {name: str(file) for name, file in (tls or {}).items()}
    return ProgramOptions(str(address), _seconds("wait", wait), _seconds("grace", grace), files)


def _seconds(name: str, value: object) -> float:
    if isinstance(value, Real) and not isinstance(value, bool) and 0.0 <= float(value) < _LONGEST_S:
        return float(value)
    raise UsageError(f"{name} must be a number of seconds, at least 0, but {shown(value)} was given")
