"""The ``island-worker`` program: options, help, exit codes. It imports little, because ``--help`` must be instant.

One process is one worker. For several workers, this process loads libraries and kernels, forks the workers, restarts
workers that die, and ends when they have ended; see `atoll_island_worker.processes`.
"""

import argparse
import contextlib
import gc
import importlib
import os
import re
import sys
import time
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Final

from atoll_core.command_line import Parser, add_log_options, add_tls_options, complete, duration, seconds
from atoll_core.machine import batch_job
from atoll_core.main_program import exit_code_of
from atoll_core.signals import draining, exiting, raise_interrupts
from atoll_island_worker import processes
from atoll_island_worker.processes import Child, ExitReasons, print_reason, report_to

if TYPE_CHECKING:
    from atoll_core.wire.addresses import Destination
    from atoll_core.wire.security.credentials import Credentials
    from atoll_island_worker.tasks.task_process import TaskServer

_GRACE_S: Final = 30.0
_MOST_PROCESSES: Final = 1024

_EPILOG: Final = """\
exit codes: 0 the coordinator ended or the worker was asked to end, 1 failed, 2 bad usage or refused by the coordinator,
3 coordinator not reachable, 130 interrupted; of several processes the worst. A process that dies is started again
after 1 s, then 2 s and so on up to 30 s; after five deaths within a minute it is given up, and counts as failed

examples:
  island-worker --connect tcp/192.168.1.5:7447               one process per core; they wait an hour for a restart
  ATOLL_CONNECT=tcp/lab1:7447 island-worker --processes 4    the address from the environment
  island-worker --connect tcp/lab1:7447 --wait 3600          wait up to an hour for a coordinator to come (back)
  island-worker --connect tls/lab1:7447 --tls-ca authority.pem --tls-cert certificate.pem --tls-key key.pem
  island-worker --connect tcp/lab1:7447 --lifetime 55m       hand over and end before a reserved hour is over
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line (None: the command line of this process) and return its exit code."""
    words = sys.argv[1:] if argv is None else argv
    return exit_code_of(lambda: _dispatch(_parse(words)), print_reason)


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    from atoll_core import VERSION

    parser = Parser(
        prog="island-worker",
        description="Evolve islands for a coordinator: connect to it, compute its islands, end with it.",
        epilog=_EPILOG,
    )
    parser.add_argument(
        "--connect",
        metavar="tcp/HOST:PORT",
        help="address of the coordinator (default: the environment variable ATOLL_CONNECT)",
    )
    parser.add_argument(
        "--connect-file",
        metavar="FILE",
        help="read the address from the file that coordinator serve --connect-file writes; wait for it up to --wait",
    )
    parser.add_argument(
        "--processes",
        metavar="auto|N",
        type=_processes,
        default=None,
        help="worker processes; auto (default): one per usable core",
    )
    parser.add_argument(
        "--name",
        type=_name,
        help="name in lists and logs (default: host and process id, after the name in the certificate)",
    )
    parser.add_argument(
        "--wait",
        metavar="SECONDS",
        type=seconds,
        help="how long the coordinator may be away, at the start or later (default: 10 at the start, 3600 later)",
    )
    parser.add_argument(
        "--lifetime",
        metavar="TIME",
        type=duration,
        help="end after this time, such as 90s, 30m or 12h: islands are handed over, nothing is lost",
    )
    parser.add_argument(
        "--grace",
        metavar="TIME",
        type=duration,
        default=_GRACE_S,
        help="how long the handover may take, also after SIGTERM; a second SIGTERM ends at once (default: 30s)",
    )
    add_log_options(parser)
    add_tls_options(parser)
    parser.add_argument("--parent", type=int, help=argparse.SUPPRESS)  # end together with this process
    parser.add_argument("--exit-reasons", type=int, help=argparse.SUPPRESS)  # where the reason of the end is reported
    parser.add_argument("--supervise", action="store_true", help=argparse.SUPPRESS)  # restart even a single worker
    parser.add_argument("--version", action="version", version=f"atoll {VERSION}")
    complete(parser)
    return parser.parse_args(argv)


