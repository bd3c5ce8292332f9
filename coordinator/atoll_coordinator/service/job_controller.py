"""Job controller: turns events (requests, reports, outcomes, timers) into state changes, stores and sends them.

It has no bus and no thread of its own: `WorkerChannel` sends messages, and `Background` works on large values. A change
is stored before any message about it is sent. An internal error ends only the job that it concerns
(`JobController.guarded`).

**How the state machines work together.** Each machine is a table in the module of its class; a step that is not in the
table is an error. The machines read no clock and do no I/O: the time is an argument, and they return actions, which
this module carries out.

    job (`jobs.job.JOB_TRANSITIONS`)
      queued --prepare--> preparing --prepared--> running --searched--> refining --refined--> done
                 <--put-back--                          (and from each: fail -> failed, cancel -> cancelled)

    place (`scheduling.job_queue.Stage`)     waiting -> preparing -> searching <-> held, then no place is needed
    task (`tasks.task_table.TASK_TRANSITIONS`)      waiting -> leased -> running -> ended, back to waiting when lost
    worker (`workers.membership.MEMBER_TRANSITIONS`)  here <-> absent, here <-> hung, each -> lost -> here
    archipelago (`workers.crash_loops`)      healthy -> suspicious -> quarantined -> failed, a commit -> healthy

A job is *queued* until `JobQueue.decide` gives it a place. In *preparing* it has a task "prepare", in *refining* a task
"refine". In *running* it has archipelagos and no task; the worker controller chooses the placements. `Job.hold` is
called when a running job loses its place: its archipelagos stop at a barrier, and its state stays *running*. When a
worker is lost, its tasks wait again, and its archipelagos get another placement. The job keeps its state, except after
too many losses: then the task or the archipelago fails the job.

Workers have tables of their own: `worker_session` for jobs and islands, `task_runner` for tasks. At each heartbeat the
coordinator compares these with its own tables, and corrects differences by messages. So a lost message does no harm.

A job whose end is decided is in `ending` until its result is composed. Meanwhile it is neither live nor ended.

*Doubts.* `ending` is a state that the table of jobs does not have. It is kept separately because the job must continue
if the coordinator dies before the end is stored. `is_paused` (by a user), `is_held` (no place) and `had_begun` (before
a restart) are three flags that one more stage of the queue could replace. All changes of a job go through `_change`, in
one long module: to understand one change, a reader must also read how jobs end.
"""

import contextlib
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from types import TracebackType
from typing import Final

from pydantic import ValidationError

from atoll_coordinator.result.result import timed
from atoll_coordinator.service.jobs import checks
from atoll_coordinator.service.jobs.job import (
    CommitCuts,
    CommitResult,
    Fault,
    Job,
    JobAction,
    PublishCommit,
    Refine,
)
from atoll_coordinator.service.monitoring.breakages import Breakages
from atoll_coordinator.service.monitoring.event_log import EventLog
from atoll_coordinator.service.monitoring.job_views import (
    Draft,
    Ending,
    JobViews,
    draft_of,
    outcomes_of,
    queue_depth,
)
from atoll_coordinator.service.monitoring.view_equations import FrontWritten, ViewEquations
from atoll_coordinator.service.scheduling.fair_share import TaskTurns, Turn
from atoll_coordinator.service.scheduling.job_queue import NO_TIME, JobQueue, pause_reason
from atoll_coordinator.service.scheduling.limits import DAY_S, TaskTime
from atoll_coordinator.service.search.archipelago import Archipelago, Checkpoint
from atoll_coordinator.service.search.checkpoint_schedule import StoredSearchState
from atoll_coordinator.service.search.ending import Cut
from atoll_coordinator.service.search.pull_budget import PullBudget
from atoll_coordinator.service.store.jobs import JobRecord, Viewer
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.tasks import background
from atoll_coordinator.service.tasks.analyses import RequestedAnalysis
from atoll_coordinator.service.tasks.task_controller import TaskController
from atoll_coordinator.service.workers.channel import WorkerChannel
from atoll_coordinator.service.workers.worker_controller import WorkerController
from atoll_coordinator.tasks.preparing import Prepared
from atoll_coordinator.tasks.refining import Searched
from atoll_core.config import JobConfig
from atoll_core.errors import RefusedError, RemoteProtocolError, StoreError, TableMissingError
from atoll_core.logs import about
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.clients import AskAnalysis, QueueDepth, Submit
from atoll_core.wire.messages.epochs import EpochReport, PullStates, States
from atoll_core.wire.messages.tasks import TaskReport
from atoll_core.wire.messages.views import TaskView, WorkerService
from atoll_core.wire.messages.workers import Close, CloseJob, WorkerStatus

_SAVE_S: Final = 10.0
"""Seconds between two commits of task time. A killed coordinator loses the task time since the last commit."""

_HAD_BEGUN_S: Final = -1e9
"""Start of the waiting time of a job that had begun before a restart; such a job comes before all other jobs."""


