"""What the system says of one process (Linux)."""

import os
from pathlib import Path
from typing import Final

from atoll_core.errors import AtollError

PROCESSES: Final = Path("/proc")
_KILOBYTE: Final = 1024


def processor_seconds(pid: int, thread: int | None = None) -> float:
    """Return the processor time that a process, or one thread of it, has taken so far, in seconds."""
    folder = PROCESSES / str(pid) if thread is None else PROCESSES / str(pid) / "task" / str(thread)
    words = (folder / "stat").read_text("utf-8", "replace").rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def status(pid: int, name: str, processes: Path = PROCESSES) -> int:
    """Return a number of a process's status, of memory in bytes; raises AtollError where the system does not say it."""
    for line in (processes / str(pid) / "status").read_text("ascii", "replace").splitlines():
        key, _, value = line.partition(":")
        if key == name:
            number, *unit = value.split()
            return int(number) * (_KILOBYTE if unit else 1)
    raise AtollError(f"the system does not say {name} of process {pid}")
