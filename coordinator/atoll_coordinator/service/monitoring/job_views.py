"""Jobs as clients see them: views of live and ended jobs, their counters, and the drafts of results.

Views are made when a client asks for them. Results of live jobs are composed from a `Draft` in the background, and the
equations of views are written there (`view_equations`).
"""

import contextlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, cast

from pydantic import ValidationError

from atoll_coordinator.data.templates import template_of
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.model.result.building import KNOWN, Account, VariableOutcome, build_result
from atoll_coordinator.result.result import UNTIMED
from atoll_coordinator.service.jobs.checks import DAMAGED_RECORD
from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.monitoring.breakages import Breakages
from atoll_coordinator.service.monitoring.view_equations import FrontWritten, ViewEquations
from atoll_coordinator.service.scheduling.job_queue import JobQueue
from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.search.ending import Improvement, Why
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.tasks.preparing import Prepared
from atoll_core import VERSION
from atoll_core.config import JobConfig
from atoll_core.errors import StoreError
from atoll_core.wire.messages.clients import QueueDepth
from atoll_core.wire.messages.views import FINAL_STATES, JobCounters, JobState, JobView, TaskView, VariableView
from atoll_core.wire.messages.workers import AssignmentStatus

# ------------------------------------------------------------------------------------------------- counters and depth


class CounterRegistry:
    """Counters of live jobs, such as reports, commits and waiting times; point evaluations are in the collector."""

    def __init__(self) -> None:
        self._counters: dict[str, JobCounters] = {}
        self._waited_s: dict[tuple[str, str, int, str], float] = {}

    def add(self, job: str, **counts: int) -> None:
        """Add to fields of a job's `JobCounters`."""
        counters = self._counters.get(job, JobCounters())
        self._counters[job] = counters.model_copy(
            update={name: getattr(counters, name) + count for name, count in counts.items()}
        )

    def set_waited(self, worker: str, assignment_status: AssignmentStatus) -> None:
        """Set the seconds for which those islands of a placement that run on this worker have waited."""
        self._waited_s[assignment_status.job, assignment_status.variable, assignment_status.term, worker] = (
            assignment_status.waited_s
        )

    def counters(self, job: Job) -> JobCounters:
        """Return the counters of a job."""
        duplicates = sum(archipelago.collector.duplicates for archipelago in job.archipelagos.values())
        waited_s = sum(seconds for key, seconds in self._waited_s.items() if key[0] == job.id)
        counters = self._counters.get(job.id, JobCounters())
        return counters.model_copy(update={"duplicates": duplicates, "waited_s": waited_s})

    def forget(self, job: str) -> None:
        """Forget a job that has ended."""
        self._counters.pop(job, None)
        self._waited_s = {key: seconds for key, seconds in self._waited_s.items() if key[0] != job}


def queue_depth(begun: Iterable[Job], queued: int, ready: int, places: int, analyses: int = 0) -> QueueDepth:
    """Return the number of jobs in each state, and the number of islands and tasks that could be computed now.

    Before its data are prepared, the number of equations of a job is unknown: the job counts with the islands of one
    equation. A job that is refined counts the same, because its batches occupy about as many workers. Waiting jobs
    count only if a place is free for them; the other waiting jobs, and held jobs, need no worker yet.

    Args:
        begun: The jobs that have begun.
        queued: Number of jobs that wait for their turn.
        ready: Number of queued jobs that wait only for their turn: neither the job nor the queue is paused.
        places: Number of jobs that may be prepared and searched at the same time.
        analyses: Number of open questions about results.
    """
    jobs = tuple(begun)
    states = [job.state for job in jobs]
    searched = [job for job in jobs if not job.is_held]
    islands = sum(archipelago.collector.limits.islands for job in searched for archipelago in job.open_archipelagos)
    tasks = states.count("preparing") + states.count("refining")
    under_way = states.count("preparing") + sum(job.state == "running" for job in searched)
    soon = min(ready, max(0, places - under_way)) * JobConfig().evolution.islands
    wanted = sum(job.config.evolution.islands for job in jobs if job.state in ("preparing", "refining"))
    return QueueDepth(
        queued=queued,
        preparing=states.count("preparing"),
        running=states.count("running"),
        refining=states.count("refining"),
        tasks_ready=islands + tasks + analyses,
        workers_wanted=islands + wanted + soon + analyses,
    )


# ------------------------------------------------------------------------------------------------- results and drafts


