"""What signals do in both programs: Ctrl-C, SIGTERM and hang-up, and those of child processes. Light to import.

A signal that whoever started us has ignored stays so (``nohup``), but for Ctrl-C where it is said to be raised.
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
"""Those that ask a program to end."""


def termination_signals() -> list[signal.Signals]:
    """Return the signals other than Ctrl-C that end us, without those that are ignored."""
    return [number for number in _TERMINATION if signal.getsignal(number) != signal.SIG_IGN]


@contextmanager
def handling(handlers: Mapping[signal.Signals, Handler]) -> Iterator[None]:
    """Handle signals so inside."""
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
    """Have an interrupt that comes inside be raised at the end of the block.

    For calls of foreign code that calls us back in the main thread, and swallows what is raised there.
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
    """Return a context that raises KeyboardInterrupt for Ctrl-C, SIGTERM and hang-up alike, also in the background."""
    return handling(dict.fromkeys((signal.SIGINT, *termination_signals()), _interrupt))


def stopping(stop: "threading.Event") -> AbstractContextManager[None]:
    """Return a context in which the first of these signals sets `stop` and the second raises KeyboardInterrupt."""

    def ask(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            _interrupt(number, frame)
        stop.set()

    return handling(dict.fromkeys((signal.SIGINT, *termination_signals()), ask))


def reloading(reload: "threading.Event") -> AbstractContextManager[None]:
    """Return a context in which a hang-up sets `reload` and ends nothing, unless whoever started us has it ignored."""
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

    A death of the process `parent`, of which the system tells by the same signal, ends this one at the first.
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
    """Have Ctrl-C end the process at once until `raise_interrupts` is called, unless a parent has it ignored."""
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, _end_at_once)


def raise_interrupts() -> None:
    """Have Ctrl-C raise KeyboardInterrupt from now on, if it has ended the process until now."""
    if signal.getsignal(signal.SIGINT) is _end_at_once:
        signal.signal(signal.SIGINT, _interrupt)


def _end_at_once(number: int, frame: FrameType | None) -> NoReturn:
    os._exit(INTERRUPTED)


def reap_children() -> None:
    """Learn how child processes end, also where a parent has that ignored: the system would not tell how they did."""
    if hasattr(signal, "SIGCHLD"):
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)


def forget_handlers() -> None:
    """Meet signals as a fresh process does, in a fork."""
    for number in ENDING:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
