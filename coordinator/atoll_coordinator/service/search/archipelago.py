"""One archipelago as the coordinator sees it: collector, placement, checkpoints, progress of its workers. Pure.

A checkpoint has three stages. Its states are gathered from the workers. When all states have arrived and the reports of
all earlier epochs are merged, the checkpoint is written. When it is durable, `mark_durable` returns the commit that is
published.

A *term* is the number of a placement. A worker of an earlier term may still send reports: they are ignored, because the
workers of the new term compute the same epochs again from the last durable checkpoint, with the same bits. *Doubts.*
The archipelago has many flags (`is_writing`, `is_planned`, `is_at_barrier`) and no table of states, unlike jobs and
workers; `validate` checks which combinations are possible.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from atoll_coordinator.service.search.checkpoint_schedule import (
    FIRST_INTERVAL,
    Gathering,
    StoredSearchState,
    common_epoch,
    interval_of,
    schedule_after,
)
from atoll_coordinator.service.search.collector import Collector, Measure, SearchState
from atoll_coordinator.service.search.ending import Cut, SearchLimits
from atoll_core.errors import RemoteProtocolError
from atoll_core.search.commit_order import Position
from atoll_core.wire.messages.epochs import EpochReport, PullReports, PullStates, States
from atoll_core.wire.messages.views import IslandView
from atoll_core.wire.messages.workers import AssignmentStatus, Commit, Placement, Schedule
from atoll_core.wire.state_pieces import IslandState

FORGET_EPOCHS: Final = 16
"""Epochs after which a commit is sent without a new checkpoint, so that workers may forget messages."""

MOST_PULLED_EPOCHS: Final = 64

PLAN_COMMITS: Final = 10
"""Least number of commits between two planned changes of a placement; the islands of a leaving worker move earlier."""

ArchipelagoKey = tuple[str, str]
"""Job and variable of an archipelago."""


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A complete checkpoint, ready to be written."""

    job: str
    variable: str
    term: int
    epoch: int
    search_state: SearchState
    states: dict[int, IslandState]

    @property
    def key(self) -> ArchipelagoKey:
        """The archipelago."""
        return (self.job, self.variable)

    @property
    def size(self) -> int:
        """Bytes of all states."""
        return sum(len(state.data) for state in self.states.values())

    def stored_search_state(self, search_seconds: float) -> StoredSearchState:
        """Return the progress that is stored with the states of the islands."""
        return StoredSearchState.of(self.search_state, search_seconds)


