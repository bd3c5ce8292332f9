"""A process knows what it takes."""

import mmap
from pathlib import Path

import pytest

from atoll_core.machine import usage


def test_memory_grows_with_what_is_kept() -> None:
    # A mapping of its own: malloc may hand out pages that earlier tests have freed and that still count.
    before = usage.memory_bytes()
    with mmap.mmap(-1, 50_000_000) as kept:
        kept.write(b"\x01" * 50_000_000)
        assert usage.memory_bytes() > before + 40_000_000


def test_without_proc_the_peak_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(usage, "_STATM", Path("/nowhere"))
    assert usage.memory_bytes() > 1_000_000
