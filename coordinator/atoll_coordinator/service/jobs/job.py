"""One job: its states, archipelagos and time limit. Pure: the time is an argument.

Methods that change a job return the actions (`JobAction`) that the job controller must carry out.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from atoll_coordinator.data.recording import STENCIL_ROWS, Recording
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.model.selection.front_member import count_constants, front_length
from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.search.checkpoint_schedule import StoredSearchState
from atoll_coordinator.service.search.collector import DivergedError, Measure
from atoll_coordinator.service.search.ending import Cut, SearchLimits, Stagnation
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.tasks.preparing import Prepared
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Target
from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.expression.program import check_program_bytes
from atoll_core.search.commit_order import CommitOrder
from atoll_core.search.pareto import FrontEntry
from atoll_core.wire.messages.epochs import EpochReport
from atoll_core.wire.messages.limits import chunk_count
from atoll_core.wire.messages.views import FINAL_STATES, JobState
from atoll_core.wire.messages.workers import Commit, JobAnnouncement

_NOT_REFINED: Final = (
    "before refining had ended: equations are as the search found them, their constants fitted to derivatives."
)
OUT_OF_TIME: Final = f"The time allowed by --max-time was used up {_NOT_REFINED}"
_CANCELLED: Final = f"The job was cancelled {_NOT_REFINED}"
_NOTHING_PREPARED: Final = "the time allowed by --max-time was used up while the data were being prepared; allow more"

SEARCH_SHARE: Final = 0.5
"""Largest share of the time after preparing that the search may take; refining takes about as long."""

STAGNATION_GIVEN: Final = 60
"""Epochs without improvement after which the search for a given target ends. The number is high because targets given
as columns have no trajectories with which refining could improve an approximate equation."""

STAGNATION_CLEAN: Final = 5
"""Fewest epochs without improvement after which the search for a clean target ends. The number grows with the epochs
until the last improvement. On random systems simulated at solver tolerances, searches with 3, 5, 8 and 12 find the same
48 equations, in 24 to 30 epochs (ADR 0033)."""

STAGNATION_NOISY: Final = 3

JobStep = Literal["prepare", "put-back", "prepared", "searched", "refined", "fail", "cancel"]
Fault = Literal["data", "diverged", "poison", "internal"]

JOB_TRANSITIONS: Final[Mapping[JobState, Mapping[JobStep, JobState]]] = {
    "queued": {"prepare": "preparing", "fail": "failed", "cancel": "cancelled"},
    "preparing": {"prepared": "running", "put-back": "queued", "fail": "failed", "cancel": "cancelled"},
    "running": {"searched": "refining", "fail": "failed", "cancel": "cancelled"},
    "refining": {"refined": "done", "fail": "failed", "cancel": "cancelled"},
    "done": {},
    "failed": {},
    "cancelled": {},
}
"""State of a job -> event -> next state. A job that has ended does not change."""


@dataclass(frozen=True, slots=True)
class CommitCuts:
    """Commit the cuts, all or none, then close their archipelagos on the workers."""

    cuts: tuple[Cut, ...]


@dataclass(frozen=True, slots=True)
class PublishCommit:
    """Publish the commit; workers may forget messages of the epochs before it."""

    commit: Commit


@dataclass(frozen=True, slots=True)
class Refine:
    """All searches have ended: refine their equations within `seconds` (None: no limit); `Job.finish` follows."""

    seconds: float | None = None


@dataclass(frozen=True, slots=True)
class CommitResult:
    """The job has ended: commit its result, then close it on the workers."""


JobAction = CommitCuts | PublishCommit | Refine | CommitResult


class Job:
    """A job from its submission to its end."""

    def __init__(self, record: JobRecord, config: JobConfig, now: float) -> None:
        """`record` is from the store, `config` its specification, `now` in seconds of the bus."""
        self.id: Final = record.id
        self.name: Final = record.name
        self.config: Final = config
        self.table: Final = record.table_digest
        self.submitted: Final = record.submitted
        self.submitted_at: Final = now - record.elapsed
        self.submitter: Final = record.submitter
        self.priority = record.priority
        self.is_held = False
        self.is_paused = bool(record.paused)
        self.is_shared = bool(record.shared)
        self.state: JobState = "queued"
        self.former_state: JobState = "queued"
        self.reason: str | None = None
        self.fault: Fault | None = None
        self.prepared: Prepared | None = None
        self.archipelagos: dict[str, Archipelago] = {}
        self.preparing_since: float | None = None
        self.preparation_seconds = 0.0
        self.started_at: float | None = None
        self.searched_before = 0.0
        self.refining_since: float | None = None
        self.spent_before_refining = 0.0
        self.refinement = Refinement()
        self.result_text: str | None = None

    @property
    def has_ended(self) -> bool:
        """Whether the job has ended; an ended job does not change."""
        return self.state in FINAL_STATES

    def open_archipelago(self, variable: str) -> Archipelago | None:
        """Return the archipelago of a variable while it is searched."""
        archipelago = self.archipelagos.get(variable) if self.state == "running" else None
        return archipelago if archipelago is not None and archipelago.cut is None else None

    @property
    def open_archipelagos(self) -> tuple[Archipelago, ...]:
        """The archipelagos whose search continues."""
        if self.state != "running":
            return ()
        return tuple(archipelago for archipelago in self.archipelagos.values() if archipelago.cut is None)

    def announcement(self) -> JobAnnouncement:
        """Return the announcement to workers; raises LocalProtocolError before the job is prepared."""
        if self.prepared is None:
            raise LocalProtocolError(f"job {self.id} cannot be announced before it is prepared")
        return JobAnnouncement(
            job=self.id,
            config=self.prepared.config,
            variables=tuple(target.variable for target in self.prepared.sought),
            blob=self.prepared.blob,
            size=self.prepared.size,
            chunks=chunk_count(self.prepared.size),
            priority=self.priority,
            submitter=self.submitter,
        )

    def start_preparing(self) -> None:
        """Enter the state "preparing"; `start_clock` follows when a loaded process begins the work."""
        self._step("prepare")

    def put_back(self) -> None:
        """Return to the queue, because no worker has begun to prepare its data."""
        self._step("put-back")
        self.preparing_since = None

    def start_clock(self, now: float) -> list[JobAction]:
        """Start the time of `--max-time`: a loaded process prepares the data now."""
        if self.state == "preparing":
            self.preparing_since = now
        return []

    def start(
        self, prepared: Prepared, cuts: Mapping[str, Cut], now: float,
        resumed: Mapping[str, StoredSearchState] | None = None,
    ) -> list[JobAction]:  # fmt: skip
        """Set up the archipelagos. The searches of variables in `cuts` have already ended; variables in `resumed` have
        a checkpoint."""
        self._step("prepared")
        self.prepared = prepared
        self.preparation_seconds = self._preparing_seconds(now)
        self.searched_before = max((cut.seconds for cut in cuts.values()), default=0.0)
        for target in prepared.sought:
            archipelago = self._archipelago(prepared, target)
            if target.variable in cuts:
                archipelago.restore(cuts[target.variable])
            elif resumed and target.variable in resumed:
                archipelago.resume(resumed[target.variable].search_state())
                self.searched_before = max(self.searched_before, resumed[target.variable].search_seconds)
            self.archipelagos[target.variable] = archipelago
        return self._refine_if_cut(now)

    def wait_to_be_refined(self, seconds: float) -> None:
        """Do not count `seconds`, for which the job has waited for a worker that refines it."""
        if self.refining_since is not None:
            self.refining_since += seconds

    def start_search(self, now: float) -> None:
        """Start the clock of the search when islands are placed for the first time."""
        if self.started_at is None:
            self.started_at = now

    def hold(self, is_held: bool) -> list[JobAction]:
        """Set whether the job is held; `workers.placement.Placer` then stops or continues its islands."""
        self.is_held = is_held
        return []

    def search_seconds(self, now: float) -> float:
        """Return the duration of the search in seconds, including the time before a restart."""
        return self.searched_before + (now - self.started_at if self.started_at is not None else 0.0)

    def spent_seconds(self, now: float) -> float:
        """Return the time that counts towards `--max-time`: preparing, searching and refining.

        Waiting times do not count: waiting for the job's turn, for a process that loads or compiles, for workers before
        islands are placed, and for a worker that refines.
        """
        if self.state == "preparing":
            return self._preparing_seconds(now)
        if self.refining_since is not None:
            return self.spent_before_refining + now - self.refining_since
        return self.preparation_seconds + self.search_seconds(now)

    def _preparing_seconds(self, now: float) -> float:
        return now - self.preparing_since if self.preparing_since is not None else 0.0

    def add_report(self, worker: str, report: EpochReport, now: float) -> list[JobAction]:
        """Add a report; raises RemoteProtocolError if the job has no such variable or the report is impossible."""
        archipelago = self.archipelagos.get(report.variable)
        if self.state != "running":
            return []
        if archipelago is None:
            raise RemoteProtocolError(f"job {self.id} has no variable {report.variable!r}")
        try:
            advanced = archipelago.add_report(worker, report, self.search_seconds(now))
        except DivergedError as error:
            return self.fail("diverged", str(error))
        if advanced and archipelago.cut is not None:
            return [CommitCuts((archipelago.cut,)), *self._refine_if_cut(now)]
        commit = archipelago.due_commit()
        return [PublishCommit(commit)] if commit is not None else []

    def tick(self, now: float) -> list[JobAction]:
        """Apply `--max-time`, which ends preparing, the search and refining.

        The search ends at each variable's last completely reported epoch, early enough that refining has its share of
        the time. When refining is stopped, equations stay as the search found them. The time for which a job is held
        does not count.
        """
        if self.is_held and all(archipelago.placement is None for archipelago in self.open_archipelagos):
            self.searched_before, self.started_at = self.search_seconds(now), None
        most, spent = self.config.budget.max_time, self.spent_seconds(now)
        if most is None or self.state not in ("preparing", "running", "refining"):
            return []
        left = max(0.0, most - self.preparation_seconds)
        end = self.preparation_seconds + SEARCH_SHARE * left if self.state == "running" else most
        if spent < end:
            return []
        if self.state == "preparing":
            return self.fail("data", _NOTHING_PREPARED)
        if self.state == "refining":
            return self.finish_unrefined(Refinement(warnings=(OUT_OF_TIME,), end="not refined"))
        open_ones = self.open_archipelagos
        for archipelago in open_ones:
            archipelago.collector.cut_now("max-time")
        cuts = tuple(archipelago.cut for archipelago in open_ones if archipelago.cut is not None)
        return [CommitCuts(cuts), *self._refine_if_cut(now)] if cuts else []

    def finish(self, text: str) -> list[JobAction]:
        """End with the result of refining, as JSON; without effect on a job that is not being refined."""
        if self.state != "refining":
            return []
        self.result_text = text
        self._step("refined")
        return [CommitResult()]

    def finish_unrefined(self, refinement: Refinement) -> list[JobAction]:
        """End with the equations as the search found them, and the warnings of `refinement`; without effect on a job
        that is not being refined."""
        if self.state != "refining":
            return []
        self.refinement = refinement
        self._step("refined")
        return [CommitResult()]

    def cancel(self) -> list[JobAction]:
        """End the job and keep the equations found; without effect on a job that has ended.

        Only the result is committed, and not the cuts. After a crash before this commit the job continues, and stored
        cuts would end its searches.
        """
        if self.has_ended:
            return []
        for archipelago in self.open_archipelagos:
            archipelago.collector.cut_now("cancelled")
        self.refinement = Refinement(warnings=(_CANCELLED,), end="not refined")
        self._step("cancel")
        return [CommitResult()]

    def fail(self, fault: Fault, sentence: str) -> list[JobAction]:
        """Let the job fail for a reason; without effect on a job that has ended."""
        if self.has_ended:
            return []
        self._step("fail")
        self.fault, self.reason = fault, sentence
        return [CommitResult()]

    def validate(self) -> None:
        """Check the invariants; raises AssertionError."""
        for archipelago in self.archipelagos.values():
            archipelago.validate()
        is_searching = bool(self.open_archipelagos)
        assert self.state != "running" or is_searching or not self.archipelagos, "a searched job is still running"

    def _step(self, step: JobStep) -> None:
        following = JOB_TRANSITIONS[self.state].get(step)
        if following is None:
            raise LocalProtocolError(f"job {self.id} is {self.state} and cannot {step}")
        self.former_state, self.state = self.state, following

    def _archipelago(self, prepared: Prepared, target: Target) -> Archipelago:
        config, inputs = prepared.config, len(prepared.dataset.names)
        recording = prepared.preparation.recording
        budget = config.budget
        limits = SearchLimits(
            islands=config.evolution.islands,
            epochs=budget.max_epochs_of.get(target.variable, budget.max_epochs),
            stagnation=stagnation_of(config, target, recording),
            commit_order=commit_order_of(config),
            runners_up=config.evolution.runners_up or 0,
            has_law=target.variable in prepared.settled,
        )
        return Archipelago(
            self.id, target.variable, limits, measure_of(target, independent_rows(target, recording)),
            lambda data: check_program_bytes(data, inputs),
        )  # fmt: skip

    def _refine_if_cut(self, now: float) -> list[JobAction]:
        if self.open_archipelagos:
            return []
        self.spent_before_refining = self.spent_seconds(now)
        self.refining_since = now
        self._step("searched")
        most = self.config.budget.max_time
        return [Refine(None if most is None else max(0.0, most - self.spent_before_refining))]


def commit_order_of(config: JobConfig) -> CommitOrder:
    """Return the commit order of the slices of this job's archipelagos."""
    return CommitOrder(
        generations=config.migration.generations,
        stride=config.evolution.refit_interval,
        joining=config.migration.joining or config.evolution.islands,
    )