def outcomes_of(job: Job) -> list[VariableOutcome]:
    """Return the present outcomes of a job's searches, and its known equations, in the order of the dataset."""
    if job.prepared is None:
        return []
    outcomes = {name: outcome_of(archipelago) for name, archipelago in job.archipelagos.items()}
    outcomes |= {name: VariableOutcome(name, (entry,), 0, why=KNOWN) for name, entry in job.prepared.known.items()}
    order = [name for name in job.prepared.dataset.variables if name in outcomes]
    return [outcomes[name] for name in order]


def outcome_of(archipelago: Archipelago) -> VariableOutcome:
    """Return the outcome of the search for one equation; before its end, the state after the complete epochs."""
    cut = archipelago.cut
    if cut is not None:
        return VariableOutcome(
            archipelago.variable, cut.front, cut.epochs, cut.generation, cut.evaluations, cut.seconds, cut.why,
            runners_up=cut.runners_up,
            convergence={convergence.island: _steps(convergence.improvements) for convergence in cut.convergence},
        )  # fmt: skip
    state = archipelago.collector.state
    return VariableOutcome(
        archipelago.variable, state.front, state.epochs, None, state.evaluations, state.seconds,
        runners_up=state.runners_up,
        convergence={island: _steps(improvements) for island, improvements in state.convergence.items()},
    )  # fmt: skip


def _steps(improvements: Sequence[Improvement]) -> tuple[tuple[int, float], ...]:
    return tuple((improvement.generation, improvement.error) for improvement in improvements)


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """The parts from which the result of a prepared job is composed. They never change, so another thread may use them.

    `submitted_at` is in seconds of the bus.
    """

    job: str
    prepared: Prepared
    outcomes: tuple[VariableOutcome, ...]
    account: Account
    refinement: Refinement
    submitted_at: float

    @property
    def is_final(self) -> bool:
        """Whether the result is final; otherwise its job continues."""
        return self.account.state in FINAL_STATES

    def compose(self) -> str:
        """Return the result as JSON, without the seconds that the job took (`result.result.timed`).

        This judges equations on all rows: it loads kernels, and takes seconds for a million rows.
        """
        config, preparation = self.prepared.config, self.prepared.preparation
        result = build_result(self.job, config, preparation, self.outcomes, self.account, self.refinement)
        return result.to_json()


@dataclass(frozen=True, slots=True, eq=False)
class Ending:
    """A job whose end takes effect when its result is composed. Until then clients see its previous state, `was`.

    `sentence` describes the error that ended the job; None: no error ended it.
    """

    job: Job
    was: JobState
    draft: Draft
    sentence: str | None = None


def draft_of(job: Job) -> Draft | None:
    """Return the parts of the present result of a job; None: its data are not prepared."""
    if job.prepared is None:
        return None
    outcomes = tuple(outcomes_of(job))
    search_seconds = max((outcome.seconds for outcome in outcomes), default=0.0)
    account = Account(job.state, UNTIMED, search_seconds, job.reason)
    return Draft(job.id, job.prepared, outcomes, account, job.refinement, job.submitted_at)


# -------------------------------------------------------------------------------------------------------------- views


def job_view(
    job: Job, queue: JobQueue, now: float, waiting_reason: str | None, counters: JobCounters,
    stalls: tuple[str, ...],
) -> JobView:  # fmt: skip
    """Return the view of a live job, or of a job that ends now, without its equations.

    Args:
        job: The job.
        queue: The queue in which the job may wait.
        now: The time in seconds of the bus.
        waiting_reason: A sentence on why its archipelagos or tasks without workers wait; None: they do not wait.
        counters: The counters of this job.
        stalls: Sentences on why its archipelagos make no progress.
    """
    outcomes = outcomes_of(job)
    evaluations = sum(sum(outcome.evaluations.values()) for outcome in outcomes)
    seconds = job.search_seconds(now)
    return JobView(
        job=job.id,
        name=job.name,
        state=job.state,
        seed=job.config.seed,
        preset=job.config.preset,
        reason=job.reason or queue.waiting_reason(job.id) or waiting_reason,
        fault=job.fault,
        warnings=job.prepared.dataset.warnings if job.prepared else (),
        notes=job.prepared.dataset.notes if job.prepared else (),
        submitted=job.submitted,
        elapsed=now - job.submitted_at,
        workers=len({worker for archipelago in job.open_archipelagos for worker in archipelago.workers}),
        point_evaluations=evaluations,
        point_evaluations_per_second=evaluations / seconds if seconds > 0.0 and evaluations else None,
        variables=(),
        priority=job.priority,
        ahead=queue.ahead_of(job.id),
        stalls=stalls,
        counters=counters,
        target_error=job.config.budget.target_error,
        submitter=job.submitter,
        shared=job.is_shared,
        paused=job.is_paused,
        held=job.is_held,
    )


