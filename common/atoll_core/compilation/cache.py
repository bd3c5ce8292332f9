"""Folders of compiled kernels, and the file in them that says that all kernels of a package have been compiled.

There is one folder per package and digest of all source text that is compiled into its kernels. So checkouts, wheels
and copies with equal sources share their machine code, machine code of other sources is never loaded, and a change of
one program's kernels leaves the other's compiled. The file is one for each kind of processor and compiler.
"""

import contextlib
import functools
import hashlib
import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

from atoll_core.compilation.sources import packages_compiled_into, source_digest
from atoll_core.machine.folders import user_folder

_CPU_INFO: Final = Path("/proc/cpuinfo")
_SETTINGS: Final = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_OPT", "NUMBA_BOUNDSCHECK")


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
