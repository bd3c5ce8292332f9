"""The kernels of a wheel are used where they fit; otherwise kernels are compiled, and a sentence says why."""

import faulthandler
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from atoll_core.compilation import cache, prebuilt
from atoll_core.compilation.cache import compile_or_load, is_compiled, wheel_kernels
from atoll_core.compilation.jit import IS_COMPILED
from atoll_core.compilation.prebuilt import INDEX, Kernels, Unusable
from atoll_core.compilation.progress import count_of
from atoll_core.errors import AtollError
from tests.unit.common.compilation.test_jit import KERNELS

PACKAGE = "atoll_island_worker"
FAST = "flags\t\t: fpu sse2 avx avx2 bmi1 bmi2 f16c fma movbe abm\n"
SLOW = "flags\t\t: fpu sse2 sse4_2\n"


class Wheel:
    """A folder of kernels as a wheel for this machine brings it, and the caches that decide about it."""

    def __init__(self, folder: Path, processor: Path) -> None:
        self.folder, self._processor = folder, processor
        place = f"{PACKAGE}-{cache.source_digest(cache.packages_compiled_into(PACKAGE))}"
        self.files = [folder / level / place / "kernel.nbc" for level in ("x86-64-v3", "generic")]
        for file in self.files:
            file.parent.mkdir(parents=True)
            file.write_bytes(b"machine code for " + file.parts[-3].encode())
        digests = {file.relative_to(folder).as_posix(): prebuilt.file_digest(file) for file in self.files}
        self.index: dict[str, Any] = {
            **prebuilt.circumstances(),
            "levels": {level: ["triple", level, ""] for level in ("x86-64-v3", "generic")},
            "packages": {PACKAGE: place.rpartition("-")[2]},
            "results": {PACKAGE: "right"},
            "files": digests,
        }
        self.write(FAST)

    def write(self, flags: str, **changed: object) -> None:
        """Write the index with `changed` entries, and the processor's `flags`, as if installed just now."""
        self.folder.joinpath(INDEX).write_text(json.dumps(self.index | changed), "utf-8")
        self._processor.write_text(flags, "utf-8")
        self.forget()

    def forget(self) -> None:
        """Decide again, as a process that starts does."""
        wheel_kernels.cache_clear()
        prebuilt._index.cache_clear()


