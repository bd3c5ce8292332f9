"""Kernels compiled for any processor rather than for this one, kept beside this machine's own.

``python -m tests.generic`` compiles them, so that ``make test`` can do it while the machine's own are compiled.
"""

import os
import subprocess
import sys
from typing import Final

from atoll.compilation.cache import cache_directory

_WARM_UP: Final = """
from atoll_coordinator.data.differentiation import warmup as warmup
from atoll_island_worker.compute.warmup import warm_up
warm_up(str)
warmup.warm_up()
"""


def environment() -> dict[str, str]:
    """Return the variables under which a process uses these kernels."""
    return {"NUMBA_CPU_NAME": "generic", "ATOLL_KERNEL_CACHE": str(cache_directory("atoll").parent / "generic")}


if __name__ == "__main__":
    done = subprocess.run([sys.executable, "-c", _WARM_UP], env={**os.environ, **environment()}, check=False)
    sys.exit(done.returncode)