def ended_view(record: JobRecord, result: str | None) -> JobView:
    """Return the view of a job that ended before this coordinator started, from its record and result.

    If this version cannot read the result, the view has a warning and no equations.
    """
    try:
        config = JobConfig.model_validate_json(record.spec)
    except ValidationError:  # a result of another version
        config = JobConfig()
    view = JobView(
        job=record.id,
        name=record.name,
        state=cast(JobState, record.state),
        seed=config.seed,
        preset=config.preset,
        reason=record.reason,
        submitted=record.submitted,
        elapsed=record.elapsed,
        workers=0,
        point_evaluations=0,
        variables=(),
        priority=record.priority,
        target_error=config.budget.target_error,
        submitter=record.submitter,
        shared=bool(record.shared),
    )
    return view if result is None else with_equations(view, result)


def with_equations(view: JobView, result: str) -> JobView:
    """Return a view with the equations of a result (JSON), or with a warning if this version cannot read it."""
    try:
        stored = json.loads(result)
        fields = {
            "warnings": tuple(stored["warnings"]),
            "notes": tuple(stored.get("notes", ())),
            "point_evaluations": stored["point_evaluations"],
            "variables": tuple(_stored_variable_view(equation) for equation in stored["equations"]),
        }
        return JobView.model_validate(dict(view) | fields)
    except (ValueError, KeyError, TypeError):
        warning = f"the stored result of this job cannot be read by version {VERSION}"
        return view.model_copy(update={"warnings": (warning,)})


def view_of_record(record: JobRecord, warning: str) -> JobView:
    """Return the view of a job from its record only, after an error. It never raises.

    For a damaged record the view has only id, name, state and time of submission. A damaged job that has not ended is
    shown as failed.
    """
    try:
        return ended_view(record, None).model_copy(update={"warnings": (warning,)})
    except Exception:
        is_final = record.state in FINAL_STATES
        return JobView(
            job=str(record.id),
            name=str(record.name),
            state=cast(JobState, record.state) if is_final else "failed",
            seed=0,
            preset="default",
            reason=DAMAGED_RECORD,
            warnings=(warning,),
            submitted=str(record.submitted),
            elapsed=0.0,
            workers=0,
            point_evaluations=0,
        )


def variable_views(job: Job, equations: ViewEquations) -> tuple[VariableView, ...]:
    """Return the views of the equations of a live job, as they were last written.

    Equations are not judged here, because this reads all rows of the data; they are judged in the result.
    """
    prepared = job.prepared
    if prepared is None:
        return ()
    return tuple(_variable_view(prepared, one, equations.fields(job, prepared, one)) for one in outcomes_of(job))


def _variable_view(prepared: Prepared, outcome: VariableOutcome, shown: Mapping[str, Any]) -> VariableView:
    """Return the view of a variable; `shown` are the fields about its equation."""
    return VariableView(
        variable=outcome.variable,
        lhs=_left_side(prepared, outcome.variable),
        epoch=outcome.epoch,
        point_evaluations=sum(outcome.evaluations.values()),
        finished=outcome.why is not None,
        why=cast(Why | Literal["known"] | None, outcome.why),
        **shown,
    )


def _left_side(prepared: Prepared, variable: str) -> str:
    """Return the left-hand side of an equation; for the unknown part of a given side, ``? in dx/dt``."""
    lhs = prepared.dataset.problem(variable).target.lhs
    unknown = template_of(prepared.config, prepared.dataset.names).unknown_of(variable)
    return lhs if unknown is None else f"{unknown.label} in {lhs}"


def _stored_variable_view(equation: dict[str, Any]) -> VariableView:
    names = ("variable", "lhs", "epoch", "error", "normalized_error", "complexity", "expression", "converged", "why")
    known = {name: equation[name] for name in names} | {"verdict": equation.get("verdict")}
    return VariableView.model_validate({**known, "point_evaluations": equation["point_evaluations"], "finished": True})


class JobWorkers(Protocol):
    """The part of `atoll_coordinator.service.job_controller.JobController` that views need."""

    @property
    def counters(self) -> CounterRegistry: ...

    @property
    def equations(self) -> ViewEquations: ...

    def waiting_reason(self, job: Job) -> str | None: ...

    def stalls(self, job_id: str) -> tuple[str, ...]: ...

    def task_views(self, job_id: str) -> tuple[TaskView, ...]: ...