def measure_of(target: Target, rows: float) -> Measure:
    """Return a function that gives the least description length, in nats, of a front for this target.

    `rows` is the number of rows with independent errors (`independent_rows`): a better fit to correlated errors is not
    an improvement. For a noisy target the error has no floor: many equations have errors below the noise, and the
    search continues while they improve.
    """
    floor = 0.0 if target.is_noisy else target.uncertainty

    def least(front: tuple[FrontEntry, ...]) -> float:
        lengths = (
            front_length(entry, rows, floor, target.standard_deviation, count_constants(entry.program))
            for entry in front
        )
        return min(lengths, default=float("inf"))

    return least


def stagnation_of(config: JobConfig, target: Target, recording: Recording | None) -> Stagnation:
    """Return the number of epochs without a better equation after which the search for a target ends.

    `recording` has the data from which the target was estimated; None: the user gave the target.
    """
    if config.budget.stagnation is not None:
        return Stagnation(config.budget.stagnation)
    if target.is_noisy:
        return Stagnation(STAGNATION_NOISY)
    if recording is None or config.budget.target_error is not None:
        return Stagnation(STAGNATION_GIVEN)
    return Stagnation(STAGNATION_CLEAN, grows=True)


def independent_rows(target: Target, recording: Recording | None) -> float:
    """Return the number of rows of a target that have independent errors.

    Smoothing by a polynomial of degree d over s rows estimates d + 1 parameters, so (d + 1) / s of the rows are
    independent. Tables without noise come from simulators, whose errors are correlated over at least the rows that an
    interpolation uses (`STENCIL_ROWS`).
    """
    rows = float(len(target.values))
    if recording is None:
        return rows
    smoothing = recording.smoothing[recording.states.index(target.variable)]
    if smoothing.span is None or smoothing.degree is None:
        return rows / STENCIL_ROWS
    return rows * min(1.0, (smoothing.degree + 1.0) / smoothing.span)
