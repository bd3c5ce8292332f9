"""Batches of work that may be computed on any machine: named pure functions of a context and of items.

A `BatchFunction` is computed by threads of this process, from values as they are, or in batches by whoever takes them
(`Batches`), from bytes: the same values come of it, to the bit, wherever and in which order batches are computed, and
however often. Items are the fixed parts: what comes of one depends on it and the context alone, not on its batch.
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
Made = TypeVar("Made")

FUNCTIONS: Final[dict[str, Callable[[bytes, bytes], bytes]]] = {}
"""By name, what is computed of a context and a batch of items, all as bytes. Complete once `pipeline` is imported."""

CANCELLED: Final = b""
"""What stands for a batch that was not computed since its time was over; no batch is computed to nothing."""

_BATCHES_OF_A_WORKER: Final = 2
"""In a call, so that one that takes longer than the others keeps nobody waiting for long."""
_CONTEXTS: Final = 8
"""Contexts that are kept as they were built: the comparisons of all states of a system, and that of the whole."""
_CALLERS: Final = 16
"""Calls whose own work, beside batches, goes on at the same time: it takes turns, since Python computes one at a time;
with more there is always one whose batches others can take."""


class Batches(Protocol):
    """Has batches computed. Several threads may call `map` at the same time."""

    @property
    def workers(self) -> int:
        """How many take batches beside this process, about; 0: values need not become bytes."""
        ...

    @property
    def threads(self) -> int:
        """How many threads this process may use by itself; the same comes of any number."""
        ...

    def map(
        self, function: str, context: bytes, items: Sequence[bytes], cancel_after: float | None = None
    ) -> list[bytes]:
        """Return ``FUNCTIONS[function](context, item)`` of each item, in order, wherever it is computed.

        Args:
            function: a name in `FUNCTIONS`.
            context: the same for all items, and for many calls.
            items: batches.
            cancel_after: seconds from now after which `CANCELLED` stands for what has not come; None: never.
        """
        ...

    def note(self, compared: int) -> None:
        """Take in that so many more candidates have been compared, which people are told."""


class LocalBatches:
    """Computes batches in this process, by threads of an `executor`, whose owner shuts it down."""

    workers: Final = 0

    def __init__(self, executor: Executor) -> None:
        """Compute by the threads of `executor`."""
        self._executor = executor

    def map(
        self, function: str, context: bytes, items: Sequence[bytes], cancel_after: float | None = None
    ) -> list[bytes]:
        """Return what `Batches.map` does; nothing is cancelled."""
        del cancel_after
        return list(self._executor.map(lambda item: FUNCTIONS[function](context, item), items))

    def note(self, compared: int) -> None:
        """Do nothing: nobody is told."""


class BatchFunction(Generic[Context, Item, Made]):
    """A pure function of a context and an item, known by its name wherever Atoll is installed.

    It takes bytes, as `FUNCTIONS` has it: those of a context and of a tuple of items.
    """

    def __init__(
        self, name: str, context: Any, item: Any, made: Any, compute: Callable[[Context, Item], Made],
        build: Callable[[Any], Context] = lambda parts: parts,
    ) -> None:  # fmt: skip
        """Know a function by `name`.

        Args:
            name: nobody else's.
            context: type of what travels of a context.
            item: type of an item.
            made: type of what is computed.
            compute: what it does.
            build: makes a context of what travels of it; once for many batches.
        """
        if name in FUNCTIONS:
            raise LocalProtocolError(f"two functions are called {name!r}")
        self.name: Final = name
        self.context: Final = context
        self._items: Final = tuple[item, ...]
        self._made: Final = tuple[made, ...]
        self._compute: Final = compute
        self._build: Final = build
        FUNCTIONS[name] = self

    def __call__(self, context: bytes, batch: bytes) -> bytes:
        """Return what is made of each item of a batch."""
        built: Context = _built.get(self._build, context, self.context)
        items: tuple[Item, ...] = decode_value(batch, self._items)
        return encode_value(tuple(self._compute(built, item) for item in items), self._made)

    def encoded(self, items: Sequence[Item]) -> bytes:
        """Return a batch of items."""
        return encode_value(tuple(items), self._items)

    def decoded(self, made: bytes) -> tuple[Made, ...]:
        """Return what was made of a batch."""
        return decode_value(made, self._made)

    def here(self, context: Context, item: Item) -> Made:
        """Return what is made of an item."""
        return self._compute(context, item)


class _BuiltContexts:
    """Contexts as they were built of bytes; the last few. Any thread may use it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[Any, bytes], Any] = OrderedDict()

    def get(self, build: Callable[[Any], Any], context: bytes, kind: Any) -> Any:
        """Return what `build` makes of the value of type `kind` in `context`."""
        key = (build, context)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        made = build(decode_value(context, kind))
        with self._lock:
            made = self._kept.setdefault(key, made)
            while len(self._kept) > _CONTEXTS:
                self._kept.popitem(last=False)
            return made


