"""The build hook: a wheel with kernels has their tag, and a wheel without them is for all systems."""

import json
from pathlib import Path
from typing import Any

import pytest

from atoll_core.compilation import prebuilt
from hatch_build import KernelsHook
from tests.unit.documents import ROOT


def built(version: str = "standard") -> dict[str, Any]:
    """Return what the hook sets for a wheel of this project."""
    data: dict[str, Any] = {"force_include": {}}
    KernelsHook(str(ROOT), {}, None, None, "", "wheel").initialize(version, data)
    return data


@pytest.fixture
def kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    index = {"Python": "3.13", "system": "Linux", "processor": "aarch64"}
    (tmp_path / prebuilt.INDEX).write_text(json.dumps(index))
    monkeypatch.setenv("ATOLL_WHEEL_KERNELS", str(tmp_path))
    return tmp_path


def test_a_wheel_without_kernels_is_for_all_systems(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ATOLL_WHEEL_KERNELS", raising=False)
    assert built() == {"force_include": {}}


def test_a_wheel_with_kernels_is_for_their_python_and_system(kernels: Path) -> None:
    data = built()
    assert (data["tag"], data["pure_python"]) == ("cp313-cp313-manylinux_2_17_aarch64", False)
    (target,) = data["force_include"].values()
    assert list(data["force_include"]) == [str(kernels)]
    assert prebuilt.FOLDER.as_posix().endswith(f"/{target}"), "where an installed Atoll looks for them"


def test_an_editable_installation_compiles_its_own(kernels: Path) -> None:
    assert built("editable") == {"force_include": {}}


def test_a_folder_without_kernels_is_refused(kernels: Path) -> None:
    (kernels / prebuilt.INDEX).unlink()
    with pytest.raises(FileNotFoundError):
        built()
