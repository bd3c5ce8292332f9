"""Collects the reports of one archipelago, merges its front and finds its end. Pure: no clock, no I/O.

Decisions go by epoch number, never by arrival time: epochs are taken in order, each once, when the reports of all
islands are there. Hence the outcome depends on what was reported and on nothing else.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Final

from common.errors import AtollError, RemoteProtocolError
from common.pareto import FrontEntry, merge
from common.wire.messages import IslandReport
from coordinator.service.cut import Cut, Why, stored

IMPROVEMENT_NATS: Final = 1.0
"""A front is better when its least description length falls by at least this much; polishing of digits is not."""

Measure = Callable[[tuple[FrontEntry, ...]], float]
"""Least description length of a front, in nats; infinity of an empty one."""


class DivergedError(AtollError):
    """Raised when two workers report different states of the same island and epoch, which purity rules out."""


@dataclass(frozen=True, slots=True)
class Limits:
    """When an archipelago ends by itself: epochs at most, epochs without improvement; generations per epoch."""

    islands: int
    epochs: int
    stagnation: int
    generations: int


@dataclass(slots=True)
class _Filed:
    """What is kept of one report: who sent it first, its digest, and, until its epoch is complete, all of it."""

    worker: str
    digest: str
    report: IslandReport | None


@dataclass(slots=True)
class Progress:
    """The archipelago after its `epochs` completely reported epochs."""

    epochs: int = 0
    front: tuple[FrontEntry, ...] = ()
    evaluations: dict[str, int] = field(default_factory=dict)
    best_length: float = math.inf
    improved_at: int = 0
    seconds: float = 0.0


class Collector:
    """Reports of one archipelago, keyed by (epoch, island)."""

    def __init__(self, variable: str, limits: Limits, measure: Measure) -> None:
        self.variable: Final = variable
        self.limits: Final = limits
        self.progress = Progress()
        self.cut: Cut | None = None
        self._measure = measure
        self._filed: dict[tuple[int, int], _Filed] = {}
        self._pending: Why | None = None

    def receive(self, worker: str, epoch: int, reports: Iterable[IslandReport], seconds: float) -> bool:
        """File reports of one epoch; return True when at least one more epoch is complete.

        Args:
            worker: who reports.
            epoch: of all these reports.
            reports: islands not yet reported, or the same again.
            seconds: since the search began.

        Raises:
            DivergedError: A report differs from one filed before.
            RemoteProtocolError: There is no such epoch or island. Nothing has changed.
        """
        if self.cut is not None:
            return False
        reports = tuple(reports)
        for report in reports:
            self._check(worker, epoch, report)
        for report in reports:
            self._filed.setdefault((epoch, report.island), _Filed(worker, report.digest, report))
        before = self.progress.epochs
        while self.cut is None and self._is_complete(self.progress.epochs):
            self._take_in(self.progress.epochs, seconds)
        return self.progress.epochs > before

    def cut_now(self, why: Why) -> None:
        """End at the last completely reported epoch; by time, not before the first one is complete."""
        if self.cut is not None:
            return
        if self.progress.epochs == 0 and why != "cancelled":
            self._pending = why
            return
        self._end(why)

    def first_missing(self, islands: Iterable[int], before: int) -> int | None:
        """Return the first epoch below `before` of which a report of any of these islands is missing; None: of none."""
        wanted = tuple(islands)
        for epoch in range(self.progress.epochs, min(before, self.limits.epochs)):
            if any((epoch, island) not in self._filed for island in wanted):
                return epoch
        return None

    def validate(self) -> None:
        """Check the invariants; raises AssertionError."""
        for (epoch, _), filed in self._filed.items():
            assert (filed.report is None) == (epoch < self.progress.epochs), f"epoch {epoch} is half taken in"
        lengths = [(entry.complexity, -entry.error) for entry in self.progress.front]
        assert lengths == sorted(lengths), "the front is not in order"
        assert all(entry.epoch < self.progress.epochs for entry in self.progress.front), "the front is ahead"

    def _check(self, worker: str, epoch: int, report: IslandReport) -> None:
        if epoch >= self.limits.epochs or report.island >= self.limits.islands:
            raise RemoteProtocolError(f"a report of island {report.island} in epoch {epoch} came; there is none such")
        filed = self._filed.get((epoch, report.island))
        if filed is not None and filed.digest != report.digest:
            raise DivergedError(
                f"workers {filed.worker} and {worker} computed different states of island {report.island} of "
                f"{self.variable} in epoch {epoch}, which must not happen; one of these machines computes wrongly"
            )

    def _is_complete(self, epoch: int) -> bool:
        return all((epoch, island) in self._filed for island in range(self.limits.islands))

    def _take_in(self, epoch: int, seconds: float) -> None:
        """Merge one complete epoch, then ask the rules of ending in their order."""
        reports = self._release(epoch)
        progress = self.progress
        front = merge(progress.front, additions_of(epoch, reports))
        if front != progress.front:
            progress.front = front
            self._note_improvement(epoch)
        progress.epochs = epoch + 1
        progress.seconds = seconds
        progress.evaluations = total_evaluations(reports)
        self._consider_end(epoch, reports)

    def _release(self, epoch: int) -> list[IslandReport]:
        reports = []
        for island in range(self.limits.islands):
            filed = self._filed[epoch, island]
            assert filed.report is not None
            reports.append(filed.report)
            filed.report = None
        return reports

    def _note_improvement(self, epoch: int) -> None:
        length = self._measure(self.progress.front)
        if length <= self.progress.best_length - IMPROVEMENT_NATS or math.isinf(self.progress.best_length):
            self.progress.best_length = length
            self.progress.improved_at = epoch

    def _consider_end(self, epoch: int, reports: list[IslandReport]) -> None:
        hits = [(report.hit.generation, report.island) for report in reports if report.hit is not None]
        if hits:
            self._end("target", epoch * self.limits.generations + min(hits)[0])
        elif epoch - self.progress.improved_at >= self.limits.stagnation:
            self._end("stagnation")
        elif epoch + 1 >= self.limits.epochs:
            self._end("max-epochs")
        elif self._pending is not None:
            self._end(self._pending)

    def _end(self, why: Why, generation: int | None = None) -> None:
        progress = self.progress
        self.cut = Cut(
            variable=self.variable,
            epochs=progress.epochs,
            generation=generation,
            why=why,
            front=tuple(stored(entry) for entry in progress.front),
            evaluations=progress.evaluations,
            seconds=progress.seconds,
        )


def additions_of(epoch: int, reports: Iterable[IslandReport]) -> list[FrontEntry]:
    """Return the additions of one epoch, tagged with epoch, generation and island."""
    return [
        FrontEntry(each.complexity, each.error, each.mse, epoch, each.generation, report.island, each.program)
        for report in reports
        for each in report.additions
    ]


def total_evaluations(reports: Iterable[IslandReport]) -> dict[str, int]:
    """Return the islands' cumulative point evaluations, summed by part, parts in alphabetical order."""
    totals: dict[str, int] = {}
    for report in reports:
        for part, count in report.evaluations.items():
            totals[part] = totals.get(part, 0) + count
    return dict(sorted(totals.items()))
