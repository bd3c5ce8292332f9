"""The kind of file system of a folder is that of the mount point closest above it."""

from pathlib import Path

import pytest

from atoll_core.machine.file_systems import file_system, is_networked


def test_the_closest_mount_point_decides(tmp_path: Path) -> None:
    mounts = tmp_path / "mounts"
    mounts.write_text(f"/dev/a / ext4 rw 0 0\nserver:/b {tmp_path.resolve()} nfs4 rw 0 0\n")
    assert file_system(tmp_path / "x", mounts) == "nfs4"
    assert file_system(Path("/usr"), mounts) == "ext4"
    assert file_system(Path("/usr"), tmp_path / "none") is None


@pytest.mark.parametrize(("kind", "expected"), [("nfs4", True), ("lustre", True), ("ext4", False), (None, False)])
def test_several_machines_may_see_some_kinds_at_once(kind: str | None, expected: bool) -> None:
    assert is_networked(kind) == expected
