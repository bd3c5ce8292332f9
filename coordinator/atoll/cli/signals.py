"""How the programs meet Ctrl-C and SIGTERM."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextmanager
def raising_interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt for Ctrl-C, SIGTERM and SIGHUP alike, also when a shell started us in the background."""
    with _handled(signal.default_int_handler):
        yield


@contextmanager
def stopping(stop: threading.Event) -> Iterator[None]:
    """Set `stop` at the first of these signals and raise KeyboardInterrupt at the second."""

    def ask(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    with _handled(ask):
        yield


@contextmanager
def _handled(handler: Any) -> Iterator[None]:
    """Handle the signals so inside; a hang-up that is ignored (``nohup``) stays ignored."""
    numbers = [number for number in _ENDING if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN]
    before = [signal.signal(number, handler) for number in numbers]
    try:
        yield
    finally:
        for number, old in zip(numbers, before, strict=True):
            signal.signal(number, old)
