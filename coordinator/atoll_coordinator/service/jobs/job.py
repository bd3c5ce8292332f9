"""One job: its states, its archipelagos, and what is to be done when something happens to it. Pure; time comes in."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from atoll_coordinator.model.criteria import count_constants, front_length
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.service.jobs.stagnation import independent_rows, stagnation_of
from atoll_coordinator.service.jobs.time_limit import TimeLimit
from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.search.checkpoint_gathering import StoredSearchState
from atoll_coordinator.service.search.collector import DivergedError, Measure
from atoll_coordinator.service.search.cut import Cut
from atoll_coordinator.service.search.ending import Limits
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
"""State of a job -> what happens -> its next state. Nothing happens to a job that has ended."""


@dataclass(frozen=True, slots=True)
class CommitCuts:
    """Commit the cuts, all or none of them, then close their archipelagos on the workers."""

    cuts: tuple[Cut, ...]


@dataclass(frozen=True, slots=True)
class PublishCommit:
    """Tell the workers what they may forget."""

    commit: Commit


@dataclass(frozen=True, slots=True)
class Refine:
    """All is cut: have the result made of what was found; `Job.finish` follows.

    `seconds` is what `--max-time` leaves for that; None: any time.
    """

    seconds: float | None = None


@dataclass(frozen=True, slots=True)
class CommitResult:
    """The job has ended: commit its result, then close it on the workers."""


JobAction = CommitCuts | PublishCommit | Refine | CommitResult


class Job:
    """A job from its submission to its end."""

    def __init__(self, record: JobRecord, config: JobConfig, now: float) -> None:
        """`record` is what the store keeps of it, `config` its specification read, `now` the bus's seconds."""
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
        """Whether nothing can happen to it any more."""
        return self.state in FINAL_STATES

    def open_archipelago(self, variable: str) -> Archipelago | None:
        """Return the archipelago of a variable while it is searched."""
        archipelago = self.archipelagos.get(variable) if self.state == "running" else None
        return archipelago if archipelago is not None and archipelago.cut is None else None

    @property
    def open_archipelagos(self) -> tuple[Archipelago, ...]:
        """The archipelagos that are still searched."""
        if self.state != "running":
            return ()
        return tuple(archipelago for archipelago in self.archipelagos.values() if archipelago.cut is None)

    def announcement(self) -> JobAnnouncement:
        """Return what workers need to know; raises LocalProtocolError before the job is prepared."""
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
        """Take in that its data are to be prepared; a process for it is started and loaded first."""
        self._step("prepare")

    def put_back(self) -> None:
        """Take in that nobody has begun to prepare its data, and that it waits again."""
        self._step("put-back")
        self.preparing_since = None

    def start_clock(self, now: float) -> list[JobAction]:
        """Take in that its data are being prepared, by a process that is loaded: the time of `--max-time` begins."""
        if self.state == "preparing":
            self.preparing_since = now
        return []

    def start(
        self, prepared: Prepared, cuts: Mapping[str, Cut], now: float,
        resumed: Mapping[str, StoredSearchState] | None = None,
    ) -> list[JobAction]:  # fmt: skip
        """Set up the archipelagos; those of `cuts` have ended before, those of `resumed` go on from a checkpoint.

        The search has lasted at least as long as any of them says.
        """
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
        """Take in that it has waited for so long to be refined: that does not count."""
        if self.refining_since is not None:
            self.refining_since += seconds

    def start_search(self, now: float) -> None:
        """Take in that islands have been placed: the time of the search begins, once."""
        if self.started_at is None:
            self.started_at = now

    def hold(self, is_held: bool) -> list[JobAction]:
        """Have its islands stop at their next checkpoints, or go on from there; see `workers.scheduling.Scheduler`."""
        self.is_held = is_held
        return []

    def _rest(self, now: float) -> None:
        """Take in that nobody computes islands of a held job: the time of the search stands still."""
        self.searched_before, self.started_at = self.search_seconds(now), None

    def search_seconds(self, now: float) -> float:
        """Return how long the search has lasted, under earlier incarnations as well."""
        return self.searched_before + (now - self.started_at if self.started_at is not None else 0.0)

    def spent_seconds(self, now: float) -> float:
        """Return what has gone by of `--max-time`: preparing, searching and refining.

        Waiting for the job's turn, for a process to load or compile what preparing needs, for workers until islands are
        placed, and for one that refines, does not count.
        """
        if self.state == "preparing":
            return self._preparing_seconds(now)
        if self.refining_since is not None:
            return self.spent_before_refining + now - self.refining_since
        return self.preparation_seconds + self.search_seconds(now)

    def _preparing_seconds(self, now: float) -> float:
        return now - self.preparing_since if self.preparing_since is not None else 0.0

    def add_report(self, worker: str, report: EpochReport, now: float) -> list[JobAction]:
        """Take in a report; raises RemoteProtocolError when it cannot be."""
        archipelago = self.archipelagos.get(report.variable)
        if self.state != "running":
            return []
        if archipelago is None:
            raise RemoteProtocolError(f"job {self.id} has no variable {report.variable!r}")
        try:
            advanced = archipelago.add_report(worker, report, self.search_seconds(now))
        except DivergedError as error:
            return self.fail("diverged", str(error))
        return self._after_epoch(archipelago, now) if advanced else self._publish_due_commit(archipelago)

    def tick(self, now: float) -> list[JobAction]:
        """Let time pass: `--max-time` ends preparing, cuts the search and ends refining (`TimeLimit`).

        The search is cut at each variable's last completely reported epoch. Where refining has not ended in time,
        equations are as the search found them. While a job is held, no time passes for it.
        """
        if self.is_held and all(archipelago.placement is None for archipelago in self.open_archipelagos):
            self._rest(now)
        if not self._time_limit.is_up(self.state, self.spent_seconds(now), self.preparation_seconds):
            return []
        if self.state == "preparing":
            return self.fail("data", _NOTHING_PREPARED)
        if self.state == "refining":
            return self.finish_unrefined(Refinement(warnings=(OUT_OF_TIME,), end="not refined"))
        return self._cut_search(now)

    @property
    def _time_limit(self) -> TimeLimit:
        return TimeLimit(self.config.budget.max_time)

    def _cut_search(self, now: float) -> list[JobAction]:
        open_ones = self.open_archipelagos
        for archipelago in open_ones:
            archipelago.collector.cut_now("max-time")
        cuts = tuple(archipelago.cut for archipelago in open_ones if archipelago.cut is not None)
        return [CommitCuts(cuts), *self._refine_if_cut(now)] if cuts else []

    def finish(self, text: str) -> list[JobAction]:
        """End with the result that refining gave, as JSON; without effect on a job that is not being refined."""
        if self.state != "refining":
            return []
        self.result_text = text
        self._step("refined")
        return [CommitResult()]

    def finish_unrefined(self, refinement: Refinement) -> list[JobAction]:
        """End with equations as found and the warnings of `refinement`; without effect unless it is being refined."""
        if self.state != "refining":
            return []
        self.refinement = refinement
        self._step("refined")
        return [CommitResult()]

    def cancel(self) -> list[JobAction]:
        """End it and keep what has been found; without effect on a job that has ended.

        The result alone is committed: cuts by a cancellation that is then lost would end a job that goes on.
        """
        if self.has_ended:
            return []
        for archipelago in self.open_archipelagos:
            archipelago.collector.cut_now("cancelled")
        self.refinement = Refinement(warnings=(_CANCELLED,), end="not refined")
        self._step("cancel")
        return [CommitResult()]

    def fail(self, fault: Fault, sentence: str) -> list[JobAction]:
        """End it with a reason; without effect on a job that has ended."""
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
        limits = Limits(
            islands=config.evolution.islands,
            epochs=budget.max_epochs_of.get(target.variable, budget.max_epochs),
            stagnation=stagnation_of(config, target, recording),
            commit_order=commit_order_of(config),
            runners_up=config.evolution.runners_up or 0,
            has_law=target.variable in prepared.settled,
        )
        return Archipelago(
            self.id, target.variable, limits, measure_of(target, independent_rows(target, recording)),
            lambda data: check_program(data, inputs),
        )  # fmt: skip

    def _after_epoch(self, archipelago: Archipelago, now: float) -> list[JobAction]:
        if archipelago.cut is None:
            return self._publish_due_commit(archipelago)
        return [CommitCuts((archipelago.cut,)), *self._refine_if_cut(now)]

    def _publish_due_commit(self, archipelago: Archipelago) -> list[JobAction]:
        commit = archipelago.due_commit()
        return [PublishCommit(commit)] if commit is not None else []

    def _refine_if_cut(self, now: float) -> list[JobAction]:
        if self.open_archipelagos:
            return []
        self.spent_before_refining = self.spent_seconds(now)
        self.refining_since = now
        self._step("searched")
        return [Refine(self._time_limit.remaining(self.spent_before_refining))]


def commit_order_of(config: JobConfig) -> CommitOrder:
    """Return how the slices of this job's archipelagos follow each other."""
    return CommitOrder(
        generations=config.migration.generations,
        stride=config.evolution.refit_interval,
        joining=config.migration.joining or config.evolution.islands,
    )


def measure_of(target: Target, rows: float) -> Measure:
    """Return the measure by which a front of this target is better than another: its least description length.

    `rows` are those that count, see `independent_rows`: what is gained at the level of errors that go together is none.

    That of a noisy target knows no floor: many equations lie below it, and the search goes on while they get better.
    """
    floor = 0.0 if target.is_noisy else target.uncertainty

    def least(front: tuple[FrontEntry, ...]) -> float:
        lengths = (
            front_length(entry, rows, floor, target.standard_deviation, count_constants(entry.program))
            for entry in front
        )
        return min(lengths, default=float("inf"))

    return least


def check_program(data: bytes, inputs: int) -> None:
    """Raise RemoteProtocolError unless `data` is a program over that many inputs."""
    check_program_bytes(data, inputs)
