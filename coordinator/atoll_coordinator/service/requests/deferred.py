"""Questions of clients that are answered when the result of a job is composed. Pure; time comes in."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from atoll_core.wire.messages.clients import Failure, JobStatus

MAX_DEFERRED: Final = 512
"""Questions that may wait for results at a time, those of all clients together; more are refused, and asked again."""

PATIENCE_S: Final = 2.5
"""So long a cancellation waits before it is told how the job stands: a client asks again after 3.3 s."""

T = TypeVar("T")


class NotYetError(Exception):
    """The answer to a question is there when the result of a `job` is composed: its last one, or as it stands.

    `meanwhile` gives the answer to who does not want to wait, None: everybody waits.
    """

    def __init__(
        self, job: str, *, is_final: bool, meanwhile: Callable[[], JobStatus | Failure] | None = None
    ) -> None:  # fmt: skip
        super().__init__(job)
        self.key: Final = job, is_final
        self.meanwhile: Final = meanwhile


@dataclass(frozen=True, slots=True, eq=False)
class Deferred(Generic[T]):
    """A question that waits, until `end` (the bus's seconds) if it has an answer `meanwhile`."""

    question: T
    end: float
    meanwhile: Callable[[], JobStatus | Failure] | None


class DeferredQuestions(Generic[T]):
    """All questions that wait, by job and whether they wait for its end, in the order in which they came."""

    def __init__(self) -> None:
        self._waiting: dict[tuple[str, bool], list[Deferred[T]]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._waiting.values()))

    def add(self, question: T, reason: NotYetError, now: float) -> bool:
        """Let a question wait; return False where too many do."""
        if len(self) >= MAX_DEFERRED:
            return False
        self._waiting.setdefault(reason.key, []).append(Deferred(question, now + PATIENCE_S, reason.meanwhile))
        return True

    def take(self, job: str, *, is_final: bool) -> list[T]:
        """Return the questions that wait for the last result of a job, or for one as it stands, and forget them."""
        return [one.question for one in self._waiting.pop((job, is_final), [])]

    def take_overdue(self, now: float) -> list[Deferred[T]]:
        """Return the questions that have waited long enough and can be answered meanwhile, and forget them."""
        overdue = [
            one for waiting in self._waiting.values() for one in waiting
            if one.meanwhile is not None and now >= one.end
        ]  # fmt: skip
        if overdue:
            left = {key: [one for one in waiting if one not in overdue] for key, waiting in self._waiting.items()}
            self._waiting = {key: waiting for key, waiting in left.items() if waiting}
        return overdue
