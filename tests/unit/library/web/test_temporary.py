"""What was sent to a process that was killed is removed by the next one, and nothing else."""

import fcntl
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from atoll.web.reading import PREFIX, locked, remove_left

LINE = """
import os, pathlib, signal, sys, tempfile
from atoll.web.reading import PREFIX, locked
with tempfile.TemporaryDirectory(prefix=PREFIX) as folder, locked(pathlib.Path(folder)):
    pathlib.Path(folder, "body").write_bytes(b"t,x")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_has_left_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    subprocess.run([sys.executable, "-c", LINE], env={"TMPDIR": str(tmp_path)}, check=False)
    (left,) = tmp_path.glob(f"{PREFIX}*")
    used, other, making = (tmp_path / name for name in (f"{PREFIX}used", "other", f"{PREFIX}making"))
    for folder in (used, other, making):
        folder.mkdir()
    with locked(used):
        remove_left()
        assert (left.exists(), used.exists(), other.exists(), making.exists()) == (False, True, True, True)


def test_a_folder_that_is_being_made_is_not_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another process looks for what was left just when the lock is there and not held yet."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    lock, looked = fcntl.flock, list[bool]()

    def interrupted(descriptor: int, operation: int) -> None:
        if not looked:
            looked.append(True)
            remove_left()
        lock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", interrupted)
    with tempfile.TemporaryDirectory(prefix=PREFIX) as folder, locked(Path(folder)):
        remove_left()
        assert looked
        assert Path(folder).exists()