class JobController:
    """All live jobs, and the workers that compute them. `shown` returns the views of live and ended jobs."""

    def __init__(
        self, store: Store, channel: WorkerChannel, background: background.Background, post: Callable[[object], None],
        clock: Callable[[], str], expected_workers: int = 1,
    ) -> None:  # fmt: skip
        """Set up the controller; no island is placed before the expected workers are ready.

        `background` works on large values, `post` hands outcomes to the loop, `clock` returns the time of day as text.
        """
        self.jobs: dict[str, Job] = {}
        self.begun: Final[dict[str, Job]] = {}
        """Jobs that are not queued: only these are visited at each tick."""
        self.ending: Final[dict[str, Ending]] = {}
        """Jobs whose ends take effect when their results are composed. Until then the store has their previous states,
        and a restarted coordinator continues them."""
        self.queue: Final = JobQueue()
        self.live_of: Final[Counter[str | None]] = Counter()
        """Number of jobs of each user that have not ended."""
        self.queue.task_time = TaskTime(_day_of(store), store.usage(_day_of(store)))
        self._saved_at = 0.0
        self._excluded_at: float | None = None
        self.events: Final = EventLog(store, clock)
        self.breakages: Final = Breakages(lambda sentence: self.events.record("broken", sentence))
        self.workers: Final = WorkerController(self, store, channel, self.events, expected_workers)
        self.counters: Final = self.workers.counters
        self.equations: Final = ViewEquations(background.write_front)
        self.shown: Final = JobViews(self.jobs, self.ending, self.queue, self, store, self.breakages)
        self.checkpoints: Final = PullBudget()
        self.changed: Callable[[str], object] = lambda job: None
        """Called with the id of each job that has changed."""
        self._store = store
        self._turns: Final = TaskTurns()
        self._composing: Final[set[str]] = set()
        self.tasks: Final = TaskController(
            channel,
            self.workers.membership,
            post,
            background.read_result,
            self._order,
            self._may_follow,
            self._charge,
            self._turns.forget,
        )
        self._channel = channel
        self._background = background
        self._clock = clock

    # ------------------------------------------------------------------------------------------- jobs

    def recover(self, now: float) -> None:
        """Continue the stored jobs that have not ended, from their checkpoints. A job that cannot be read fails."""
        self.queue.is_paused = self._store.is_queue_paused()
        self.workers.membership.set_cordons(self._store.cordons())
        for record in self._store.open_jobs():
            with self.guarded(record.id, "continuing a job", now):
                if not record.is_sound:
                    self._end_without_job(record.id, checks.DAMAGED_RECORD)
                    continue
                try:
                    config = JobConfig.model_validate_json(record.spec)
                except ValidationError as error:
                    self._end_without_job(record.id, checks.settings_reason(error))
                else:
                    self._take_over(record, config, now)

    def _take_over(self, record: JobRecord, config: JobConfig, now: float) -> None:
        """Continue a stored job; if its prepared data are stored, it needs no worker and keeps the equations found."""
        has_begun = record.state != "queued"
        if record.submitted_s is not None:
            record = replace(record, elapsed=max(record.elapsed, self._store.served_s - record.submitted_s))
        self._add(Job(record, config, now), _HAD_BEGUN_S if has_begun else now, has_begun=has_begun)
        self.workers.crash_loops.recover(record.id)
        if record.prepared_digest is None or record.dataset_digest is None:
            return
        if not self._store.is_sound(record.dataset_digest):  # workers would ask for the damaged dataset for ever
            return
        try:
            prepared = self.tasks.take_prepared(
                record.id, record.prepared_digest, self._store.get_blob(record.prepared_digest)
            )
        except (KeyError, RemoteProtocolError):  # damaged or of another version: the data are prepared again
            return
        self._change(record.id, "continuing a job", now, lambda job: self._continue(job, record, prepared, now))

    def _continue(self, job: Job, record: JobRecord, prepared: Prepared, now: float) -> Sequence[JobAction]:
        """Continue a job in the state that it had when the coordinator ended, held until its next turn."""
        job.start_preparing()
        self.begun[job.id] = job
        self.queue.take_over(job.id)
        actions = self._set_up(job, record.dataset_digest, prepared, now)
        if not job.has_ended:
            job.hold(job.state == "running")
            self.events.record("resumed", "the coordinator was started again; the job continues from the store", job.id)
        return actions

    def submit(self, body: Submit, now: float, submitter: str | None = None) -> None:
        """Accept a job. A repeated submission (same id, same contents) changes nothing, not even the submitter.

        Raises:
            RefusedError: The id belongs to another job or to a deleted job.
            TableMissingError: The table has not been uploaded, or was deleted.
        """
        spec = body.config.model_dump_json()
        known = self._store.job(body.job)
        if known is not None:
            if (known.spec, known.table_digest, known.priority) != (spec, body.table, body.priority):
                raise RefusedError(f"job {body.job} exists already with other contents; submit under another id")
            return
        if self._store.is_deleted(body.job):  # workers may still have its data, and would use them for this job
            raise RefusedError(f"job {body.job} was deleted, and its id is not used again; submit under another id")
        if not self._store.has_blob(body.table):
            raise TableMissingError(f"the table of job {body.job} has not been uploaded; upload it, then submit again")
        submitted = self._clock()
        record = JobRecord(
            body.job, body.name, spec, body.table, submitted,
            priority=body.priority, submitter=submitter, shared=int(body.shared), submitted_s=self._store.served_s,
        )  # fmt: skip
        self._store.add_job(record)
        with self.guarded(body.job, "accepting a job", now):
            self._add(Job(record, body.config, now), now)
            self.events.record("submitted", f"submitted as {body.name!r}", body.job, priority=body.priority)
        self._apply_decision(now)

    def _add(self, job: Job, asked_at: float, *, has_begun: bool = False) -> None:
        """Add a job to the queue; its waiting time counts from `asked_at` (seconds of the bus).

        A job that `has_begun` before a restart continues even if the queue is paused.
        """
        self.jobs[job.id] = job
        self.live_of[job.submitter] += 1
        self.queue.add(
            job.id, job.submitter, job.priority, asked_at, is_paused=job.is_paused, had_begun=has_begun
        )  # fmt: skip

    def pause(self, job_id: str, is_paused: bool, now: float) -> None:
        """Pause or resume a job. A pause is stored, so it stays after a restart.

        Raises:
            RefusedError: The job has ended, or is being refined; refining is not interrupted.
        """
        job = self._live(job_id, "paused or resumed")
        if job.state == "refining" and is_paused and not self.tasks.waits(job_id):
            raise RefusedError(f"job {job_id} is being refined, which cannot be interrupted; wait for its end")
        self._store.update_job(job_id, paused=int(is_paused))
        with self.guarded(job_id, "pausing a job", now):
            job.is_paused = is_paused
            if job.state != "refining":
                self.queue.pause(job_id, is_paused)
            if self.queue.is_held(job_id):
                job.hold(True)
            text = "paused: its islands stop at a checkpoint" if is_paused else "resumed: it continues at its next turn"
            self.events.record("held" if is_paused else "resumed", text, job_id)
        self._exclude_waiting(now)
        self._apply_decision(now)
        self._place(now)

    def set_priority(self, job_id: str, priority: int, now: float) -> None:
        """Change the priority of a job and announce it to workers. Raises RefusedError when it has ended."""
        job = self._live(job_id, "given another priority")
        self._store.update_job(job_id, priority=priority)
        with self.guarded(job_id, "changing a priority", now):
            job.priority = priority
            self.queue.set_priority(job_id, priority)
            self.events.record("changed", f"its priority is {priority} now", job_id)
            if job.state == "running":
                self._channel.publish(job.announcement())
        self._apply_decision(now)

    def share(self, job_id: str, is_shared: bool) -> None:
        """Let all users see a job, or only its submitter and admins."""
        self._store.share_job(job_id, is_shared)
        self.events.record(
            "changed", "all users may see it" if is_shared else "only its submitter and admins may see it", job_id
        )
        ending = self.ending.get(job_id)
        job = ending.job if ending is not None else self.jobs.get(job_id)
        if job is not None:
            job.is_shared = is_shared

    def submission_again(self, job_id: str, again: str) -> Submit:
        """Return the submission of a job under another id.

        Raises:
            RefusedError: The job did not fail and was not cancelled, or this version cannot read its settings.
        """
        record = self._store.job(job_id)
        if record is None or record.state not in ("failed", "cancelled"):
            raise RefusedError(f"job {job_id} has not failed; only failed or cancelled jobs can be tried again")
        try:
            config = JobConfig.model_validate_json(record.spec)
        except ValidationError as error:
            raise RefusedError(f"job {job_id} cannot be tried again: {checks.settings_reason(error)}") from error
        return Submit(
            job=again, name=record.name, config=config, table=record.table_digest,
            priority=record.priority, shared=bool(record.shared),
        )  # fmt: skip

    def pause_queue(self, is_paused: bool, now: float) -> None:
        """Pause or resume the queue; the setting is stored."""
        self._store.pause_queue(is_paused)
        self.queue.is_paused = is_paused
        self.events.record(
            "changed",
            "the queue is paused: no more jobs are started" if is_paused else "the queue is resumed: jobs are started",
        )
        self._apply_decision(now)

    def set_worker(self, worker: str, service: WorkerService, now: float) -> None:
        """Open, cordon or drain a worker; the setting is stored. Raises RefusedError for an unknown worker."""
        cordons = self._store.cordons()
        if self.workers.membership.member(worker) is None and worker not in cordons:
            raise RefusedError(f"there is no worker {worker!r}; 'coordinator workers' lists all of them")
        self._store.cordon(worker, None if service == "open" else service == "draining")
        self.workers.membership.set_cordons(self._store.cordons())
        self.events.record("changed", f"it is now {service}", worker=worker)
        self._place(now)

    def _live(self, job_id: str, what: str) -> Job:
        job = self.jobs.get(job_id)
        if job is None:
            raise RefusedError(f"job {job_id} has ended and cannot be {what}; coordinator retry submits it again")
        return job

    def analyse(self, asked: AskAnalysis, user: str | None, now: float) -> RequestedAnalysis:
        """Return a question about the result of a job, with its answer if there is one. A new question becomes a task.

        Raises:
            RefusedError: The job has no result (yet), or the user has too many open questions.
            TableMissingError: The table was deleted.
        """
        known = self.tasks.analyses.ask(asked, now)
        if known is not None:
            return known
        if self.shown.is_open(asked.job):
            raise RefusedError(f"job {asked.job} has not ended; ask about its result after its end")
        if self.queue.has_no_time(user):
            raise RefusedError(f"the question {NO_TIME}; ask tomorrow, or analyse the saved result yourself")
        text = self._store.result(asked.job)
        if text is None:
            raise RefusedError(f"job {asked.job} has ended without a result, so there is nothing to ask about")
        size = self._store.blob_size(asked.table) if asked.table is not None else 0
        if asked.table is not None and not size:
            raise TableMissingError("the table of the question has not been uploaded; upload it, then ask again")
        return self.tasks.analyse(asked, text.encode(), size, user, now)

    def queue_depth(self) -> QueueDepth:
        """Return the numbers of jobs by state, and of islands and tasks that could be computed now."""
        queue = self.queue
        return queue_depth(
            self.begun.values(), queue.queued, queue.ready, queue.limits.total.running, self.tasks.analyses.open_count
        )

    def cancel(self, job_id: str, now: float) -> None:
        """End a job and keep its equations; without effect if it has ended or is `ending`.

        Raises:
            RefusedError: After a restart, its data must be prepared again before its equations can be kept.
        """
        job = self.jobs.get(job_id)
        if job is not None and job.prepared is None and self._store.has_search(job_id):
            raise RefusedError(
                f"job {job_id} continues a stored search, whose equations cannot be kept before its data "
                "are prepared again; start a worker, and cancel the job when `status` shows equations"
            )
        self._change(job_id, "cancelling", now, Job.cancel)

    def _start(self, job: Job, made: background.JobPrepared, now: float) -> Sequence[JobAction]:
        if job.state != "preparing":
            return ()
        actions = self._set_up(job, made.former, made.prepared, now)
        if job.has_ended:
            return actions
        self.queue.search(job.id)
        job.hold(self.queue.is_held(job.id))
        self._store.update_job(job.id, state="running")
        sought = ", ".join(job.archipelagos)
        self.events.record("prepared", f"data are prepared; sought: {sought or 'nothing'}", job.id)
        return actions

    def _set_up(self, job: Job, dataset: str | None, prepared: Prepared, now: float) -> Sequence[JobAction]:
        """Set up the search of a prepared job from its stored cuts and checkpoints. If they do not fit, the job fails.

        `dataset` is the digest of the dataset that was prepared before a restart, if any.
        """
        unknown = checks.epoch_limit_reason(job.config, prepared)
        if unknown is not None:
            return job.fail("data", unknown)
        try:
            cuts = {name: decode(data, Cut) for name, data in self._store.cuts(job.id).items()}
            stored = self._stored_checkpoints(job, prepared)
            resumed = {name: decode(data, StoredSearchState) for name, (_, data) in stored.items() if name not in cuts}
        except RemoteProtocolError as error:  # another version has written the checkpoint or cut
            return job.fail("internal", checks.stored_search_reason(error))
        reason = checks.resume_reason(prepared, dataset, bool(cuts), resumed)
        if reason is not None:
            return job.fail("internal", reason)
        return job.start(prepared, cuts, now, resumed)

    def _stored_checkpoints(self, job: Job, prepared: Prepared) -> dict[str, tuple[int, bytes]]:
        """Return epoch and contents of the checkpoints from which a search continues, by variable.

        If states of the last checkpoint are damaged, the search continues from the previous checkpoint, or from the
        beginning. The result is the same, because epochs are pure functions.
        """
        last = self._store.checkpoints(job.id)
        whole = self._store.whole_checkpoints(job.id, prepared.config.evolution.islands) if last else {}
        for variable in last:
            if whole.get(variable) != last[variable]:
                epoch = whole[variable][0] if variable in whole else 0
                text = (
                    f"states of its last checkpoint are damaged in the store; its search continues from epoch {epoch}"
                )
                self.events.record("unplaced", text, job.id, variable=variable, epoch=epoch)
        return whole

    def has_lost(self, pull: PullStates) -> bool:
        """Return whether the missing states that a pull asks for are states from which a search continues now."""
        job = self.jobs.get(pull.job)
        archipelago = job.open_archipelago(pull.variable) if job is not None else None
        if archipelago is None or archipelago.durable == 0 or pull.epoch != archipelago.durable:
            return False
        return set(pull.islands) <= set(range(archipelago.collector.limits.islands))

    def fail_job(self, job_id: str, fault: Fault, sentence: str, now: float) -> None:
        """Let a job fail; without effect when it has ended."""
        self._change(job_id, "ending", now, lambda job: job.fail(fault, sentence))

    def job_of_dataset(self, digest: str) -> str | None:
        """Return the id of a live job whose prepared dataset has this digest; None: there is no such job."""
        jobs = (job.id for job in self.begun.values() if job.prepared is not None and job.prepared.blob == digest)
        return next(jobs, None)

    # ---------------------------------------------------------------------------------------- outcomes

    def take_outcome(self, item: background.Outcome, now: float) -> None:
        """Handle an outcome of background work or of a task.

        Each outcome is posted only once, so an error in handling it must end its job.
        """
        match item:
            case background.TableChecked():
                with self.guarded(item.job, "preparing a job", now):
                    self._prepare_checked(item, now)
            case background.PreparationBegun():
                self._change(item.job, "preparing a job", now, lambda job: job.start_clock(now))
            case background.JobPrepared():
                self._change(item.job, "beginning the search", now, lambda job: self._start(job, item, now))
                self._place(now)
            case background.PreparationFailed():
                self.fail_job(item.job, item.fault, item.sentence, now)
            case background.JobRefined():
                self._change(item.job, "ending", now, lambda job: job.finish(item.text))
            case background.RefiningFailed():
                self._change(item.job, "ending", now, lambda job: job.finish_unrefined(item.refinement))
            case FrontWritten():
                self.shown.add_written(item)
                self.changed(item.front.job)
            case background.CheckpointWritten():
                with self.guarded(item.checkpoint.job, "committing a checkpoint", now):
                    self._commit_checkpoint(item, now)
                if self._may_change_placement(item.checkpoint):  # it has waited for this checkpoint
                    self._place(now)
                self._advance_waiting(now)

    def _prepare_checked(self, checked: background.TableChecked, now: float) -> None:
        job = self.jobs.get(checked.job)
        if job is None or job.state != "preparing":  # the job has ended in the meantime
            return
        if checked.error is not None:
            raise checked.error
        if not checked.is_sound:
            self.fail_job(job.id, "internal", "its table is missing or damaged in the store; submit it again", now)
            return
        self.tasks.prepare(job.id, job.table, self._store.blob_size(job.table), job.config, now)
        self.changed(job.id)

    def _commit_checkpoint(self, written: background.CheckpointWritten, now: float) -> None:
        """Publish the commit of a written checkpoint; raises the error of writing it."""
        self.checkpoints.mark_written(written.checkpoint)
        if written.error is not None:
            raise written.error
        self._mark_durable(written.checkpoint, now)

    # --------------------------------------------------------------------------- workers' reports, time

    def add_heartbeat(self, worker: str, status: WorkerStatus, now: float) -> None:
        """Handle a heartbeat: the worker's state, islands, tasks, and epochs of snapshots.

        Raises:
            RemoteProtocolError: The worker names a later incarnation that does not exist.
            StoreError: The later incarnation exists: another coordinator has taken over.
        """
        is_known = self.workers.add_heartbeat(worker, status, now)
        if is_known:
            computed = ((amount.submitter, amount.seconds) for amount in status.computed)
            self.queue.task_time.add_heartbeat(worker, status.instance, computed)
            with self.breakages.tolerated("comparing the tasks of a worker"):
                self.tasks.add_heartbeat(worker, status, now)
        for assignment_status in status.holdings if is_known else ():
            self._advance_checkpoint(assignment_status.job, assignment_status.variable, now)

    def has_task(self, worker: str) -> bool:
        """Return whether a worker has a task."""
        return self.tasks.table.on(worker) is not None

    def lose_tasks(self, worker: str, now: float, *, had_left: bool) -> tuple[str, ...]:
        """Let the tasks of a lost worker wait for other workers; return the jobs of these tasks.

        The worker `had_left` if it had announced its end.
        """
        with self.breakages.tolerated("taking tasks from a worker that is lost"):
            return self.tasks.lose(worker, now, had_left=had_left)
        return ()

    def stalls(self, job_id: str) -> tuple[str, ...]:
        """Return sentences on why archipelagos of a job make no progress, by variable."""
        return self.workers.stalls(job_id)

    def task_views(self, job_id: str) -> tuple[TaskView, ...]:
        """Return the views of the tasks of a job."""
        return self.tasks.views(job_id)

    def waiting_reason(self, job: Job) -> str | None:
        """Return a sentence on why the islands or tasks of a job wait; None: they do not wait."""
        reason = self.workers.waiting_reason(job) or self.tasks.waiting_reason(job.id)
        if reason is None or self._may_run(job) or job.state != "refining":
            return reason
        return pause_reason(job.id) if job.is_paused else NO_TIME

    def add_task_report(self, worker: str, report: TaskReport, now: float) -> None:
        """Handle a worker's report on a task; raises RemoteProtocolError when it is impossible."""
        task = self.tasks.table.get(report.body.task)
        with self.guarded(task.job if task is not None else "", "handling the result of a task", now, by_peer=True):
            self.tasks.add_report(worker, report, now)

    def take_result(self, read: background.ResultRead, now: float) -> None:
        """Handle the result of a task; raises RemoteProtocolError if it was damaged in transit."""
        with self.guarded(read.result.job, "handling the result of a task", now, by_peer=True):
            self.tasks.take_result(read, now)

    def _may_follow(self, job_id: str) -> bool:
        """Return whether a job may soon create a task: after a restart, for example, its data are prepared first."""
        job = self.jobs.get(job_id)
        return job is not None and job.state in ("queued", "preparing")

    def _order(self, waiting: Collection[str], running: Collection[str]) -> list[str]:
        """Return the ids of jobs and questions whose waiting tasks may be leased, in the order of their turns."""
        ready = [one for one in map(self._find_turn, waiting) if one is not None and self._may_run(one)]
        served = [one for one in map(self._find_turn, running) if one is not None]
        return self._turns.order_tasks([*map(_turn, ready)], [*map(_turn, served)])

    def _find_turn(self, turn: str) -> Job | RequestedAnalysis | None:
        return self.jobs.get(turn) or self.tasks.analyses.get(turn)

    def _may_run(self, turn: Job | RequestedAnalysis) -> bool:
        """Return whether waiting tasks of a job, or of a question, may be leased. Running tasks are not affected."""
        is_paused = isinstance(turn, Job) and turn.is_paused
        return not (is_paused or self.queue.has_no_time(turn.submitter))

    def _charge(self, turn: str, seconds: float) -> None:
        """Charge the user of a job, or of a question, for the time of workers."""
        charged = self._find_turn(turn)
        if charged is not None:
            self.queue.task_time.charge(charged.submitter, seconds)
            self._turns.charge(charged.submitter, seconds)

    def add_report(self, worker: str, report: EpochReport, now: float) -> None:
        """Handle a report of islands; raises RemoteProtocolError when it is impossible."""
        job = self.jobs.get(report.job)
        if job is None:
            if self._store.job(report.job) is None:
                raise RemoteProtocolError(f"a report of job {report.job} came, which does not exist")
            return

        def add(job: Job) -> Sequence[JobAction]:
            self.counters.add(job.id, reports=1)
            return job.add_report(worker, report, now)

        self._change(job.id, "adding a report", now, add, by_peer=True)
        self._advance_checkpoint(job.id, report.variable, now)

    def tick(self, now: float) -> None:
        """Do the work of each tick: lost workers, `--max-time`, turns of jobs, tasks, checkpoints, stalls, events."""
        with self.breakages.tolerated("looking for lost workers"):
            self.workers.expire(now)
        with self.breakages.tolerated("counting task time"):
            self._count_time(now)
        self._exclude_waiting(now)
        for job_id in tuple(self.begun):
            self._change(job_id, "letting time pass", now, lambda job: job.tick(now))
        self._apply_decision(now)
        with self.breakages.tolerated("leasing tasks"):
            self.tasks.tick(now)
        self._place(now)
        self._advance_checkpoints(now)
        with self.breakages.tolerated("looking for stalls"):
            self.workers.check_stalls(now)
        with self.breakages.tolerated("writing events"):
            self.events.flush()

    def _count_time(self, now: float) -> None:
        """Store the task time of all users."""
        if now - self._saved_at >= _SAVE_S:
            self._saved_at = now
            unsaved = self.queue.task_time.take_unsaved()
            if unsaved or self.jobs:
                self._store.add_usage(_day_of(self._store), unsaved)
            self.queue.task_time.begin_day(_day_of(self._store))

    def _exclude_waiting(self, now: float) -> None:
        """Do not count the time for which jobs wait for a worker that refines them.

        Jobs that wait to be prepared but may not run give their places back.
        """
        seconds = now - self._excluded_at if self._excluded_at is not None else 0.0
        self._excluded_at = now
        for job in tuple(self.begun.values()):
            if job.state in ("preparing", "refining") and self.tasks.waits(job.id):
                with self.guarded(job.id, "letting a job wait", now):
                    if job.state == "refining":
                        job.wait_to_be_refined(seconds)
                    elif not self._may_run(job):
                        self._put_back(job)

    def _put_back(self, job: Job) -> None:
        self._store.update_job(job.id, state="queued")
        self.tasks.cancel(job.id)
        job.put_back()
        del self.begun[job.id]
        self.queue.put_back(job.id)
        self.changed(job.id)

    def _place(self, now: float) -> None:
        """Place islands. This step concerns all jobs, so an error in it ends no job."""
        with self.breakages.tolerated("placing islands"):
            self.workers.place(now)

    # ------------------------------------------------------------------------------------- checkpoints

    def add_states(self, worker: str, pull: PullStates, body: States | None, now: float) -> None:
        """Handle the answer to a pull of states; None: there was no answer, and the states are pulled again later.

        Raises:
            RemoteProtocolError: A state was damaged in transit.
        """
        job = self.jobs.get(pull.job)
        archipelago = job.archipelagos.get(pull.variable) if job is not None else None
        with self.guarded(pull.job, "adding states", now, by_peer=True):
            self.checkpoints.add_states(archipelago, worker, pull, body)
        if body is not None:
            self._advance_checkpoint(pull.job, pull.variable, now)
            self._advance_waiting(now)

    def _may_change_placement(self, checkpoint: Checkpoint) -> bool:
        """Return whether the archipelago of a checkpoint that was written may now begin another term."""
        job = self.jobs.get(checkpoint.job)
        archipelago = job.open_archipelago(checkpoint.variable) if job is not None else None
        if job is None or archipelago is None:
            return False
        return job.is_held or archipelago.placement is None or archipelago.is_planned

    def _mark_durable(self, checkpoint: Checkpoint, now: float) -> None:
        job = self.jobs.get(checkpoint.job)
        archipelago = job.archipelagos.get(checkpoint.variable) if job is not None else None
        if archipelago is None:
            return
        commit = archipelago.mark_durable(checkpoint, now)
        self.counters.add(checkpoint.job, commits=1)
        self.workers.crash_loops.add_commit(checkpoint.key, checkpoint.epoch)
        self.events.record_commit(checkpoint)
        if commit is not None:
            self.workers.tell(archipelago, commit)

    def _advance_checkpoints(self, now: float) -> None:
        """Pull the states that are due, and start writing complete checkpoints."""
        with self.breakages.tolerated("gathering checkpoints"):
            self.checkpoints.begin_round({archipelago.key: archipelago for archipelago in self._open_archipelagos()})
        for archipelago in self._open_archipelagos():
            self._advance_checkpoint(archipelago.job, archipelago.variable, now)

    def _advance_waiting(self, now: float) -> None:
        """Pull the states that waited for the end of other pulls, or for memory."""
        for job_id, variable in self.checkpoints.waiting:
            self._advance_checkpoint(job_id, variable, now)

    def _advance_checkpoint(self, job_id: str, variable: str, now: float) -> None:
        """Pull states and write the checkpoint of one archipelago: a visit to all at each message would be slow."""
        with self.guarded(job_id, "gathering a checkpoint", now):
            job = self.jobs.get(job_id)
            archipelago = job.open_archipelago(variable) if job is not None else None
            if job is None or archipelago is None:
                return
            for worker, pull in self.checkpoints.next_pulls(archipelago):
                self._channel.pull(worker, pull)
            checkpoint = self.checkpoints.take_complete_checkpoint(archipelago)
            if checkpoint is not None:
                search_state = encode(checkpoint.stored_search_state(job.search_seconds(now)))
                self._background.write_checkpoint(checkpoint, search_state, now - job.submitted_at)

    # ------------------------------------------------------------------------------------ changes and errors

    def _change(
        self, job_id: str, task: str, now: float, act: Callable[[Job], Sequence[JobAction]], *, by_peer: bool = False
    ) -> None:
        """Change a live job by `act`, and carry out the actions that it returns; all changes go through this method."""
        job = self.jobs.get(job_id)
        if job is not None:
            with self.guarded(job_id, task, now, by_peer=by_peer):
                self._carry_out(job, act(job), now)
            self.changed(job_id)

    def guarded(self, job_id: str, task: str, now: float, *, by_peer: bool = False) -> AbstractContextManager[None]:
        """Let an error within the block end only this job, which the block may have changed in part.

        `by_peer`: the block handles a message of a peer. A RemoteProtocolError then means that the message was wrong
        and has changed nothing; this error is raised. A StoreError does not concern a single job, and is raised as
        well.
        """
        return _Guard(self, job_id, task, now, by_peer)

    def end_by_error(self, job_id: str, task: str, error: Exception, now: float) -> None:
        """End a job by an internal error during `task`, which may have changed the job in part."""
        job, ending = self.jobs.get(job_id), self.ending.get(job_id)
        job = ending.job if ending is not None else job
        self._end_broken(job_id, self.breakages.add(task, error, job.config if job is not None else None), now)

    def _end_broken(self, job_id: str, sentence: str, now: float) -> None:
        """End a job that an error may have changed only in part, with as much of its result as possible."""
        job, ending = self.jobs.get(job_id), self.ending.get(job_id)
        if ending is not None and ending.sentence is not None:  # the job is already ending with an error
            return
        self.ending.pop(job_id, None)
        self._remove(job_id)
        if self._store.job(job_id) is None:
            return
        broken = _broken(ending.job if ending is not None else job, sentence)
        if broken is None:
            self._end_without_job(job_id, sentence)
            self._close(job_id)
        else:
            self._compose(broken)

    def _close(self, job_id: str) -> None:
        """Close a job that ended with an error on all workers, and forget it."""
        with self.breakages.tolerated("closing a job"):
            self._channel.publish(CloseJob(job=job_id))
        with self.breakages.tolerated("ending the tasks of a job"):
            self.tasks.cancel(job_id)
        with self.breakages.tolerated("forgetting the counters of a job"):
            self.counters.forget(job_id)
        with self.breakages.tolerated("forgetting a job"):
            self.workers.crash_loops.forget(job_id)

    def _compose(self, ending: Ending) -> None:
        """Let the end of a job take effect when its result is composed."""
        self.ending[ending.job.id] = ending
        self._background.compose_result(ending.draft)

    def compose(self, draft: Draft) -> None:
        """Start composing the best result so far of a live job, unless this is in progress."""
        if draft.job not in self._composing:
            self._composing.add(draft.job)
            self._background.compose_result(draft)

    def finish_composing(self, composed: background.ResultComposed, now: float) -> str:
        """Return the composed result of a live job; raises the error of composing it."""
        self._composing.discard(composed.draft.job)
        if composed.error is not None:
            raise composed.error
        return timed(composed.text, now - composed.draft.submitted_at)

    def finish_ending(self, composed: background.ResultComposed, now: float) -> None:
        """Complete the end of a job, whose result is composed now; without effect if the job has ended otherwise."""
        job_id = composed.draft.job
        ending = self.ending.get(job_id)
        if ending is None or ending.draft is not composed.draft:
            return
        with self.guarded(job_id, "ending", now):
            if ending.sentence is not None:
                del self.ending[job_id]
                text = timed(composed.text, now - ending.job.submitted_at) if composed.error is None else None
                self._end_without_job(job_id, ending.sentence, text)
                self._close(job_id)
            elif composed.error is not None:
                raise composed.error
            else:
                ending.job.result_text = composed.text
                self._commit_result(ending.job, now)
                del self.ending[job_id]
        self.changed(job_id)

    def _end_without_job(self, job_id: str, reason: str, text: str | None = None) -> None:
        """Fail a stored job that is not live, unless it has ended."""
        if self._store.commit_result(job_id, "failed", text, reason, self._clock()):
            with self.breakages.tolerated("recording the end of a job"):
                self.events.record("failed", reason, job_id)

    # ----------------------------------------------------------------------------------------- actions

    def _carry_out(self, job: Job, actions: Sequence[JobAction], now: float) -> None:
        for action in actions:
            match action:
                case CommitCuts():
                    self._commit_cuts(job, action.cuts)
                case PublishCommit():
                    self.workers.tell(job.archipelagos[action.commit.variable], action.commit)
                case Refine():
                    self.queue.remove(job.id)
                    self._store.update_job(job.id, state="refining")
                    if job.prepared is not None:
                        text = "all searches have ended; its equations are being refined"
                        self.events.record("refining", text, job.id)
                        searched = Searched(job.id, tuple(outcomes_of(job)))
                        self.tasks.refine(searched, job.prepared.config, action.seconds, now)
                case CommitResult():
                    self._end(job, now)

    def _commit_cuts(self, job: Job, cuts: Sequence[Cut]) -> None:
        self._store.commit_cuts(job.id, {cut.variable: encode(cut) for cut in cuts})
        for cut in cuts:
            archipelago = job.archipelagos[cut.variable]
            if archipelago.placement is not None:
                close = Close(job=job.id, variable=cut.variable, term=archipelago.placement.term)
                self.workers.tell(archipelago, close)
            self.events.record_cut(job.id, cut)

    def _end(self, job: Job, now: float) -> None:
        """End a job: at once if it has a result or cannot have one, otherwise when its result is composed.

        Before the result is composed, nothing about the end is stored or sent. So the job continues if the coordinator
        dies before that, and workers still compute for it.
        """
        draft = draft_of(job) if job.result_text is None else None
        if draft is None:
            self._commit_result(job, now)
            return
        self._remove(job.id)
        self._compose(Ending(job, job.former_state, draft))
        self._apply_decision(now)

    def _commit_result(self, job: Job, now: float) -> None:
        result = timed(job.result_text, now - job.submitted_at) if job.result_text is not None else None
        text = self._fitting(job, result)
        self._store.update_job(job.id, elapsed=now - job.submitted_at)
        is_crash_loop, finished = job.fault == "poison", self._clock()
        view = self.shown.last_view(job, now).model_dump_json()
        self._store.commit_result(
            job.id, job.state, text, job.reason, finished, keeps_checkpoints=is_crash_loop, view=view
        )
        self._channel.publish(CloseJob(job=job.id))
        self.tasks.cancel(job.id)
        self._remove(job.id)
        self.events.record_end(job)
        self.counters.forget(job.id)
        self.workers.crash_loops.forget(job.id)
        self._apply_decision(now)

    def _fitting(self, job: Job, text: str | None) -> str | None:
        """Return the result if its user may store it, after deleting the user's oldest ended jobs if necessary.

        If no ended job is left and the result is still too large, the job fails and None is returned.
        """
        most = self.queue.limits.of(job.submitter).stored
        if text is None or most is None:
            return text
        size = len(text.encode())
        while self._store.held(job.submitter).stored + size > most:
            oldest = self._store.oldest_ended_job(Viewer(job.submitter))
            if oldest is None:
                job.state, job.fault = "failed", "internal"
                job.reason = (
                    f"its result of {size} bytes exceeds the {most} that limits let its user store; delete "
                    "jobs or have the limit raised, then: coordinator retry"
                )
                job.result_text = None
                return None
            self.forget_ended(oldest.id, "a newer job of its user needs the space that limits allow")
        return text

    def forget_ended(self, job_id: str, reason: str) -> None:
        """Delete a job that has ended."""
        self.events.flush()  # otherwise its last events would be written after its deletion
        self.tasks.cancel(job_id)
        self._store.delete_job(job_id)
        self.events.record("deleted", f"job {job_id} is deleted: {reason}")

    def _remove(self, job_id: str) -> None:
        job = self.jobs.get(job_id)
        if job is not None:
            self.live_of[job.submitter] -= 1
        self.jobs.pop(job_id, None)
        self.begun.pop(job_id, None)
        self.queue.remove(job_id)
        self._turns.forget(job_id)

    def _apply_decision(self, now: float) -> None:
        """Start, hold and release jobs by the decision of the queue."""
        with self.breakages.tolerated("deciding about turns"):
            self.queue.charge(now)
            decision = self.queue.decide()
            for job_id in decision.hold:
                self._change(job_id, "holding a job", now, lambda job: job.hold(True))
            for job_id in decision.release:
                self._change(job_id, "releasing a job", now, lambda job: job.hold(False))
            for job_id in decision.take_up:
                with self.guarded(job_id, "preparing a job", now):
                    self._prepare(job_id, now)

    def _prepare(self, job_id: str, now: float) -> None:
        waiting = self.jobs.get(job_id)
        if waiting is None or waiting.state != "queued":  # the end of an earlier job in the list has started it
            return
        # Store first: if the store fails (full disk), the job must stay in the queue, or it would never be prepared.
        self._store.update_job(waiting.id, state="preparing")
        waiting.start_preparing()
        self.begun[job_id] = waiting
        self.queue.begin(job_id)
        self.changed(waiting.id)
        self._background.check_table(waiting.id, waiting.table)

    def _open_archipelagos(self) -> list[Archipelago]:
        return [archipelago for job in self.begun.values() for archipelago in job.open_archipelagos]


