"""Batches of work that any machine may compute: items of a named pure function, which share a context.

How it works. A `BatchFunction` has a name, a context (the data that all items share) and items. `Spread.map` computes
the results of items: threads of this process take the values directly; with workers, context and items are encoded as
bytes, and any worker that pulls a batch (`Batches`) decodes and computes it. A worker keeps the last contexts that it
has built. The result of an item depends on the item and the context alone. So results are equal to the bit: it does not
matter which machine computes a batch, in which order, or how often. Batches are whole fits, searches of laws, or folds;
no batch is a part of a fit. Parts of a fit are integrated by threads of one process (`Spread.divide`), since one
integration gives megabytes of sensitivities, which would have to be sent (ADR 0078).

Doubts. The batch size follows from the numbers of workers and items, and not from the seconds that an item takes. So
one slow item can delay a whole call.
"""

import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Final, Generic, Protocol, TypeVar

from atoll_coordinator.model.deadline import Deadline
from atoll_core.errors import LocalProtocolError
from atoll_core.wire.values import decode_value, encode_value

Context = TypeVar("Context")
Item = TypeVar("Item")
Outcome = TypeVar("Outcome")

FUNCTIONS: Final[dict[str, Callable[[bytes, bytes], bytes]]] = {}
"""Batch functions by name; each takes the bytes of a context and of a batch. A function is registered
by its module; see `atoll.tasks.process` for the modules."""

CANCELLED: Final = b""
"""The result of a batch that was not computed before the deadline: empty bytes. No other result is empty."""

_BATCHES_OF_A_WORKER: Final = 2
"""Batches for each worker in one call. With two, a slow batch delays the call by less than with one."""
_CONTEXTS: Final = 8
"""Number of built contexts that are kept. In many jobs this is enough for one comparison for each state and one for the
whole system."""
_CALLERS: Final = 16
"""Most calls that run at the same time. The Python interpreter executes only one call at a time, but with several calls
there are always batches for the workers."""


class Batches(Protocol):
    """Computes batches, here or on workers. Several threads may call `map` at the same time."""

    @property
    def workers(self) -> int:
        """The approximate number of workers that pull batches. If it is 0, values are not encoded."""
        ...

    @property
    def threads(self) -> int:
        """Number of threads that this process may use; results do not depend on it."""
        ...

    def map(
        self, function: str, context: bytes, items: Sequence[bytes], cancel_after: float | None = None
    ) -> list[bytes]:
        """Return ``FUNCTIONS[function](context, item)`` of each item, in order.

        Args:
            function: a name in `FUNCTIONS`.
            context: bytes of the context, which many calls share.
            items: bytes of each batch.
            cancel_after: number of seconds from now; results that are missing then are `CANCELLED`. None: no limit.
        """
        ...

    def note(self, compared: int) -> None:
        """Report the number of newly `compared` candidates."""


class BatchFunction(Generic[Context, Item, Outcome]):
    """A pure function of a context and an item, known by the same name on every machine.

    As an entry of `FUNCTIONS` it takes the bytes of a context and of a batch of items.
    """

    def __init__(
        self, name: str, context: Any, item: Any, outcome: Any, compute: Callable[[Context, Item], Outcome],
        build: Callable[[Any], Context] = lambda parts: parts,
    ) -> None:  # fmt: skip
        """Register a function.

        Args:
            name: must be unique.
            context: type of the parts of a context that are sent.
            item: type of an item.
            outcome: type of a result.
            compute: the function.
            build: builds a context from its parts, once for many batches.
        """
        if name in FUNCTIONS:
            raise LocalProtocolError(f"two functions are called {name!r}")
        self.name: Final = name
        self.context: Final = context
        self.compute: Final = compute
        self._items: Final = tuple[item, ...]
        self._outcomes: Final = tuple[outcome, ...]
        self._build: Final = build
        FUNCTIONS[name] = self

    def __call__(self, context: bytes, batch: bytes) -> bytes:
        """Return the results of the items of a batch."""
        built: Context = _built.get(self._build, context, self.context)
        items: tuple[Item, ...] = decode_value(batch, self._items)
        return encode_value(tuple(self.compute(built, item) for item in items), self._outcomes)

    def encode(self, items: Sequence[Item]) -> bytes:
        """Return a batch of items."""
        return encode_value(tuple(items), self._items)

    def decode(self, outcomes: bytes) -> tuple[Outcome, ...]:
        """Return the results of a batch."""
        return decode_value(outcomes, self._outcomes)


