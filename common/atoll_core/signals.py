"""Handling of signals in both programs: Ctrl-C, SIGTERM, hang-up and SIGCHLD. Few imports.

A signal that the parent process has set to be ignored (``nohup``) stays ignored, except for Ctrl-C where noted.
"""

import os
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from types import FrameType
from typing import TYPE_CHECKING, Final, NoReturn

if TYPE_CHECKING:
    import threading

Handler = Callable[[int, FrameType | None], object]
"""Takes the number of a signal and the frame that it interrupts."""

INTERRUPTED: Final = 130
"""Exit code after Ctrl-C."""

_TERMINATION: Final = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
ENDING: Final[tuple[signal.Signals, ...]] = (signal.SIGINT, *_TERMINATION)
"""Signals that ask a program to end."""


def termination_signals() -> list[signal.Signals]:
    """Return the signals that end this process, except Ctrl-C and ignored signals."""
    return [number for number in _TERMINATION if signal.getsignal(number) != signal.SIG_IGN]


@contextmanager
def handling(handlers: Mapping[signal.Signals, Handler]) -> Iterator[None]:
    """Use these handlers inside the block."""
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def ignore(numbers: Iterable[signal.Signals]) -> None:
    """Ignore these signals from now on."""
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)


class _Hold:
    """Whether an interrupt is held back now, and whether one has come meanwhile."""

    depth = 0
    has_come = False


@contextmanager
def interrupts_held_back() -> Iterator[None]:
    """Hold back an interrupt that arrives inside the block, and raise it at the end of the block.

    This is for calls of foreign code that calls us back in the main thread and swallows exceptions raised there.
    """
    _Hold.depth += 1
    try:
        yield
    finally:
        _Hold.depth -= 1
        if _Hold.has_come and not _Hold.depth:
            _Hold.has_come = False
            raise KeyboardInterrupt


def _interrupt(number: int, frame: FrameType | None) -> None:
    if _Hold.depth:
        _Hold.has_come = True
    else:
        raise KeyboardInterrupt


def raising_interrupts() -> AbstractContextManager[None]:
    """Return a context that raises KeyboardInterrupt for Ctrl-C, SIGTERM and hang-up, also for a background program."""
    return handling(dict.fromkeys((signal.SIGINT, *termination_signals()), _interrupt))


def stopping(stop: "threading.Event") -> AbstractContextManager[None]:
    """Return a context in which the first of these signals sets `stop` and the second raises KeyboardInterrupt."""

    def ask(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            _interrupt(number, frame)
        stop.set()

    return handling(dict.fromkeys((signal.SIGINT, *termination_signals()), ask))


def reloading(reload: "threading.Event") -> AbstractContextManager[None]:
    """Return a context in which a hang-up sets `reload` and does not end the process, unless it is ignored."""
    number = getattr(signal, "SIGHUP", None)
    if number is None or signal.getsignal(number) == signal.SIG_IGN:
        return nullcontext()
    return handling({number: lambda *_: reload.set()})


def exiting() -> AbstractContextManager[None]:
    """Return a context that raises SystemExit(0) for SIGTERM and hang-up, once, and KeyboardInterrupt for Ctrl-C."""
    handlers = dict.fromkeys(termination_signals(), _exit)
    return handling({**handlers, signal.SIGINT: signal.default_int_handler})


def draining(parent: int | None, leave: Callable[[], None]) -> AbstractContextManager[None]:
    """Return a context in which the first SIGTERM or hang-up calls `leave`, and the second raises SystemExit(0).

    The system sends the same signal when the process `parent` dies; this process then ends at the first signal.
    """
    has_left = False

    def drain(number: int, frame: FrameType | None) -> None:
        nonlocal has_left
        if has_left or parent not in (None, os.getppid()):
            _exit(number, frame)
        has_left = True
        leave()

    return handling(dict.fromkeys(termination_signals(), drain))


def _exit(number: int, frame: FrameType | None) -> NoReturn:
    ignore(termination_signals())
    raise SystemExit(0)


def end_at_interrupts() -> None:
    """Let Ctrl-C end the process at once until `raise_interrupts` is called, unless Ctrl-C is ignored."""
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, _end_at_once)


def raise_interrupts() -> None:
    """Let Ctrl-C raise KeyboardInterrupt from now on, if it ended the process until now."""
    if signal.getsignal(signal.SIGINT) is _end_at_once:
        signal.signal(signal.SIGINT, _interrupt)


def _end_at_once(number: int, frame: FrameType | None) -> NoReturn:
    os._exit(INTERRUPTED)


def reap_children() -> None:
    """Handle SIGCHLD by default even if a parent set it to be ignored, else exit codes of children are unknown."""
    if hasattr(signal, "SIGCHLD"):
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)


def forget_handlers() -> None:
    """Reset the handlers in a fork to the handlers of a new process."""
    for number in ENDING:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