class _Guard:
    """The context of `JobController.guarded`. A class, because a message enters several of these contexts, and a
    generator takes three times as long."""

    __slots__ = ("_about", "_by_peer", "_controller", "_job_id", "_now", "_task")

    def __init__(self, controller: JobController, job_id: str, task: str, now: float, by_peer: bool) -> None:
        self._controller = controller
        self._job_id = job_id
        self._task = task
        self._now = now
        self._by_peer = by_peer
        self._about = about(job=job_id or None)

    def __enter__(self) -> None:
        self._about.__enter__()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        self._about.__exit__(kind, error, trace)
        if not isinstance(error, Exception) or isinstance(error, StoreError):
            return False
        if self._by_peer and isinstance(error, RemoteProtocolError):
            return False
        self._controller.end_by_error(self._job_id, self._task, error, self._now)
        return True


def _broken(job: Job | None, sentence: str) -> Ending | None:
    """Return the end of a job by an error, with its equations; None if its result cannot be composed."""
    with contextlib.suppress(Exception):
        if job is not None and job.prepared is not None:
            was = job.former_state if job.has_ended else job.state
            job.state, job.fault, job.reason = "failed", "internal", sentence
            draft = draft_of(job)
            return Ending(job, was, draft, sentence) if draft is not None else None
    return None


def _turn(one: Job | RequestedAnalysis) -> Turn:
    return Turn(one.id, one.submitter, one.priority, one.submitted_at)


def _day_of(store: Store) -> int:
    """Return the number of the day of service."""
    return int(store.served_s // DAY_S)
