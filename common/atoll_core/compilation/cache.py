"""Compile the kernels of a package once per machine; choose the folder of the compiled kernels.

There is one folder for each package and each digest of all source text that is compiled into its kernels. Checkouts,
wheels and copies with equal sources therefore share machine code. Machine code of other sources is never loaded. If the
kernels of one program change, the kernels of the other program stay compiled. A marker file for each kind of processor
and compiler says that all kernels of the package have been compiled; another one says so for a part of the package. If
several processes find nothing compiled, one process compiles. The others wait and then load. If a wheel brought kernels
that this machine can use, nothing is compiled (`prebuilt`).
"""

import contextlib
import functools
import hashlib
import os
import platform
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from atoll_core.compilation import prebuilt
from atoll_core.compilation.progress import Report, reporting
from atoll_core.errors import AtollError
from atoll_core.machine import user_folder

WORKER: Final = ("atoll_core", "atoll_island_worker")
"""The packages whose kernels decide the bits of a search."""
ALL: Final = (*WORKER, "atoll_coordinator")

_COMPILED_IN: Final = {
    "atoll_core": ("compilation/jit.py", "search/seeding.py", "expression/operators.py"),
    "atoll_island_worker": ("evolution/structures.py",),
    "atoll_coordinator": ("model/cholesky.py",),
}
"""Other files whose constants and types are compiled into the kernels."""

on_ready: Final[list[Callable[[], None]]] = []
"""Callbacks that `jit` calls after each kernel that was compiled, or loaded from the cache."""

_CPU_INFO: Final = Path("/proc/cpuinfo")
_OWN_ONLY: Final = "ATOLL_OWN_KERNELS"
"""The variable that excludes the kernels of a wheel if it is set and not 0."""
_SETTINGS: Final = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_OPT", "NUMBA_BOUNDSCHECK")


def packages_compiled_into(package: str) -> tuple[str, ...]:
    """Return the packages whose kernels may be compiled into the kernels of `package`.

    For a package that is not in `ALL`, such as the tests, the result is all packages in `ALL`.
    """
    return tuple(dict.fromkeys(("atoll_core", package))) if package in ALL else ALL


def kernel_files(packages: Sequence[str] = ALL) -> list[Path]:
    """Return the modules of every folder ``kernels`` in `packages`, in a fixed order."""
    return [file for package in packages for file in sorted(_folder(package).glob("**/kernels/[!_]*.py"))]


