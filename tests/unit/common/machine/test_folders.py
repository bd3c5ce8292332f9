"""Where programs keep what outlives them, also for a user whom the list of users does not have."""

from pathlib import Path

import pytest

from atoll_core.compilation.cache import cache_directory
from atoll_core.errors import UsageError
from atoll_core.machine.folders import user_folder


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
