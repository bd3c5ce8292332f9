"""A process knows what it takes."""

from pathlib import Path

import pytest

from atoll.machine import usage


def test_memory_grows_with_what_is_kept() -> None:
    before = usage.memory_bytes()
    kept = bytearray(b"\x01" * 50_000_000)
    assert usage.memory_bytes() > before + 40_000_000
    assert len(kept) == 50_000_000


def test_without_proc_the_peak_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(usage, "_STATM", Path("/nowhere"))
    assert usage.memory_bytes() > 1_000_000


def test_processor_time_only_rises() -> None:
    assert 0.0 < usage.cpu_s() <= usage.cpu_s()