class _BuiltContexts:
    """A cache of the last contexts that were built from bytes. Safe for threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[Any, bytes], Any] = OrderedDict()

    def get(self, build: Callable[[Any], Any], context: bytes, kind: Any) -> Any:
        """Return the context that `build` makes from a value of type `kind`; the bytes in `context` are this value,
        encoded."""
        key = (build, context)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        built = build(decode_value(context, kind))
        with self._lock:
            built = self._kept.setdefault(key, built)
            while len(self._kept) > _CONTEXTS:
                self._kept.popitem(last=False)
            return built


_built: Final = _BuiltContexts()


class Spread:
    """Distributes work over threads of this process, or in batches over all workers that pull them."""

    def __init__(
        self, batches: Batches | None = None, executor: Executor | None = None, deadline: Deadline | None = None,
        threads: int = 1,
    ) -> None:  # fmt: skip
        """Without `batches`, the `threads` threads of `executor` do the work. Without both, items are computed one
        after another.

        Results that are missing at the `deadline` are None.
        """
        self._batches = batches
        self._executor = executor
        self._deadline = deadline or Deadline()
        self.threads: Final = threads

    @property
    def is_shared(self) -> bool:
        """Whether workers pull batches now."""
        return self._batches is not None and self._batches.workers > 0

    def note(self, compared: int) -> None:
        """Report the number of newly `compared` candidates; safe for threads."""
        if self._batches is not None:
            self._batches.note(compared)

    def map_threads(self, function: Callable[[Item], Outcome], items: Sequence[Item]) -> Iterator[Outcome]:
        """Yield the results of items, in order, computed by threads of this process."""
        yield from map(function, items) if self._executor is None else self._executor.map(function, items)

    def divide(self, function: Callable[[Item], Outcome], parts: Sequence[Item]) -> list[Outcome]:
        """Return the results of the parts of one computation, in order.

        This thread and idle threads of this process take one part after another. This thread never waits for a thread
        that does other work: it computes the parts that no other thread has taken. So a part may be divided again, and
        a thread of the pool may divide its own work.
        """
        waiting, results = deque(enumerate(parts)), dict[int, Outcome]()

        def compute() -> None:
            while waiting:
                try:
                    place, part = waiting.popleft()
                except IndexError:  # another thread has taken the last part
                    return
                results[place] = function(part)

        helpers = min(self.threads, len(parts)) - 1 if self._executor is not None else 0
        others = [self._executor.submit(compute) for _ in range(helpers)] if self._executor is not None else []
        compute()
        for other in others:
            if not other.cancel():
                other.result()
        return [results[place] for place in range(len(parts))]

    def map(
        self, function: BatchFunction[Context, Item, Outcome], context: Callable[[], Context], items: Sequence[Item],
        size: int = 1, parts: Callable[[], Any] | None = None, *, is_long: bool = False,
    ) -> list[Outcome | None]:  # fmt: skip
        """Return the results of items. Workers compute them in batches; without workers, this process computes them.

        Args:
            function: computes an item.
            context: returns the context for this process.
            items: the items; with workers, even a single item is sent.
            size: most items of a batch.
            parts: returns the parts of the context that are sent; by default the context itself.
            is_long: whether the items take seconds. Then batches are offered even if no worker pulls them at the
                beginning, since a worker may come during the call.

        Returns:
            None for items that no worker has computed before the deadline.
        """
        if not (self.is_shared or (is_long and self._batches is not None)) or not items:
            built = context()
            return list(self.map_threads(lambda item: function.compute(built, item), items))
        return self.map_workers(function, encode_value((parts or context)(), function.context), items, size)

    def map_workers(
        self, function: BatchFunction[Context, Item, Outcome], context: bytes, items: Sequence[Item], size: int
    ) -> list[Outcome | None]:
        """Return the results of items, which workers compute with an encoded context; see `map`."""
        if self._batches is None or not items:
            return []
        size = self.batch_size(len(items), size)
        groups = [items[first : first + size] for first in range(0, len(items), size)]
        batches = [function.encode(group) for group in groups]
        outcomes = self._batches.map(function.name, context, batches, self._deadline.seconds_left)
        results: list[Outcome | None] = []
        for group, one in zip(groups, outcomes, strict=True):
            self._deadline.has_cut_short |= one == CANCELLED
            results += [None] * len(group) if one == CANCELLED else function.decode(one)
        return results

    def batch_size(self, count: int, most: int) -> int:
        """Return the number of items in a batch: there are two batches for each worker, and a batch has at most `most`
        items.

        Results do not depend on the batch size, since the result of an item does not depend on the other items of its
        batch.
        """
        workers = self._batches.workers if self._batches is not None else 1
        return max(1, min(most, -(-count // (_BATCHES_OF_A_WORKER * max(workers, 1)))))

    def run_calls(self, calls: Sequence[Callable[[], Outcome]]) -> list[Outcome]:
        """Return the result of each call. With workers the calls run at the same time; without workers they run one
        after another."""
        if not self.is_shared or len(calls) < 2:
            return [call() for call in calls]
        with ThreadPoolExecutor(min(len(calls), _CALLERS)) as callers:
            return list(callers.map(lambda call: call(), calls))


@contextmanager
def spreading(batches: Batches | None, threads: int, deadline: Deadline) -> Iterator[Spread]:
    """Context manager: a `Spread` over `batches` and `threads` threads of this process."""
    with ThreadPoolExecutor(threads) as executor:
        yield Spread(batches, executor, deadline, threads)