@pytest.fixture
def wheel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Wheel]:
    for name in (*cache._SETTINGS, "NUMBA_DISABLE_JIT", "ATOLL_OWN_KERNELS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ATOLL_KERNEL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(prebuilt, "FOLDER", tmp_path / "prebuilt")
    monkeypatch.setattr(prebuilt, "_CPU_INFO", tmp_path / "cpuinfo")
    monkeypatch.setattr("platform.machine", lambda: "x86_64")
    made = Wheel(tmp_path / "prebuilt", tmp_path / "cpuinfo")
    yield made
    made.forget()


def warm_up(results: str) -> list[object]:
    """Return what is reported while kernels that compute `results` are compiled or loaded: counts and sentences."""
    said: list[object] = []
    compile_or_load(
        PACKAGE, lambda: results, {"one": 1.0, "two": 1.0}, lambda text: said.append(count_of(text) or text)
    )
    return list(dict.fromkeys(said))


COMPILED = [(0, 2), (2, 2)]


@pytest.mark.parametrize(("flags", "level"), [(FAST, "x86-64-v3"), (SLOW, "generic"), ("", "generic")])
def test_the_best_level_that_the_processor_can_run_is_taken(wheel: Wheel, flags: str, level: str) -> None:
    wheel.write(flags)
    kernels = wheel_kernels(PACKAGE)
    assert isinstance(kernels, Kernels)
    assert kernels.target == ("triple", level, "")
    assert (kernels.folder / "kernel.nbc").read_bytes().endswith(level.encode())


def test_nothing_is_compiled_or_said_if_the_self_test_is_passed(wheel: Wheel) -> None:
    assert is_compiled(PACKAGE)
    assert warm_up("right") == []


def test_a_clone_brings_no_kernels(wheel: Wheel) -> None:
    wheel.folder.joinpath(INDEX).unlink()
    wheel.forget()
    assert wheel_kernels(PACKAGE) is None
    assert warm_up("right") == COMPILED


@pytest.mark.parametrize(
    ("flags", "changed", "reason"),
    [
        (FAST, {"numba": "0.1.2"}, f"are for numba 0.1.2, and this is numba {prebuilt.circumstances()['numba']}"),
        (FAST, {"Python": "3.5"}, "are for Python 3.5, and this is Python 3."),
        (FAST, {"processor": "aarch64"}, "are for processor aarch64, and this is processor x86_64"),
        (FAST, {"packages": {PACKAGE: "0123456789abcdef"}}, "are for other source files"),
        (SLOW, {"levels": {"x86-64-v3": ["triple", "x86-64-v3", ""]}}, "need a processor of the kind x86-64-v3"),
    ],
)
def test_kernels_that_do_not_fit_are_compiled_after_one_sentence(
    wheel: Wheel, flags: str, changed: dict[str, object], reason: str
) -> None:
    wheel.write(flags, **changed)
    assert not is_compiled(PACKAGE)
    first, *rest = warm_up("anything")
    assert reason in str(first)
    assert rest == COMPILED
    assert warm_up("anything") == []


@pytest.mark.parametrize("what", ["changed", "missing", "added"])
def test_a_file_that_differs_from_the_index_is_noticed(wheel: Wheel, what: str) -> None:
    file = wheel.files[0]
    match what:
        case "changed":
            file.write_bytes(file.read_bytes()[:-1] + b"4")
        case "missing":
            file.unlink()
        case _:
            file.with_name("other.nbc").write_bytes(b"")
    first, *rest = warm_up("right")
    assert "were changed after they were built" in str(first)
    assert rest == COMPILED


def test_digests_are_checked_until_the_self_test_was_passed(wheel: Wheel) -> None:
    warm_up("right")
    wheel.files[0].write_bytes(b"not read")
    wheel.forget()
    assert isinstance(wheel_kernels(PACKAGE), Kernels)
    wheel.write(FAST, results={PACKAGE: "another wheel"})
    assert isinstance(wheel_kernels(PACKAGE), Unusable)


def test_kernels_that_compute_wrong_values_are_used_once_only(wheel: Wheel) -> None:
    with pytest.raises(AtollError, match=r"wrong values on this machine; start again"):
        warm_up("wrong")
    wheel.forget()
    first, *rest = warm_up("right")
    assert "have failed their self-test" in str(first)
    assert rest == COMPILED


def fork(exercise: Callable[[], str]) -> int:
    """Return the id of a process that runs the exercise as its self-test, and then exits with 0."""
    child = os.fork()
    if child == 0:
        faulthandler.disable()  # a crash is expected
        try:
            compile_or_load(PACKAGE, exercise, {}, lambda text: None)
        except BaseException:
            os._exit(1)
        os._exit(0)
    return child


def die() -> str:
    os.kill(os.getpid(), signal.SIGILL)
    return "right"


def test_kernels_that_end_the_process_are_used_once_only(wheel: Wheel) -> None:
    assert os.waitstatus_to_exitcode(os.waitpid(fork(die), 0)[1]) == -signal.SIGILL
    wheel.forget()
    first, *rest = warm_up("right")
    assert "ended the process" in str(first)
    assert rest == COMPILED
    assert warm_up("right") == []


def test_kernels_that_ended_the_process_of_one_program_are_not_used_by_the_other(wheel: Wheel) -> None:
    other = "atoll_coordinator"
    digest = cache.source_digest(cache.packages_compiled_into(other))
    wheel.write(FAST, packages={**wheel.index["packages"], other: digest})
    os.waitpid(fork(die), 0)
    wheel.forget()
    excluded = wheel_kernels(other)
    assert isinstance(excluded, Unusable)
    assert "ended the process" in excluded.reason
    Path(excluded.reason.removesuffix(")").rpartition("remove ")[2]).unlink()
    wheel.forget()
    assert "changed after" in str(wheel_kernels(other)), "looked at again, but this wheel has no files for it"
    assert isinstance(wheel_kernels(PACKAGE), Kernels)


@pytest.mark.parametrize("signal_number", [0, signal.SIGKILL])
def test_a_test_in_another_process_is_not_taken_for_a_crash(wheel: Wheel, signal_number: int) -> None:
    begun, is_begun = os.pipe()
    may_end, end = os.pipe()

    def wait() -> str:
        os.write(is_begun, b"1")
        os.read(may_end, 1)
        return "right"

    child = fork(wait)
    os.read(begun, 1)
    wheel.forget()
    assert isinstance(wheel_kernels(PACKAGE), Kernels), "it is tested just now"
    if signal_number:
        os.kill(child, signal_number)
    os.write(end, b"1")
    os.waitpid(child, 0)
    wheel.forget()
    assert isinstance(wheel_kernels(PACKAGE), Unusable if signal_number else Kernels)


def test_an_interrupted_test_has_no_outcome(wheel: Wheel) -> None:
    def interrupt() -> str:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compile_or_load(PACKAGE, interrupt, {}, lambda text: None)
    wheel.forget()
    assert isinstance(wheel_kernels(PACKAGE), Kernels)
    assert warm_up("right") == []


def test_a_process_that_waited_for_a_test_that_crashed_does_not_try_the_kernels(wheel: Wheel) -> None:
    assert isinstance(wheel_kernels(PACKAGE), Kernels), "chosen before the crash"
    os.waitpid(fork(die), 0)
    with pytest.raises(AtollError, match="start again"):
        warm_up("right")


def test_a_cache_that_cannot_be_written_does_not_matter(wheel: Wheel, monkeypatch: pytest.MonkeyPatch) -> None:
    wheel.folder.with_name("file").write_text("")
    monkeypatch.setenv("ATOLL_KERNEL_CACHE", str(wheel.folder.with_name("file")))
    assert warm_up("right") == []
    with pytest.raises(AtollError, match="ATOLL_OWN_KERNELS=1"):
        warm_up("wrong")


@pytest.mark.parametrize("name", ["NUMBA_CPU_NAME", "NUMBA_OPT", "ATOLL_OWN_KERNELS"])
def test_other_machine_code_is_compiled_if_the_environment_asks_for_it(
    wheel: Wheel, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(name, "1")
    assert wheel_kernels(PACKAGE) is None
    assert warm_up("anything") == COMPILED


LOAD = """
import sys
from pathlib import Path
from atoll_core.compilation import prebuilt
prebuilt.FOLDER = Path(sys.argv[1])
import place
print(place.double(2.0), sum(place.double._cache_hits.values()))
"""
WRITE = """
import json, sys
from pathlib import Path
from numba.core.registry import cpu_target
from atoll_core.compilation import cache, prebuilt
import place
place.double(2.0)
folder = Path(sys.argv[1])
files = {file.relative_to(folder).as_posix(): prebuilt.file_digest(file) for file in folder.glob("*/*/*")}
index = {
    **prebuilt.circumstances(),
    "levels": {"generic": cpu_target.target_context.codegen().magic_tuple()},
    "packages": {"place": cache.source_digest(cache.packages_compiled_into("place"))},
    "results": {}, "files": files,
}
(folder / prebuilt.INDEX).write_text(json.dumps(index))
"""


@pytest.mark.slow
@pytest.mark.skipif(not IS_COMPILED, reason="kernels are interpreted")
def test_machine_code_of_a_level_is_loaded_instead_of_compiled(tmp_path: Path) -> None:
    (tmp_path / "place.py").write_text(KERNELS.replace("FACTOR", "2.0"))
    folder = tmp_path / "prebuilt"
    outside = {name: value for name, value in os.environ.items() if name not in cache._SETTINGS}

    def run(program: str, **settings: str) -> list[str]:
        command = [sys.executable, "-c", program, str(folder)]
        environment = {**outside, **settings}
        return subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        ).stdout.split()

    run(WRITE, ATOLL_KERNEL_CACHE=str(folder / "generic"), NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES="")
    assert run(LOAD, ATOLL_KERNEL_CACHE=str(tmp_path / "cache")) == ["4.0", "1"]
    assert not list(tmp_path.glob("cache/**/*.nbc"))
    own = run(LOAD, ATOLL_KERNEL_CACHE=str(tmp_path / "cache"), ATOLL_OWN_KERNELS="1")
    assert own == ["4.0", "0"]
