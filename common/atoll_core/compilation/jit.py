"""The only module that imports and configures numba: strict IEEE arithmetic, cached machine code, no GIL.

Fast-math and contraction are off, so that one seed gives one answer on every processor (ADR 0002). Kernels use the
subset of Python that also runs interpreted (``NUMBA_DISABLE_JIT=1``); the oracles and the coverage run use this mode.
Machine code is found by the text of its sources and not by their folder (ADR 0011). Numba's caches for other programs
in the same process are not changed.
"""

import contextlib
import functools
import hashlib
import re
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, TypeVar, cast

from atoll_core.compilation.cache import WORKER, cache_directory, on_ready, wheel_kernels
from atoll_core.compilation.prebuilt import Kernels
from atoll_core.errors import AtollError

try:
    import numba
    import numba._dispatcher
    import numba.core.ccallback
    import numba.core.cgutils
    import numba.core.codegen
    import numba.core.compiler
    import numba.core.runtime
    import numba.core.sigutils
    import numba.extending
    from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
    from numba.core.dispatcher import _FunctionCompiler  # type: ignore[attr-defined]  # numba has no types
    from numba.core.registry import CPUDispatcher
except ImportError as error:
    raise AtollError(
        f"kernels cannot be compiled with numba {version('numba')} ({error}); install a version from 0.63 to 0.68"
    ) from error

IS_COMPILED = not numba.config.DISABLE_JIT
"""Whether kernels are compiled to machine code; else they run as interpreted Python."""

types = numba.types
cgutils = numba.core.cgutils
_llvm = numba.core.codegen.ll
intrinsic: Callable[[Callable[..., Any]], Any] = numba.extending.intrinsic

_entry_points: Final[dict[tuple[Any, ...], Callable[..., Any]]] = {}
"""Machine code by kernel and the fingerprints of its arguments' types."""

F = TypeVar("F", bound=Callable[..., Any])

_STRICT: Final = {"nogil": True, "error_model": "numpy", "fastmath": False, "no_cfunc_wrapper": True}
_BARE: Final = {**_STRICT, "_nrt": False}
"""Without numba's reference counting at run time. Kernels allocate no arrays, and each array that was passed on cost
an atomic instruction, which took more time than the work itself."""


def kernel(function: F) -> F:
    """Compile `function` on first call: strict arithmetic, numpy's division rules, GIL released, cached on disk.

    The function must not allocate arrays: the caller passes scratch arrays as arguments.
    """
    return cast(F, _Kernel(function, _BARE)) if IS_COMPILED else function


def entry_point(function: F, *arguments: object) -> F:
    """Return the machine code of a kernel for arguments of the types of `arguments`; interpreted: the kernel itself.

    The machine code does not check the types of its arguments, because for the hundred arrays of an island this check
    takes as long as a generation. The caller must pass arguments of the same types. Types that occurred before are
    recognised by their fingerprints, as in numba's own calls. This takes 0.05 ms for each kernel of each island;
    numba's `typeof` takes 3 ms.
    """
    if not IS_COMPILED:
        return function
    key = (function, *map(numba._dispatcher.compute_fingerprint, arguments))
    if key not in _entry_points:
        _entry_points[key] = function.compile(tuple(map(numba.typeof, arguments)))  # type: ignore[attr-defined]
    return cast(F, _entry_points[key])


def allocating_kernel(function: F) -> F:
    """Compile `function` as `kernel` does; the function may allocate arrays."""
    return cast(F, _Kernel(function, _STRICT)) if IS_COMPILED else function


def inlined(function: F) -> F:
    """Compile `function` into its callers, whatever its size, so that loops that call it can be vectorised."""
    return cast(F, _Kernel(function, {**_BARE, "forceinline": True})) if IS_COMPILED else function


def callback(signature: str, function: F) -> Any:
    """Compile `function` once, instead of again in each caller; callers call it at the ``address`` of the result."""
    options = {"nopython": True, "error_model": "numpy", "fastmath": False}
    result = numba.core.ccallback.CFunc(function, numba.core.sigutils.normalize_signature(signature), {}, options)
    result._cache = _Cache(function)
    result.compile()
    return result


_has_plain_indices: bool = False
"""Whether the function that is being compiled has no negative indices; numba compiles one function at a time."""


@functools.cache
def _replace_index_code() -> None:
    """Let numba ask `_has_plain_indices` before it writes the test for negative indices."""
    import numba.np.arrayobj  # only if a function must be compiled, see `_Cache.load_overload`

    numba_code = numba.np.arrayobj.fix_integer_index

    def code(context: Any, builder: Any, kind: Any, index: Any, size: Any) -> Any:
        if _has_plain_indices:
            return context.cast(builder, index, kind, types.intp)
        return numba_code(context, builder, kind, index, size)

    numba.np.arrayobj.fix_integer_index = code


@contextlib.contextmanager
def _without_negative_indices(function: Callable[..., Any]) -> Iterator[None]:
    """Compile indices of a kernel of the search as they are: none of them counts from the end of an array.

    numba adds the size of the array to a negative index. In the kernels of the search, whose indices are stored in
    arrays, this test took a tenth of the time (ADR 0101). Other functions are compiled as numba does it.
    """
    global _has_plain_indices
    _replace_index_code()
    before, _has_plain_indices = _has_plain_indices, function.__module__.partition(".")[0] in WORKER
    try:
        yield
    finally:
        _has_plain_indices = before


