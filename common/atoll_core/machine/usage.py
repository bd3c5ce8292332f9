"""What this process takes of its machine: memory, and how often it looks for garbage."""

import contextlib
import gc
import os
import resource
import sys
from pathlib import Path
from typing import Final

_MEMINFO: Final = Path("/proc/meminfo")
_GROUP: Final = Path("/sys/fs/cgroup")
_STATM: Final = Path("/proc/self/statm")


def memory_bytes() -> int:
    """Return the memory that this process occupies; where that cannot be told (not Linux), the most it ever did."""
    try:
        return int(_STATM.read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else peak * 1024


def total_memory_bytes() -> int:
    """Return the memory of this machine; 0 where that cannot be told."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        return 0


def available_bytes() -> int | None:
    """Return the memory that more data can take here, in the machine and in our control group; None: not told."""
    try:
        lines = dict(line.split(":", 1) for line in _MEMINFO.read_text("ascii").splitlines())
        available = int(lines["MemAvailable"].split()[0]) * 1024
    except (OSError, ValueError, KeyError, IndexError):
        return None
    with contextlib.suppress(OSError, ValueError):  # "max", or no such file: the group has no limit of its own
        most, taken = (int((_GROUP / name).read_text("ascii")) for name in ("memory.max", "memory.current"))
        available = min(available, max(0, most - taken))
    return available


def collect_rarely() -> None:
    """Look for garbage less often than Python would, from now on.

    Loading libraries makes hundreds of thousands of objects that stay. Looking at them again and again took a tenth of
    the time that loading takes.
    """
    gc.set_threshold(20_000, 20, 20)
