"""The one place where numba is chosen and configured: strict IEEE arithmetic, cached machine code, no GIL.

No fast-math and no contraction, so that one seed gives one answer on every processor (ADR 0002). Kernels stay in the
subset of Python that also runs interpreted (``NUMBA_DISABLE_JIT=1``), which the oracles and the coverage run use.
Machine code is found by the text of its sources, wherever these lie (ADR 0011); numba's caches of other programs in
the same process are left alone.
"""

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numba
import numba._dispatcher
import numba.core.caching
import numba.core.ccallback
import numba.core.cgutils
import numba.core.compiler
import numba.core.dispatcher
import numba.core.registry
import numba.core.runtime
import numba.core.sigutils
import numba.extending

from atoll_core.compilation.cache import cache_directory

IS_COMPILED = not numba.config.DISABLE_JIT
"""Whether kernels are machine code; else they run as the Python they are."""

types = numba.types
cgutils = numba.core.cgutils
intrinsic: Callable[[Callable[..., Any]], Any] = numba.extending.intrinsic

_entry_points: Final[dict[tuple[Any, ...], Callable[..., Any]]] = {}
"""By kernel and the fingerprints of its arguments' types."""

on_ready: Final[list[Callable[[], None]]] = []
"""Functions that are called whenever a kernel has been compiled, or loaded from the cache."""

F = TypeVar("F", bound=Callable[..., Any])

_STRICT: Final = {"nogil": True, "error_model": "numpy", "fastmath": False, "no_cfunc_wrapper": True}
_BARE: Final = {**_STRICT, "_nrt": False}
"""Without numba's run-time counting of references: kernels make no arrays, and the count of an array handed on, an
atomic instruction, took more time than the work."""


def kernel(function: F) -> F:
    """Compile `function` on first call: strict arithmetic, numpy's division rules, GIL released, cached on disk.

    It must not make arrays: what it needs is handed to it.
    """
    return cast(F, _Kernel(function, _BARE)) if IS_COMPILED else function


def entry_point(function: F, *arguments: object) -> F:
    """Return the machine code of a kernel for arguments of the types of `arguments`; interpreted: the kernel itself.

    It does not look at types again, which for the hundred arrays of an island takes as long as a generation. Whoever
    calls it answers for them. Types that were there before are known by their fingerprints, as they are when numba
    calls a kernel itself: that takes 0.05 ms, and numba's `typeof` 3 ms, for each kernel of each island.
    """
    if not IS_COMPILED:
        return function
    key = (function, *map(numba._dispatcher.compute_fingerprint, arguments))
    if key not in _entry_points:
        _entry_points[key] = function.compile(tuple(map(numba.typeof, arguments)))  # type: ignore[attr-defined]
    return cast(F, _entry_points[key])


def allocating_kernel(function: F) -> F:
    """Compile `function` as `kernel` does; it may make arrays."""
    return cast(F, _Kernel(function, _STRICT)) if IS_COMPILED else function


def inlined(function: F) -> F:
    """Compile `function` into its callers, whatever its size: loops over it can then be vectorised."""
    return cast(F, _Kernel(function, {**_BARE, "forceinline": True})) if IS_COMPILED else function


def callback(signature: str, function: F) -> Any:
    """Compile `function` apart from its callers, which reach it by its ``address``: once, not in each of them."""
    options = {"nopython": True, "error_model": "numpy", "fastmath": False}
    result = numba.core.ccallback.CFunc(function, numba.core.sigutils.normalize_signature(signature), {}, options)
    result._cache = _Cache(function)
    result.compile()
    return result


class _CalleeCompiler(numba.core.dispatcher._FunctionCompiler):  # type: ignore[misc]  # numba has no types
    def _customize_flags(self, flags: Any) -> Any:
        flags.no_compile = flags.no_cpython_wrapper = True
        return flags


class _Callee(numba.core.registry.CPUDispatcher):  # type: ignore[misc]
    """A function as its compiled callers see it: optimised, to be linked into them, and never made machine code."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        super().__init__(function, targetoptions=options)
        self._compiler = _CalleeCompiler(function, self.targetdescr, options, {}, numba.core.compiler.Compiler)

    def add_overload(self, result: Any) -> None:
        library = result.library
        library._finalize_final_module = functools.partial(setattr, library, "_finalized", True)
        self.targetctx.insert_user_function(library, result.fndesc, [library])
        self.overloads[tuple(result.signature.args)] = result

    def get_overload(self, signature: Any) -> Any:
        return self.overloads[numba.core.sigutils.normalize_signature(signature)[0]].library


class _Kernel(numba.core.registry.CPUDispatcher):  # type: ignore[misc]
    """A function to be called from Python, and from other kernels: two thirds of numba's own time to compile both ways.

    What another kernel calls is compiled for it alone, once for each type of arguments whatever constants they are, and
    neither wrapped for Python nor cached: it is part of the caller's machine code.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        super().__init__(function, targetoptions={**options, "nopython": True})
        self._cache = _Cache(function)
        self._callee = _Callee(function, self.targetoptions)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return self._callee.get_call_template(tuple(map(types.unliteral, args)), kws)

    def get_overload(self, signature: Any) -> Any:
        return self._callee.get_overload(signature)


class _Locator(numba.core.caching._CacheLocator):  # type: ignore[misc]
    """The place of one function's machine code: a file in its package's folder, named by module and line."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._package, _, self._module = function.__module__.partition(".")
        self._line = function.__code__.co_firstlineno
        self._py_file = file  # numba's warnings name it

    def get_cache_path(self) -> str:
        return str(cache_directory(self._package))

    def get_source_stamp(self) -> str:
        """Return a digest of the file, for what is not in a folder of kernels, such as tests."""
        return _digest(self._py_file)

    def get_disambiguator(self) -> str:
        return f"{self._module}-{self._line}"

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> "_Locator":
        return cls(function, file)


@functools.cache
def _digest(file: str) -> str:
    return hashlib.blake2b(Path(file).read_bytes(), digest_size=8).hexdigest()


class _Results(numba.core.caching.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class _Cache(numba.core.caching.FunctionCache):  # type: ignore[misc]
    _impl_class = _Results

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return what has been compiled before, None if it has not been.

        Machine code needs numba's run-time system, but none of what numba knows of Python and numpy, which takes as
        long to load as all kernels: that is left to compiling.
        """
        numba.core.runtime.rtsys.initialize(target)
        with self._guard_against_spurious_io_errors():
            result = self._load_overload(signature, target)
        if result is None:
            target.refresh()
        else:
            _announce()
        return result

    def save_overload(self, signature: Any, data: Any) -> None:
        super().save_overload(signature, data)
        _announce()


def _announce() -> None:
    for function in on_ready:
        function()
