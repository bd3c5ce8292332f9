"""Adapts the executors of other libraries. No other module has code about a particular library.

Most libraries have a class with the interface of `concurrent.futures.Executor`. This module finds the number of workers
of such an executor, and makes a new executor when a pool is broken. Ray has another interface; `RayExecutor` adapts it.
"""

import contextlib
import os
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from types import ModuleType
from typing import Any, Final, ParamSpec, TypeVar

from atoll_core.errors import AtollError, RefusedError, UsageError
from atoll_core.machine import usable_cores
from atoll_core.quoting import shown

P = ParamSpec("P")
T = TypeVar("T")

EXPECTED: Final = (
    "executor must be an executor with the interface of concurrent.futures, a function that returns one, a "
    "distributed.Client, or the module ray"
)


class ExecutorError(AtollError):
    """Raised when an executor takes no tasks, or loses them again and again."""


class OtherVersionError(ExecutorError, RefusedError):
    """Raised when a worker of an executor has another version of Atoll than the caller."""


class InlineExecutor(Executor):
    """Computes each task at once, in the thread that submits it."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        """Return a future that is done."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class RayExecutor(Executor):
    """Runs tasks on a Ray cluster, to which the module ``ray`` is connected."""

    def __init__(self, ray: ModuleType) -> None:
        """`ray` is the module; raises UsageError before ``ray.init``."""
        self._ray: Any = ray
        if not self._ray.is_initialized():
            raise UsageError("ray is not connected to a cluster; call ray.init() before")
        self._remote: dict[object, Any] = {}
        self._max_workers = max(1, int(self._ray.cluster_resources().get("CPU", 1)))

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        """Return the future of a call; Ray runs the call again if its worker dies."""
        if fn not in self._remote:
            self._remote[fn] = self._ray.remote(fn)
        future: Future[T] = self._remote[fn].remote(*args, **kwargs).future()
        return future


@dataclass(slots=True, eq=False)
class Adapted:
    """An executor; `make` makes another one if it is broken (None: this is impossible).

    `is_ours`: it is shut down after use. The executors of users are not.
    """

    executor: Executor
    make: Callable[[], Executor] | None = None
    is_ours: bool = False
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def replace(self, broken: Executor) -> None:
        """Replace a `broken` executor, unless another thread has done so; `make` must be known.

        Raises ExecutorError if no executor is made.
        """
        with self._lock:
            if self.executor is broken and self.make is not None:
                try:
                    self.executor = self.make()
                except UsageError as error:  # the executor could be made before
                    raise ExecutorError(str(error)) from error

    def close(self, *, is_done: bool) -> None:
        """Shut down an executor that is ours, and make no other; if calls are not done, its processes are killed."""
        with self._lock:
            self.make = None
        if self.is_ours and is_done:
            # A process pool that is not waited for may print an error of its own when the interpreter ends.
            self.executor.shutdown()
        elif self.is_ours:
            end(self.executor)


def check_executor(given: object) -> None:
    """Raise UsageError if `adapted` does not take this object; a function is not called."""
    if isinstance(given, ModuleType) and given.__name__ == "ray":
        RayExecutor(given)
    elif not (isinstance(given, Executor) or callable(given) or _is_a(given, "distributed.client", "Client")):
        raise UsageError(f"{EXPECTED}; {shown(given)} was given")


def adapted(given: object) -> Adapted:
    """Return an executor for what the user gave.

    Args:
        given: an executor, a function that returns an executor, a ``distributed.Client``, or the module ``ray``.

    Raises:
        UsageError: `given` is none of these.
        ExecutorError: the function raised an error, now or, by `Adapted.make`, later.
    """
    if isinstance(given, ModuleType) and given.__name__ == "ray":
        return Adapted(RayExecutor(given))
    if _is_a(given, "distributed.client", "Client"):
        return Adapted(given.get_executor(pure=False))  # type: ignore[attr-defined]
    if isinstance(given, Executor):
        return Adapted(_forked(given), _maker_of_loky(given))
    if callable(given):
        made = _made_by(given)
        is_ours = _maker_of_loky(made) is None  # loky's is for reuse
        return Adapted(_forked(made), partial(_made_by, given), is_ours=is_ours)
    raise UsageError(f"{EXPECTED}; {shown(given)} was given")


def _made_by(function: Callable[[], object]) -> Executor:
    """Return the executor that a function of the user makes; see `adapted` for the errors."""
    try:
        made = function()
    except AtollError:
        raise
    except Exception as error:
        name = getattr(function, "__name__", None) or shown(function)
        raise ExecutorError(
            f"the function {name} of executor= made no executor, but raised {type(error).__name__}: {error}; correct "
            "the function, or give an executor"
        ) from error
    if not isinstance(made, Executor):
        raise UsageError(f"{EXPECTED}; {shown(made)} was returned by the function")
    return made


def _forked(executor: Executor) -> Executor:
    """Let a pool start its processes now, before this process has threads, in which a fork may find a lock held."""
    if isinstance(executor, ProcessPoolExecutor):
        with contextlib.suppress(RuntimeError):  # a pool that was shut down, or is broken: the first task reports it
            executor.submit(int)
    return executor


def end(executor: Executor) -> None:
    """Shut down an executor without waiting for its calls; the processes of a process pool are killed.

    A task process ends with the process that has started it. Before Python 3.12, a pool fails if a process dies while
    cancelled calls wait, so the pool forgets these calls first.
    """
    pool = isinstance(executor, ProcessPoolExecutor)
    processes = [*(getattr(executor, "_processes", None) or {}).values()] if pool else []
    executor.shutdown(wait=False, **({"cancel_futures": True} if pool else {}))
    for process in processes:
        process.kill()
    for process in processes:
        process.join()


def _is_a(given: object, module: str, name: str) -> bool:
    """Return whether an object is of a class, without importing its module."""
    return any((kind.__module__, kind.__name__) == (module, name) for kind in type(given).__mro__)


def _maker_of_loky(executor: Any) -> Callable[[], Executor] | None:
    """Return the function that makes another reusable executor of loky; None: this is another executor."""
    if not _is_a(executor, "loky.reusable_executor", "_ReusablePoolExecutor"):
        return None
    make = sys.modules["loky"].get_reusable_executor
    return partial(make, max_workers=executor._max_workers, timeout=executor._timeout)


def workers_of(executor: Any) -> int:
    """Return the number of tasks that an executor runs at the same time; if it is unknown, the number of cores here."""
    client = getattr(executor, "_client", None)
    if client is not None:  # Dask
        return max(1, int(sum(client.nthreads().values())))
    number = getattr(executor, "_max_workers", None)  # concurrent.futures, loky, mpi4py
    return number if isinstance(number, int) and number > 0 else usable_cores(os.environ)[0]
