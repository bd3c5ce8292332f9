"""Compiles kernels before the first test, whose time is limited, and shows how far it has got.

``python -m tests.kernels`` compiles the kernels of both programs, one process for each core; with ``--generic`` also
those for any processor rather than for this one, kept beside this machine's own, since one test compares their bits.
"""

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from atoll_core.compilation.cache import cache_directory, is_compiled
from atoll_core.compilation.progress import WarmUpDisplay
from atoll_core.machine import usable_cores

_WORKER: Final = "from atoll_island_worker.compute.warmup import warm_up"
_COORDINATOR: Final = "from atoll_coordinator.warmup import warm_up"
_DATA: Final = "from atoll_coordinator.data.differentiation.derivatives import warm_up as data"
_RUN: Final = "warm_up(lambda sentence: print(sentence, flush=True))"


def environment() -> dict[str, str]:
    """Return the variables under which a process uses the kernels for any processor."""
    return {"NUMBA_CPU_NAME": "generic", "ATOLL_KERNEL_CACHE": str(cache_directory("atoll_core").parent / "generic")}


def compile_all(with_generic: bool) -> int:
    """Compile what is not compiled yet; return the first exit code that is not 0, else 0."""
    show, lock = WarmUpDisplay(), threading.Lock()

    def run(of: str, code: str, further: dict[str, str]) -> int:
        command = [sys.executable, "-c", code]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, **further}) as process:
            assert process.stdout is not None
            for line in process.stdout:
                with lock:
                    show(line.strip(), of)
        return process.returncode

    with ThreadPoolExecutor(usable_cores(os.environ)[0]) as pool:
        works = []
        if not is_compiled("atoll_island_worker"):
            works += [pool.submit(run, "for the worker", f"{_WORKER}; {_RUN}", {})]
        if not is_compiled("atoll_coordinator"):
            works += [pool.submit(run, "for the coordinator", f"{_COORDINATOR}; {_RUN}", {})]
        if with_generic:
            works += [pool.submit(run, "for any processor", f"{_WORKER}; {_DATA}; {_RUN}; data()", environment())]
    return next((work.result() for work in works if work.result()), 0)


if __name__ == "__main__":
    sys.exit(compile_all("--generic" in sys.argv))
