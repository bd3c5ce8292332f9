"""How long the kernels of a package take to be compiled: ``python -m benchmarks.kernels.compiling [PACKAGE]...``.

Each package is compiled anew by a process of its own, in a temporary cache, without the kernels of a wheel. Prints the
processor seconds up to each kernel since the one before, in the order of the tables of costs in the warm-up modules.
Then loads the same kernels by another process, and prints the processor seconds of both processes.
"""

import os
import subprocess
import sys
import tempfile
from typing import Final

MODULES: Final = {
    "atoll_island_worker": "atoll_island_worker.compute.warmup",
    "atoll_coordinator": "atoll_coordinator.warmup",
}
_RUN: Final = """
import importlib, sys, time
from atoll_core.compilation.cache import on_ready
latest = time.process_time()
def count():
    global latest
    now = time.process_time()
    function = sys._getframe(2).f_locals["self"]  # numba's cache of the kernel
    print(f'    "{function._py_func.__name__}": {now - latest:.1f},')
    latest = now
if sys.argv[2] == "each":
    on_ready.append(count)
importlib.import_module(sys.argv[1]).warm_up(lambda sentence: None)
print(f"{time.process_time():.2f} s of a processor")
"""


def main(packages: list[str]) -> None:
    """Measure and print."""
    for package in packages or [*MODULES]:
        with tempfile.TemporaryDirectory(prefix="atoll-compiling-") as cache:
            environment = {**os.environ, "ATOLL_KERNEL_CACHE": cache, "ATOLL_OWN_KERNELS": "1"}
            for what in ("each", "all"):
                print(f"{package}, {'compiled' if what == 'each' else 'loaded'}:", flush=True)
                command = [sys.executable, "-c", _RUN, MODULES[package], what]
                subprocess.run(command, env=environment, check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
