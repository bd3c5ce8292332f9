"""Compiling the kernels of a package once per machine, before work comes; they are loaded everywhere else.

Of several processes that find nothing compiled, one compiles while the others wait and then load.
"""

import contextlib
import importlib
import os
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Final

from atoll_core.compilation.cache import cache_directory, is_compiled, marker
from atoll_core.compilation.progress import sentence_of
from atoll_core.errors import AtollError

_ADVICE: Final = "install a version from 0.63 to 0.68"

Report = Callable[[str], None]


def compile_or_load(package: str, exercise: Callable[[], None], kernels: int, report: Report) -> None:
    """Compile or load all kernels of `package`, which `exercise` runs. Does nothing with ``NUMBA_DISABLE_JIT``.

    `exercise` compiles or loads so many `kernels`, each with the types that it is used with. `report` is called with a
    sentence before the first compilation and after each kernel, or when this process waits. Raises AtollError where the
    cache of compiled kernels cannot be written, or this numba lacks a part that `jit` builds on.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return
    _import_compiler()
    if not is_compiled(package):  # else a folder that can only be read does
        with _locked(_make(cache_directory(package)) / "lock", report):
            if not is_compiled(package):
                with _counted(kernels, report):
                    exercise()
                marker(package).touch()
                return
    exercise()


def _import_compiler() -> None:
    try:
        importlib.import_module("atoll_core.compilation.jit")
    except (AttributeError, ImportError) as error:
        raise AtollError(f"kernels cannot be compiled with numba {version('numba')} ({error}); {_ADVICE}") from error


def _make(directory: Path) -> Path:
    try:
        directory.mkdir(parents=True, exist_ok=True)
        if not os.access(directory, os.W_OK | os.X_OK):
            raise PermissionError(13, "permission denied")
    except OSError as error:
        raise AtollError(
            f"the folder of compiled kernels {directory} cannot be written ({error.strerror}); "
            "set ATOLL_KERNEL_CACHE to one that can"
        ) from error
    return directory


@contextlib.contextmanager
def _counted(kernels: int, report: Report) -> Iterator[None]:
    """Report how many kernels are compiled, at the beginning, after each, and at the end."""
    from atoll_core.compilation.jit import on_ready

    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        if done < kernels:  # the last is reported below, since some may have been ready before
            report(sentence_of(done, kernels))

    report(sentence_of(0, kernels))
    on_ready.append(count)
    try:
        yield
    finally:
        on_ready.remove(count)
    report(sentence_of(kernels, kernels))


@contextlib.contextmanager
def _locked(path: Path, report: Report) -> Iterator[None]:
    """Hold the machine's one lock on compiling; the system gives it back should the holder die."""
    import fcntl

    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            report("waiting while another process of this machine compiles the kernels")
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