def _dispatch(options: argparse.Namespace) -> int:
    from atoll_core.machine import usable_cores
    from atoll_core.wire.security.credentials import credentials_of

    credentials = credentials_of(vars(options), os.environ, "connect")
    connect = _destination(options, credentials)
    name = _worker_name(credentials.name if credentials is not None else None, options.name)
    raise_interrupts()
    number = options.processes
    if number is None:
        number, reason = usable_cores(os.environ)
        sys.stderr.write(f"island-worker: {number} {'process' if number == 1 else 'processes'}: {reason}\n")
    if number == 1 and not options.supervise:
        report = partial(report_to, options.exit_reasons) if options.exit_reasons is not None else print_reason
        return exit_code_of(partial(work, connect, name, options, options.parent), report)
    names = [f"{name[:58]}-{index}" for index in range(number)]
    return work_together(connect, names, options)


def _destination(options: argparse.Namespace, credentials: "Credentials | None") -> "Destination":
    """Return the address of the coordinator, from the options or ``ATOLL_CONNECT``; wait for the file with the address.

    Raises:
        UsageError: no address, two addresses or an invalid one was given.
        UnreachableError: the file did not appear in time, or no program accepts connections at the addresses in it.
    """
    from atoll_core.errors import UsageError
    from atoll_core.wire.addresses import destination

    if options.connect_file:
        if options.connect:
            raise UsageError("both --connect and --connect-file were given; give one of them")
        from pathlib import Path

        from atoll_core.wire.addresses import address_in
        from atoll_island_worker.connection import START_S

        wait_s = START_S if options.wait is None else options.wait
        return destination(address_in(Path(options.connect_file), wait_s), credentials)
    connect = options.connect or os.environ.get("ATOLL_CONNECT")
    if not connect:
        raise UsageError("no coordinator was named; give --connect tcp/HOST:PORT or set ATOLL_CONNECT")
    return destination(connect, credentials)


def _worker_name(principal: str | None, wanted: str | None) -> str:
    """Return the worker's name; with a certificate it must be the name in it, or this name with a hyphen and a suffix.

    Raises:
        UsageError: the requested name does not match the certificate.
    """
    from atoll_core.errors import UsageError

    if principal is None:
        return wanted or _default_name()
    if wanted is None:
        name = _default_name()
        return name if name.startswith(f"{principal}-") else f"{principal}-{name[-(57 - len(principal)) :].lstrip('-')}"
    if wanted != principal and not wanted.startswith(f"{principal}-"):
        raise UsageError(
            f"--name must be {principal}, as in the certificate, or begin with {principal}-, but {wanted!r} was given"
        )
    return wanted


def _default_name() -> str:
    import socket

    host = re.sub(r"[^A-Za-z0-9_-]", "-", socket.gethostname().split(".")[0]) or "worker"
    if job := batch_job(os.environ):  # `coordinator adapt` looks for this name
        return f"{host[:28]}-{job}-{os.getpid()}"
    return f"{host[:40]}-{os.getpid()}"


def _processes(text: str) -> int | None:
    if text == "auto":
        return None
    if text.isascii() and text.isdigit() and 1 <= int(text) <= _MOST_PROCESSES:
        return int(text)
    raise argparse.ArgumentTypeError(
        f"auto or a number from 1 to {_MOST_PROCESSES} was expected, but {text!r} was given"
    )


def _name(text: str) -> str:
    from atoll_core.wire.topics import is_id

    if is_id(text):
        return text
    raise argparse.ArgumentTypeError(f"up to 64 letters, digits, - and _ were expected, but {text!r} was given")