def source_digest(packages: Sequence[str] = ALL) -> str:
    """Return a short digest of every source file that takes part in the compiled kernels of `packages`."""
    digest = hashlib.blake2b(digest_size=8)
    others = [_folder(package) / name for package in packages for name in _COMPILED_IN.get(package, ())]
    for file in [*others, *kernel_files(packages)]:
        digest.update(file.name.encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _folder(package: str) -> Path:
    spec = find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent


def cache_directory(package: str) -> Path:
    """Return the folder of a package's compiled kernels, in ``ATOLL_KERNEL_CACHE`` or the user's cache directory."""
    chosen = os.environ.get("ATOLL_KERNEL_CACHE")
    base = Path(chosen) if chosen else user_folder("XDG_CACHE_HOME", ".cache") / "atoll"
    return base / f"{package}-{_digest(package)}"


@functools.cache
def _digest(package: str) -> str:
    return source_digest(packages_compiled_into(package))


def is_compiled(package: str, part: str = "") -> bool:
    """Return whether the kernels of a package, or of a `part`, are compiled for this machine: they are only loaded."""
    if isinstance(wheel_kernels(package), prebuilt.Kernels):
        return True
    return any(marker(package, one).exists() for one in {"", part})


@functools.cache
def wheel_kernels(package: str) -> prebuilt.Kernels | prebuilt.Unusable | None:
    """Return the kernels that the installed wheel brought for `package`, or why they cannot be used.

    The digests of the files are checked until the kernels have passed their self-test on this machine. If a self-test
    of kernels of this wheel has failed, or has ended its process, no kernels of the wheel are used. The result is None
    if there are none, or if the environment asks for other machine code.
    """
    if sys.flags.optimize >= 2 or any(os.environ.get(name) for name in _SETTINGS):
        return None
    if os.environ.get(_OWN_ONLY, "0") not in ("", "0"):
        return None
    found = prebuilt.find(package, _digest(package))
    if not isinstance(found, prebuilt.Kernels):
        return found
    # Kernels call kernels of other packages.
    files = {one: _outcome_file(one, found) for one in sorted({*ALL, package})}
    outcomes = {one: _outcome(file) for one, file in files.items()}
    for one, outcome in outcomes.items():
        if outcome in _EXCLUDING:  # a test that was ended from outside, as when memory runs out, also counts
            return prebuilt.Unusable(f"{_EXCLUDING[outcome]} on this machine (to test again, remove {files[one]})")
    if outcomes[package] == _PASSED or found.is_intact():
        return found
    return prebuilt.Unusable("were changed after they were built")


_TESTING: Final = "testing"
_PASSED: Final = "passed"
_FAILED: Final = "failed"
_CRASHED: Final = "crashed"
_EXCLUDING: Final = {_FAILED: "have failed their self-test", _CRASHED: "ended the process that tested them"}
"""Outcomes of the self-test after which no kernels of the wheel are used, as the ends of a sentence about them."""


def _outcome_file(package: str, kernels: prebuilt.Kernels) -> Path:
    """Return the file that says whether the kernels of this wheel have passed their self-test on this machine.

    During the test it says so, and the testing process holds a lock on it. The system frees the lock when the process
    dies, so a test without a lock is a test that has ended its process, for example by an illegal instruction.
    """
    return cache_directory(package) / f"wheel-{kernels.index_digest}-{_machine_digest()}"


def _outcome(file: Path) -> str:
    """Return the outcome of the self-test; "" before the test, and while another process tests."""
    import fcntl

    try:
        with file.open(encoding="ascii") as opened:
            outcome = opened.read()
            if outcome != _TESTING:
                return outcome
            fcntl.flock(opened, fcntl.LOCK_SH | fcntl.LOCK_NB)
            opened.seek(0)
            outcome = opened.read()  # the test may have ended just now
            return _CRASHED if outcome == _TESTING else outcome
    except OSError:  # there is no file, or another process has the lock
        return ""


@contextlib.contextmanager
def _under_test(file: Path) -> Iterator[Callable[[str], object]]:
    """Context manager: `file` says that the kernels are tested; yields a function that writes the outcome.

    It waits until no other process tests them. If the file cannot be written, nothing is written, and the digests of
    the kernels are checked each time.
    """
    import fcntl

    with contextlib.ExitStack() as stack:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            opened = stack.enter_context(file.open("a+", encoding="ascii"))
            fcntl.flock(opened, fcntl.LOCK_EX)
        except OSError:
            yield lambda outcome: None
            return

        def write(outcome: str) -> None:
            opened.truncate(0)
            opened.write(outcome)
            opened.flush()

        opened.seek(0)
        before = opened.read()
        if before in (_TESTING, _CRASHED):  # the process that tested them until now has died of it
            write(_CRASHED)
            raise AtollError(f"the compiled kernels of the installed wheel {_EXCLUDING[_CRASHED]}; {_AGAIN}")
        write(_TESTING)
        try:
            yield write
        except BaseException:  # such as Ctrl-C: no outcome
            write("")
            raise


_AGAIN: Final = f"start again to compile kernels here (or set {_OWN_ONLY}=1)"


def _test_wheel_kernels(package: str, kernels: prebuilt.Kernels, exercise: "Exercise") -> None:
    """Load the kernels and compare what they compute; raise AtollError if their results are wrong.

    The outcome is written: later processes need not check the digests of the files of kernels that passed, and compile
    instead of using kernels that failed, or that ended the process.
    """
    file = _outcome_file(package, kernels)
    if _outcome(file) == _PASSED and exercise() == kernels.results:
        return
    with _under_test(file) as write:
        is_right = exercise() == kernels.results
        write(_PASSED if is_right else _FAILED)
    if not is_right:
        raise AtollError(f"the compiled kernels of the installed wheel compute wrong values on this machine; {_AGAIN}")


def marker(package: str, part: str = "") -> Path:
    """Return the file that exists if all kernels of a package, or of a `part`, have been compiled for this machine."""
    return cache_directory(package) / "-".join(word for word in ("ready", part, _machine_digest()) if word)


def _machine_digest() -> str:
    """Return a digest of everything by which numba finds machine code, except the source text of the kernels."""
    parts = [platform.python_version(), platform.machine(), _processor()]
    parts += [version(name) for name in ("numba", "llvmlite", "numpy")]
    parts += [f"{name}={os.environ.get(name, '')}" for name in _SETTINGS]
    if sys.flags.optimize >= 2:  # numba finds its machine code by the bytecode, which differs without docstrings
        parts.append("without docstrings")
    return hashlib.blake2b("\n".join(parts).encode(), digest_size=8).hexdigest()


def _processor() -> str:
    """Return the kind of processor that numba compiles for: this machine's, unless the environment sets another."""
    if os.environ.get("NUMBA_CPU_NAME") and "NUMBA_CPU_FEATURES" in os.environ:
        return "chosen"  # its name and features are among the settings
    with contextlib.suppress(OSError):
        lines = _CPU_INFO.read_text("utf-8", "replace").split("\n\n")[0].splitlines()
        return "\n".join(line for line in lines if line.startswith(("model name", "flags", "CPU part", "Features")))
    return platform.processor()


Exercise = Callable[[], str]
"""Calls every kernel with the types of arguments that the program uses, and returns a digest of what they computed."""


def compile_or_load(
    package: str, exercise: Exercise, costs: Mapping[str, float], report: Report, part: str = ""
) -> None:
    """Compile or load all kernels of `package` by running `exercise`. Do nothing with ``NUMBA_DISABLE_JIT``.

    If `exercise` needs only some of the kernels, `part` is their name. The kernels of a wheel are tested only with all
    kernels of the package.

    `costs` has each separately compiled function, in the order of the exercise, and the seconds of a processor that it
    usually takes. `report` is called with a message before the first compilation, after each kernel and every second;
    if this process waits; or if the kernels of a wheel cannot be used. Raises AtollError if the cache of compiled
    kernels cannot be written, or if the kernels of a wheel fail their self-test.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return
    brought = wheel_kernels(package)
    if isinstance(brought, prebuilt.Kernels) and not part:
        _test_wheel_kernels(package, brought, exercise)
        return
    if not is_compiled(package, part):  # otherwise a read-only folder is enough
        if isinstance(brought, prebuilt.Unusable):
            report(f"the compiled kernels of the installed wheel {brought.reason}; kernels are compiled here")
        with _hold_lock(_make(cache_directory(package)) / "lock", report):
            if not is_compiled(package, part):
                with reporting([*costs.values()], on_ready, report):
                    exercise()
                marker(package, part).touch()
                return
    exercise()


def _make(directory: Path) -> Path:
    try:
        directory.mkdir(parents=True, exist_ok=True)
        if not os.access(directory, os.W_OK | os.X_OK):
            raise PermissionError(13, "permission denied")
    except OSError as error:
        raise AtollError(
            f"the folder of compiled kernels {directory} cannot be written ({error.strerror}); "
            "set ATOLL_KERNEL_CACHE to a folder that can be written"
        ) from error
    return directory


@contextlib.contextmanager
def _hold_lock(path: Path, report: Report) -> Iterator[None]:
    """Hold the lock file at `path`, so that one process compiles; the system frees the lock when a process dies."""
    import fcntl

    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            report("waiting while another process of this machine compiles the kernels")
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
