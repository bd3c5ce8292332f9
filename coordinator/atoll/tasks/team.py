"""Batches of a task's work, computed here and by other workers that help.

Each thread that calls `Team.map` computes its items from the front; helpers, who ask through the worker of this
process, get them from the back. What has not come back when nothing else is left is computed here as well: the first
answer counts, and all are equal.
"""

import hashlib
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

from atoll_core.task_frames import Ask, Batch, FromProcess, Give, Progressed
from atoll_core.wire.messages.tasks import MAX_BATCH

HOLD_S: Final = 2.0
"""How long a helper's question waits for a batch before it is told to ask again; below the time limit of questions."""

NOTED_S: Final = 1.0
"""The worker learns at most so often how far a task is: its heartbeat has no use for more."""

LATE: Final = 2.0
"""A batch that a helper has had for so many times the longest that one took here is computed here as well."""

_LOG = logging.getLogger(__name__)


@dataclass(eq=False, slots=True)
class _Call:
    """One call of `Team.map`: its items by place, and how far they are. `first` is the number of its first batch."""

    function: str
    digest: str
    context: bytes
    items: Sequence[bytes]
    first: int
    waiting: deque[int]
    given: dict[int, float] = field(default_factory=dict)
    results: dict[int, bytes] = field(default_factory=dict)
    longest_s: float = 0.0

    @property
    def is_complete(self) -> bool:
        return len(self.results) == len(self.items)