class _KernelCompiler(_FunctionCompiler):  # type: ignore[misc]  # numba has no types
    def _compile_core(self, args: Any, return_type: Any) -> Any:
        with _without_negative_indices(self.py_func):
            return super()._compile_core(args, return_type)


class _CalleeCompiler(_KernelCompiler):
    def _customize_flags(self, flags: Any) -> Any:
        flags.no_compile = flags.no_cpython_wrapper = True
        return flags


class _Callee(CPUDispatcher):  # type: ignore[misc]
    """A function for its compiled callers: optimised LLVM code that is linked into them, no machine code of its own."""

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


class _Kernel(CPUDispatcher):  # type: ignore[misc]
    """A function that Python and other kernels can call.

    For calls from other kernels the function is compiled once for each combination of argument types; constants do not
    make a type of their own. The result is not wrapped for Python and not cached, because it becomes part of the
    caller's machine code. Compiling a function for both kinds of calls takes two thirds of the time that numba's own
    dispatcher takes.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        super().__init__(function, targetoptions={**options, "nopython": True})
        self._compiler = _KernelCompiler(
            function, self.targetdescr, self.targetoptions, {}, numba.core.compiler.Compiler
        )
        self._cache = _Cache(function)

    @functools.cached_property
    def _callee(self) -> _Callee:
        """The function for compiled callers; made when one is compiled, not for loaded kernels."""
        return _Callee(self.py_func, self.targetoptions)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return self._callee.get_call_template(tuple(map(types.unliteral, args)), kws)

    def get_overload(self, signature: Any) -> Any:
        return self._callee.get_overload(signature)


class _Locator(_CacheLocator):  # type: ignore[misc]
    """The place of one function's machine code: a file in the folder of its package, named by module and line."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._package, _, self._module = function.__module__.partition(".")
        self._line = function.__code__.co_firstlineno
        self._py_file = file  # numba's warnings name it

    def get_cache_path(self) -> str:
        return str(cache_directory(self._package))

    def get_source_stamp(self) -> str:
        """Return a digest of the source file, for functions that are not in a folder ``kernels``, such as tests."""
        return _digest(self._py_file)

    def get_disambiguator(self) -> str:
        return f"{self._module}-{self._line}"

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> "_Locator":
        return cls(function, file)


@functools.cache
def _digest(file: str) -> str:
    return hashlib.blake2b(Path(file).read_bytes(), digest_size=8).hexdigest()


class _Results(CompileResultCacheImpl):  # type: ignore[misc]
    """What of a compilation is stored: machine code, and the names of its functions.

    Numba also stores the LLVM code, for other functions that are compiled later with calls of this one. Kernels never
    need it (`_Kernel`), and reading it took half of the time of loading.
    """

    _locator_classes = (_Locator,)

    def reduce(self, result: Any) -> Any:
        (name, kind, (machine_code, llvm_code)), *rest = result._reduce()
        return (name, kind, (machine_code, _without_bodies(llvm_code))), *rest


_BODY: Final = re.compile(r"^(define [^\n]*\{)\n.*?^\}", re.MULTILINE | re.DOTALL)
_UNUSED: Final = re.compile(r"^(declare |@[^\n]* = (private|internal) )[^\n]*\n", re.MULTILINE)
"""What only the instructions of a function name: other functions, and constants."""


def _without_bodies(llvm_code: bytes) -> bytes:
    """Return LLVM code with the same functions and public variables, but without the instructions of functions."""
    text = str(_llvm.parse_bitcode(llvm_code))
    declared = _UNUSED.sub("", _BODY.sub(r"\1\n  unreachable\n}", text))
    code: bytes = _llvm.parse_assembly(declared).as_bitcode()
    return code


class _WheelLocator(_Locator):
    """The place of one function's machine code in the installed wheel; the function belongs to a package with some."""

    def get_cache_path(self) -> str:
        kernels = wheel_kernels(self._package)
        assert isinstance(kernels, Kernels)
        return str(kernels.folder)


class _WheelResults(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_WheelLocator,)


class _WheelCache(FunctionCache):  # type: ignore[misc]
    """Machine code of one function that the installed wheel brought for a level of processors; it is only read."""

    _impl_class = _WheelResults

    def __init__(self, function: Callable[..., Any], kernels: Kernels) -> None:
        super().__init__(function)
        self._target = kernels.target

    def _index_key(self, signature: Any, codegen: Any) -> Any:
        arguments, _, code = super()._index_key(signature, codegen)
        return arguments, self._target, code


class _Cache(FunctionCache):  # type: ignore[misc]
    _impl_class = _Results

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        kernels = wheel_kernels(function.__module__.partition(".")[0])
        self._wheel = _WheelCache(function, kernels) if isinstance(kernels, Kernels) else None

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return the cached compilation, None if there is none.

        Machine code needs numba's run-time system only. Numba's knowledge about Python and numpy takes as long to load
        as all kernels, so it is loaded (`refresh`) only if the function must be compiled.
        """
        numba.core.runtime.rtsys.initialize(target)
        with self._guard_against_spurious_io_errors():
            result = None if self._wheel is None else self._wheel._load_overload(signature, target)
            if result is None:
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
