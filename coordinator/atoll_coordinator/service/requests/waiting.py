"""Questions of clients that wait for their turn, or for the result of a job that is being composed. Pure.

The loop answers one question at a time and handles other events in between; users take turns (`atoll_core.wire.bus`),
so that no burst of questions delays a heartbeat, a report or another user for longer than one answer takes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from atoll_core.wire.bus.queues import Bounds
from atoll_core.wire.messages.clients import Failure, JobStatus

QUESTIONS: Final = Bounds(
    of_client=32,  # our programs ask one question after the other; a client whose question is refused asks again
    of_party=512,  # an eighth of all
    of_all=4096,  # at 5 ms each, twice as long as a client waits (10 s)
    bytes_of_party=64 * 1024**2,  # sixteen chunks of tables
    bytes_of_all=256 * 1024**2,
)
"""Questions that may wait for their turn, of one client, of one user and of all."""

MAX_DEFERRED: Final = 512
"""Questions that may wait for results at a time, of all clients; further ones are refused, and asked again."""

PATIENCE_S: Final = 2.5
"""How long a cancellation waits before it is answered by the status of the job: a client asks again after 3.3 s."""

T = TypeVar("T")


class NotYetError(Exception):
    """A question can be answered when the result of a `job` has been composed: the final one, or the best so far.

    `meanwhile` returns the answer for a question whose wait is over; None: it still waits.
    """

    def __init__(
        self, job: str, *, is_final: bool, meanwhile: Callable[[], JobStatus | Failure] | None = None
    ) -> None:  # fmt: skip
        super().__init__(job)
        self.key: Final = job, is_final
        self.meanwhile: Final = meanwhile


@dataclass(frozen=True, slots=True, eq=False)
class Deferred(Generic[T]):
    """A question that waits, until `end` (seconds of the bus) if it has an answer `meanwhile`."""

    question: T
    end: float
    meanwhile: Callable[[], JobStatus | Failure] | None


class DeferredQuestions(Generic[T]):
    """All waiting questions, by job and whether they wait for its final result, in the order in which they came."""

    def __init__(self) -> None:
        self._waiting: dict[tuple[str, bool], list[Deferred[T]]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._waiting.values()))

    def add(self, question: T, reason: NotYetError, now: float) -> bool:
        """Let a question wait; return False when too many do."""
        if len(self) >= MAX_DEFERRED:
            return False
        self._waiting.setdefault(reason.key, []).append(Deferred(question, now + PATIENCE_S, reason.meanwhile))
        return True

    def take(self, job: str, *, is_final: bool) -> list[T]:
        """Remove and return the questions that wait for the final result of a job, or for the best so far."""
        return [one.question for one in self._waiting.pop((job, is_final), [])]

    def take_overdue(self, now: float) -> list[Deferred[T]]:
        """Remove and return the questions that have waited long enough and have an answer meanwhile."""
        overdue = [
            one for waiting in self._waiting.values() for one in waiting
            if one.meanwhile is not None and now >= one.end
        ]  # fmt: skip
        if overdue:
            left = {key: [one for one in waiting if one not in overdue] for key, waiting in self._waiting.items()}
            self._waiting = {key: waiting for key, waiting in left.items() if waiting}
        return overdue
