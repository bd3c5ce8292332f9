"""Compile the kernels that a wheel brings: ``python -m deploy.kernels FOLDER`` (CONTRIBUTING.md: a release).

Compiles all kernels of the Atoll that this Python imports, for every level of this machine's architecture that this
processor can run, and writes them to FOLDER in the form that `atoll_core.compilation.prebuilt` reads. They are for this
version of Python and of numba. ``ATOLL_WHEEL_KERNELS=FOLDER python -m build --wheel`` then puts them into a wheel.
"""

import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

from atoll_core.compilation import prebuilt
from atoll_core.compilation.cache import ALL, packages_compiled_into, source_digest
from atoll_core.machine import usable_cores

EXERCISES: Final = {
    "atoll_island_worker": ("atoll_island_worker.compute.warmup", "run_small_epochs"),
    "atoll_coordinator": ("atoll_coordinator.warmup", "exercise"),
}
"""Module and name of the function that calls all kernels of a package."""

_COMPILE: Final = """
import importlib, json, sys
from numba.core.registry import cpu_target
results = getattr(importlib.import_module(sys.argv[1]), sys.argv[2])()
print(json.dumps([results, cpu_target.target_context.codegen().magic_tuple()]))
"""


def main(words: list[str]) -> int:
    """Compile; return 1 if the levels compute different values."""
    folder = Path(words[0])
    shutil.rmtree(folder, ignore_errors=True)
    flags = prebuilt.processor_flags()
    here = prebuilt.circumstances()
    levels = [level for level, needed in prebuilt.LEVELS[here["processor"]].items() if flags.issuperset(needed)]
    works = [(level, package) for level in levels for package in EXERCISES]
    with ThreadPoolExecutor(usable_cores(os.environ)[0]) as pool:
        outcomes = dict(zip(works, pool.map(lambda work: _compile(folder, *work), works), strict=True))
    results = {}
    for package in EXERCISES:
        found = {outcomes[level, package][0] for level in levels}
        if len(found) != 1:
            sys.stderr.write(f"the kernels of {package} compute different values at the levels {', '.join(levels)}\n")
            return 1
        (results[package],) = found
    index = {
        **here,
        "levels": {level: outcomes[level, "atoll_island_worker"][1] for level in levels},
        "packages": {package: source_digest(packages_compiled_into(package)) for package in ALL},
        "results": results,
        "files": {
            file.relative_to(folder).as_posix(): prebuilt.file_digest(file) for file in sorted(folder.glob("*/*/*"))
        },
    }
    (folder / prebuilt.INDEX).write_text(json.dumps(index, indent=1), "ascii")
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    print(f"{folder}: kernels for {', '.join(levels)}, {size / 1e6:.1f} MB, results {results}")
    return 0


def _compile(folder: Path, level: str, package: str) -> tuple[str, list[str]]:
    """Compile the kernels of one package for one level; return the digest of the results and numba's name of it."""
    settings = {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": "", "ATOLL_KERNEL_CACHE": str(folder / level)}
    done = subprocess.run(
        [sys.executable, "-c", _COMPILE, *EXERCISES[package]], env={**os.environ, **settings},
        stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    results, target = json.loads(done.stdout)
    return results, target


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
