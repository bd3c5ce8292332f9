"""Kernels are compiled by one process of a machine, and only the first time."""

import fcntl
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numba.core.dispatcher
import pytest

from atoll_core.compilation import cache as compiled
from atoll_core.compilation import jit
from atoll_core.compilation.progress import sentence_of
from atoll_core.compilation.warmup import Report, compile_or_load
from atoll_core.errors import AtollError

PACKAGE = "atoll_island_worker"


def warm_up(report: Report, exercise: Callable[[], None]) -> None:
    compile_or_load(PACKAGE, exercise, 2, report)


@pytest.fixture(autouse=True)
def cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv("ATOLL_KERNEL_CACHE", str(tmp_path))
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    return compiled.cache_directory(PACKAGE)


class Exercise:
    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> None:
        self.count += 1


def test_the_first_time_is_announced_and_later_ones_are_not() -> None:
    said: list[str] = []
    exercise = Exercise()
    warm_up(said.append, exercise)
    assert said == [sentence_of(0, 2), sentence_of(2, 2)]
    warm_up(said.append, exercise)
    assert len(said) == 2
    assert exercise.count == 2


def test_a_compilation_that_failed_does_not_count() -> None:
    def fail() -> None:
        raise ValueError("no compiler")

    said: list[str] = []
    with pytest.raises(ValueError, match="no compiler"):
        warm_up(said.append, fail)
    warm_up(said.append, Exercise())
    assert said == [sentence_of(0, 2), sentence_of(0, 2), sentence_of(2, 2)]


def test_every_kernel_that_is_ready_is_counted() -> None:
    said: list[str] = []
    warm_up(said.append, lambda: jit.on_ready[-1]())
    assert said == [sentence_of(done, 2) for done in (0, 1, 2)]
    assert jit.on_ready == []


def test_another_processor_is_another_first_time(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    warm_up(said.append, Exercise())
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    warm_up(said.append, Exercise())
    assert len(said) == 4


def test_kernels_for_a_chosen_processor_are_ready_on_every_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in an image, which is made on one machine and used on others."""
    monkeypatch.setenv("NUMBA_CPU_NAME", "x86-64-v3")
    monkeypatch.setenv("NUMBA_CPU_FEATURES", "")
    said: list[str] = []
    warm_up(said.append, Exercise())
    monkeypatch.setattr(compiled.platform, "processor", lambda: "another")
    monkeypatch.setattr(compiled, "_CPU_INFO", Path("/nowhere"))
    warm_up(said.append, Exercise())
    assert len(said) == 2
    monkeypatch.delenv("NUMBA_CPU_FEATURES")
    warm_up(said.append, Exercise())
    assert len(said) == 4


def test_who_comes_while_another_compiles_waits_and_then_loads(cache: Path) -> None:
    cache.mkdir(parents=True)
    said: list[str] = []
    waiting, events = threading.Event(), []

    def report(sentence: str) -> None:
        said.append(sentence)
        waiting.set()

    with (cache / "lock").open("w") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        thread = threading.Thread(target=warm_up, args=(report, lambda: events.append("loaded")))
        thread.start()
        assert waiting.wait(30.0)
        assert events == []
        compiled.marker(PACKAGE).touch()
    thread.join(30.0)
    assert events == ["loaded"]
    assert said == ["waiting while another process of this machine compiles the kernels"]


def test_a_cache_that_cannot_be_written_is_said_with_advice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ATOLL_KERNEL_CACHE", str(tmp_path / "file"))
    with pytest.raises(AtollError, match="set ATOLL_KERNEL_CACHE"):
        warm_up(lambda sentence: None, Exercise())


def test_kernels_that_are_compiled_are_loaded_from_a_folder_that_can_only_be_read(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exercise = Exercise()
    warm_up(lambda said: None, exercise)
    cache.chmod(0o500)
    monkeypatch.setattr("os.access", lambda place, mode: False)  # root may write everywhere
    warm_up(lambda said: pytest.fail(said), exercise)
    assert exercise.count == 2


def test_without_a_compiler_there_is_nothing_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    exercise = Exercise()
    warm_up(lambda sentence: None, exercise)
    assert exercise.count == 0


def test_a_numba_that_lacks_what_is_built_on_is_said_with_advice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "atoll_core.compilation.jit")
    monkeypatch.delattr(numba.core.dispatcher, "_FunctionCompiler")
    with pytest.raises(AtollError, match=r"with numba [0-9.]+ \(.*_FunctionCompiler.*\); install a version"):
        warm_up(lambda sentence: None, Exercise())
