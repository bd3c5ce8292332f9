"""Processes of workers: how many, their commands, their signals, and that none outlives what it belongs to.

A child is forked from this process, or a fresh interpreter where that cannot be, in a session of its own, so that a
Ctrl-C on the terminal reaches the parent alone, which tells the children. Should the parent die without a word, the
kernel (on Linux) and a watching thread end the child.
"""

import contextlib
import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from types import FrameType
from typing import Final

from atoll_core.wire.addresses import Destination
from atoll_island_worker.processes.supervisor import Command, ending_signals, handlers

_STOP_LIMIT_S: Final = 5.0
_WATCH_INTERVAL_S: Final = 1.0
_PR_SET_PDEATHSIG: Final = 1


def worker_command(
    connect: Destination,
    name: str,
    wait_s: float,
    grace_s: float = 0.0,
    lifetime_s: float | None = None,
    further: Sequence[str] = (),
) -> Command:
    """Return the command of one worker process that ends with this one; `further` are options for it."""
    options = ["--connect", str(connect), *tls_options(connect)]
    options += ["--processes", "1", "--name", name, "--wait", f"{wait_s:g}", "--grace", f"{grace_s:g}"]
    options += ["--lifetime", f"{lifetime_s:g}"] if lifetime_s is not None else []
    return [sys.executable, "-m", "atoll_island_worker", *options, *further, "--parent", str(os.getpid())]


def tls_options(connect: Destination) -> list[str]:
    """Return the options that name the same certificates for a child."""
    files = connect.credentials
    if files is None:
        return []
    return ["--tls-ca", str(files.authority), "--tls-cert", str(files.certificate), "--tls-key", str(files.key)]


@contextlib.contextmanager
def exit_on_signals() -> Iterator[None]:
    """Raise SystemExit(0) for SIGTERM and hang-up, once, and KeyboardInterrupt for Ctrl-C, so that all is closed."""

    def end(number: int, frame: FrameType | None) -> None:
        for ending_signal in ending_signals():
            signal.signal(ending_signal, signal.SIG_IGN)
        raise SystemExit(0)

    with handlers({**dict.fromkeys(ending_signals(), end), signal.SIGINT: signal.default_int_handler}):
        yield


@contextlib.contextmanager
def drain_on_signals(parent: int | None, leave: Callable[[], None]) -> Iterator[None]:
    """Call `leave` at the first SIGTERM or hang-up, and raise SystemExit(0) at the second.

    A death of the process `parent`, of which the system tells by the same signal, ends this one at the first.
    """
    signals: list[int] = []

    def on_signal(number: int, frame: FrameType | None) -> None:
        signals.append(number)
        if len(signals) > 1 or parent not in (None, os.getppid()):
            for ending_signal in ending_signals():
                signal.signal(ending_signal, signal.SIG_IGN)
            raise SystemExit(0)
        leave()

    with handlers(dict.fromkeys(ending_signals(), on_signal)):
        yield


def end_with_parent(parent: int) -> None:
    """End this process, by a SIGTERM to itself, as soon as `parent` is no longer its parent; if need be, forcibly."""
    request_parent_death_signal()
    threading.Thread(target=_watch, args=(parent,), name="watching the parent", daemon=True).start()


def request_parent_death_signal() -> None:
    """Have the system send this process a SIGTERM when its parent dies, at once; on Linux only, and not for sure."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH_INTERVAL_S)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_STOP_LIMIT_S)
    os._exit(1)
