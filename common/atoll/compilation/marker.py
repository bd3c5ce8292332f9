"""The file that says that the kernels have been compiled: one for each kind of processor, compiler and checkout."""

import contextlib
import hashlib
import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

from atoll.compilation.sources import kernel_files

_SETTINGS: Final = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_OPT", "NUMBA_BOUNDSCHECK")


def marker_in(directory: Path) -> Path:
    """Return the file that is in the folder of compiled kernels once they have been compiled for this machine."""
    return directory / f"ready-{_machine()}"


def _machine() -> str:
    """Return a name for everything, apart from the text of the kernels, by which numba finds its machine code."""
    parts = [*_stamps(), platform.python_version(), platform.machine(), _processor()]
    parts += [_version(name) for name in ("numba", "llvmlite", "numpy")]
    parts += [f"{name}={os.environ.get(name, '')}" for name in _SETTINGS]
    return hashlib.blake2b("\n".join(parts).encode(), digest_size=8).hexdigest()


def _stamps() -> list[str]:
    """Return place and time of the kernels' sources: numba compiles anew what was moved, copied or written again."""
    return [f"{file} {file.stat().st_mtime_ns}" for file in kernel_files()]


def _processor() -> str:
    """Return the kind of processor that is compiled for: this machine's, unless another was chosen."""
    if os.environ.get("NUMBA_CPU_NAME") and "NUMBA_CPU_FEATURES" in os.environ:
        return "chosen"  # its name and features are among the settings
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").split("\n\n")[0].splitlines()
        return "\n".join(line for line in lines if line.startswith(("model name", "flags", "CPU part", "Features")))
    return platform.processor()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
