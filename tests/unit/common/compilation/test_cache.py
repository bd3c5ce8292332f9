"""Machine code is found by the text of its sources and compiled once per machine; progress is shown meanwhile."""

import fcntl
import importlib
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numba.core.dispatcher
import pytest

from atoll_core.compilation import cache
from atoll_core.compilation.cache import ALL, WORKER, compile_or_load, kernel_files, source_digest
from atoll_core.compilation.progress import Report, count_of, sentence_of
from atoll_core.errors import AtollError

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


@pytest.mark.parametrize("package", ALL)
@pytest.mark.parametrize("compiled_in", [False, True])
def test_the_fingerprint_of_workers_covers_exactly_the_sources_of_their_kernels(
    copied: Path, package: str, compiled_in: bool
) -> None:
    fingerprint, everything = source_digest(WORKER), source_digest(ALL)
    edited = copied / package / cache._COMPILED_IN[package][0] if compiled_in else kernel_in(package, copied)
    with edited.open("a") as file:
        file.write("# edited\n")
    assert (source_digest(WORKER) != fingerprint) == (package in WORKER)
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


PACKAGE = "atoll_island_worker"


def warm_up(report: Report, exercise: Callable[[], str]) -> None:
    compile_or_load(PACKAGE, exercise, {"one": 1.0, "two": 3.0}, report)


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv("ATOLL_KERNEL_CACHE", str(tmp_path))
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    return cache.cache_directory(PACKAGE)


class Exercise:
    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> str:
        self.count += 1
        return ""


def test_the_first_time_is_announced_and_later_ones_are_not() -> None:
    said: list[str] = []
    exercise = Exercise()
    warm_up(said.append, exercise)
    assert (count_of(said[0]), said[-1]) == ((0, 2), sentence_of(2, 2))
    number = len(said)
    warm_up(said.append, exercise)
    assert len(said) == number
    assert exercise.count == 2


def test_a_compilation_that_failed_does_not_count() -> None:
    def fail() -> str:
        raise ValueError("no compiler")

    said: list[str] = []
    with pytest.raises(ValueError, match="no compiler"):
        warm_up(said.append, fail)
    assert sentence_of(2, 2) not in said
    warm_up(said.append, Exercise())
    assert said[-1] == sentence_of(2, 2)


def test_every_kernel_that_is_ready_is_counted() -> None:
    said: list[str] = []
    warm_up(said.append, lambda: str(cache.on_ready[-1]()))
    assert list(dict.fromkeys(map(count_of, said))) == [(0, 2), (1, 2), (2, 2)]
    assert cache.on_ready == []


def test_another_processor_is_another_first_time(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    warm_up(said.append, Exercise())
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    warm_up(said.append, Exercise())
    assert said.count(sentence_of(2, 2)) == 2


def test_who_comes_while_another_compiles_waits_and_then_loads(folder: Path) -> None:
    folder.mkdir(parents=True)
    said: list[str] = []
    waiting, events = threading.Event(), []

    def report(sentence: str) -> None:
        said.append(sentence)
        waiting.set()

    with (folder / "lock").open("w") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        thread = threading.Thread(target=warm_up, args=(report, lambda: str(events.append("loaded"))))
        thread.start()
        assert waiting.wait(30.0)
        assert events == []
        cache.marker(PACKAGE).touch()
    thread.join(30.0)
    assert events == ["loaded"]
    assert said == ["waiting while another process of this machine compiles the kernels"]


def test_a_compiled_part_is_not_compiled_again_and_is_not_the_whole_package() -> None:
    said: list[str] = []
    exercise = Exercise()
    compile_or_load(PACKAGE, exercise, {"one": 1.0}, said.append, "first")
    assert said[-1] == sentence_of(1, 1)
    assert cache.is_compiled(PACKAGE, "first")
    assert not cache.is_compiled(PACKAGE)
    number = len(said)
    compile_or_load(PACKAGE, exercise, {"one": 1.0}, said.append, "first")
    assert len(said) == number
    warm_up(said.append, exercise)
    assert said[-1] == sentence_of(2, 2)
    assert cache.is_compiled(PACKAGE, "second"), "the package has all its parts"


def test_a_cache_that_cannot_be_written_is_said_with_advice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ATOLL_KERNEL_CACHE", str(tmp_path / "file"))
    with pytest.raises(AtollError, match="set ATOLL_KERNEL_CACHE"):
        warm_up(lambda sentence: None, Exercise())


def test_kernels_that_are_compiled_are_loaded_from_a_folder_that_can_only_be_read(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exercise = Exercise()
    warm_up(lambda said: None, exercise)
    folder.chmod(0o500)
    monkeypatch.setattr("os.access", lambda place, mode: False)  # root may write everywhere
    warm_up(lambda said: pytest.fail(said), exercise)
    assert exercise.count == 2


def test_without_a_compiler_there_is_nothing_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    exercise = Exercise()
    warm_up(lambda sentence: None, exercise)
    assert exercise.count == 0


def test_a_numba_without_a_needed_part_is_reported_with_advice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "atoll_core.compilation.jit", raising=False)
    monkeypatch.delattr(numba.core.dispatcher, "_FunctionCompiler")
    with pytest.raises(AtollError, match=r"with numba [0-9.]+ \(.*_FunctionCompiler.*\); install a version"):
        importlib.import_module("atoll_core.compilation.jit")
