"""Compiling the kernels of a package once per machine, before work comes; they are loaded everywhere else.

Of several processes that find nothing compiled, one compiles while the others wait and then load.
"""

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from atoll.compilation.cache import cache_directory, is_compiled, marker
from atoll.errors import AtollError

Report = Callable[[str], None]


def compile_or_load(package: str, exercise: Callable[[], None], report: Report) -> None:
    """Compile or load all kernels of `package`, which `exercise` runs. Does nothing with ``NUMBA_DISABLE_JIT``.

    Args:
        package: the package whose kernels these are.
        exercise: runs every kernel with the types that it is used with.
        report: told in one sentence when it is going to take long, and why.

    Raises:
        AtollError: the cache of compiled kernels cannot be written.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return
    directory = _make(cache_directory(package))
    if not is_compiled(package):
        with _locked(directory / "lock", report):
            if not is_compiled(package):
                report("compiling kernels, first time on this machine, about half a minute")
                exercise()
                marker(package).touch()
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
            "set ATOLL_KERNEL_CACHE to one that can"
        ) from error
    return directory


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
