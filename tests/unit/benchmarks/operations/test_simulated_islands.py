"""Workers whose islands only pretend end when they are told to."""

import signal
from contextlib import nullcontext
from typing import Any

import pytest

from atoll_core.wire.bus.interface import Timer
from benchmarks.operations import simulated_islands as module


class SilentBus:
    """A bus that nobody else is on, where only the worker's own tick comes."""

    dropped = 0

    def now(self) -> float:
        return 0.0

    def receive(self, limit_s: float) -> Timer:
        return Timer("tick")

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: 1


def test_the_workers_end_at_a_sigterm(monkeypatch: pytest.MonkeyPatch) -> None:
    def send_at_once(number: int, handler: Any) -> None:
        if number == signal.SIGTERM:
            handler()

    monkeypatch.setattr(module.signal, "signal", send_at_once)
    monkeypatch.setattr(module, "open_client", lambda connect, limit_s: nullcontext(SilentBus()))
    monkeypatch.setattr(module.Samples, "load", lambda file: None)
    words = ["--connect", "tcp/127.0.0.1:1", "--samples", "none", "--first", "0", "--workers", "2", "--period", "1"]
    assert module.main(words) == 0
