"""What ``coordinator doctor`` looks at on this machine: cores, memory, limits, kernels, the state folder."""

import argparse
import contextlib
import os
import platform
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from atoll.cli.doctor.finding import Finding, counted, fine
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.machine import file_system, is_networked, usable_cores

MB: Final = 1024 * 1024
GB: Final = 1024 * MB

WORKER_BYTES: Final = 300 * MB
"""What one worker process takes with a data set of some thousand rows; measured: some 200 MB."""

FEW_FILES: Final = 1024
LITTLE_ROOM: Final = 100 * MB
SOME_ROOM: Final = GB

_MEMINFO: Final = Path("/proc/meminfo")
_CGROUP: Final = Path("/sys/fs/cgroup")


def check_versions(options: argparse.Namespace) -> Iterator[Finding]:
    """Say what is installed here."""
    from importlib.metadata import version

    libraries = ", ".join(f"{name} {version(name)}" for name in ("eclipse-zenoh", "numpy", "numba"))
    fact = f"Atoll {VERSION} (protocol {PROTOCOL_VERSION}, engine {ENGINE_REVISION})"
    yield fine("versions", f"{fact}, Python {platform.python_version()}, {libraries}, {platform.machine()}")


def check_cores(options: argparse.Namespace) -> Iterator[Finding]:
    """How many workers this machine has room for."""
    cores, reason = usable_cores(os.environ)
    yield fine("cores", f"{counted(cores, 'worker process')} by default: {reason}")


def check_memory(options: argparse.Namespace) -> Iterator[Finding]:
    """Whether memory suffices for a worker per core."""
    free = available_memory()
    if free is None:
        yield fine("memory", "not known on this system")
        return
    cores, _ = usable_cores(os.environ)
    fact = f"{free / GB:.1f} GB available for {counted(cores, 'worker process')}"
    if free >= cores * WORKER_BYTES:
        yield fine("memory", fact)
    else:
        advice = f"start fewer: island-worker --processes {max(1, free // WORKER_BYTES)}"
        yield Finding("memory", "warning" if free >= WORKER_BYTES else "problem", fact, advice)


def available_memory(meminfo: Path = _MEMINFO, cgroup: Path = _CGROUP) -> int | None:
    """Return the bytes that processes started now could take, by the system and its control group; None: unknown."""
    amounts = []
    with contextlib.suppress(OSError, ValueError, IndexError):
        lines = [line.split() for line in meminfo.read_text("ascii").splitlines()]
        amounts += [int(words[1]) * 1024 for words in lines if words[0] == "MemAvailable:"]
    with contextlib.suppress(OSError, ValueError):
        limit = int((cgroup / "memory.max").read_text("ascii"))
        amounts.append(limit - int((cgroup / "memory.current").read_text("ascii")))
    return min(amounts, default=None)


def check_open_files(options: argparse.Namespace) -> Iterator[Finding]:
    """Whether a coordinator here could have many connections."""
    try:
        import resource
    except ImportError:
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    fact = f"{soft} at once, each worker and client takes one of the coordinator's"
    if soft == resource.RLIM_INFINITY or soft >= FEW_FILES:
        yield fine("open files", fact)
    else:
        most = "unlimited" if hard == resource.RLIM_INFINITY else str(hard)
        yield Finding("open files", "warning", fact, f"before serve: ulimit -n {FEW_FILES} (at most {most} here)")


def check_kernels(options: argparse.Namespace) -> Iterator[Finding]:
    """Whether a worker here would compile first, and whether it could."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        fact = "NUMBA_DISABLE_JIT is set: everything is interpreted, a thousand times slower"
        yield Finding("kernels", "warning", fact, "unset it for real work")
        return
    from atoll_core.compilation.cache import cache_directory, is_compiled

    directory = cache_directory("atoll_island_worker")
    if is_compiled("atoll_island_worker"):
        yield fine("kernels", f"compiled, in {directory}")
        return
    existing = _existing(directory)
    if os.access(existing, os.W_OK | os.X_OK):
        yield fine("kernels", f"not compiled yet; that takes about a minute of one processor, once, into {directory}")
    else:
        fact = f"not compiled yet, and {existing} cannot be written"
        yield Finding("kernels", "problem", fact, "set ATOLL_KERNEL_CACHE to a folder that can be")


def check_state(options: argparse.Namespace) -> Iterator[Finding]:
    """Whether a job store can be kept in the state folder (the current one unless it is named)."""
    wanted = Path(options.state or ".").absolute()
    place = _existing(wanted)
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        fact = f"{place} cannot be written" if place.is_dir() else f"{place} is a file"
        yield Finding("state folder", "problem", fact, "name another folder with --state")
        return
    free = shutil.disk_usage(place).free
    fact = f"{wanted}: {free / GB:.1f} GB free"
    if free >= SOME_ROOM:
        yield fine("state folder", fact)
    else:
        advice = "make room, or name a folder on another disk with --state"
        yield Finding("state folder", "problem" if free < LITTLE_ROOM else "warning", fact, advice)
    kind = file_system(place)
    if is_networked(kind):
        fact = f"{place} is on a network file system ({kind})"
        advice = (
            "keep the store on a disk of the coordinator's machine: SQLite relies on locks that many such systems lack"
        )
        yield Finding("state folder", "warning", fact, advice)


def _existing(path: Path) -> Path:
    """Return `path`, or the first folder above it that exists."""
    return next(folder for folder in (path, *path.parents) if folder.exists())