class Archipelago:
    """The islands of one variable of one job."""

    def __init__(
        self, job: str, variable: str, limits: SearchLimits, measure: Measure, check: Callable[[bytes], None]
    ) -> None:
        """`check` raises RemoteProtocolError for bytes that are not a program over this job's inputs."""
        self.job: Final = job
        self.variable: Final = variable
        self.collector: Final = Collector(variable, limits, measure)
        self.placement: Placement | None = None
        self.placed_at = 0.0
        self.interval = FIRST_INTERVAL
        self.durable = 0
        self.is_writing = False
        self._check = check
        self._kept_cut: Cut | None = None
        self._schedule = Schedule(next=0, last=0)
        self._gathering: Gathering | None = None
        self._snapshots: dict[str, tuple[int, ...]] = {}
        self._islands_of: dict[str, tuple[int, ...]] = {}  # of the present placement, by worker
        self._wants_barrier = False
        self._since_plan = PLAN_COMMITS
        self._durable_at = 0.0
        self._forget = 0
        self._hit: Position | None = None
        self._has_news = False  # a report had an earlier hit, which workers do not know yet
        self._latest: list[int] = []

    @property
    def key(self) -> ArchipelagoKey:
        """Job and variable."""
        return (self.job, self.variable)

    @property
    def workers(self) -> tuple[str, ...]:
        """The workers that have islands of the archipelago, sorted; none without a placement."""
        return tuple(self._islands_of)

    def islands_of(self, worker: str) -> tuple[int, ...]:
        """Return the islands that `worker` computes now."""
        return self._islands_of.get(worker, ())

    def island_views(self) -> list[IslandView]:
        """Return worker and epoch of each island; none before the first placement."""
        workers = self.placement.workers if self.placement is not None else [None] * len(self._latest)
        pairs = enumerate(zip(workers, self._latest, strict=True))
        return [IslandView(variable=self.variable, island=k, worker=w, epoch=max(0, e + 1)) for k, (w, e) in pairs]

    @property
    def cut(self) -> Cut | None:
        """Where the search ended; None while it continues."""
        return self._kept_cut or self.collector.cut

    @property
    def is_at_barrier(self) -> bool:
        """Whether all islands wait for another placement, and their states are durable."""
        return self.placement is not None and self._schedule.holds and self.durable == self._schedule.last

    @property
    def has_no_commit(self) -> bool:
        """Whether no checkpoint has become durable since the archipelago was placed."""
        return self.placement is not None and self.durable == self.placement.epoch

    @property
    def gathered_bytes(self) -> int | None:
        """Bytes of the checkpoint that is being gathered; None: no checkpoint is being gathered."""
        return self._gathering.size if self._gathering is not None else None

    @property
    def has_pulls(self) -> bool:
        """Whether states of the checkpoint that is being gathered are missing and are not being pulled."""
        return self._gathering is not None and bool(self._gathering.unasked)

    @property
    def is_planned(self) -> bool:
        """Whether another placement has been requested."""
        return self._wants_barrier or self._schedule.holds

    @property
    def may_plan(self) -> bool:
        """Whether another placement may be requested although no worker leaves."""
        return self._since_plan >= PLAN_COMMITS and not self.is_planned

    def restore(self, cut: Cut) -> None:
        """Restore a cut that was committed earlier."""
        self._kept_cut = cut

    def resume(self, state: SearchState) -> None:
        """Continue from a checkpoint that was committed earlier."""
        self.collector.resume(state)
        self.durable = state.epochs

    def place(self, placement: Placement, now: float) -> None:
        """Begin a term, at the last checkpoint that is durable."""
        self.placement, self.placed_at = placement, now
        self._islands_of = {worker: placement.islands_of(worker) for worker in sorted(set(placement.workers))}
        self._schedule, self._gathering = placement.schedule, None
        self._snapshots.clear()
        self._wants_barrier = False
        self._durable_at = now
        self._forget = placement.epoch
        self._hit, self._has_news = None, False
        self._latest = [placement.epoch - 1] * len(placement.workers)

    def unplace(self) -> None:
        """End the placement: no worker computes the archipelago after this."""
        self.placement, self._gathering = None, None
        self._islands_of = {}

    def request_barrier(self) -> None:
        """Let all islands wait at the next possible checkpoint; without effect if this was requested before."""
        if not self.is_planned:
            self._wants_barrier = True
            self._since_plan = 0

    # ----------------------------------------------------------------------------------------- reports

    def add_report(self, worker: str, report: EpochReport, seconds: float) -> bool:
        """Add a report; return True when at least one more epoch is complete.

        Raises:
            RemoteProtocolError: Its term is unknown, its islands belong to another worker, or its contents are
                impossible.
            DivergedError: It contradicts an earlier report.
        """
        if self.cut is not None or self.placement is None or report.term < self.placement.term:
            return False
        if report.term > self.placement.term:
            raise RemoteProtocolError(f"worker {worker} reports under term {report.term}, which does not exist")
        if report.epoch < self.placement.epoch:
            raise RemoteProtocolError(f"worker {worker} reports epoch {report.epoch}, before its term began")
        if report.epoch < self.durable:
            return False
        islands = [island_report.island for island_report in report.islands]
        if len(set(islands)) < len(islands) or not set(islands) <= set(self.islands_of(worker)):
            raise RemoteProtocolError(f"worker {worker} reported islands {islands}, which are not placed there")
        for island_report in report.islands:
            for addition in (*island_report.additions, *island_report.runners_up):
                self._check(addition.program)
        advanced = self.collector.add_reports(worker, report.epoch, report.islands, seconds)
        self._update_latest(islands, report.epoch)
        for island_report in report.islands:
            if island_report.hit is not None:
                self._learn_hit(Position(report.epoch, island_report.hit.generation, island_report.island))
        return advanced

    def update_assignment_status(self, worker: str, assignment_status: AssignmentStatus) -> Commit | None:
        """Record the epochs that a worker's islands have reported, its snapshots, and its first hit.

        Return the commit that is due, if any. A commit tells workers which messages they may forget, or at which hit
        they stop.
        """
        if self.placement is None:
            return None
        self._update_latest(self.islands_of(worker), assignment_status.reported - 1)
        self._snapshots[worker] = assignment_status.snapshots
        self._learn_hit(assignment_status.hit)
        return self.due_commit()

    def _learn_hit(self, hit: Position | None) -> None:
        """Record a hit that a worker has told; the next commit is due if it is earlier than the hits before."""
        if self.cut is None and self._is_earlier(hit, self._hit):
            self._hit, self._has_news = hit, True

    def _is_earlier(self, hit: Position | None, other: Position | None) -> bool:
        """Return whether a hit counts before another hit; None: no hit."""
        rank = self.collector.limits.commit_order.rank
        return hit is not None and (other is None or rank(hit) < rank(other))

    def missed_commit(self, assignment_status: AssignmentStatus) -> Commit | None:
        """Return the current commit if a worker does not know it; None: the worker knows it."""
        is_known = assignment_status.commit >= self.durable and not self._is_earlier(self._hit, assignment_status.hit)
        return None if is_known else self.commit()

    def missing_reports(self, worker: str, assignment_status: AssignmentStatus) -> PullReports | None:
        """Return a pull of the reports that a worker sent and that did not arrive; None: no report is missing."""
        placement = self.placement
        if placement is None or self.cut is not None or assignment_status.term != placement.term:
            return None
        first = self.collector.first_missing(self.islands_of(worker), assignment_status.reported)
        if first is None:
            return None
        last = min(assignment_status.reported, first + MOST_PULLED_EPOCHS)
        return PullReports(job=self.job, variable=self.variable, term=placement.term, first=first, last=last)

    def due_commit(self) -> Commit | None:
        """Return the commit that is due; None: not yet. It lets workers forget messages, or tells them a hit."""
        if self._has_news and self.cut is None:
            self._has_news = False
            return self.commit()
        reached = min(min(self._latest, default=-1), self.collector.state.epochs - 1)
        if reached < self._forget + FORGET_EPOCHS or self.cut is not None:
            return None
        self._forget = reached
        return self.commit()

    # ------------------------------------------------------------------------------------- checkpoints

    def next_pulls(self, most: int) -> list[tuple[str, PullStates]]:
        """Return at most `most` pulls of states, each with its worker; begin a checkpoint if one is due."""
        placement = self.placement
        if placement is None or self.cut is not None or self.is_writing:
            return []
        if self._gathering is None:
            snapshots = (self._snapshots.get(name, ()) for name in dict.fromkeys(placement.workers))
            epoch = common_epoch(snapshots, self.durable)
            if epoch is None or epoch not in (self._schedule.next, self._schedule.last):
                return []
            self._gathering = Gathering(placement, epoch)
        return self._gathering.next_pulls(most)

    def add_states(self, worker: str, asked: PullStates, body: States | None) -> None:
        """Add a worker's answer to a pull; None: there was no answer.

        Raises:
            RemoteProtocolError: A state was damaged in transit; it is pulled again.
        """
        placement, gathering = self.placement, self._gathering
        if placement is None or gathering is None:
            return
        if (placement.term, gathering.epoch) == (asked.term, asked.epoch):
            gathering.add(worker, body)

    def take_complete_checkpoint(self) -> Checkpoint | None:
        """Return the checkpoint that can be written now, each only once; `mark_durable` or another term follows."""
        placement, gathering = self.placement, self._gathering
        if placement is None or gathering is None or self.cut is not None or not gathering.is_complete:
            return None
        state = self.collector.at(gathering.epoch)
        if state is None:
            return None
        self._gathering, self.is_writing = None, True
        states = dict(sorted(gathering.states.items()))
        return Checkpoint(self.job, self.variable, placement.term, gathering.epoch, state, states)

    def mark_durable(self, checkpoint: Checkpoint, now: float) -> Commit | None:
        """Record that a checkpoint is durable; return the commit to publish, if its term is the current term."""
        self.is_writing = False
        epochs, seconds = checkpoint.epoch - self.durable, now - self._durable_at
        self.interval = interval_of(seconds / epochs, checkpoint.size, self.interval)
        self.durable, self._durable_at = checkpoint.epoch, now
        self.collector.forget(checkpoint.epoch)
        if self.placement is None or self.placement.term != checkpoint.term:
            return None
        self._since_plan += 1
        self._schedule = schedule_after(self._schedule, checkpoint.epoch, self.interval, self._wants_barrier)
        self._wants_barrier = False
        return self.commit()

    def commit(self) -> Commit | None:
        """Return the current commit; None without a placement."""
        if self.placement is None:
            return None
        return Commit(
            job=self.job,
            variable=self.variable,
            term=self.placement.term,
            epoch=self.durable,
            schedule=self._schedule,
            reported=max(self._forget, self.durable),
            hit=self._hit,
        )

    def validate(self) -> None:
        """Check the invariants; raises AssertionError."""
        self.collector.validate()
        assert self.durable <= self.collector.state.epochs, "a checkpoint is ahead of the reports"
        assert self.placement is None or self.placement.epoch <= self.durable, (
            "a term begins at an epoch that is not durable"
        )
        assert not self.is_writing or self._gathering is None, "two checkpoints are made at once"

    def _update_latest(self, islands: Iterable[int], epoch: int) -> None:
        for island in islands:
            self._latest[island] = max(self._latest[island], epoch)
