"""Collects the reports of one archipelago, merges front and runners-up and finds its end. Pure: no clock, no I/O.

Decisions go by epoch number, never by arrival time: epochs are taken in order, each once, when every island has
reported as much of it as counts. Hence the outcome depends on what was reported and on nothing else: not even on how
far an island got beyond the cut.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from atoll_coordinator.service.search.cut import Convergence, Cut, Improvement, stored
from atoll_coordinator.service.search.ending import Limits, Why, end_of
from atoll_core.errors import AtollError, RemoteProtocolError
from atoll_core.search.commit_order import Position
from atoll_core.search.pareto import FrontEntry, merge, runners_up
from atoll_core.wire.messages.epochs import Addition, IslandReport

IMPROVEMENT_NATS: Final = 1.0
"""A front is better when its least description length falls by at least this much; polishing of digits is not."""

Measure = Callable[[tuple[FrontEntry, ...]], float]
"""Least description length of a front, in nats; infinity of an empty one."""


class DivergedError(AtollError):
    """Raised when two workers report different states of the same island and generation, which purity rules out."""


@dataclass(slots=True)
class _Filed:
    """What is kept of one report: who sent it first, how far it goes, and, until its epoch is complete, all of it."""

    worker: str
    generations: int
    is_hit: bool
    digest: str
    report: IslandReport | None

    def contradicts(self, report: IslandReport) -> bool:
        """Tell whether another report of the same island and epoch cannot be true if this one is."""
        if self.generations == report.generations:
            return (self.is_hit, self.digest) != (report.hit is not None, report.digest)
        # an island that meets the target stops there, so the one that got less far cannot have met it
        return self.is_hit if self.generations < report.generations else report.hit is not None


@dataclass(slots=True)
class SearchState:
    """The archipelago after its `epochs` completely reported epochs.

    `counted` are the point evaluations of each island that has any, `evaluations` their sums, both by part.
    `convergence` has, for each island, the generations (counted from the start of the search) in which it found a lower
    error than before, each with that error.
    """

    epochs: int = 0
    front: tuple[FrontEntry, ...] = ()
    runners_up: tuple[FrontEntry, ...] = ()
    evaluations: dict[str, int] = field(default_factory=dict)
    counted: dict[int, dict[str, int]] = field(default_factory=dict)
    convergence: dict[int, tuple[Improvement, ...]] = field(default_factory=dict)
    best_length: float = math.inf
    improved_at: int = 0
    seconds: float = 0.0


class Collector:
    """Reports of one archipelago, keyed by (epoch, island)."""

    def __init__(self, variable: str, limits: Limits, measure: Measure) -> None:
        self.variable: Final = variable
        self.limits: Final = limits
        self.state = SearchState()
        self.cut: Cut | None = None
        self.duplicates = 0
        self._measure = measure
        self._filed: dict[tuple[int, int], _Filed] = {}
        self._whole: Counter[int] = Counter()
        self._with_hit: set[int] = set()
        self._past: dict[int, SearchState] = {}
        self._pending: Why | None = None

    def add_reports(self, worker: str, epoch: int, reports: Iterable[IslandReport], seconds: float) -> bool:
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
            self._file(worker, epoch, report)
        before = self.state.epochs
        if epoch != before:
            return False
        while self.cut is None and self._is_complete(self.state.epochs):
            self._merge_epoch(self.state.epochs, seconds)
        return self.state.epochs > before

    def _file(self, worker: str, epoch: int, report: IslandReport) -> None:
        """Keep a report, the first one of its island and epoch; count, so that not all need be looked through again."""
        if (epoch, report.island) in self._filed:
            self.duplicates += 1
            return
        is_hit = report.hit is not None
        self._filed[epoch, report.island] = _Filed(worker, report.generations, is_hit, report.digest, report)
        if is_hit:
            self._with_hit.add(epoch)
        elif report.generations == self.limits.commit_order.generations:
            self._whole[epoch] += 1

    def cut_now(self, why: Why) -> None:
        """End at the last completely reported epoch; by time, not before the first one is complete."""
        if self.cut is not None:
            return
        if self.state.epochs == 0 and why != "cancelled":
            self._pending = why
            return
        self._end(why)

    def at(self, epochs: int) -> SearchState | None:
        """Return how the archipelago stood after so many epochs; None: not so far yet, or forgotten."""
        return self._past.get(epochs)

    def forget(self, before: int) -> None:
        """Forget how it stood before so many epochs, and what was reported of them: none of it comes again."""
        self._past = {epochs: past for epochs, past in self._past.items() if epochs >= before}
        if before <= self.state.epochs:
            self._filed = {key: filed for key, filed in self._filed.items() if key[0] >= before}
            self._whole = Counter({epoch: count for epoch, count in self._whole.items() if epoch >= before})
            self._with_hit = {epoch for epoch in self._with_hit if epoch >= before}

    def resume(self, state: SearchState) -> None:
        """Go on from where an archipelago stood; only before the first report."""
        self.state = state

    def first_missing(self, islands: Iterable[int], before: int) -> int | None:
        """Return the first epoch below `before` of which a report of any of these islands is missing; None: of none."""
        wanted = tuple(islands)
        for epoch in range(self.state.epochs, min(before, self.limits.epochs)):
            if any((epoch, island) not in self._filed for island in wanted):
                return epoch
        return None

    def awaited(self) -> tuple[int, ...]:
        """Return the islands whose reports the next epoch still waits for; none once there is a cut."""
        epoch, hit = self.state.epochs, self._hit(self.state.epochs)
        filed = {island: self._filed[epoch, island].generations for _, island in self._keys(epoch)}
        islands = range(self.limits.islands) if self.cut is None else ()
        return tuple(island for island in islands if filed.get(island, 0) < self._needed(hit, island))

    def validate(self) -> None:
        """Check the invariants; raises AssertionError."""
        for (epoch, _), filed in self._filed.items():
            assert (filed.report is None) == (epoch < self.state.epochs), f"epoch {epoch} is half taken in"
        lengths = [(entry.complexity, -entry.error) for entry in self.state.front]
        assert lengths == sorted(lengths), "the front is not in order"
        assert all(entry.epoch < self.state.epochs for entry in self.state.front), "the front is ahead"

    def _check(self, worker: str, epoch: int, report: IslandReport) -> None:
        if epoch >= self.limits.epochs or report.island >= self.limits.islands:
            raise RemoteProtocolError(f"a report of island {report.island} in epoch {epoch} came; there is none such")
        if not self._is_whole(report):
            raise RemoteProtocolError(f"a report of island {report.island} in epoch {epoch} came with slices missing")
        filed = self._filed.get((epoch, report.island))
        if filed is not None and filed.contradicts(report):
            raise DivergedError(
                f"workers {filed.worker} and {worker} computed different states of island {report.island} of "
                f"{self.variable} in epoch {epoch}, which must not happen; one of these machines computes wrongly"
            )

    def _is_whole(self, report: IslandReport) -> bool:
        """Tell whether a report has the counters of just those slices that it must have finished."""
        reached, order = report.generations, self.limits.commit_order
        # Ends are listed of no more slices than the report itself lists: it may say that it reached generation 2**62.
        if reached > order.generations or reached // order.stride > len(report.counters):
            return False
        ends = order.ends(reached)
        at_end = report.hit is None or (report.hit.generation == reached and reached in ends)
        return at_end and tuple(counters.generation for counters in report.counters) == ends

    def _is_complete(self, epoch: int) -> bool:
        """Tell whether every island has reported as much of an epoch as counts, by the hits that are known."""
        if epoch not in self._with_hit:
            return self._whole[epoch] == self.limits.islands
        hit = self._hit(epoch)
        for island in range(self.limits.islands):
            filed = self._filed.get((epoch, island))
            if (filed.generations if filed is not None else 0) < self._needed(hit, island):
                return False
        return True

    def _hit(self, epoch: int) -> Position | None:
        """Return where, by the reports that are there, the target was first met in an epoch that is not taken in."""
        reports = (self._filed[key].report for key in self._keys(epoch))
        hits = (Position(epoch, report.hit.generation, report.island) for report in reports if report and report.hit)
        return min(hits, key=self.limits.commit_order.rank, default=None)

    def _needed(self, hit: Position | None, island: int) -> int:
        """Return how many generations of an epoch count when the target was first met there."""
        return self.limits.commit_order.generations if hit is None else self.limits.commit_order.needed(hit, island)

    def _keys(self, epoch: int) -> list[tuple[int, int]]:
        """Return the keys of the reports of an epoch that are there, by island."""
        return [(epoch, island) for island in range(self.limits.islands) if (epoch, island) in self._filed]

    def _merge_epoch(self, epoch: int, seconds: float) -> None:
        """Merge one complete epoch as far as it counts, then ask whether the search ends."""
        hit = self._hit(epoch)
        counted = [(report, self._needed(hit, report.island)) for report in self._release(epoch)]
        state = self.state
        additions = [entry for report_and_end in counted for entry in additions_of(epoch, *report_and_end)]
        near = [entry for report_and_end in counted for entry in runners_up_of(epoch, *report_and_end)]
        front, before = merge(state.front, additions), (*state.front, *state.runners_up)
        state.runners_up = runners_up(front, (*before, *additions, *near), self.limits.runners_up)
        if front != state.front:
            state.front = front
            self._update_best(epoch)
        for report, end in counted:
            if end > 0:
                state.counted[report.island] = evaluations_at(report, end)
        state.epochs = epoch + 1
        state.seconds = seconds
        state.evaluations = total_evaluations(state.counted.values())
        self._follow_convergence(additions)
        self._past[state.epochs] = replace(state, counted=dict(state.counted), convergence=dict(state.convergence))
        self._end_if_due(epoch, hit)

    def _follow_convergence(self, additions: Iterable[FrontEntry]) -> None:
        """Add the improvements of one epoch; of those in one generation the last is the best."""
        convergence = self.state.convergence
        for entry in sorted(additions, key=lambda addition: (addition.generation, -addition.error)):
            before = convergence.get(entry.island, ())
            if math.isfinite(entry.error) and (not before or entry.error < before[-1].error):
                generation = entry.epoch * self.limits.commit_order.generations + entry.generation
                convergence[entry.island] = (*before, Improvement(generation=generation, error=entry.error))

    def _release(self, epoch: int) -> list[IslandReport]:
        """Return the reports of an epoch, by island, and keep no more of them than is needed to compare."""
        reports = []
        for key in self._keys(epoch):
            filed = self._filed[key]
            assert filed.report is not None
            reports.append(filed.report)
            filed.report = None
        return reports

    def _update_best(self, epoch: int) -> None:
        length = self._measure(self.state.front)
        if length <= self.state.best_length - IMPROVEMENT_NATS or math.isinf(self.state.best_length):
            self.state.best_length = length
            self.state.improved_at = epoch

    def _end_if_due(self, epoch: int, hit: Position | None) -> None:
        why = end_of(self.limits, epoch, self.state.improved_at, hit, self._pending)
        if why is not None:
            self._end(why, epoch * self.limits.commit_order.generations + hit.generation if hit is not None else None)

    def _end(self, why: Why, generation: int | None = None) -> None:
        state = self.state
        self.cut = Cut(
            variable=self.variable,
            epochs=state.epochs,
            generation=generation,
            why=why,
            front=tuple(stored(entry) for entry in state.front),
            evaluations=state.evaluations,
            seconds=state.seconds,
            runners_up=tuple(stored(entry) for entry in state.runners_up),
            convergence=Convergence.of(state.convergence),
        )


def additions_of(epoch: int, report: IslandReport, end: int) -> list[FrontEntry]:
    """Return what an island added to the front of one epoch up to generation `end`, tagged with where it was found."""
    return _tagged(epoch, report, report.additions, end)


def runners_up_of(epoch: int, report: IslandReport, end: int) -> list[FrontEntry]:
    """Return what came to be a runner-up of an island in one epoch up to generation `end`, tagged likewise."""
    return _tagged(epoch, report, report.runners_up, end)


def _tagged(epoch: int, report: IslandReport, stated: Iterable[Addition], end: int) -> list[FrontEntry]:
    return [
        FrontEntry(
            addition.complexity,
            addition.error,
            addition.mse,
            epoch,
            addition.generation,
            report.island,
            addition.program,
        )
        for addition in stated
        if addition.generation <= end
    ]


def evaluations_at(report: IslandReport, end: int) -> dict[str, int]:
    """Return the cumulative point evaluations by part of an island at generation `end`, the end of a slice."""
    return next(dict(counters.evaluations) for counters in report.counters if counters.generation == end)


def total_evaluations(islands: Iterable[Mapping[str, int]]) -> dict[str, int]:
    """Return the islands' point evaluations, summed by part, parts in alphabetical order."""
    totals: dict[str, int] = {}
    for evaluations in islands:
        for part, count in evaluations.items():
            totals[part] = totals.get(part, 0) + count
    return dict(sorted(totals.items()))
