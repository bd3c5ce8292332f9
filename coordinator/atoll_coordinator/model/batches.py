"""Batches of work that may be computed on any machine: named pure functions of a context and of items.

A `BatchFunction` is computed by threads of this process, from values as they are, or as bytes in batches by any worker
that pulls them (`Batches`). The results are equal to the bit, wherever and in which order batches are computed, and
however often: the result of an item depends on the item and the context alone, not on its batch. Work is divided on one
level only, into whole fits, searches of laws, folds and the like; no function computes a part of a fit (ADR 0078).
"""

import threading
from collections import OrderedDict
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
"""Batch functions by name, of the bytes of a context and of a batch. Complete once `pipeline` is imported."""

CANCELLED: Final = b""
"""Stands for a batch that was not computed since its time was over; no result of a batch is empty."""

_BATCHES_OF_A_WORKER: Final = 2
"""In a call, so that a batch that takes longer than the others delays the call by little."""
_CONTEXTS: Final = 8
"""Contexts that are kept as they were built: the comparisons of all states of a system, and the one of the whole."""
_CALLERS: Final = 16
"""Calls whose own work, besides batches, goes on at the same time: it takes turns, since Python computes one at a time;
with more there is always one with batches for other workers."""


class Batches(Protocol):
    """Has batches computed. Several threads may call `map` at the same time."""

    @property
    def workers(self) -> int:
        """About the number of other workers that pull batches; 0: values need not become bytes."""
        ...

    @property
    def threads(self) -> int:
        """Number of threads that this process may use; results do not depend on it."""
        ...

    def map(
        self, function: str, context: bytes, items: Sequence[bytes], cancel_after: float | None = None
    ) -> list[bytes]:
        """Return ``FUNCTIONS[function](context, item)`` of each item, in order, wherever it is computed.

        Args:
            function: a name in `FUNCTIONS`.
            context: the same for all items, and for many calls.
            items: batches.
            cancel_after: seconds from now after which `CANCELLED` stands for results that are missing; None: never.
        """
        ...

    def note(self, compared: int) -> None:
        """Report that so many more candidates have been compared."""


class BatchFunction(Generic[Context, Item, Outcome]):
    """A pure function of a context and an item, known by its name wherever Atoll is installed.

    Called with bytes, as in `FUNCTIONS`, it takes a context and a batch of items.
    """

    def __init__(
        self, name: str, context: Any, item: Any, outcome: Any, compute: Callable[[Context, Item], Outcome],
        build: Callable[[Any], Context] = lambda parts: parts,
    ) -> None:  # fmt: skip
        """Register a function.

        Args:
            name: no other function has it.
            context: type of the parts of a context that travel.
            item: type of an item.
            outcome: type of a result.
            compute: the function.
            build: makes a context of its parts; once for many batches.
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

    def encoded(self, items: Sequence[Item]) -> bytes:
        """Return a batch of items."""
        return encode_value(tuple(items), self._items)

    def decoded(self, outcomes: bytes) -> tuple[Outcome, ...]:
        """Return the results of a batch."""
        return decode_value(outcomes, self._outcomes)


class _BuiltContexts:
    """The last contexts that were built of bytes. Any thread may use it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[Any, bytes], Any] = OrderedDict()

    def get(self, build: Callable[[Any], Any], context: bytes, kind: Any) -> Any:
        """Return the context that `build` makes of a value of type `kind`, given its bytes."""
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
    """Spreads work over threads of this process, or in batches over all workers that pull them."""

    def __init__(
        self, batches: Batches | None = None, executor: Executor | None = None, deadline: Deadline | None = None
    ) -> None:
        """Without `batches`, work is done by threads of `executor`; without both one item after another.

        After the `deadline` no result is waited for.
        """
        self._batches = batches
        self._executor = executor
        self._deadline = deadline or Deadline()

    @property
    def is_shared(self) -> bool:
        """Whether workers pull batches now."""
        return self._batches is not None and self._batches.workers > 0

    def note(self, compared: int) -> None:
        """Report, from any thread, that so many more candidates have been compared."""
        if self._batches is not None:
            self._batches.note(compared)

    def here(self, function: Callable[[Item], Outcome], items: Sequence[Item]) -> Iterator[Outcome]:
        """Yield the results of items, in order, computed by threads of this process."""
        yield from map(function, items) if self._executor is None else self._executor.map(function, items)

    def map(
        self, function: BatchFunction[Context, Item, Outcome], context: Callable[[], Context], items: Sequence[Item],
        size: int = 1, parts: Callable[[], Any] | None = None,
    ) -> list[Outcome | None]:  # fmt: skip
        """Return the results of items, computed in batches by other workers if there are any, else here.

        Args:
            function: is given each item.
            context: gives it as the function takes it here.
            items: even a single one goes elsewhere where workers pull batches.
            size: most items of a batch.
            parts: gives the parts of the context that travel; the context itself unless given.

        Returns:
            None for items that were not computed elsewhere before the time was over.
        """
        if not self.is_shared or not items:
            built = context()
            return list(self.here(lambda item: function.compute(built, item), items))
        return self.share(function, encode_value((parts or context)(), function.context), items, size)

    def share(
        self, function: BatchFunction[Context, Item, Outcome], context: bytes, items: Sequence[Item], size: int
    ) -> list[Outcome | None]:
        """Return the results of `map` where workers pull batches, given the bytes of the context."""
        if self._batches is None or not items:
            return []
        size = self.batch_size(len(items), size)
        groups = [items[first : first + size] for first in range(0, len(items), size)]
        batches = [function.encoded(group) for group in groups]
        outcomes = self._batches.map(function.name, context, batches, self._deadline.left)
        results: list[Outcome | None] = []
        for group, one in zip(groups, outcomes, strict=True):
            self._deadline.has_cut_short |= one == CANCELLED
            results += [None] * len(group) if one == CANCELLED else function.decoded(one)
        return results

    def batch_size(self, count: int, most: int) -> int:
        """Return the size of batches for this many items: two batches for each worker, of at most so many items.

        The result of an item does not depend on the others of its batch, so that the number of workers changes no bit.
        """
        workers = self._batches.workers if self._batches is not None else 1
        return max(1, min(most, -(-count // (_BATCHES_OF_A_WORKER * max(workers, 1)))))

    def branches(self, calls: Sequence[Callable[[], Outcome]]) -> list[Outcome]:
        """Return the result of each call: at the same time where workers pull their batches, else one after another."""
        if not self.is_shared or len(calls) < 2:
            return [call() for call in calls]
        with ThreadPoolExecutor(min(len(calls), _CALLERS)) as callers:
            return list(callers.map(lambda call: call(), calls))


@contextmanager
def spreading(batches: Batches | None, threads: int, deadline: Deadline) -> Iterator[Spread]:
    """Yield a `Spread` over `batches` and this many threads of this process while the block lasts."""
    with ThreadPoolExecutor(threads) as executor:
        yield Spread(batches, executor, deadline)
