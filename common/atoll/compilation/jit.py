"""The one place where numba is chosen and configured: strict IEEE arithmetic, cached machine code, no GIL.

No fast-math and no contraction, so that one seed gives one answer on every processor (ADR 0002). Kernels stay in the
subset of Python that also runs interpreted (``NUMBA_DISABLE_JIT=1``), which the oracles and the coverage run use.
The cache lies under the user's cache directory, one folder per digest of the kernels' source text, so that kernels
compile once per machine and a stale cache can never be loaded.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from atoll.compilation.sources import source_digest


def cache_directory() -> Path:
    """Return the folder of compiled kernels: ``ATOLL_KERNEL_CACHE``, else under the user's cache directory."""
    chosen = os.environ.get("ATOLL_KERNEL_CACHE")
    base = Path(chosen) if chosen else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "atoll"
    return base / f"kernels-{source_digest()}"


os.environ.setdefault("NUMBA_CACHE_DIR", str(cache_directory()))

import numba  # noqa: E402  the cache directory must be set before numba reads its configuration
import numba.core.cgutils  # noqa: E402
import numba.extending  # noqa: E402

IS_COMPILED = not numba.config.DISABLE_JIT
"""Whether kernels are machine code; else they run as the Python they are."""

types = numba.types
cgutils = numba.core.cgutils
intrinsic: Callable[[Callable[..., Any]], Any] = numba.extending.intrinsic

F = TypeVar("F", bound=Callable[..., Any])


_STRICT = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": False}
_BARE = {**_STRICT, "_nrt": False}
"""Without numba's run-time counting of references: kernels make no arrays, and the count of an array handed on, an
atomic instruction, took more time than the work."""


def kernel(function: F) -> F:
    """Compile `function` on first call: strict arithmetic, numpy's division rules, GIL released, cached on disk.

    It must not make arrays: what it needs is handed to it.
    """
    return cast(F, numba.njit(**_BARE)(function))


def allocating_kernel(function: F) -> F:
    """Compile `function` as `kernel` does; it may make arrays."""
    return cast(F, numba.njit(**_STRICT)(function))


def callback(signature: str, function: F) -> Any:
    """Compile `function` apart from its callers, which reach it by its ``address``: once, not in each of them."""
    return numba.cfunc(signature, cache=True, nopython=True, error_model="numpy", fastmath=False)(function)


def inlined(function: F) -> F:
    """Compile `function` into its callers, whatever its size: loops over it can then be vectorised."""
    return cast(F, numba.njit(**_BARE, forceinline=True)(function))
