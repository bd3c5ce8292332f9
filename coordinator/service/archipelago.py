"""One archipelago as the coordinator sees it: its collector, its placement, and how far its workers have come. Pure."""

from collections.abc import Callable, Iterable
from typing import Final

from common.errors import RemoteProtocolError
from common.wire.messages import Commit, EpochReport, Holding, Placement, PullReports
from coordinator.service.collector import Collector, Limits, Measure
from coordinator.service.cut import Cut

INTERVAL_EPOCHS: Final = 16
"""Epochs between commits; no island runs ahead of the last commit by more than twice as many."""

MOST_PULLED_EPOCHS: Final = 64


class Archipelago:
    """The islands of one variable of one job."""

    def __init__(
        self, job: str, variable: str, limits: Limits, measure: Measure, check: Callable[[bytes], None]
    ) -> None:
        """`check` raises RemoteProtocolError for bytes that are not a program over this job's inputs."""
        self.job: Final = job
        self.variable: Final = variable
        self.collector: Final = Collector(variable, limits, measure)
        self.placement: Placement | None = None
        self.placed_at = 0.0
        self._check = check
        self._kept_cut: Cut | None = None
        self._commit = 0
        self._latest: list[int] = []

    @property
    def cut(self) -> Cut | None:
        """Where the search ended; None while it goes on."""
        return self._kept_cut or self.collector.cut

    def restore(self, cut: Cut) -> None:
        """Take over a cut that was committed earlier."""
        self._kept_cut = cut

    def place(self, placement: Placement, now: float) -> None:
        """Begin a term, at epoch 0."""
        self.placement, self.placed_at = placement, now
        self._commit = 0
        self._latest = [-1] * len(placement.workers)

    def unplace(self) -> None:
        """Nobody computes it any more."""
        self.placement = None

    def receive(self, worker: str, report: EpochReport, seconds: float) -> bool:
        """Take in a report; return True when at least one more epoch is complete.

        Raises:
            RemoteProtocolError: It is of a term or worker that is not the current one, or holds what cannot be.
            DivergedError: It contradicts an earlier one.
        """
        if self.cut is not None or self.placement is None or report.term < self.placement.term:
            return False
        if report.term > self.placement.term:
            raise RemoteProtocolError(f"worker {worker} reports under term {report.term}, which was never issued")
        self._check_report(worker, report, self.placement)
        advanced = self.collector.receive(worker, report.epoch, report.islands, seconds)
        self._note_latest((each.island for each in report.islands), report.epoch)
        return advanced

    def note_holding(self, worker: str, holding: Holding) -> None:
        """Take in how far a worker says its islands have come."""
        if self.placement is not None:
            self._note_latest(self.placement.islands_of(worker), holding.reported - 1)

    def missing_reports(self, worker: str, holding: Holding) -> PullReports | None:
        """Return the question for reports that a worker sent and that did not come; None when there are none."""
        placement = self.placement
        if placement is None or self.cut is not None or holding.term != placement.term:
            return None
        first = self.collector.first_missing(placement.islands_of(worker), holding.reported)
        if first is None:
            return None
        last = min(holding.reported, first + MOST_PULLED_EPOCHS)
        return PullReports(job=self.job, variable=self.variable, term=placement.term, first=first, last=last)

    def commit_due(self) -> Commit | None:
        """Move the commit to the last multiple of the interval that all islands have reported, if that is further."""
        reached = min(min(self._latest, default=-1), self.collector.progress.epochs - 1)
        commit = reached - reached % INTERVAL_EPOCHS if reached >= 0 else 0
        if commit <= self._commit or self.cut is not None:
            return None
        self._commit = commit
        return self.commit()

    def commit(self) -> Commit | None:
        """Return the current commit, for a worker that does not know it yet."""
        if self.placement is None:
            return None
        return Commit(job=self.job, variable=self.variable, term=self.placement.term, epoch=self._commit)

    def validate(self) -> None:
        """Check the invariants; raises AssertionError."""
        self.collector.validate()
        assert self._commit <= max(self.collector.progress.epochs, 0), "the commit is ahead of the reports"

    def _note_latest(self, islands: Iterable[int], epoch: int) -> None:
        for island in islands:
            self._latest[island] = max(self._latest[island], epoch)

    def _check_report(self, worker: str, report: EpochReport, placement: Placement) -> None:
        islands = [each.island for each in report.islands]
        if len(set(islands)) < len(islands) or not set(islands) <= set(placement.islands_of(worker)):
            raise RemoteProtocolError(f"worker {worker} reported islands {islands}, which are not placed there")
        for each in report.islands:
            for addition in (*each.additions, *each.runners_up):
                self._check(addition.program)
