"""The sign by which a caller lets its calls end, in its own process and in others."""

import os
import pickle
import tempfile
import time
from pathlib import Path

import pytest

from atoll.executors import tasks
from atoll.executors.tasks import StopSign


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(tasks, "_SEEN_S", 0.0)
    return tmp_path


def test_a_copy_is_set_when_the_sign_is(folder: Path) -> None:
    sign = StopSign()
    copy = pickle.loads(pickle.dumps(sign))
    assert not copy.is_set
    sign.set()
    assert copy.is_set
    assert len([*folder.iterdir()]) == 1


def test_the_file_is_removed_only_after_other_processes_have_looked(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept: list[float] = []
    monkeypatch.setattr(time, "monotonic", lambda: 100.0)
    monkeypatch.setattr(time, "sleep", slept.append)
    file = folder / "sign"
    file.touch()
    tasks._remove_seen(file, 100.75)
    assert slept == [0.75]
    assert not file.exists()


def test_a_copy_that_is_sent_after_the_end_is_set() -> None:
    sign = StopSign()
    sign.set()
    assert pickle.loads(pickle.dumps(sign)).is_set


def test_a_sign_that_was_not_sent_writes_no_file(folder: Path) -> None:
    sign = StopSign()
    sign.set()
    assert sign.is_set
    assert not [*folder.iterdir()]


def test_without_a_folder_for_temporary_files_a_copy_is_never_set(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> str:
        raise FileNotFoundError("no usable temporary directory")

    monkeypatch.setattr(tempfile, "gettempdir", fail)
    sign = StopSign()
    copy = pickle.loads(pickle.dumps(sign))
    monkeypatch.setattr(Path, "touch", lambda *_, **__: pytest.fail("a file was written"))
    sign.set()
    assert sign.is_set
    assert not copy.is_set
    assert not pickle.loads(pickle.dumps(sign)).is_set


@pytest.mark.skipif(os.geteuid() == 0, reason="root may look into every folder")
def test_a_folder_that_may_not_be_looked_into_is_no_error(folder: Path) -> None:
    copy = pickle.loads(pickle.dumps(StopSign()))
    folder.chmod(0)
    try:
        assert not copy.is_set
    finally:
        folder.chmod(0o700)


def test_an_error_of_the_file_system_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    copy = pickle.loads(pickle.dumps(StopSign()))

    def fail(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "stat", fail)
    assert not copy.is_set
