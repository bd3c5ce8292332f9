"""What becomes of jobs: takes in what happens, and has the rooms below decide, store, send and compute.

Knows no bus and no thread. What is sent has been stored before. Where something of ours breaks, the job that it
concerns ends (`JobController.guarded`), and nothing else.

One module, since every change of a job goes through `JobController._change`, be it a request, a report, a checkpoint or
the time: whoever reads one of them reads what ends a job and what follows from its end.
"""

import contextlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from typing import Final

from pydantic import ValidationError

from atoll_coordinator.model.refinement import Refinement
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
from atoll_coordinator.service.monitoring.drafts import Draft, Ending, draft_of
from atoll_coordinator.service.monitoring.event_log import EventLog
from atoll_coordinator.service.monitoring.job_views import JobViews
from atoll_coordinator.service.monitoring.queue_depth import queue_depth
from atoll_coordinator.service.monitoring.views import outcomes_of
from atoll_coordinator.service.scheduling.job_queue import NO_TIME, JobQueue, pause_reason
from atoll_coordinator.service.scheduling.limits import DAY_S, Limits
from atoll_coordinator.service.scheduling.task_time import TaskTime
from atoll_coordinator.service.scheduling.task_turns import TaskTurns
from atoll_coordinator.service.search.archipelago import Archipelago, Checkpoint
from atoll_coordinator.service.search.checkpoint_gathering import StoredSearchState
from atoll_coordinator.service.search.cut import Cut
from atoll_coordinator.service.search.pull_budget import PullBudget
from atoll_coordinator.service.store.jobs import JobRecord, Viewer
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.tasks.analyses import Analysis
from atoll_coordinator.service.tasks.background import Background
from atoll_coordinator.service.tasks.outcomes import JobPrepared, ResultComposed
from atoll_coordinator.service.tasks.results import ResultRead
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
from atoll_core.wire.messages.workers import Close, CloseJob, JobAnnouncement, Placements, WorkerStatus

_SAVE_S: Final = 10.0
"""Task time is stored so often: a commit takes milliseconds, and a coordinator that is killed loses no more."""

_HAD_BEGUN_S: Final = -1e9
"""Second from which on a job counts as waiting that had begun before a restart: it comes before all others."""


