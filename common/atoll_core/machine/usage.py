"""What this process takes of its machine."""

import os
import resource
import sys
import time
from pathlib import Path
from typing import Final

_STATM: Final = Path("/proc/self/statm")


def memory_bytes() -> int:
    """Return the memory that this process occupies; where that cannot be told (not Linux), the most it ever did."""
    try:
        return int(_STATM.read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else peak * 1024


def cpu_s() -> float:
    """Return the seconds of processor time that all threads of this process have taken."""
    return time.process_time()
