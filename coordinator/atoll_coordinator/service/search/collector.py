"""Collects the reports of one archipelago, merges front and runners-up and finds its end. Pure: no clock, no I/O.

Epochs are merged in order, each once, when every island has reported all slices of the epoch that count. Decisions
depend on epoch numbers and never on arrival times. So the result depends only on the contents of the reports, and not
on their order, or on slices after the cut.

Which slices of an epoch count depends on its first hit, in the commit order (`atoll_core.search.commit_order`). A later
report may contain an earlier hit, so the first hit is found again among the reports of an epoch whenever it is needed.
*Doubts.* The collector checks that reports are complete and do not contradict each other. It trusts their errors and
programs, which only a worker has computed.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Final

from atoll_coordinator.service.search.ending import Cut, Improvement, IslandConvergence, SearchLimits, Why, end_of
from atoll_core.errors import AtollError, RemoteProtocolError
from atoll_core.search.commit_order import Position
from atoll_core.search.pareto import FrontEntry, merge, runners_up
from atoll_core.wire.messages.epochs import Addition, IslandReport

IMPROVEMENT_NATS: Final = 1.0
"""A front counts as improved when its least description length falls by at least this number of nats."""

Measure = Callable[[tuple[FrontEntry, ...]], float]
"""Least description length of a front, in nats; infinity for an empty front."""


class DivergedError(AtollError):
    """Raised when workers report different states of the same island and generation: epochs are pure functions."""


@dataclass(slots=True)
class _Filed:
    """One report: its first sender, its last generation, and, until its epoch is merged, the whole report."""

    worker: str
    generations: int
    is_hit: bool
    digest: str
    report: IslandReport | None

    def contradicts(self, report: IslandReport) -> bool:
        """Return whether this report contradicts another report of the same island and epoch."""
        if self.generations == report.generations:
            return (self.is_hit, self.digest) != (report.hit is not None, report.digest)
        # An island stops when it meets the target, so the report with fewer generations cannot contain a hit.
        return self.is_hit if self.generations < report.generations else report.hit is not None


@dataclass(slots=True)
class SearchState:
    """The state of an archipelago after its first `epochs` epochs, which all islands have reported.

    `counted` are the cumulative point evaluations of each island, `evaluations` their sums over islands, both by part.
    `convergence` are the improvements of each island. `best_length` is in nats; the front last improved in epoch
    `improved_at`; `seconds` have passed since the search began.
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

    def __init__(self, variable: str, limits: SearchLimits, measure: Measure) -> None:
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
        """Add a worker's reports of one epoch; return True when at least one more epoch is complete.

        `seconds` have passed since the search began.

        Raises:
            DivergedError: A report differs from an earlier report.
            RemoteProtocolError: There is no such epoch or island; the state has not changed.
        """
        if self.cut is not None:
            return False
        reports = tuple(reports)
        for report in reports:
            self._check(worker, epoch, report)
        for report in reports:
            key, is_hit = (epoch, report.island), report.hit is not None
            if key in self._filed:
                self.duplicates += 1
                continue
            self._filed[key] = _Filed(worker, report.generations, is_hit, report.digest, report)
            if is_hit:
                self._with_hit.add(epoch)
            elif report.generations == self.limits.commit_order.generations:
                self._whole[epoch] += 1
        before = self.state.epochs
        if epoch != before:
            return False
        while self.cut is None and self._is_complete(self.state.epochs):
            self._merge_epoch(self.state.epochs, seconds)
        return self.state.epochs > before

    def cut_now(self, why: Why) -> None:
        """End the search at the last completely reported epoch; if it is not cancelled, at the first epoch or later."""
        if self.cut is not None:
            return
        if self.state.epochs == 0 and why != "cancelled":
            self._pending = why
            return
        self._end(why)

    def at(self, epochs: int) -> SearchState | None:
        """Return the state after this number of epochs; None: the epoch is not reached, or its state is forgotten."""
        return self._past.get(epochs)

    def forget(self, before: int) -> None:
        """Forget states and reports of earlier epochs."""
        self._past = {epochs: past for epochs, past in self._past.items() if epochs >= before}
        if before <= self.state.epochs:
            self._filed = {key: filed for key, filed in self._filed.items() if key[0] >= before}
            self._whole = Counter({epoch: count for epoch, count in self._whole.items() if epoch >= before})
            self._with_hit = {epoch for epoch in self._with_hit if epoch >= before}

    def resume(self, state: SearchState) -> None:
        """Continue from an earlier state; call it only before the first report."""
        self.state = state

    def first_missing(self, islands: Iterable[int], before: int) -> int | None:
        """Return the first epoch before `before` with a missing report of these islands; None: none is missing."""
        wanted = tuple(islands)
        for epoch in range(self.state.epochs, min(before, self.limits.epochs)):
            if any((epoch, island) not in self._filed for island in wanted):
                return epoch
        return None

    def awaited(self) -> tuple[int, ...]:
        """Return the islands whose reports the next epoch waits for; none once there is a cut."""
        epoch, hit = self.state.epochs, self._hit(self.state.epochs)
        filed = {island: self._filed[epoch, island].generations for _, island in self._keys(epoch)}
        islands = range(self.limits.islands) if self.cut is None else ()
        return tuple(island for island in islands if filed.get(island, 0) < self._needed(hit, island))

    def validate(self) -> None:
        """Check the invariants; raises AssertionError."""
        for (epoch, _), filed in self._filed.items():
            assert (filed.report is None) == (epoch < self.state.epochs), f"epoch {epoch} is merged in part"
        lengths = [(entry.complexity, -entry.error) for entry in self.state.front]
        assert lengths == sorted(lengths), "the front is not in order"
        assert all(entry.epoch < self.state.epochs for entry in self.state.front), (
            "the front has entries of later epochs"
        )

    def _check(self, worker: str, epoch: int, report: IslandReport) -> None:
        if epoch >= self.limits.epochs or report.island >= self.limits.islands:
            raise RemoteProtocolError(
                f"a report of island {report.island} in epoch {epoch} came, but there is no such island or epoch"
            )
        if not self._is_whole(report):
            raise RemoteProtocolError(f"a report of island {report.island} in epoch {epoch} came with slices missing")
        filed = self._filed.get((epoch, report.island))
        if filed is not None and filed.contradicts(report):
            raise DivergedError(
                f"workers {filed.worker} and {worker} computed different states of island {report.island} of "
                f"{self.variable} in epoch {epoch}, which must not happen; one of these machines computes wrongly"
            )

    def _is_whole(self, report: IslandReport) -> bool:
        """Return whether a report has counters for exactly the slices up to its last generation."""
        reached, order = report.generations, self.limits.commit_order
        # A report may claim generation 2**62. Its slices are listed only if it has a counter for each.
        if reached > order.generations or reached // order.stride > len(report.counters):
            return False
        ends = order.ends(reached)
        at_end = report.hit is None or (report.hit.generation == reached and reached in ends)
        return at_end and tuple(counters.generation for counters in report.counters) == ends

    def _is_complete(self, epoch: int) -> bool:
        """Return whether every island has reported the slices of an epoch that count, given the known hits."""
        if epoch not in self._with_hit:
            return self._whole[epoch] == self.limits.islands
        hit = self._hit(epoch)
        for island in range(self.limits.islands):
            filed = self._filed.get((epoch, island))
            if (filed.generations if filed is not None else 0) < self._needed(hit, island):
                return False
        return True

    def _hit(self, epoch: int) -> Position | None:
        """Return the first hit, in the commit order, in the reports so far of an epoch that is not merged."""
        reports = (self._filed[key].report for key in self._keys(epoch))
        hits = (Position(epoch, report.hit.generation, report.island) for report in reports if report and report.hit)
        return min(hits, key=self.limits.commit_order.rank, default=None)

    def _needed(self, hit: Position | None, island: int) -> int:
        """Return how many generations of an epoch count when the target was first met at `hit`."""
        return self.limits.commit_order.generations if hit is None else self.limits.commit_order.needed(hit, island)

    def _keys(self, epoch: int) -> list[tuple[int, int]]:
        """Return the keys of the reports of an epoch that have arrived, by island."""
        return [(epoch, island) for island in range(self.limits.islands) if (epoch, island) in self._filed]

    def _merge_epoch(self, epoch: int, seconds: float) -> None:
        """Merge the slices of a complete epoch that count, then decide whether the search ends."""
        hit = self._hit(epoch)
        counted = [(report, self._needed(hit, report.island)) for report in self._release(epoch)]
        state = self.state
        additions = [entry for report, end in counted for entry in entries_of(epoch, report, report.additions, end)]
        near = [entry for report, end in counted for entry in entries_of(epoch, report, report.runners_up, end)]
        front, before = merge(state.front, additions), (*state.front, *state.runners_up)
        state.runners_up = runners_up(front, (*before, *additions, *near), self.limits.runners_up)
        if front != state.front:
            state.front = front
            length = self._measure(front)
            if length <= state.best_length - IMPROVEMENT_NATS or math.isinf(state.best_length):
                state.best_length, state.improved_at = length, epoch
        for report, end in counted:
            if end > 0:  # the end of a slice
                counters = next(counters for counters in report.counters if counters.generation == end)
                state.counted[report.island] = dict(counters.evaluations)
        state.epochs = epoch + 1
        state.seconds = seconds
        totals = Counter[str]()
        for evaluations in state.counted.values():
            totals.update(evaluations)
        state.evaluations = dict(sorted(totals.items()))
        self._add_improvements(additions)
        self._past[state.epochs] = replace(state, counted=dict(state.counted), convergence=dict(state.convergence))
        why = end_of(self.limits, epoch, state.improved_at, hit, self._pending)
        if why is not None:
            self._end(why, epoch * self.limits.commit_order.generations + hit.generation if hit is not None else None)

    def _add_improvements(self, additions: Iterable[FrontEntry]) -> None:
        """Add the improvements of one epoch; the last improvement in a generation is the best of that generation."""
        convergence = self.state.convergence
        for entry in sorted(additions, key=lambda addition: (addition.generation, -addition.error)):
            before = convergence.get(entry.island, ())
            if math.isfinite(entry.error) and (not before or entry.error < before[-1].error):
                generation = entry.epoch * self.limits.commit_order.generations + entry.generation
                convergence[entry.island] = (*before, Improvement(generation=generation, error=entry.error))

    def _release(self, epoch: int) -> list[IslandReport]:
        """Return the reports of an epoch, by island, and keep only the fields needed for comparison."""
        reports = []
        for key in self._keys(epoch):
            filed = self._filed[key]
            assert filed.report is not None
            reports.append(filed.report)
            filed.report = None
        return reports

    def _end(self, why: Why, generation: int | None = None) -> None:
        state = self.state
        self.cut = Cut(
            variable=self.variable,
            epochs=state.epochs,
            generation=generation,
            why=why,
            front=state.front,
            evaluations=state.evaluations,
            seconds=state.seconds,
            runners_up=state.runners_up,
            convergence=IslandConvergence.of(state.convergence),
        )


def entries_of(epoch: int, report: IslandReport, additions: Iterable[Addition], end: int) -> list[FrontEntry]:
    """Return the additions of an island up to generation `end` of an epoch, as entries with epoch and island."""
    return [
        FrontEntry(one.complexity, one.error, one.mse, epoch, one.generation, report.island, one.program)
        for one in additions
        if one.generation <= end
    ]
