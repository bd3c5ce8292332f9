"""What is loaded before a fork, and that nothing which a fork breaks has been begun by then."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from atoll_core.errors import AtollError
from atoll_island_worker.processes import Forked

LIMIT_S = 100.0

SCRIPT = """
import gc, sys
from pathlib import Path
from atoll_island_worker.cli import load_ahead, load_shared
for load in (load_shared, load_ahead):
    load()
    lines = Path("/proc/self/status").read_text().splitlines()
    print(*(line.split()[1] for line in lines if line.startswith("Threads:")))
expected = {"atoll_island_worker.worker", "atoll_core.wire.bus.zenoh_bus", "atoll_island_worker.evolution.island"}
print(*(expected - set(sys.modules)))
print(gc.get_freeze_count() > 10_000)
"""


def loaded(cache: Path, **more: str) -> list[str]:
    """Return number of threads, modules not loaded, and whether what was loaded is kept from the search for garbage."""
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env=environment | {"ATOLL_KERNEL_CACHE": str(cache)} | more,
        capture_output=True, text=True, timeout=LIMIT_S, check=True,
    )  # fmt: skip
    assert done.stderr == ""
    return done.stdout.splitlines()


def test_libraries_are_loaded_without_a_thread_and_compiling_is_left_to_the_workers(tmp_path: Path) -> None:
    assert loaded(tmp_path) == ["1", "1", "atoll_island_worker.evolution.island", "True"]
    assert list(tmp_path.rglob("*.nb?")) == []


def test_a_system_that_starts_no_more_processes_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> int:
        raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")

    monkeypatch.setattr(os, "fork", refuse)
    with pytest.raises(AtollError, match="starts no more processes"):
        Forked(lambda: 0)
