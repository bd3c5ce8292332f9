"""Processes of workers: how many, starting them, and that none outlives what it belongs to.

A child is forked from this process, or a fresh interpreter where that cannot be, in a session of its own, so that a
Ctrl-C on the terminal reaches the parent alone, which tells the children. Should the parent die without a word, the
kernel (on Linux) and a watching thread end the child.
"""

import contextlib
import ctypes
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from types import FrameType
from typing import Any, Final, Protocol

from common.cores import usable_cores
from common.wire.addresses import Destination
from island_worker.forking import Forked, Work

INTERRUPTED: Final = 130
_STOP_LIMIT_S: Final = 5.0
_WATCH_INTERVAL_S: Final = 1.0
_WAIT_S: Final = 0.2
_PR_SET_PDEATHSIG: Final = 1
_ENDING: Final = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))

choose_number = usable_cores

Command = Sequence[str]


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
    return [sys.executable, "-m", "island_worker", *options, *further, "--parent", str(os.getpid())]


def tls_options(connect: Destination) -> list[str]:
    """Return the options that name the same certificates for a child."""
    files = connect.credentials
    if files is None:
        return []
    return ["--tls-ca", str(files.authority), "--tls-cert", str(files.certificate), "--tls-key", str(files.key)]


class Child(Protocol):
    """A process that was started here."""

    pid: int

    def wait(self) -> int:
        """Wait for its end and return its exit code, negative for a signal."""

    def terminate(self) -> None:
        """Tell it to end."""

    def kill(self) -> None:
        """End it."""


def supervise(commands: Sequence[Command], parent: int | None = None, grace_s: float = 0.0) -> int:
    """Run the commands as children until all have ended; return the worst exit code, or 130 after a Ctrl-C.

    SIGTERM and Ctrl-C are passed on as SIGTERM; who has not ended `_STOP_LIMIT_S` later (after a SIGTERM `grace_s`
    more, in which children hand over what they compute), or at a second signal, is killed. `parent`: the process with
    which this one ends.
    """
    return _Children(grace_s).run([partial(_started, command) for command in commands], parent)


def supervise_forks(works: Sequence[Work], parent: int | None = None, grace_s: float = 0.0) -> int:
    """Do the same with children that are forked from this process, which must have no other thread."""
    return _Children(grace_s).run([partial(Forked, work) for work in works], parent)


def _started(command: Command) -> Child:
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)


def worst(codes: Sequence[int]) -> int:
    """Return the worst of some exit codes; death by a signal is failure."""
    return max((1 if code < 0 else code for code in codes), default=0)


@contextlib.contextmanager
def ending_on_signals() -> Iterator[None]:
    """Raise SystemExit(0) for SIGTERM and hang-up, once, and KeyboardInterrupt for Ctrl-C, so that all is closed."""

    def end(number: int, frame: FrameType | None) -> None:
        for each in _ENDING:
            signal.signal(each, signal.SIG_IGN)
        raise SystemExit(0)

    with _handlers({**dict.fromkeys(_ending_signals(), end), signal.SIGINT: signal.default_int_handler}):
        yield


@contextlib.contextmanager
def leaving_on_signals(parent: int | None, leave: Callable[[], None]) -> Iterator[None]:
    """Call `leave` at the first SIGTERM or hang-up, and raise SystemExit(0) at the second.

    A death of the process `parent`, of which the system tells by the same signal, ends this one at the first.
    """
    signals: list[int] = []

    def on_signal(number: int, frame: FrameType | None) -> None:
        signals.append(number)
        if len(signals) > 1 or parent not in (None, os.getppid()):
            for each in _ENDING:
                signal.signal(each, signal.SIG_IGN)
            raise SystemExit(0)
        leave()

    with _handlers(dict.fromkeys(_ending_signals(), on_signal)):
        yield


def end_with_parent(parent: int) -> None:
    """End this process, by a SIGTERM to itself, as soon as `parent` is no longer its parent; if need be, forcibly."""
    hear_of_death()
    threading.Thread(target=_watch, args=(parent,), name="watching the parent", daemon=True).start()


def hear_of_death() -> None:
    """Have the system send this process a SIGTERM when its parent dies, at once; on Linux only, and not for sure."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH_INTERVAL_S)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_STOP_LIMIT_S)
    os._exit(1)


class _Children:
    """Children of this process; whatever happens is one event in one queue."""

    def __init__(self, grace_s: float) -> None:
        self._grace_s = grace_s
        self._events: queue.SimpleQueue[tuple[str, int]] = queue.SimpleQueue()
        self._children: list[Child] = []
        self._deadline: float | None = None
        self._signals: list[int] = []

    def run(self, starts: Sequence[Callable[[], Child]], parent: int | None) -> int:
        asked = dict.fromkeys((signal.SIGINT, *_ending_signals()), self._on_signal)
        with _handlers(asked):
            try:
                for start in starts:
                    self._children.append(start())
                self._watch_over(parent)
                codes = [self._next_code() for _ in starts]
            finally:
                self._kill()
        if self._deadline is not None:  # who was told before it could listen has ended as it was told
            codes = [0 if code == -signal.SIGTERM else code for code in codes]
        return INTERRUPTED if signal.SIGINT in self._signals else worst(codes)

    def _watch_over(self, parent: int | None) -> None:
        """Start the threads that wait for events; not before the last child, which may be a fork."""
        if parent is not None:
            end_with_parent(parent)
        for child in self._children:
            threading.Thread(target=self._wait_for, args=(child,), daemon=True).start()

    def _wait_for(self, child: Child) -> None:
        code = child.wait()
        if code < 0 and self._deadline is None:
            sys.stderr.write(f"island-worker: process {child.pid} was ended by signal {-code}; the others go on\n")
        self._events.put(("ended", code))

    def _next_code(self) -> int:
        """Wait for the next child to end, serving signals meanwhile."""
        while True:
            kind, number = self._next_event()
            if kind == "ended":
                return number
            if self._deadline is None:
                self._tell()
            else:
                self._kill()

    def _next_event(self) -> tuple[str, int]:
        """Return the next event. A signal that comes just before the wait is only seen after it: hence short waits."""
        while True:
            if self._deadline is not None and time.monotonic() > self._deadline:
                self._kill()
            with contextlib.suppress(queue.Empty):
                return self._events.get(timeout=_WAIT_S)

    def _tell(self) -> None:
        grace_s = 0.0 if signal.SIGINT in self._signals else self._grace_s
        self._deadline = time.monotonic() + _STOP_LIMIT_S + grace_s
        for child in self._children:
            child.terminate()

    def _kill(self) -> None:
        for child in self._children:
            child.kill()

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._signals.append(number)
        self._events.put(("signal", number))


def _ending_signals() -> list[signal.Signals]:
    """Return the signals that end us; one that is ignored (``nohup``) stays ignored."""
    return [number for number in _ENDING if signal.getsignal(number) != signal.SIG_IGN]


@contextlib.contextmanager
def _handlers(handlers: Mapping[signal.Signals, Any]) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)
