"""The number of worker processes follows the tightest limit."""

from pathlib import Path

import pytest

from atoll_core.machine import cores
from atoll_core.machine.cores import cgroup_quota, usable_cores


@pytest.mark.parametrize(
    ("affinity", "quota", "environment", "number", "reason"),
    [
        (8, None, {}, 8, "one per core"),
        (8, 2.5, {}, 2, "the control group allows 2.5 cores"),
        (8, 0.5, {}, 1, "the control group allows 0.5 cores"),
        (8, None, {"SLURM_CPUS_PER_TASK": "4"}, 4, "SLURM_CPUS_PER_TASK is 4"),
        (2, None, {"SLURM_CPUS_PER_TASK": "4"}, 2, "one per core"),
        (2, None, {"SLURM_CPUS_PER_TASK": "none"}, 2, "one per core"),
        (2, None, {"SLURM_CPUS_PER_TASK": "0"}, 2, "one per core"),
    ],
)
def test_the_smallest_limit_decides_and_is_named(
    affinity: int,
    quota: float | None,
    environment: dict[str, str],
    number: int,
    reason: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(cores, "affinity", lambda: affinity)
    monkeypatch.setattr(cores, "cgroup_quota", lambda: quota)
    count, why = usable_cores(environment)
    assert count == number
    assert reason in why


def test_this_machine_has_at_least_one_core() -> None:
    assert usable_cores({})[0] >= 1


@pytest.mark.parametrize(
    ("own", "files", "quota"),
    [
        ("0::/\n", {}, None),
        ("0::/\n", {"cpu.max": "max 100000\n"}, None),
        ("0::/\n", {"cpu.max": "150000 100000\n"}, 1.5),
        ("0::/a/b\n", {"a/cpu.max": "300000 100000\n", "a/b/cpu.max": "400000 100000\n"}, 3.0),
        ("4:cpu,cpuacct:/a\n", {"cpu/a/cpu.cfs_quota_us": "200000\n", "cpu/a/cpu.cfs_period_us": "100000\n"}, 2.0),
        ("4:cpu:/\n", {"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, None),
        ("4:memory:/a\n", {"a/cpu.max": "100000 100000\n"}, None),
        ("", {}, None),
    ],
)
def test_quotas_of_control_groups_are_found(
    own: str, files: dict[str, str], quota: float | None, tmp_path: Path
) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "own").write_text(own)
    assert cgroup_quota(tmp_path / "own", tmp_path) == quota