class JobController:
    """All live jobs, and the workers that compute them; `shown` are the views of these jobs and of those that ended."""

    def __init__(
        self, store: Store, channel: WorkerChannel, background: Background, post: Callable[[object], None],
        clock: Callable[[], str], expected_workers: int = 1,
    ) -> None:  # fmt: skip
        """Set up the jobs of a store; no island is placed before the expected workers are ready.

        `background` works on large values, `post` hands outcomes to the loop, `clock` gives the time of day as text.
        """
        self.jobs: dict[str, Job] = {}
        self.begun: Final[dict[str, Job]] = {}
        """Those that do not wait to be prepared: what is done for all jobs again and again is done for these alone."""
        self.ending: Final[dict[str, Ending]] = {}
        """Those that are live no more and whose ends take effect when their results are composed: until then the store
        has them as they were, and a coordinator that starts again goes on with them."""
        self.queue: Final = JobQueue()
        self.live_of: Final[Counter[str | None]] = Counter()
        """How many jobs of each user have not ended."""
        self._task_time = TaskTime(_day_of(store), store.usage(_day_of(store)))
        self._saved_at = 0.0
        self._rested_at: float | None = None
        self.events: Final = EventLog(store, clock)
        self.breakages: Final = Breakages(lambda sentence: self.events.record("broken", sentence))
        self.workers: Final = WorkerController(self, store, channel, self.events, expected_workers)
        self.counters: Final = self.workers.counters
        self.shown: Final = JobViews(self.jobs, self.ending, self.queue, self, store, self.breakages)
        self.checkpoints: Final = PullBudget()
        self.changed: Callable[[str], object] = lambda job: None
        """Called with the id of a job to which something has happened."""
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
        """Take over the jobs of the store: those that had not ended go on from their checkpoints.

        One that cannot be understood fails, and takes no other with it.
        """
        self.queue.is_paused = self._store.is_queue_paused()
        self.workers.membership.set_cordons(self._store.cordons())
        for record in self._store.open_jobs():
            with self.guarded(record.id, "taking over a job", now):
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
        """Let a job of the store go on: one whose data are prepared there from what it had found, without a worker."""
        has_begun = record.state != "queued"
        if record.submitted_s is not None:
            record = replace(record, elapsed=max(record.elapsed, self._store.served_s - record.submitted_s))
        self._add(Job(record, config, now), _HAD_BEGUN_S if has_begun else now, has_begun=has_begun)
        self.workers.crash_loops.recover(record.id)
        if record.prepared_digest is None or record.dataset_digest is None:
            return
        if not self._store.is_sound(record.dataset_digest):  # workers would ask for one that is damaged for ever
            return
        try:
            prepared = self.tasks.take_prepared(
                record.id, record.prepared_digest, self._store.get_blob(record.prepared_digest)
            )
        except (KeyError, RemoteProtocolError):  # damaged, or of another version: its data are prepared again
            return
        self._change(record.id, "taking over a job", now, lambda job: self._go_on(job, record, prepared, now))

    def _go_on(self, job: Job, record: JobRecord, prepared: Prepared, now: float) -> Sequence[JobAction]:
        """Continue a job as it was when the coordinator ended; its next turn is decided with those of the others."""
        job.start_preparing()
        self.begun[job.id] = job
        self.queue.take_over(job.id)
        actions = self._set_up(job, record.dataset_digest, prepared, now)
        if not job.has_ended:
            job.hold(job.state == "running")
            self.events.record("resumed", "the coordinator was started again; it goes on from what is stored", job.id)
            self._channel.publish(job.announcement())
        return actions

    def submit(self, body: Submit, now: float, submitter: str | None = None) -> None:
        """Take in a job. The same id with the same contents again changes nothing, nor does it whose job it is.

        Raises:
            RefusedError: The id belongs to another job or to a deleted one.
            TableMissingError: The table has not been uploaded, or has been deleted since.
        """
        spec = body.config.model_dump_json()
        known = self._store.job(body.job)
        if known is not None:
            if (known.spec, known.table_digest, known.priority) != (spec, body.table, body.priority):
                raise RefusedError(f"job {body.job} exists already with other contents; submit under another id")
            return
        if self._store.is_deleted(body.job):  # workers may still hold its data, and take them for those of this job
            raise RefusedError(f"job {body.job} was deleted, and its id is not given again; submit under another id")
        if not self._store.has_blob(body.table):
            raise TableMissingError(f"the table of job {body.job} has not been uploaded; upload it, then submit again")
        submitted = self._clock()
        record = JobRecord(
            body.job, body.name, spec, body.table, submitted,
            priority=body.priority, submitter=submitter, shared=int(body.shared), submitted_s=self._store.served_s,
        )  # fmt: skip
        self._store.add_job(record)
        with self.guarded(body.job, "taking in a job", now):
            self._add(Job(record, body.config, now), now)
            self.events.record_submission(body)
        self._take_turns(now)

    def _add(self, job: Job, asked_at: float, *, has_begun: bool = False) -> None:
        """Let a job join those that wait; `asked_at` is the bus's second from which on it has.

        One that `has_begun` before a restart goes on under a paused queue as well.
        """
        self.jobs[job.id] = job
        self.live_of[job.submitter] += 1
        self.queue.add(
            job.id, job.submitter, job.priority, asked_at, is_paused=job.is_paused, had_begun=has_begun
        )  # fmt: skip

    def set_limits(self, limits: Limits, now: float) -> None:
        """Let other limits hold from now on: jobs beyond them are held, and what is stored already stays."""
        self.queue.limits = limits
        self._take_turns(now)

    def pause(self, job_id: str, is_paused: bool, now: float) -> None:
        """Have a job wait until it is resumed, or resume it. It lasts, also when the coordinator is started again.

        Raises:
            RefusedError: It has ended, or is refined, which nothing interrupts.
        """
        job = self._live(job_id, "paused or resumed")
        if job.state == "refining" and is_paused and not self.tasks.waits(job_id):
            raise RefusedError(f"job {job_id} is being refined, which takes no place and is not interrupted; wait")
        self._store.update_job(job_id, paused=int(is_paused))
        with self.guarded(job_id, "pausing a job", now):
            job.is_paused = is_paused
            if job.state != "refining":
                self.queue.pause(job_id, is_paused)
            if self.queue.is_held(job_id):
                job.hold(True)
            text = "paused: its islands stop at a checkpoint" if is_paused else "it goes on when it is its turn"
            self.events.record("held" if is_paused else "resumed", text, job_id)
        self._rest(now)
        self._take_turns(now)
        self._place(now)

    def set_priority(self, job_id: str, priority: int, now: float) -> None:
        """Change the priority of a job; workers that have it are told. Raises RefusedError when it has ended."""
        job = self._live(job_id, "given another priority")
        self._store.update_job(job_id, priority=priority)
        with self.guarded(job_id, "changing a priority", now):
            job.priority = priority
            self.queue.set_priority(job_id, priority)
            self.events.record("changed", f"its priority is {priority} now", job_id)
            if job.state == "running":
                self._channel.publish(job.announcement())
        self._take_turns(now)

    def share(self, job_id: str, is_shared: bool) -> None:
        """Let everybody see a job, or its submitter and admins only."""
        self._store.share_job(job_id, is_shared)
        self.events.record("changed", "everybody may see it" if is_shared else "it is private", job_id)
        ending = self.ending.get(job_id)
        job = ending.job if ending is not None else self.jobs.get(job_id)
        if job is not None:
            job.is_shared = is_shared

    def again(self, job_id: str, again: str) -> Submit:
        """Return the submission of what a job was submitted with, under another id.

        Raises:
            RefusedError: It neither failed nor was cancelled, or this version does not understand it.
        """
        record = self._store.job(job_id)
        if record is None or record.state not in ("failed", "cancelled"):
            raise RefusedError(f"job {job_id} has not failed; only jobs that failed or were cancelled are tried again")
        try:
            config = JobConfig.model_validate_json(record.spec)
        except ValidationError as error:
            raise RefusedError(f"job {job_id} cannot be tried again: {checks.settings_reason(error)}") from error
        return Submit(
            job=again, name=record.name, config=config, table=record.table_digest,
            priority=record.priority, shared=bool(record.shared),
        )  # fmt: skip

    def pause_queue(self, is_paused: bool, now: float) -> None:
        """Take up no more jobs, or go on; it lasts."""
        self._store.pause_queue(is_paused)
        self.queue.is_paused = is_paused
        self.events.record("changed", "no more jobs are taken up" if is_paused else "jobs are taken up again")
        self._take_turns(now)

    def set_worker(self, worker: str, service: WorkerService, now: float) -> None:
        """Let a worker have islands, no more of them, or none; it lasts. Raises RefusedError for an unknown worker."""
        cordons = self._store.cordons()
        if self.workers.membership.member(worker) is None and worker not in cordons:
            raise RefusedError(f"there is no worker {worker!r}; 'coordinator workers' lists all of them")
        self._store.cordon(worker, None if service == "open" else service == "draining")
        self.workers.membership.set_cordons(self._store.cordons())
        self.events.record("changed", f"it is {service} now", worker=worker)
        self._place(now)

    def _live(self, job_id: str, what: str) -> Job:
        job = self.jobs.get(job_id)
        if job is None:
            raise RefusedError(f"job {job_id} has ended and cannot be {what}; coordinator retry submits it again")
        return job

    def analyse(self, asked: AskAnalysis, user: str | None, now: float) -> Analysis:
        """Return a question about the result of a job with what has come of it; the first to ask has it answered.

        Raises:
            RefusedError: The job has no result, or not yet; or the user has asked too much.
            TableMissingError: The table has been deleted.
        """
        known = self.tasks.analyses.ask(asked, now)
        if known is not None:
            return known
        if self.shown.is_open(asked.job):
            raise RefusedError(f"job {asked.job} has not ended; ask about its result when it has")
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
        """Return how much work waits."""
        queue = self.queue
        return queue_depth(
            self.begun.values(), queue.queued, queue.ready, queue.limits.total.running, self.tasks.analyses.open_count
        )

    def cancel(self, job_id: str, now: float) -> None:
        """End a job and keep what it has found; without effect when it has ended or is `ending`.

        Raises:
            RefusedError: What the store has of its search cannot be kept before its data are prepared again.
        """
        job = self.jobs.get(job_id)
        if job is not None and job.prepared is None and self._store.has_search(job_id):
            raise RefusedError(
                f"job {job_id} goes on from a search that is stored, of which nothing could be kept before its data "
                "are prepared again; start a worker, and cancel it when `status` shows equations"
            )
        self._change(job_id, "cancelling", now, Job.cancel)

    def begin_preparing(self, job_id: str, now: float) -> None:
        """Take in that the process that prepares a job is loaded: its time counts from now on."""
        self._change(job_id, "having a job prepared", now, lambda job: job.start_clock(now))

    def start_search(self, made: JobPrepared, now: float) -> None:
        """Begin the search of a job whose data are prepared, and in the store: announce it and place its islands."""
        self._change(made.job, "beginning the search", now, lambda job: self._start(job, made, now))
        self._place(now)

    def _start(self, job: Job, made: JobPrepared, now: float) -> Sequence[JobAction]:
        if job.state != "preparing":
            return ()
        actions = self._set_up(job, made.former, made.prepared, now)
        if job.has_ended:
            return actions
        self.queue.search(job.id)
        job.hold(self.queue.is_held(job.id))
        self._store.update_job(job.id, state="running")
        self.events.record_preparation(job)
        self._channel.publish(job.announcement())
        return actions

    def _set_up(self, job: Job, dataset: str | None, prepared: Prepared, now: float) -> Sequence[JobAction]:
        """Set up the search of a job whose data are prepared, from what the store has of it; it may fail.

        `dataset` is the digest of what its data were before, if they were prepared before.
        """
        unknown = checks.epoch_limit_reason(job.config, prepared)
        if unknown is not None:
            return job.fail("data", unknown)
        try:
            cuts = {name: decode(data, Cut) for name, data in self._store.cuts(job.id).items()}
            stored = self._stored_checkpoints(job, prepared)
            resumed = {name: decode(data, StoredSearchState) for name, (_, data) in stored.items() if name not in cuts}
        except RemoteProtocolError as error:  # nobody else has written it: it is of another version of ours
            return job.fail("internal", checks.stored_search_reason(error))
        reason = checks.resume_reason(prepared, dataset, bool(cuts), resumed)
        if reason is not None:
            return job.fail("internal", reason)
        return job.start(prepared, cuts, now, resumed)

    def _stored_checkpoints(self, job: Job, prepared: Prepared) -> dict[str, tuple[int, bytes]]:
        """Return epoch and contents of the checkpoints from which a search goes on, by variable.

        Where states of the last one are damaged that is the one before or, if there is none, the beginning: by purity
        the answer is the same, and workers would ask for ever for what is not there.
        """
        last = self._store.checkpoints(job.id)
        whole = self._store.whole_checkpoints(job.id, prepared.config.evolution.islands) if last else {}
        for variable in last:
            if whole.get(variable) != last[variable]:
                epoch = whole[variable][0] if variable in whole else 0
                text = f"states of its last checkpoint are damaged in the store; its search goes on from epoch {epoch}"
                self.events.record("unplaced", text, job.id, variable=variable, epoch=epoch)
        return whole

    def has_lost(self, pull: PullStates) -> bool:
        """Tell whether states that are not in the store are those from which a search goes on now."""
        job = self.jobs.get(pull.job)
        archipelago = job.open_archipelago(pull.variable) if job is not None else None
        if archipelago is None or archipelago.durable == 0 or pull.epoch != archipelago.durable:
            return False
        return set(pull.islands) <= set(range(archipelago.collector.limits.islands))

    def finish_job(self, job_id: str, text: str, now: float) -> None:
        """End a job with the result that refining gave, as JSON."""
        self._change(job_id, "ending", now, lambda job: job.finish(text))

    def finish_unrefined(self, job_id: str, refinement: Refinement, now: float) -> None:
        """End a job with its equations as found, and a warning in place of what refining gives."""
        self._change(job_id, "ending", now, lambda job: job.finish_unrefined(refinement))

    def fail_job(self, job_id: str, fault: Fault, sentence: str, now: float) -> None:
        """Let a job fail; without effect when it has ended."""
        self._change(job_id, "ending", now, lambda job: job.fail(fault, sentence))

    def announcement(self, job_id: str) -> JobAnnouncement | None:
        """Return what workers must know of a job that is being searched."""
        job = self.jobs.get(job_id)
        return job.announcement() if job is not None and job.state == "running" else None

    def placements(self, job_id: str) -> Placements:
        """Return the current placements of a job."""
        job = self.jobs.get(job_id)
        open_ones = job.open_archipelagos if job is not None else ()
        return Placements(
            placements=tuple(archipelago.placement for archipelago in open_ones if archipelago.placement is not None)
        )

    def job_of_dataset(self, digest: str) -> str | None:
        """Return the id of a live job whose prepared dataset this is; None: there is none."""
        jobs = (job.id for job in self.begun.values() if job.prepared is not None and job.prepared.blob == digest)
        return next(jobs, None)

    # --------------------------------------------------------------------------- workers' reports, time

    def add_heartbeat(self, worker: str, status: WorkerStatus, now: float) -> None:
        """Take in a heartbeat: who is there, what it holds, and of which epochs it has snapshots.

        Raises:
            RemoteProtocolError: The worker has heard of an incarnation that there is not.
            StoreError: There is: another coordinator has taken over.
        """
        is_known = self.workers.add_heartbeat(worker, status, now)
        if is_known:
            computed = ((amount.submitter, amount.seconds) for amount in status.computed)
            self._task_time.add_heartbeat(worker, status.instance, computed)
            with self.breakages.tolerated("taking in which tasks a worker has"):
                self.tasks.add_heartbeat(worker, status, now)
        for assignment_status in status.holdings if is_known else ():
            self._advance_checkpoint(assignment_status.job, assignment_status.variable, now)

    def has_task(self, worker: str) -> bool:
        """Tell whether a worker has a task that has not ended."""
        return self.tasks.table.on(worker) is not None

    def lose_tasks(self, worker: str, now: float, *, had_left: bool) -> tuple[str, ...]:
        """Take in that a worker is lost, which `had_left` if it had said that it would: others get its tasks.

        Returns the jobs of these tasks.
        """
        with self.breakages.tolerated("taking tasks from a worker that is lost"):
            return self.tasks.lose(worker, now, had_left=had_left)
        return ()

    def stalls(self, job_id: str) -> tuple[str, ...]:
        """Return why archipelagos of a job stand still, in words, by variable."""
        return self.workers.stalls(job_id)

    def task_views(self, job_id: str) -> tuple[TaskView, ...]:
        """Return the tasks of a job that have not ended, as they are shown."""
        return self.tasks.views(job_id)

    def waiting_reason(self, job: Job) -> str | None:
        """Return in words what the islands or tasks of a job wait for; None: they do not."""
        reason = self.workers.waiting_reason(job) or self.tasks.waiting_reason(job.id)
        if reason is None or self._may_run(job) or job.state != "refining":
            return reason
        return pause_reason(job.id) if job.is_paused else NO_TIME

    def add_task_report(self, worker: str, report: TaskReport, now: float) -> None:
        """Take in what came of a task; raises RemoteProtocolError when it cannot be."""
        task = self.tasks.table.get(report.body.task)
        with self.guarded(task.job if task is not None else "", "taking in what came of a task", now, by_peer=True):
            self.tasks.add_report(worker, report, now)

    def take_result(self, read: ResultRead, now: float) -> None:
        """Take in that the result of a task was read; raises RemoteProtocolError when it was damaged on its way."""
        with self.guarded(read.result.job, "taking in what came of a task", now, by_peer=True):
            self.tasks.take_result(read, now)

    def _may_follow(self, job_id: str) -> bool:
        """Tell whether a task of a job may be wanted soon: after a restart its data are prepared first."""
        job = self.jobs.get(job_id)
        return job is not None and job.state in ("queued", "preparing")

    def _order(self, waiting: Collection[str], running: Collection[str]) -> list[str]:
        """Return whose tasks that wait may be leased, jobs and questions about them, the next one first."""
        ready = [one for one in map(self._of_turn, waiting) if one is not None and self._may_run(one)]
        return self._turns.order(ready, [one for one in map(self._of_turn, running) if one is not None])

    def _of_turn(self, turn: str) -> Job | Analysis | None:
        return self.jobs.get(turn) or self.tasks.analyses.get(turn)

    def _may_run(self, turn: Job | Analysis) -> bool:
        """Tell whether tasks of a job, or of a question, may be leased; what runs already runs on."""
        is_paused = isinstance(turn, Job) and turn.is_paused
        return not (is_paused or self.queue.has_no_time(turn.submitter))

    def _charge(self, turn: str, seconds: float) -> None:
        """Charge the user of a job, or who has asked a question, for what workers have done for it."""
        charged = self._of_turn(turn)
        if charged is not None:
            self._task_time.charge(charged.submitter, seconds)
            self._turns.charge(charged.submitter, seconds)

    def add_report(self, worker: str, report: EpochReport, now: float) -> None:
        """Take in a report; raises RemoteProtocolError when it cannot be."""
        job = self.jobs.get(report.job)
        if job is None:
            if self._store.job(report.job) is None:
                raise RemoteProtocolError(f"a report of job {report.job} came, which does not exist")
            return
        self._change(
            job.id, "taking in a report", now, lambda job: self._report(job, worker, report, now), by_peer=True
        )
        self._advance_checkpoint(job.id, report.variable, now)

    def _report(self, job: Job, worker: str, report: EpochReport, now: float) -> Sequence[JobAction]:
        self.counters.add(job.id, reports=1)
        return job.add_report(worker, report, now)

    def tick(self, now: float) -> None:
        """Let time pass: lost workers, `--max-time`, jobs that wait for their turn."""
        with self.breakages.tolerated("looking for lost workers"):
            self.workers.expire(now)
        with self.breakages.tolerated("counting task time"):
            self._count_time(now)
        self._rest(now)
        for job_id in tuple(self.begun):
            self._change(job_id, "letting time pass", now, lambda job: job.tick(now))
        self._take_turns(now)
        with self.breakages.tolerated("leasing tasks"):
            self.tasks.tick(now)
        self._place(now)
        self._advance_checkpoints(now)
        with self.breakages.tolerated("looking for what stands still"):
            self.workers.check_stalls(now)
        with self.breakages.tolerated("writing events"):
            self.events.flush()

    def _count_time(self, now: float) -> None:
        """Hold the jobs of users who have used up their day, and store what all have used."""
        self.queue.exhausted = self._task_time.exhausted(self.queue.limits)
        self.queue.is_exhausted = self._task_time.is_used_up(self.queue.limits)
        if now - self._saved_at >= _SAVE_S:
            self._saved_at = now
            unsaved = self._task_time.take_unsaved()
            if unsaved or self.jobs:
                self._store.add_usage(_day_of(self._store), unsaved)
            self._task_time.begin_day(_day_of(self._store))

    def _rest(self, now: float) -> None:
        """Let jobs rest whose tasks wait: no time passes for those to be refined, as for islands without workers.

        Those to be prepared that may not run give their places back.
        """
        seconds = now - self._rested_at if self._rested_at is not None else 0.0
        self._rested_at = now
        for job in tuple(self.begun.values()):
            if job.state in ("preparing", "refining") and self.tasks.waits(job.id):
                with self.guarded(job.id, "letting a job rest", now):
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
        """Have islands placed, which concerns all jobs: it ends none that happens to be the occasion."""
        with self.breakages.tolerated("placing islands"):
            self.workers.place(now)

    # ------------------------------------------------------------------------------------- checkpoints

    def add_states(self, worker: str, pull: PullStates, body: States | None, now: float) -> None:
        """Take in the answer to a pull of states; None: there was none, and they are pulled again later.

        Raises:
            RemoteProtocolError: A state was damaged on its way.
        """
        job = self.jobs.get(pull.job)
        archipelago = job.archipelagos.get(pull.variable) if job is not None else None
        with self.guarded(pull.job, "taking in states", now, by_peer=True):
            self.checkpoints.add_states(archipelago, worker, pull, body)
        if body is not None:
            self._advance_checkpoints(now)

    def commit_checkpoint(self, checkpoint: Checkpoint, now: float, error: Exception | None = None) -> None:
        """Take in that a checkpoint is durable: the commit is published, and what waits for it is placed.

        `error` says why it could not be written instead. Raises StoreError when that is the store's.
        """
        with self.guarded(checkpoint.job, "committing a checkpoint", now):
            self.checkpoints.mark_written(checkpoint)
            if error is not None:
                raise error
            self._mark_durable(checkpoint, now)
        self._place(now)
        if self.checkpoints.is_short:
            self._advance_checkpoints(now)

    def _mark_durable(self, checkpoint: Checkpoint, now: float) -> None:
        job = self.jobs.get(checkpoint.job)
        archipelago = job.archipelagos.get(checkpoint.variable) if job is not None else None
        if archipelago is None:
            return
        commit = archipelago.mark_durable(checkpoint, now)
        self.counters.add(checkpoint.job, commits=1)
        self.workers.add_commit(checkpoint)
        self.events.record_commit(checkpoint)
        if commit is not None:
            self._channel.publish(commit)

    def _advance_checkpoints(self, now: float) -> None:
        """Pull the states that are due, and have complete checkpoints written."""
        with self.breakages.tolerated("gathering checkpoints"):
            self.checkpoints.begin_round({archipelago.key: archipelago for archipelago in self._open_archipelagos()})
        for archipelago in self._open_archipelagos():
            self._advance_checkpoint(archipelago.job, archipelago.variable, now)

    def _advance_checkpoint(self, job_id: str, variable: str, now: float) -> None:
        """Do so for one archipelago, of which something has come; all of them each time would take too long."""
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

    # --------------------------------------------------------------------------------------- what breaks

    def _change(
        self, job_id: str, task: str, now: float, act: Callable[[Job], Sequence[JobAction]], *, by_peer: bool = False
    ) -> None:
        """Have something happen to a live job, and carry out what follows; the only way in which that is done."""
        job = self.jobs.get(job_id)
        if job is not None:
            with self.guarded(job_id, task, now, by_peer=by_peer):
                self._carry_out(job, act(job), now)
            self.changed(job_id)

    @contextlib.contextmanager
    def guarded(self, job_id: str, task: str, now: float, *, by_peer: bool = False) -> Iterator[None]:
        """Let what breaks within end this job and nothing else: how much of it was done to the job is not known.

        `by_peer`: what comes from a peer is taken in, whose RemoteProtocolError changes nothing, and passes. A store
        that fails is no matter of one job, and passes as well.
        """
        try:
            with about(job=job_id or None):
                yield
        except StoreError:
            raise
        except Exception as error:
            if by_peer and isinstance(error, RemoteProtocolError):
                raise
            job, ending = self.jobs.get(job_id), self.ending.get(job_id)
            job = ending.job if ending is not None else job
            self._end_broken(job_id, self.breakages.add(task, error, job.config if job is not None else None), now)

    def _end_broken(self, job_id: str, sentence: str, now: float) -> None:
        """End a job whose state may be half changed: all that ends it is done as far as it can be."""
        job, ending = self.jobs.get(job_id), self.ending.get(job_id)
        if ending is not None and ending.sentence is not None:  # it ends so already
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
        """Have nobody compute for a job that has ended since something broke, and forget it."""
        with self.breakages.tolerated("closing a job"):
            self._channel.publish(CloseJob(job=job_id))
        with self.breakages.tolerated("ending the tasks of a job"):
            self.tasks.cancel(job_id)
        with self.breakages.tolerated("forgetting what a job has cost"):
            self.counters.forget(job_id)
        with self.breakages.tolerated("forgetting a job"):
            self.workers.forget(job_id)

    def _compose(self, ending: Ending) -> None:
        """Have the end of a job take effect when its result is composed."""
        self.ending[ending.job.id] = ending
        self._background.compose_result(ending.draft)

    def compose(self, draft: Draft) -> None:
        """Have the result of a live job composed as it stands, unless that is under way."""
        if draft.job not in self._composing:
            self._composing.add(draft.job)
            self._background.compose_result(draft)

    def finish_composing(self, composed: ResultComposed, now: float) -> str:
        """Return the result of a job that was live when it was asked for; raises what composing it raised."""
        self._composing.discard(composed.draft.job)
        if composed.error is not None:
            raise composed.error
        return timed(composed.text, now - composed.draft.submitted_at)

    def finish_ending(self, composed: ResultComposed, now: float) -> None:
        """Let the end of a job take effect whose result is composed; without effect where another end came first."""
        job_id = composed.draft.job
        ending = self.ending.get(job_id)
        if ending is None or ending.draft is not composed.draft:
            return
        with self.guarded(job_id, "ending", now):
            if ending.sentence is not None:
                self._finish_broken(ending, composed, now)
            elif composed.error is not None:
                raise composed.error
            else:
                ending.job.result_text = composed.text
                self._commit_result(ending.job, now)
                del self.ending[job_id]
        self.changed(job_id)

    def _finish_broken(self, ending: Ending, composed: ResultComposed, now: float) -> None:
        """Let a job end over which something broke, without a result where that cannot be composed."""
        job_id = ending.job.id
        del self.ending[job_id]
        text = timed(composed.text, now - ending.job.submitted_at) if composed.error is None else None
        self._end_without_job(job_id, ending.sentence or "", text)
        self._close(job_id)

    def _end_without_job(self, job_id: str, reason: str, text: str | None = None) -> None:
        """Let a job of the store fail that is not live, unless it has ended there."""
        if self._store.commit_result(job_id, "failed", text, reason, self._clock()):
            with self.breakages.tolerated("noting the end of a job"):
                self.events.record("failed", reason, job_id)

    # ---------------------------------------------------------------------------------------- outcomes

    def _carry_out(self, job: Job, actions: Sequence[JobAction], now: float) -> None:
        for action in actions:
            match action:
                case CommitCuts():
                    self._commit_cuts(job, action.cuts)
                case PublishCommit():
                    self._channel.publish(action.commit)
                case Refine():
                    self.queue.remove(job.id)
                    self._store.update_job(job.id, state="refining")
                    if job.prepared is not None:
                        self.events.record_refining(job.id)
                        searched = Searched(job.id, tuple(outcomes_of(job)))
                        self.tasks.refine(searched, job.prepared.config, action.seconds, now)
                case CommitResult():
                    self._end(job, now)

    def _commit_cuts(self, job: Job, cuts: Sequence[Cut]) -> None:
        self._store.commit_cuts(job.id, {cut.variable: encode(cut) for cut in cuts})
        for cut in cuts:
            placement = job.archipelagos[cut.variable].placement
            if placement is not None:
                self._channel.publish(Close(job=job.id, variable=cut.variable, term=placement.term))
            self.events.record_cut(job.id, cut)

    def _end(self, job: Job, now: float) -> None:
        """End a job: at once where its result is there or it has none, or else when its result is composed.

        Nothing of its end is in the store, and nobody is told, before its result is there: whatever kills us in
        between, it goes on. So workers compute for it until then.
        """
        draft = draft_of(job) if job.result_text is None else None
        if draft is None:
            self._commit_result(job, now)
            return
        self._remove(job.id)
        self._compose(Ending(job, job.former_state, draft))
        self._take_turns(now)

    def _commit_result(self, job: Job, now: float) -> None:
        made = timed(job.result_text, now - job.submitted_at) if job.result_text is not None else None
        text = self._fitting(job, made)
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
        self.workers.forget(job.id)
        self._take_turns(now)

    def _fitting(self, job: Job, text: str | None) -> str | None:
        """Return a result as far as its user may store it: the oldest of that user's ended jobs make room for it.

        Where nothing is left to delete, the job fails: what a user may store holds to the byte.
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
                    f"its result of {size} bytes does not fit into the {most} that limits let its user store; delete "
                    "jobs or have the limit raised, then: coordinator retry"
                )
                job.result_text = None
                return None
            self.forget_ended(oldest.id, "a newer job of its user needs the room that limits give")
        return text

    def forget_ended(self, job_id: str, reason: str) -> None:
        """Delete a job that has ended."""
        self.events.flush()  # or its last events would be written after its end
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

    def _take_turns(self, now: float) -> None:
        """Have those jobs prepared and searched whose turn it is, and others held."""
        with self.breakages.tolerated("deciding whose turn it is"):
            self.queue.charge(now)
            decision = self.queue.decide()
            for job_id in decision.hold:
                self._change(job_id, "holding a job", now, lambda job: job.hold(True))
            for job_id in decision.release:
                self._change(job_id, "letting a job go on", now, lambda job: job.hold(False))
            for job_id in decision.take_up:
                with self.guarded(job_id, "having a job prepared", now):
                    self._prepare(job_id, now)

    def _prepare(self, job_id: str, now: float) -> None:
        waiting = self.jobs.get(job_id)
        if waiting is None or waiting.state != "queued":  # the end of one before it in the line had this one taken up
            return
        # What the store refuses, as on a full disk, must leave the job in the line, or nobody would prepare it.
        self._store.update_job(waiting.id, state="preparing")
        waiting.start_preparing()
        self.begun[job_id] = waiting
        self.queue.begin(job_id)
        self.changed(waiting.id)
        self._background.check_table(waiting.id, waiting.table)

    def prepare_checked(self, job_id: str, is_sound: bool, error: Exception | None, now: float) -> None:
        """Have a job prepared whose table was checked; raises the `error` of a store that cannot be read."""
        job = self.jobs.get(job_id)
        if job is None or job.state != "preparing":  # it has ended meanwhile
            return
        if error is not None:
            raise error
        if not is_sound:
            self.fail_job(job_id, "internal", "its table is missing or damaged in the store; submit it again", now)
            return
        self.tasks.prepare(job_id, job.table, self._store.blob_size(job.table), job.config, now)
        self.changed(job_id)

    def _open_archipelagos(self) -> list[Archipelago]:
        return [archipelago for job in self.begun.values() for archipelago in job.open_archipelagos]


def _broken(job: Job | None, sentence: str) -> Ending | None:
    """Return the end of a job over which something broke, with what it has found; None where that cannot be had."""
    with contextlib.suppress(Exception):
        if job is not None and job.prepared is not None:
            was = job.former_state if job.has_ended else job.state
            job.state, job.fault, job.reason = "failed", "internal", sentence
            draft = draft_of(job)
            return Ending(job, was, draft, sentence) if draft is not None else None
    return None


def _day_of(store: Store) -> int:
    """Return the number of the day of service."""
    return int(store.served_s // DAY_S)