_built: Final = _BuiltContexts()


class Spread:
    """Spreads work: over threads of this process, or in batches over all who take them."""

    def __init__(
        self, batches: Batches | None = None, executor: Executor | None = None, deadline: Deadline | None = None
    ) -> None:
        """Without `batches` that others take, work is done by threads of `executor`; without both one after another.

        After the `deadline` nothing is waited for.
        """
        self._batches = batches
        self._executor = executor
        self._deadline = deadline or Deadline()

    @property
    def is_shared(self) -> bool:
        """Whether others take batches now."""
        return self._batches is not None and self._batches.workers > 0

    def note(self, compared: int) -> None:
        """Take in, from any thread, that so many more candidates have been compared."""
        if self._batches is not None:
            self._batches.note(compared)

    def here(self, function: Callable[[Item], Made], items: Sequence[Item]) -> Iterator[Made]:
        """Yield what a function makes of items, in order, computed by threads of this process."""
        yield from map(function, items) if self._executor is None else self._executor.map(function, items)

    def map(
        self, function: BatchFunction[Context, Item, Made], context: Callable[[], Context], items: Sequence[Item],
        size: int = 1, parts: Callable[[], Any] | None = None,
    ) -> list[Made | None]:  # fmt: skip
        """Return what a function makes of items, elsewhere in batches, here one after another or by threads.

        Args:
            function: is given each item.
            context: gives it as the function takes it here.
            items: one at least goes elsewhere where others take batches.
            size: most items of a batch.
            parts: gives what travels of the context; itself unless given.

        Returns:
            None of items that were not computed elsewhere before the time was over.
        """
        if not self.is_shared or not items:
            built = context()
            return list(self.here(lambda item: function.here(built, item), items))
        return self.share(function, encode_value((parts or context)(), function.context), items, size)

    def share(
        self, function: BatchFunction[Context, Item, Made], context: bytes, items: Sequence[Item], size: int
    ) -> list[Made | None]:
        """Return what `map` does, computed by whoever takes batches, of whom there are some."""
        if self._batches is None or not items:
            return []
        size = self.batch_size(len(items), size)
        groups = [items[first : first + size] for first in range(0, len(items), size)]
        batches = [function.encoded(group) for group in groups]
        made = self._batches.map(function.name, context, batches, self._deadline.left)
        results: list[Made | None] = []
        for group, one in zip(groups, made, strict=True):
            self._deadline.has_cut_short |= one == CANCELLED
            results += [None] * len(group) if one == CANCELLED else function.decoded(one)
        return results

    def batch_size(self, count: int, most: int) -> int:
        """Return into batches of how many items so many fall: two for each worker, of at most so many items.

        What comes of an item does not depend on those beside it, so that the number of workers changes no bit.
        """
        workers = self._batches.workers if self._batches is not None else 1
        return max(1, min(most, -(-count // (_BATCHES_OF_A_WORKER * max(workers, 1)))))

    def branches(self, calls: Sequence[Callable[[], Made]]) -> list[Made]:
        """Return what each call gives: at the same time where others take their batches, else one after another."""
        if not self.is_shared or len(calls) < 2:
            return [call() for call in calls]
        with ThreadPoolExecutor(min(len(calls), _CALLERS)) as callers:
            return list(callers.map(lambda call: call(), calls))


@contextmanager
def spreading(batches: Batches | None, threads: int, deadline: Deadline) -> Iterator[Spread]:
    """Yield what spreads work over `batches`, and over so many threads of this process while the block lasts."""
    with ThreadPoolExecutor(threads) as executor:
        yield Spread(batches, executor, deadline)
