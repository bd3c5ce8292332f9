"""What a process may use of its machine and what it uses; matrix products are equal on all processors of a kind."""

import mmap
import os
import subprocess
import sys
from pathlib import Path

import pytest

from atoll_core import machine
from atoll_core.compilation.cache import cache_directory
from atoll_core.errors import UsageError
from atoll_core.machine import (
    CORE_TYPES,
    cgroup_quota,
    file_system,
    is_networked,
    usable_cores,
    use_common_instructions,
    user_folder,
)


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
    monkeypatch.setattr(machine, "affinity", lambda: affinity)
    monkeypatch.setattr(machine, "cgroup_quota", lambda: quota)
    count, why = usable_cores(environment)
    assert count == number
    assert reason in why


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


def test_the_closest_mount_point_decides(tmp_path: Path) -> None:
    mounts = tmp_path / "mounts"
    mounts.write_text(f"/dev/a / ext4 rw 0 0\nserver:/b {tmp_path.resolve()} nfs4 rw 0 0\n")
    assert file_system(tmp_path / "x", mounts) == "nfs4"
    assert file_system(Path("/usr"), mounts) == "ext4"
    assert file_system(Path("/usr"), tmp_path / "none") is None


@pytest.mark.parametrize(("kind", "expected"), [("nfs4", True), ("lustre", True), ("ext4", False), (None, False)])
def test_several_machines_may_see_some_kinds_at_once(kind: str | None, expected: bool) -> None:
    assert is_networked(kind) == expected


@pytest.fixture
def homeless(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Have no home folder; return the folder for what is temporary."""

    def home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", home)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for variable in ("ATOLL_KERNEL_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(variable, raising=False)
    return tmp_path


def test_a_folder_is_the_chosen_one_or_lies_in_the_home_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    assert user_folder("XDG_CACHE_HOME", ".cache") == tmp_path / ".cache"
    monkeypatch.setenv("XDG_CACHE_HOME", "/elsewhere")
    assert user_folder("XDG_CACHE_HOME", ".cache") == Path("/elsewhere")


def test_who_has_no_home_keeps_kernels_in_a_temporary_folder_of_its_own(homeless: Path) -> None:
    folder = cache_directory("atoll_core")
    (own,) = homeless.iterdir()
    assert folder.is_relative_to(own)
    assert own.stat().st_mode & 0o077 == 0
    assert cache_directory("atoll_core") == folder


@pytest.mark.parametrize("how", ["writable by others", "a link"])
def test_what_another_user_may_write_is_not_loaded(homeless: Path, how: str) -> None:
    (own,) = [user_folder("XDG_CACHE_HOME", ".cache").parent]
    if how == "a link":
        own.rename(homeless / "other")
        own.symlink_to(homeless / "other")
    else:
        own.chmod(0o777)
    with pytest.raises(UsageError, match="set HOME or XDG_CACHE_HOME"):
        user_folder("XDG_CACHE_HOME", ".cache")


PROGRAM = """
import hashlib, os, sys
from atoll_core.machine import use_common_instructions
if sys.argv[1] == "common":
    use_common_instructions(os.environ)
import numpy as np
matrix = np.random.default_rng(1).standard_normal((60, 61))
product = matrix @ matrix.T
print(hashlib.sha256(product.tobytes() + np.linalg.eigh(product)[1].tobytes()).hexdigest())
"""


def digest(how: str, **environment: str) -> str:
    plain = {name: value for name, value in os.environ.items() if not name.startswith("OPENBLAS")}
    command = [sys.executable, "-c", PROGRAM, how]
    return subprocess.run(command, env=plain | environment, capture_output=True, text=True, check=True).stdout


def test_the_kernels_are_those_that_all_processors_of_a_kind_have() -> None:
    environment: dict[str, str] = {}
    use_common_instructions(environment, "AMD64")
    assert environment == {"OPENBLAS_CORETYPE": "Nehalem", "OPENBLAS_NUM_THREADS": "1"}
    own = {"OPENBLAS_CORETYPE": "Haswell", "OPENBLAS_NUM_THREADS": "2"}
    use_common_instructions(own, "x86_64")
    assert own == {"OPENBLAS_CORETYPE": "Haswell", "OPENBLAS_NUM_THREADS": "2"}
    other: dict[str, str] = {}
    use_common_instructions(other, "riscv64")
    assert other == {"OPENBLAS_NUM_THREADS": "1"}


@pytest.mark.skipif(not CORE_TYPES.keys() & {os.uname().machine}, reason="OpenBLAS chooses for this kind of processor")
def test_products_are_those_of_the_common_kernels() -> None:
    assert digest("common") == digest("own", OPENBLAS_CORETYPE="Nehalem", OPENBLAS_NUM_THREADS="1")
    assert digest("common", OPENBLAS_CORETYPE="Prescott") != digest("common"), "kernels can be told apart"


def test_memory_grows_with_what_is_kept() -> None:
    # A mapping of its own: malloc may hand out pages that earlier tests have freed and that still count.
    before = machine.memory_bytes()
    with mmap.mmap(-1, 50_000_000) as kept:
        kept.write(b"\x01" * 50_000_000)
        assert machine.memory_bytes() > before + 40_000_000
