"""Questions about the results of ended jobs, and their answers. Pure.

An answer is a pure function of the stored result, so it need not be stored. The answer is kept in memory while clients
ask for it, and computed again if a client asks later.
"""

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from atoll_core.errors import RefusedError
from atoll_core.wire.messages.clients import AskAnalysis

WANTED_S: Final = 30.0
"""Seconds after which a question that no client repeats is dropped. Waiting clients ask every second, and try for 10 s
when the coordinator does not answer."""

MAX_OPEN: Final = 16
"""Largest number of open questions of one user; each needs a result in memory."""

MAX_KEPT: Final = 64 * 1024**2
"""Largest number of bytes of answers that are kept; the least recently requested answers are dropped first."""

PRIORITY: Final = 10
"""Priority of questions: before all jobs of the same user, because a person waits for the answer."""


@dataclass(slots=True)
class RequestedAnalysis:
    """A requested analysis of a result, with the bytes of its `answer`, or the reason why it `failed`.

    `id` is the id of its task, `submitter` the user who asked first; `submitted_at` and `asked_at`, when it was asked
    last, are in seconds of the bus.
    """

    id: str
    key: str
    job: str
    submitter: str | None
    submitted_at: float
    asked_at: float
    answer: bytes | None = None
    failed: str | None = None
    digest: str = ""
    priority: int = PRIORITY

    @property
    def is_open(self) -> bool:
        """Whether the question has no answer yet and has not failed."""
        return self.answer is None and self.failed is None


def key_of(question: AskAnalysis) -> str:
    """Return the key of a question, the same for all users: results of ended jobs do not change."""
    asked = hashlib.sha256(question.question).hexdigest()
    return "\n".join((question.job, question.function, asked, question.table or ""))


class Analyses:
    """All questions that clients wait for, by the id of their task."""

    def __init__(self) -> None:
        self._by_id: dict[str, RequestedAnalysis] = {}
        self._by_key: dict[str, RequestedAnalysis] = {}

    def __iter__(self) -> Iterator[RequestedAnalysis]:
        return iter(tuple(self._by_id.values()))

    @property
    def open_count(self) -> int:
        """Number of open questions."""
        return sum(analysis.is_open for analysis in self)

    def get(self, task: str) -> RequestedAnalysis | None:
        """Return the question that a task answers."""
        return self._by_id.get(task)

    def ask(self, question: AskAnalysis, now: float) -> RequestedAnalysis | None:
        """Return a question that was asked before, and record that it is repeated; None: it is new."""
        analysis = self._by_key.get(key_of(question))
        if analysis is not None:
            analysis.asked_at = now
        return analysis

    def check(self, user: str | None) -> None:
        """Raise RefusedError if a user has too many open questions."""
        if sum(analysis.is_open and analysis.submitter == user for analysis in self) >= MAX_OPEN:
            raise RefusedError(
                f"{MAX_OPEN} of your questions about results wait for answers; ask again when one has been answered"
            )

    def add(self, analysis: RequestedAnalysis) -> None:
        """Add a new question."""
        self._by_id[analysis.id] = self._by_key[analysis.key] = analysis

    def finish(self, task: str, answer: bytes, digest: str) -> None:
        """Add an answer with its SHA-256; beyond `MAX_KEPT` bytes the least recently requested answers are dropped."""
        self._by_id[task].answer, self._by_id[task].digest = answer, digest
        last, *others = sorted(self, key=lambda analysis: -analysis.asked_at)
        size = len(last.answer or b"")
        for kept in others:
            size += len(kept.answer or b"")
            if size > MAX_KEPT and kept.answer is not None:
                kept.asked_at = -math.inf  # the next `expire` drops it

    def fail(self, task: str, sentence: str) -> None:
        """Record that the task of a question has failed and is not tried again."""
        self._by_id[task].failed = sentence

    def expire(self, now: float) -> list[str]:
        """Forget the questions that no client repeats; return the ids of their tasks."""
        return [self._forget(analysis) for analysis in self if now - analysis.asked_at > WANTED_S]

    def forget_job(self, job: str) -> list[str]:
        """Forget the questions about a job; return the ids of their tasks."""
        return [self._forget(analysis) for analysis in self if analysis.job == job]

    def _forget(self, analysis: RequestedAnalysis) -> str:
        del self._by_id[analysis.id], self._by_key[analysis.key]
        return analysis.id
