"""What tests of task processes need to know of processes."""

import os
import time
from collections.abc import Callable
from pathlib import Path

LIMIT_S = 120.0


def until(condition: Callable[[], bool]) -> None:
    """Wait until something is so."""
    end = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.01)


def is_gone(pid: int) -> bool:
    """Tell whether a process has ended; who should wait for it may not have done so yet."""
    try:
        return Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def pid_in(mark: Path) -> int:
    until(mark.exists)
    return int(mark.read_text("ascii"))


def children_of(pid: int) -> list[int]:
    """Return the living children of a process."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                stat = (folder / "stat").read_text("ascii").rpartition(")")[2].split()
            except OSError:
                continue
            if int(stat[1]) == pid and stat[0] != "Z":
                found.append(int(folder.name))
    return found


def path_bytes(path: Path) -> bytes:
    return os.fsencode(path)
