"""How many cores this process may use: its affinity, its control group's quota, its Slurm allocation."""

import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

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
