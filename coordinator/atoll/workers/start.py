"""`start_on`, which checks its arguments before anything is sent to a cluster; the program that it starts on a machine,
and the handle that it returns."""

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
"""How long the program may take to end, in addition to the grace; it kills its workers after five seconds."""

ENDS: Final = {
    0: "the coordinator ended, or the workers were asked to end",
    2: "bad options, or refused by the coordinator",
    3: "the coordinator could not be reached",
}
"""Meanings of exit codes of the program; any other code is a failure."""


@dataclass(frozen=True)
class ProgramOptions:
    """Options of the program, as plain values.

    `connect` is the coordinator's address, `tls` has the certificate files by ``ca``, ``cert``, ``key``, with their
    paths on the machines of the cluster. The coordinator may be away for `wait_s` seconds; when the program is asked to
    end, it hands islands over within `grace_s` seconds.
    """

    connect: str
    wait_s: float
    grace_s: float
    tls: Mapping[str, str] = field(default_factory=dict)


def drain_limit_s(options: ProgramOptions) -> float:
    """Return the seconds after which a program that is asked to end has ended, killed if necessary."""
    return options.grace_s + STOP_LIMIT_S


class WorkerProgram:
    """Several worker processes: one program, which restarts processes that die, and ends with this process.

    Should this process be killed, they hand over their islands before they end, see ADR 0062.
    """

    def __init__(self, options: ProgramOptions, processes: int) -> None:
        """Start it."""
        self.processes: Final = processes
        self._limit_s = drain_limit_s(options)
        command = worker_command(options.connect, None, processes, wait_s=options.wait_s, grace_s=options.grace_s)
        files = [word for name, file in options.tls.items() for word in (f"--tls-{name}", file)]
        # Its output is this process's, so that it stands in the cluster's logs; certificates may be in the environment.
        self._process = subprocess.Popen(
            [*command, *files, "--supervise"], stdin=subprocess.DEVNULL, start_new_session=True
        )

    def exit_code(self) -> int | None:
        """Return the program's exit code, negative for a signal; None while it runs."""
        return self._process.poll()

    def drain(self) -> None:
        """Have the workers hand over their islands and end; within a limit, then by force. Repeatable."""
        self._process.terminate()
        try:
            self._process.wait(self._limit_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def ending(exit_code: int) -> str:
    """Return how a program has ended, for people."""
    if exit_code < 0:
        return f"ended by signal {-exit_code}"
    return f"ended with exit code {exit_code}" + (f" ({ENDS[exit_code]})" if exit_code in ENDS else "")


@dataclass(frozen=True)
class MachineWorkers:
    """The program on one machine: how many worker processes it keeps, and its exit code, None while it runs."""

    processes: int
    exit_code: int | None


class Handle(ABC):
    """Island workers that were started on a cluster; a context manager that ends them."""

    @abstractmethod
    def machines(self) -> Mapping[str, MachineWorkers]:
        """Return the programs by the machine's name in the cluster: a Dask worker's address, a Ray node's id."""

    @abstractmethod
    def close(self) -> None:
        """End all of them: each hands over its islands first. Repeatable; machines that come later get none."""

    def check(self) -> None:
        """Raise AtollError when the program has ended on a machine, with the reason that its exit code gives."""
        for name, workers in self.machines().items():
            if workers.exit_code is not None:
                raise AtollError(
                    f"the island workers of {name} have {ending(workers.exit_code)}; the log of that machine's process "
                    "in the cluster says more"
                )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


A = TypeVar("A")


def limited(call: Callable[[], A], limit_s: float, what: str) -> A:
    """Return the result of `call`, or raise its error; UnreachableError with `what` when it takes longer.

    Then its thread goes on waiting, and ends with this process at the latest.
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
        raise UnreachableError(f"{what} within {limit_s:g} s; a machine of it may hang: see its logs")
    return answers[0]


WAIT_S: Final = 60.0
"""How long the coordinator may be away; it is started again within that."""

GRACE_S: Final = 30.0
"""As of ``island-worker --grace``."""

MOST_PROCESSES: Final = 1024
"""As of ``island-worker --processes``."""

Start = Callable[[Any, ProgramOptions, int | None], Handle]
"""Starts workers on a cluster, from a client, the options of the program and the number of processes a machine."""

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
    """Start island workers on the machines of a Dask or a Ray cluster, also on machines that join later.

    Each Dask worker or Ray node starts one program ``island-worker``, which ends with it. Atoll is installed there, in
    the same version. Machines that leave the cluster regularly hand over their islands first; a killed machine
    costs a second or two of its work, and no result.

    Args:
        client: a ``distributed.Client`` or a Dask scheduler's address such as ``tcp://host:8786``; or the module
            ``ray`` after ``ray.init``, or a Ray address such as ``auto`` or ``ray://host:10001``.
        connect: address of the coordinator for the machines of the cluster, such as ``tcp/host:7447``.
        workers: processes on each Dask worker or Ray node; None: one for each of its threads, or CPUs.
        tls: files by ``ca``, ``cert`` and ``key`` for an address ``tls/…``, with their paths on those machines; None:
            the files in their environment.
        wait: seconds for which the coordinator may be away.
        grace: seconds within which islands are handed over.

    Returns:
        A handle; ``close()``, or the end of a ``with`` block, ends the workers.

    Raises:
        UsageError: an argument is wrong, or dask or ray is missing.
        AtollError: the cluster does not start them.
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
            f"{package} is not installed, which workers on such a cluster need; pip install 'atoll[{name}]'"
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
