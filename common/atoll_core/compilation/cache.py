"""Which sources are compiled into the kernels of a package, and where the compiled kernels lie.

There is one folder per package and digest of all source text that is compiled into its kernels. So checkouts, wheels
and copies with equal sources share their machine code, machine code of other sources is never loaded, and a change of
one program's kernels leaves the other's compiled. A file in it says that all kernels of the package have been compiled:
one for each kind of processor and compiler.
"""

import contextlib
import functools
import hashlib
import os
import platform
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from atoll_core.machine.folders import user_folder

WORKER: Final = ("atoll_core", "atoll_island_worker")
"""The packages whose kernels decide the bits of a search."""
ALL: Final = (*WORKER, "atoll_coordinator")

_COMPILED_IN: Final = {
    "atoll_core": ("compilation/jit.py", "search/seeding.py", "expression/operators.py"),
    "atoll_island_worker": ("evolution/structures.py",),
    "atoll_coordinator": ("model/cholesky.py",),
}
"""Files beside the kernels whose constants and types are compiled into them."""


_CPU_INFO: Final = Path("/proc/cpuinfo")
_SETTINGS: Final = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_OPT", "NUMBA_BOUNDSCHECK")


def packages_compiled_into(package: str) -> tuple[str, ...]:
    """Return the packages whose kernels may be compiled into those of `package`; of tests and the like, all."""
    return tuple(dict.fromkeys(("atoll_core", package))) if package in ALL else ALL


def kernel_files(packages: Sequence[str] = ALL) -> list[Path]:
    """Return the modules of every folder ``kernels`` in `packages`, in a fixed order."""
    return [file for package in packages for file in sorted(_folder(package).glob("**/kernels/[!_]*.py"))]


def source_digest(packages: Sequence[str] = ALL) -> str:
    """Return a short digest of every source file that takes part in the compiled kernels of `packages`."""
    digest = hashlib.blake2b(digest_size=8)
    others = [_folder(package) / name for package in packages for name in _COMPILED_IN.get(package, ())]
    for file in [*others, *kernel_files(packages)]:
        digest.update(file.name.encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _folder(package: str) -> Path:
    spec = find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent


def cache_directory(package: str) -> Path:
    """Return where the compiled kernels of a package lie: ``ATOLL_KERNEL_CACHE``, else the user's cache directory."""
    chosen = os.environ.get("ATOLL_KERNEL_CACHE")
    base = Path(chosen) if chosen else user_folder("XDG_CACHE_HOME", ".cache") / "atoll"
    return base / f"{package}-{_digest(package)}"


@functools.cache
def _digest(package: str) -> str:
    return source_digest(packages_compiled_into(package))


def is_compiled(package: str) -> bool:
    """Return whether the kernels of a package have been compiled for this machine, and so need only be loaded."""
    return marker(package).exists()


def marker(package: str) -> Path:
    """Return the file that is there once the kernels of a package have been compiled for this machine."""
    return cache_directory(package) / f"ready-{_machine()}"


def _machine() -> str:
    """Return a name for everything, apart from the text of the kernels, by which numba finds its machine code."""
    parts = [platform.python_version(), platform.machine(), _processor()]
    parts += [_version(name) for name in ("numba", "llvmlite", "numpy")]
    parts += [f"{name}={os.environ.get(name, '')}" for name in _SETTINGS]
    if sys.flags.optimize >= 2:  # without docstrings bytecode is another, by which numba finds its machine code
        parts.append("without docstrings")
    return hashlib.blake2b("\n".join(parts).encode(), digest_size=8).hexdigest()


def _processor() -> str:
    """Return the kind of processor that is compiled for: this machine's, unless another was chosen."""
    if os.environ.get("NUMBA_CPU_NAME") and "NUMBA_CPU_FEATURES" in os.environ:
        return "chosen"  # its name and features are among the settings
    with contextlib.suppress(OSError):
        lines = _CPU_INFO.read_text("utf-8", "replace").split("\n\n")[0].splitlines()
        return "\n".join(line for line in lines if line.startswith(("model name", "flags", "CPU part", "Features")))
    return platform.processor()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