class Team:
    """This process and the helpers of its task: an implementation of `atoll_coordinator.model.batches.Batches`.

    `threads` is how many this process may use by itself.
    """

    def __init__(self, send: Callable[[FromProcess], None], clock: Callable[[], float] = time.monotonic) -> None:
        """`send` hands messages to the worker, from any thread."""
        self.threads = 1
        self._task = ""
        self._here = self._elsewhere = self._compared = 0
        self._noted_at = 0.0
        self._send = send
        self._clock = clock
        self._changed = threading.Condition()
        self._asked: deque[tuple[Ask, float]] = deque()
        self._asked_at: float | None = None
        self._calls: list[_Call] = []
        self._numbers = int.from_bytes(os.urandom(5))  # what is late for another process of this task fits nowhere

    # ----------------------------------------------------------------------------------- the task's threads

    @property
    def workers(self) -> int:
        """How many helpers there are, about; 0: values need not become bytes."""
        if self._asked_at is None or self._clock() - self._asked_at > 2.0 * HOLD_S:
            return 0
        with self._changed:
            return max(1, len(self._asked) + sum(len(call.given) for call in self._calls))

    def begin(self, task: str, threads: int) -> None:
        """Begin a task that may use so many threads."""
        self._task, self.threads = task, threads
        self._here = self._elsewhere = self._compared = 0
        self._noted_at = self._clock()

    def note(self, compared: int) -> None:
        """Take in, from any thread, that so many more candidates have been compared; the worker is told."""
        with self._changed:
            self._compared += compared
            now = self._clock()
            if now - self._noted_at >= NOTED_S:
                self._noted_at = now
                self._send(Progressed(self._task, self._compared))

    @property
    def counts(self) -> dict[str, int]:
        """How many candidates were compared; how many batches of the task were computed here, how many by helpers."""
        return {
            "compared": self._compared, "batches_here": self._here, "batches_elsewhere": self._elsewhere,
        }  # fmt: skip

    def end(self) -> None:
        """End a task: helpers have nothing to wait for."""
        with self._changed:
            self._asked_at = None
            while self._asked:
                self._give(None)

    def map(
        self, function: str, context: bytes, items: Sequence[bytes], cancel_after: float | None = None
    ) -> list[bytes]:
        """See `atoll_coordinator.model.batches.Batches.map`."""
        from atoll_coordinator.model.batches import CANCELLED

        end = None if cancel_after is None else self._clock() + cancel_after
        digest = hashlib.sha256(context).hexdigest()
        with self._changed:
            call = _Call(function, digest, context, items, self._numbers, deque(range(len(items))))
            self._numbers += len(items)
            self._calls.append(call)
            self._serve_waiting()
        try:
            while not call.is_complete and (end is None or self._clock() < end):
                place = self._next(call, end)
                if place is not None:
                    self._compute_here(call, place)
        finally:
            with self._changed:
                self._calls.remove(call)
        return [call.results.get(place, CANCELLED) for place in range(len(items))]

    def _next(self, call: _Call, end: float | None) -> int | None:
        """Return the next item to compute here; None: look again, a helper's answer may have come."""
        with self._changed:
            if call.waiting:
                return call.waiting.popleft()
            out = [(given, place) for place, given in call.given.items()]
            if not out:
                return None
            now = self._clock()
            given, place = min(out)
            due = given + LATE * call.longest_s
            if now < due:
                self._changed.wait((due if end is None else min(due, end)) - now)
                return None
            call.given[place] = now
            return place

    def _compute_here(self, call: _Call, place: int) -> None:
        began = self._clock()
        result = _computed(call.function, call.context, call.items[place])
        with self._changed:
            call.longest_s = max(call.longest_s, self._clock() - began)
            if self._settle(call, place, result):
                self._here += 1

    # ----------------------------------------------------------------------------------- the reading thread

    def ask(self, question: Ask) -> None:
        """Take in that a helper has room for a batch: it gets one now or as soon as there is one."""
        with self._changed:
            self._asked_at = self._clock()
            self._asked.append((question, self._asked_at))
            self._serve_waiting()

    def take(self, number: int, result: bytes | None) -> None:
        """Take in what a helper made of a batch; one that could not be made there is the next that is made here."""
        with self._changed:
            call = next((one for one in self._calls if one.first <= number < one.first + len(one.items)), None)
            if call is None or number - call.first not in call.given:
                return
            place = number - call.first
            if result is None:
                del call.given[place]
                call.waiting.appendleft(place)  # helpers get others, from the back: it may break with each of them
            else:
                self._elsewhere += self._settle(call, place, result)
            self._changed.notify_all()

    def expire(self) -> None:
        """Tell helpers that have waited for long to ask again."""
        now = self._clock()
        with self._changed:
            while self._asked and now - self._asked[0][1] >= HOLD_S:
                self._give(None)

    def _settle(self, call: _Call, place: int, result: bytes) -> bool:
        """Take in a result; return whether it is the first one."""
        is_first = place not in call.results
        call.results.setdefault(place, result)
        call.given.pop(place, None)
        return is_first

    def _serve_waiting(self) -> None:
        while self._asked:
            batch = self._batch(self._asked[0][0])
            if batch is None:
                return
            self._give(batch)

    def _give(self, batch: Batch | None) -> None:
        """Answer the helper that has waited longest."""
        question, _ = self._asked.popleft()
        self._send(Give(question.token, batch))

    def _batch(self, question: Ask) -> Batch | None:
        """Return a batch for a helper: the last of the call that has most waiting; the first is left for its thread."""
        fit = [call for call in self._calls if len(call.waiting) > 1 and _size(call) <= MAX_BATCH]
        if not fit:
            return None
        call = max(fit, key=lambda one: len(one.waiting))
        place = call.waiting.pop()
        call.given[place] = self._clock()
        context = b"" if call.digest in question.contexts else call.context
        return Batch(call.first + place, call.function, call.digest, context, call.items[place])


def _size(call: _Call) -> int:
    return len(call.context) + len(call.items[call.waiting[-1]])


def compute(batch: Batch) -> bytes | None:
    """Return what a batch of another worker's task comes to; None where it breaks here: it is computed there."""
    try:
        return _computed(batch.function, batch.context, batch.item)
    except Exception:
        _LOG.exception("a batch broke")
        return None


def _computed(function: str, context: bytes, item: bytes) -> bytes:
    import atoll_coordinator.model.pipeline  # noqa: F401  # fills the table
    from atoll_coordinator.model.batches import FUNCTIONS

    if function not in FUNCTIONS:
        import atoll.experiments.identifiability  # noqa: F401  # fills it further

    return FUNCTIONS[function](context, item)
