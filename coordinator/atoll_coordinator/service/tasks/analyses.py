"""Questions about the results of jobs that have ended: who asks, since when, and what has come of it. Pure.

The answer is a pure function of what is stored, so that nothing of it is: it is kept for as long as somebody asks, and
made again for who comes later.
"""

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from atoll_core.errors import RefusedError
from atoll_core.wire.messages.clients import AskAnalysis

WANTED_S: Final = 30.0
"""Who has not asked again for so long wants the answer no more: clients ask every second, and try for 10 s."""

MAX_OPEN: Final = 16
"""Questions of one user that are open at a time: each holds what it is about in memory."""

MAX_KEPT: Final = 64 * 1024**2
"""Bytes of answers that are kept; beyond, those go that have been asked for least recently."""

PRIORITY: Final = 10
"""A person waits for an answer: among the tasks of one user they come before those of jobs, also of the most urgent."""


@dataclass(slots=True)
class Analysis:
    """A question, and what has come of it: the bytes of the `answer`, or why it `failed`.

    `id` is that of its task, `submitter` who asked first; `submitted_at` and `asked_at`, when it was asked last, are
    the bus's seconds.
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
        """Whether nothing has come of it yet."""
        return self.answer is None and self.failed is None


def key_of(question: AskAnalysis) -> str:
    """Return what names a question, whoever asks it: results of jobs that have ended do not change."""
    asked = hashlib.sha256(question.question).hexdigest()
    return "\n".join((question.job, question.function, asked, question.table or ""))


class Analyses:
    """All questions that somebody wants answered, by the id of their task."""

    def __init__(self) -> None:
        self._by_id: dict[str, Analysis] = {}
        self._by_key: dict[str, Analysis] = {}

    def __iter__(self) -> Iterator[Analysis]:
        return iter(tuple(self._by_id.values()))

    @property
    def open_count(self) -> int:
        """How many have no answer yet."""
        return sum(analysis.is_open for analysis in self)

    def get(self, task: str) -> Analysis | None:
        """Return the question that a task answers."""
        return self._by_id.get(task)

    def ask(self, question: AskAnalysis, now: float) -> Analysis | None:
        """Return a question that was asked before; it is wanted from now on again."""
        analysis = self._by_key.get(key_of(question))
        if analysis is not None:
            analysis.asked_at = now
        return analysis

    def check(self, user: str | None) -> None:
        """Raise RefusedError where a user has asked as much at a time as may be."""
        if sum(analysis.is_open and analysis.submitter == user for analysis in self) >= MAX_OPEN:
            raise RefusedError(f"{MAX_OPEN} of your questions about results wait for answers; ask when one has come")

    def add(self, analysis: Analysis) -> None:
        """Take in a question that is new."""
        self._by_id[analysis.id] = self._by_key[analysis.key] = analysis

    def finish(self, task: str, answer: bytes, digest: str) -> None:
        """Take in an answer with its SHA-256; where too much is kept, those go that were asked for least recently."""
        analysis = self._by_id[task]
        analysis.answer, analysis.digest = answer, digest
        self._drop_beyond(MAX_KEPT)

    def fail(self, task: str, sentence: str) -> None:
        """Take in that a task has failed for good."""
        self._by_id[task].failed = sentence

    def expire(self, now: float) -> list[str]:
        """Forget what nobody wants any more; return the ids of its tasks."""
        return [self._forget(analysis) for analysis in self if now - analysis.asked_at > WANTED_S]

    def forget_job(self, job: str) -> list[str]:
        """Forget the questions about a job; return the ids of their tasks."""
        return [self._forget(analysis) for analysis in self if analysis.job == job]

    def _drop_beyond(self, most: int) -> None:
        """Drop answers beyond so many bytes, but for the one that was asked for last."""
        last, *others = sorted(self, key=lambda analysis: -analysis.asked_at)
        size = len(last.answer or b"")
        for kept in others:
            size += len(kept.answer or b"")
            if size > most and kept.answer is not None:
                kept.asked_at = -math.inf  # the next `expire` takes it

    def _forget(self, analysis: Analysis) -> str:
        del self._by_id[analysis.id], self._by_key[analysis.key]
        return analysis.id
