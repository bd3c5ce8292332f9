"""The digests of kernels: what the fingerprint of a worker depends on, and what it does not."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from atoll_core.compilation import cache
from atoll_core.compilation.cache import ALL, WORKER, kernel_files, source_digest

LOADED = """
import sys
from atoll_core.compilation.cache import WORKER, kernel_files
import atoll_island_worker.evolution.island
loaded = {getattr(module, "__file__", None) for module in list(sys.modules.values())}
print([str(file) for file in kernel_files(WORKER) if str(file) not in loaded])
"""


@pytest.fixture
def copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with copies of all packages, whose digests are taken in place of those that are imported."""
    for package in ALL:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(cache._folder(package), tmp_path / package, ignore=ignored)
    monkeypatch.setattr(cache, "_folder", lambda package: tmp_path / package)
    return tmp_path


def kernel_in(package: str, folder: Path) -> Path:
    return next(file for file in kernel_files([package]) if folder in file.parents)


def test_editing_a_kernel_that_no_worker_runs_leaves_the_workers_fingerprint_alone(copied: Path) -> None:
    fingerprint, everything = source_digest(WORKER), source_digest(ALL)
    with kernel_in("atoll_coordinator", copied).open("a") as file:
        file.write("# edited\n")
    assert source_digest(WORKER) == fingerprint
    assert source_digest(ALL) != everything


@pytest.mark.parametrize("package", WORKER)
def test_editing_a_kernel_that_workers_run_changes_their_fingerprint(copied: Path, package: str) -> None:
    fingerprint = source_digest(WORKER)
    with kernel_in(package, copied).open("a") as file:
        file.write("# edited\n")
    assert source_digest(WORKER) != fingerprint


def test_editing_what_kernels_of_the_model_are_made_with_changes_their_digest(copied: Path) -> None:
    fingerprint, everything = source_digest(WORKER), source_digest(ALL)
    with (copied / "atoll_coordinator" / "model" / "cholesky.py").open("a") as file:
        file.write("# edited\n")
    assert source_digest(WORKER) == fingerprint
    assert source_digest(ALL) != everything


@pytest.mark.slow
def test_every_kernel_in_the_fingerprint_is_one_that_an_island_runs() -> None:
    unused = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True, timeout=120)
    assert unused.stdout.strip() == "[]"


def test_without_docstrings_kernels_are_compiled_once_more_which_is_told() -> None:
    """Numba finds its machine code by bytecode, which is another then: they are not ready, and are not said to be."""
    line = "from atoll_core.compilation.cache import marker; print(marker('atoll_core'))"
    said = [
        subprocess.run([sys.executable, *option, "-c", line], capture_output=True, text=True, check=True).stdout
        for option in ((), ("-O",), ("-OO",))
    ]
    assert (said[0] == said[1], said[0] == said[2]) == (True, False)