def work_together(connect: "Destination", names: Sequence[str], options: argparse.Namespace) -> int:
    """Run one process for each name, and restart it when it dies.

    If possible, processes are forked after the libraries were loaded once.
    """
    from atoll_island_worker.tasks.task_process import TaskServer

    end = time.monotonic() + options.lifetime if options.lifetime is not None else None
    if processes.can_fork():
        load_shared()
    with contextlib.ExitStack() as held:
        # Started first, because it is also a fork: it must not inherit the kernels and pipes loaded and opened below.
        start = partial(_fork, held.enter_context(contextlib.closing(TaskServer()))) if processes.can_fork() else _start
        exit_reasons = held.enter_context(ExitReasons())
        if processes.can_fork():
            with exiting():
                if options.parent is not None:
                    processes.request_parent_death_signal()
                load_ahead()
                if options.parent not in (None, os.getppid()):
                    return 0
        starts = {name: partial(start, connect, name, options, end, exit_reasons) for name in names}
        return processes.supervise(starts, exit_reasons, options.parent, options.grace)


def load_shared() -> None:
    """Load the libraries that workers and task processes both need, without a thread.

    Errors are ignored, because every process reports them.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # otherwise numpy's library starts threads
    with contextlib.suppress(Exception):
        for module in ("atoll_core.config", "atoll_core.data.dataset", "atoll_core.compilation.jit"):
            importlib.import_module(module)


def load_ahead() -> None:
    """Load libraries, and kernels if they are compiled. Errors are ignored here, because every worker reports them.

    The workers compile, because they can report this to the coordinator.
    """
    load_shared()
    with contextlib.suppress(Exception):
        importlib.import_module("atoll_core.wire.bus.zenoh_bus")
        importlib.import_module("atoll_island_worker.worker")
        from atoll_core.compilation.cache import is_compiled
        from atoll_island_worker.compute.warmup import run_small_epochs

        if is_compiled("atoll_island_worker"):
            run_small_epochs()
    gc.freeze()  # all workers share this memory unless the garbage collector writes to it


def _start(
    connect: "Destination", name: str, options: argparse.Namespace, end: float | None, exit_reasons: ExitReasons
) -> Child:
    """Start an interpreter that works until `end` on the monotonic clock (None: no end), and ends with this process."""
    words = ["--connect", str(connect), "--processes", "1", "--name", name, "--grace", f"{options.grace:g}"]
    if (files := connect.credentials) is not None:
        words += ["--tls-ca", str(files.authority), "--tls-cert", str(files.certificate), "--tls-key", str(files.key)]
    words += ["--wait", f"{options.wait:g}"] if options.wait is not None else []
    words += ["--lifetime", f"{_seconds_until(end):g}"] if end is not None else []
    words += ["--log-format", options.log_format, "--log-level", options.log_level]
    words += ["--exit-reasons", str(exit_reasons.writing_end), "--parent", str(os.getpid())]
    return processes.start_process([sys.executable, "-m", "atoll_island_worker", *words], exit_reasons)


def _fork(
    tasks: "TaskServer", connect: "Destination", name: str, options: argparse.Namespace, end: float | None,
    exit_reasons: ExitReasons,
) -> Child:  # fmt: skip
    """Start a fork of this process that works until `end`; `tasks` forks the processes for its tasks."""
    parent = os.getpid()

    def run_until_end() -> int:
        options.lifetime = _seconds_until(end)
        return exit_code_of(partial(work, connect, name, options, parent, tasks), exit_reasons.report)

    return processes.Forked(run_until_end)


def _seconds_until(end: float | None) -> float | None:
    return None if end is None else max(0.0, end - time.monotonic())


def work(
    connect: "Destination", name: str, options: argparse.Namespace, parent: int | None,
    tasks: "TaskServer | None" = None,
) -> int:  # fmt: skip
    """Run one worker until it ends; `parent`: if this process ends, the worker ends too.

    `tasks` starts processes for tasks, by default new interpreters.
    """
    from atoll_core.logs import configure

    with exiting():
        if parent is not None:
            processes.end_with_parent(parent)
        configure(options.log_format, options.log_level, worker=name)
        from atoll_core.compilation.progress import WarmUpDisplay
        from atoll_island_worker.worker import run_worker

        on_signal = partial(draining, parent) if options.grace > 0.0 else lambda leave: contextlib.nullcontext()
        show = WarmUpDisplay() if sys.stderr.isatty() and options.parent is None else None  # else it is logged
        return run_worker(connect, name, options.wait, options.lifetime, options.grace, on_signal, show, tasks)
