"""What this process may use of its machine, and what it uses: cores, memory, folders, file systems, BLAS kernels.

Standard library only, since programs import this module before anything else.
"""

import contextlib
import gc
import math
import os
import platform
import re
import resource
import stat
import sys
import tempfile
from collections.abc import Iterator, Mapping, MutableMapping
from pathlib import Path
from typing import Final

from atoll_core.errors import UsageError

_LONGEST: Final = 10
"""Digits of a job's id."""

_VARIABLES: Final[Mapping[str, tuple[str, str | None]]] = {
    "slurm": ("SLURM_JOB_ID", None),
    "pbs": ("PBS_JOBID", None),
    "lsf": ("LSB_JOBID", None),
    "sge": ("JOB_ID", "SGE_ROOT"),
}
"""The variable with the id, and one that has to be there for that to be what it says."""

_IN_NAME: Final = re.compile(rf"-(?:{'|'.join(_VARIABLES)})([0-9]+)-")


def batch_job(environment: Mapping[str, str]) -> str:
    """Return the system and the number of the job, such as ``slurm123``; "" outside of one."""
    for system, (variable, beside) in _VARIABLES.items():
        found = re.match(r"\d+", environment.get(variable, ""), re.ASCII)
        if found and len(found[0]) <= _LONGEST and (beside is None or beside in environment):
            return f"{system}{found[0]}"
    return ""


def job_of(worker: str) -> str | None:
    """Return the number of the job that a worker is of, by its name; None: of none that is known."""
    found = _IN_NAME.search(worker)
    return found[1] if found else None


_CGROUPS: Final = Path("/sys/fs/cgroup")
_OWN_CGROUP: Final = Path("/proc/self/cgroup")


def usable_cores(environment: Mapping[str, str]) -> tuple[int, str]:
    """Return the number of cores that may be used, at least 1, and which limit it comes from."""
    limits = [(affinity(), "one per core this process may use")]
    quota = cgroup_quota()
    if quota is not None:
        limits.append((max(1, math.floor(quota)), f"the control group allows {quota:g} cores"))
    slurm = environment.get("SLURM_CPUS_PER_TASK", "")
    if slurm.isascii() and slurm.isdigit() and int(slurm) > 0:
        limits.append((int(slurm), f"SLURM_CPUS_PER_TASK is {slurm}"))
    return min(limits, key=lambda limit: limit[0])


def affinity() -> int:
    """Return how many cores this process may be scheduled on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cgroup_quota(own: Path = _OWN_CGROUP, root: Path = _CGROUPS) -> float | None:
    """Return the smallest CPU quota, in cores, of this process's control group and those above it; None without one."""
    quotas = [quota for folder in _folders(own, root) for quota in (_v2(folder), _v1(folder)) if quota is not None]
    return min(quotas, default=None)


def _folders(own: Path, root: Path) -> Iterator[Path]:
    """Yield the folders whose quota may bind this process; inside a container, only the root is visible."""
    yield root
    yield root / "cpu"
    for line in _read(own).splitlines():
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if controllers in ("", "cpu", "cpu,cpuacct", "cpuacct,cpu"):
            base = root / "cpu" if controllers else root
            place = base / path.strip("/")
            while place != base and base in place.parents:
                yield place
                place = place.parent


def _v2(folder: Path) -> float | None:
    words = _read(folder / "cpu.max").split()
    return _ratio(*words) if len(words) == 2 else None


def _v1(folder: Path) -> float | None:
    return _ratio(_read(folder / "cpu.cfs_quota_us").strip(), _read(folder / "cpu.cfs_period_us").strip())


def _ratio(quota: str, period: str) -> float | None:
    if quota.isdigit() and period.isdigit() and int(period) > 0:
        return int(quota) / int(period)
    return None  # "max" or -1: no quota


def _read(path: Path) -> str:
    try:
        return path.read_text("utf-8", "replace")
    except OSError:
        return ""


_NETWORKED: Final = ("nfs", "cifs", "smb", "lustre", "gpfs", "beegfs", "ceph", "afs", "fuse.sshfs", "9p")
_MOUNTS: Final = Path("/proc/self/mounts")


def file_system(place: Path, mounts: Path = _MOUNTS) -> str | None:
    """Return the kind of file system that `place` is on, or would be on; None where this is not known."""
    kinds = {}
    with contextlib.suppress(OSError):
        for line in mounts.read_text("utf-8", "replace").splitlines():
            _, point, kind, *_ = line.split()
            kinds[Path(point.replace("\\040", " "))] = kind
    real = place.resolve()
    return next((kinds[folder] for folder in (real, *real.parents) if folder in kinds), None)


def is_networked(kind: str | None) -> bool:
    """Tell whether several machines may see a file system of this kind at once."""
    return kind is not None and kind.startswith(_NETWORKED)


def user_folder(variable: str, usual: str) -> Path:
    """Return the folder that `variable` names, else `usual` in the home folder, else a temporary one of this user.

    `variable` is one of the environment, such as ``XDG_CACHE_HOME``. A user without an entry in the list of users, as a
    container may have, has no home folder. Raises UsageError where the temporary one is somebody else's.
    """
    chosen = os.environ.get(variable)
    if chosen:
        return Path(chosen)
    try:
        return Path.home() / usual
    except RuntimeError:
        return _own_temporary_folder(variable) / usual


def _own_temporary_folder(variable: str) -> Path:
    """Return a folder whose contents nobody else has written: machine code is loaded from there."""
    folder = Path(tempfile.gettempdir()) / f"atoll-of-user-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError as error:
        raise _without_home(folder, variable, error.strerror or str(error)) from error
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o022:
        raise _without_home(folder, variable, "somebody else may write there")
    return folder


def _without_home(folder: Path, variable: str, reason: str) -> UsageError:
    return UsageError(
        f"user {os.getuid()} has no home folder, and {folder} cannot be used instead ({reason}); set HOME or {variable}"
    )


CORE_TYPES: Final[Mapping[str, str]] = {"x86_64": "Nehalem", "amd64": "Nehalem"}
"""By kind of processor, the core whose kernels are used. Of kinds that are not here OpenBLAS chooses itself."""


def use_common_instructions(environment: MutableMapping[str, str], machine: str | None = None) -> None:
    """Set in `environment` what OpenBLAS reads when it is loaded, unless the user has; before numpy is imported.

    One thread: how a product falls to several depends on how many there are, and small ones wait for each other.
    `machine` is the kind of processor, as `platform.machine` says; this one's unless given.
    """
    core = CORE_TYPES.get((machine or platform.machine()).lower())
    if core is not None:
        environment.setdefault("OPENBLAS_CORETYPE", core)
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")


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
