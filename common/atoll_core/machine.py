"""Resources that this process may use, and its use of them: cores, memory, folders, file systems, BLAS kernels.

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
"""Most digits of a job's id."""

_VARIABLES: Final[Mapping[str, tuple[str, str | None]]] = {
    "slurm": ("SLURM_JOB_ID", None),
    "pbs": ("PBS_JOBID", None),
    "lsf": ("LSB_JOBID", None),
    "sge": ("JOB_ID", "SGE_ROOT"),
}
"""By batch system: the variable with the job's id, and another variable that must also be set (None: no other)."""

_IN_NAME: Final = re.compile(rf"-(?:{'|'.join(_VARIABLES)})([0-9]+)-")


def batch_job(environment: Mapping[str, str]) -> str:
    """Return batch system and job number of this process, such as ``slurm123``; "" outside of a batch job."""
    for system, (variable, other) in _VARIABLES.items():
        found = re.match(r"\d+", environment.get(variable, ""), re.ASCII)
        if found and len(found[0]) <= _LONGEST and (other is None or other in environment):
            return f"{system}{found[0]}"
    return ""


def job_of(worker: str) -> str | None:
    """Return the number of the batch job in a worker's name, None if it has none; ``coordinator adapt`` needs it."""
    found = _IN_NAME.search(worker)
    return found[1] if found else None


_CGROUPS: Final = Path("/sys/fs/cgroup")
_OWN_CGROUP: Final = Path("/proc/self/cgroup")


def usable_cores(environment: Mapping[str, str]) -> tuple[int, str]:
    """Return the number of usable cores, at least 1, and the limit that decides it."""
    limits = [(affinity(), "one per core this process may use")]
    quota = cgroup_quota()
    if quota is not None:
        limits.append((max(1, math.floor(quota)), f"the control group allows {quota:g} cores"))
    slurm = environment.get("SLURM_CPUS_PER_TASK", "")
    if slurm.isascii() and slurm.isdigit() and int(slurm) > 0:
        limits.append((int(slurm), f"SLURM_CPUS_PER_TASK is {slurm}"))
    return min(limits, key=lambda limit: limit[0])


def affinity() -> int:
    """Return the number of cores on which this process may be scheduled."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cgroup_quota(own: Path = _OWN_CGROUP, root: Path = _CGROUPS) -> float | None:
    """Return the smallest CPU quota, in cores, of this process's control group and its parents; None: no quota."""
    quotas = []
    for folder in _folders(own, root):
        version_2 = _read(folder / "cpu.max").split()
        version_1 = [_read(folder / "cpu.cfs_quota_us").strip(), _read(folder / "cpu.cfs_period_us").strip()]
        pairs = [pair for pair in (version_2, version_1) if len(pair) == 2 and all(map(str.isdigit, pair))]
        quotas += [int(quota) / int(period) for quota, period in pairs if int(period) > 0]  # no pair: "max" or -1
    return min(quotas, default=None)


def _folders(own: Path, root: Path) -> Iterator[Path]:
    """Yield the folders whose quota may limit this process; inside a container, only the root is visible."""
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


def _read(path: Path) -> str:
    try:
        return path.read_text("utf-8", "replace")
    except OSError:
        return ""


_NETWORKED: Final = ("nfs", "cifs", "smb", "lustre", "gpfs", "beegfs", "ceph", "afs", "fuse.sshfs", "9p")
_MOUNTS: Final = Path("/proc/self/mounts")


def file_system(place: Path, mounts: Path = _MOUNTS) -> str | None:
    """Return the kind of file system of an existing or future `place`, such as ``nfs``; None if unknown (not Linux)."""
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
    """Return the folder that `variable` names, else `usual` in the home folder, else a temporary folder of this user.

    `variable` is an environment variable such as ``XDG_CACHE_HOME``. Users without an entry in the list of users, as in
    some containers, have no home folder. Raises UsageError where the temporary folder belongs to another user.
    """
    chosen = os.environ.get(variable)
    if chosen:
        return Path(chosen)
    try:
        return Path.home() / usual
    except RuntimeError:
        return _own_temporary_folder(variable) / usual


def _own_temporary_folder(variable: str) -> Path:
    """Return a folder that no other user can write: machine code is loaded from there."""
    folder = Path(tempfile.gettempdir()) / f"atoll-of-user-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError as error:
        raise _without_home(folder, variable, error.strerror or str(error)) from error
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o022:
        raise _without_home(folder, variable, "other users may write there")
    return folder


def _without_home(folder: Path, variable: str, reason: str) -> UsageError:
    return UsageError(
        f"user {os.getuid()} has no home folder, and {folder} cannot be used instead ({reason}); set HOME or {variable}"
    )


CORE_TYPES: Final[Mapping[str, str]] = {"x86_64": "Nehalem", "amd64": "Nehalem"}
"""By kind of processor, the core whose BLAS kernels are used. For other kinds OpenBLAS chooses."""


def use_common_instructions(environment: MutableMapping[str, str], machine: str | None = None) -> None:
    """Make numpy's and scipy's linear algebra use the same instructions on all processors of a kind.

    Call it before importing numpy. OpenBLAS has kernels for each processor, which add in different orders. The kernels
    of the oldest processor that numpy supports run on all later ones; matrices here are small, so that newer kernels
    would save little time. OpenBLAS gets one thread, because the order of additions depends on the number of threads.
    Variables that the user has set stay as they are. `machine` is the kind of processor as in `platform.machine`
    (default: this machine's).
    """
    core = CORE_TYPES.get((machine or platform.machine()).lower())
    if core is not None:
        environment.setdefault("OPENBLAS_CORETYPE", core)
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")


_MEMINFO: Final = Path("/proc/meminfo")
_GROUP: Final = Path("/sys/fs/cgroup")
_STATM: Final = Path("/proc/self/statm")


def memory_bytes() -> int:
    """Return the memory that this process uses now, in bytes; its maximum so far if that is not known (not Linux)."""
    try:
        return int(_STATM.read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else peak * 1024


def total_memory_bytes() -> int:
    """Return the memory of this machine in bytes; 0 where it is not known."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        return 0


def available_bytes() -> int | None:
    """Return the memory in bytes that is available for data, in the machine and the control group; None: unknown."""
    try:
        lines = dict(line.split(":", 1) for line in _MEMINFO.read_text("ascii").splitlines())
        available = int(lines["MemAvailable"].split()[0]) * 1024
    except (OSError, ValueError, KeyError, IndexError):
        return None
    with contextlib.suppress(OSError, ValueError):  # "max", or no such file: the group has no limit
        limit, used = (int((_GROUP / name).read_text("ascii")) for name in ("memory.max", "memory.current"))
        available = min(available, max(0, limit - used))
    return available


def collect_rarely() -> None:
    """Run the garbage collector less often than by default: scanning new, lasting objects took 10 % of loading time."""
    gc.set_threshold(20_000, 20, 20)
