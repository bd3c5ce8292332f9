"""Questions of clients that wait for their turn, or for a result or equations that are being written. Pure.

The loop answers one question at a time and handles other events before the next one; users take turns
(`atoll_core.wire.bus`). Even many questions of one user therefore delay a heartbeat, a report or another user by one
answer at most.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, NamedTuple, TypeVar

from atoll_core.wire.bus.queues import Bounds
from atoll_core.wire.messages.clients import AnswerBody

QUESTIONS: Final = Bounds(
    of_client=32,  # our programs ask one question after another; a client asks again after a refusal
    of_party=512,  # an eighth of all
    of_all=4096,  # answering them takes 20 s (5 ms each), twice the time that a client waits
    bytes_of_party=64 * 1024**2,  # sixteen chunks of tables
    bytes_of_all=256 * 1024**2,
)
"""Questions that may wait for their turn: of one client, of one user, and of all users."""

MAX_DEFERRED: Final = 512
"""Questions of all clients that may wait at a time. Further questions are refused, and clients repeat them; a question
with an answer `meanwhile` gets this answer at once."""

PATIENCE_S: Final = 2.5
"""Seconds after which a cancellation, or a question for views, is answered by the status at that time; a client asks
again after 3.3 s."""

T = TypeVar("T")


class ResultOf(NamedTuple):
    """Awaited: a result of a job is composed, the final one, or the best so far."""

    job: str
    is_final: bool


class FrontOf(NamedTuple):
    """Awaited: the front of this number is written, and so are all earlier ones (`ViewEquations.awaited`)."""

    number: int


Awaited = ResultOf | FrontOf


class NotYetError(Exception):
    """Raised when a question must wait for `awaited`.

    `meanwhile` returns the answer when the question has waited for `PATIENCE_S`; None: it waits without this limit.
    """

    def __init__(self, awaited: Awaited, meanwhile: Callable[[], AnswerBody] | None = None) -> None:
        super().__init__(awaited)
        self.awaited: Final = awaited
        self.meanwhile: Final = meanwhile


@dataclass(frozen=True, slots=True, eq=False)
class Deferred(Generic[T]):
    """A waiting question. If it has an answer `meanwhile`, it waits until `end` (seconds of the bus)."""

    question: T
    end: float
    meanwhile: Callable[[], AnswerBody] | None


class DeferredQuestions(Generic[T]):
    """Waiting questions in the order of arrival, by what they wait for."""

    def __init__(self) -> None:
        self._waiting: dict[Awaited, list[Deferred[T]]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._waiting.values()))

    def add(self, question: T, reason: NotYetError, now: float) -> bool:
        """Let a question wait; return False if too many questions wait."""
        if len(self) >= MAX_DEFERRED:
            return False
        self._waiting.setdefault(reason.awaited, []).append(Deferred(question, now + PATIENCE_S, reason.meanwhile))
        return True

    def take(self, awaited: Awaited) -> list[Deferred[T]]:
        """Remove and return the questions that have waited for `awaited`."""
        return self._waiting.pop(awaited, [])

    def take_overdue(self, now: float) -> list[Deferred[T]]:
        """Remove and return the questions whose wait has ended and which have an answer `meanwhile`."""
        overdue = [
            one for waiting in self._waiting.values() for one in waiting
            if one.meanwhile is not None and now >= one.end
        ]  # fmt: skip
        if overdue:
            left = {key: [one for one in waiting if one not in overdue] for key, waiting in self._waiting.items()}
            self._waiting = {key: waiting for key, waiting in left.items() if waiting}
        return overdue