class JobViews:
    """The views and results of jobs, by id."""

    def __init__(
        self, jobs: Mapping[str, Job], ending: Mapping[str, Ending], queue: JobQueue, workers: JobWorkers, store: Store,
        breakages: Breakages,
    ) -> None:  # fmt: skip
        """`jobs` are the live jobs by id, `ending` the jobs whose ends have not taken effect. Both change later."""
        self._queue = queue
        self.bytes_read = 0
        """Bytes of results that have been read to make views of old jobs. This is slow and done once for each job."""
        self._jobs = jobs
        self._ending = ending
        self._workers = workers
        self._store = store
        self._breakages = breakages

    def view(self, job_id: str, now: float) -> JobView | None:
        """Return the view of a job; None for an unknown job."""
        return next(iter(self.views([job_id], now)), None)

    def views(self, job_ids: Iterable[str], now: float) -> Iterator[JobView]:
        """Yield the views of jobs, leaving out unknown jobs.

        After an error, the view of a job has only fields of its record; other jobs are not affected.
        """
        ids = [*job_ids]
        kept = self._store.views([job_id for job_id in ids if not self.is_open(job_id)])
        made: dict[str, str] = {}
        try:
            for job_id in ids:
                try:
                    view = self._view(job_id, kept.get(job_id), made, now)
                except StoreError:
                    raise
                except Exception as error:
                    record, sentence = self._store.job(job_id), self._breakages.add("showing a job", error)
                    view = view_of_record(record, sentence) if record else None
                if view is not None:
                    yield view
        finally:
            if made:
                with contextlib.suppress(StoreError):  # if the disk is full, the views are made again later
                    self._store.keep_views(made)

    def is_open(self, job_id: str) -> bool:
        """Return whether a job is live, or its end has not taken effect."""
        return job_id in self._jobs or job_id in self._ending

    def state(self, job_id: str) -> JobState | None:
        """Return the state that the view of a job shows; None: the job has ended, or is unknown."""
        ending, job = self._ending.get(job_id), self._jobs.get(job_id)
        if ending is not None:
            return ending.was
        return job.state if job is not None else None

    def result(self, job_id: str) -> str | Draft | None:
        """Return a job's result as JSON, or for a live job the draft of its best result so far; None: no result yet."""
        job = self._jobs.get(job_id)
        return draft_of(job) if job is not None else self._store.result(job_id)

    def add_written(self, written: FrontWritten) -> None:
        """Keep the equation of a front that was written; an error is counted, and no equation is shown."""
        job_id = written.front.job
        if written.error is not None:
            self._breakages.add("writing an equation", written.error)
        ending = self._ending.get(job_id)
        self._workers.equations.add_written(written, ending.job if ending is not None else self._jobs.get(job_id))

    def last_view(self, job: Job, now: float) -> JobView:
        """Return the view of a job that ends now."""
        view = self._live_view(job, now).model_copy(
            update={"reason": job.reason, "workers": 0, "stalls": (), "ahead": None, "paused": False, "held": False,
                    "tasks": ()}
        )  # fmt: skip
        return view if job.result_text is None else with_equations(view, job.result_text)

    def _view(
        self, job_id: str, kept: str | None, made: dict[str, str], now: float
    ) -> JobView | None:  # fmt: skip
        """Return the view of a job; a new view of an ended job is added to `made`."""
        if job_id in self._jobs:
            return self._live_view(self._jobs[job_id], now)
        ending = self._ending.get(job_id)
        if (
            ending is not None and ending.sentence is None
        ):  # after an error, the job may be changed in part: show its record
            as_it_was = {"state": ending.was, "reason": None, "fault": None}
            return self._live_view(ending.job, now).model_copy(update=as_it_was)
        if kept is not None:
            with contextlib.suppress(ValidationError):  # if the view is not valid, another version has stored it
                return JobView.model_validate_json(kept)
        record = self._store.job(job_id)
        if record is None:
            return None
        result = self._store.result(job_id)
        self.bytes_read += len(result or "")
        view = ended_view(record, result)
        if record.is_sound and record.state in FINAL_STATES:
            made[job_id] = view.model_dump_json()
        return view

    def _live_view(self, job: Job, now: float) -> JobView:
        waiting_reason, stalls = self._workers.waiting_reason(job), self._workers.stalls(job.id)
        view = job_view(job, self._queue, now, waiting_reason, self._workers.counters.counters(job), stalls)
        tasks = self._workers.task_views(job.id)
        at_tasks = sum((task.worker is not None) + task.helpers for task in tasks)
        equations = self._workers.equations
        variables = variable_views(job, equations) if job.result_text is None else ()  # else the result has them
        changes = {"tasks": tasks, "workers": max(view.workers, at_tasks), "variables": variables}
        return view.model_copy(update=changes)
