"""What becomes of jobs and workers: takes in what happens, and has the rooms below decide, store, send and compute.

Knows no bus and no thread. What is sent has been stored before.
"""

from collections.abc import Callable, Sequence
from typing import Final

from pydantic import ValidationError

from atoll.config import JobConfig
from atoll.errors import RefusedError, RemoteProtocolError
from atoll.wire.codec import decode, encode
from atoll.wire.messages.clients import Submit
from atoll.wire.messages.handshake import Hello
from atoll.wire.messages.views import FINAL_STATES, JobView
from atoll.wire.messages.workers import (
    Close,
    CloseJob,
    EpochReport,
    Introduce,
    JobAnnouncement,
    Placement,
    Placements,
    PullReports,
    PullStates,
    Shutdown,
    States,
    WorkerStatus,
)
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.service.background.runner import TaskRunner
from atoll_coordinator.service.jobs import checks
from atoll_coordinator.service.jobs.job import (
    CommitCuts,
    CommitResult,
    Fault,
    Job,
    JobAction,
    Prepared,
    PublishCommit,
    Refine,
)
from atoll_coordinator.service.jobs.queue import next_job
from atoll_coordinator.service.monitoring.counters import CounterRegistry
from atoll_coordinator.service.monitoring.event_log import EventLog
from atoll_coordinator.service.monitoring.views import ended_view, job_result, job_view, result_text
from atoll_coordinator.service.search.archipelago import Archipelago, Checkpoint
from atoll_coordinator.service.search.checkpoint_coordinator import CheckpointCoordinator
from atoll_coordinator.service.search.checkpoints import StoredSearchState
from atoll_coordinator.service.search.cut import Cut
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.workers.channel import WorkerChannel
from atoll_coordinator.service.workers.crash_loops import CrashLoops
from atoll_coordinator.service.workers.leases import LeaseBackoff
from atoll_coordinator.service.workers.membership import Member, Membership
from atoll_coordinator.service.workers.quarantine import Quarantine
from atoll_coordinator.service.workers.reconciliation import corrections
from atoll_coordinator.service.workers.scheduling import Scheduler
from atoll_coordinator.service.workers.stalls import StallDetector


class Controller:
    """All live jobs, all workers, and the views of the jobs that have ended."""

    def __init__(
        self, store: Store, channel: WorkerChannel, tasks: TaskRunner, clock: Callable[[], str],
        expected_workers: int = 1,
    ) -> None:  # fmt: skip
        """`clock` gives the time of day as ISO text; no island is placed before the expected workers are ready."""
        self.membership: Final = Membership()
        self.jobs: dict[str, Job] = {}
        self.ended: dict[str, JobView | None] = {}
        """Jobs that have ended; None: the view has not been made of what is stored yet."""
        self.events: Final = EventLog(store, clock)
        self.counters: Final = CounterRegistry()
        self.crash_loops: Final = CrashLoops(store, self.events)
        self.checkpoints: Final = CheckpointCoordinator()
        self._store = store
        self._channel = channel
        self._tasks = tasks
        self._clock = clock
        self._leases = LeaseBackoff()
        self._quarantine = Quarantine(self.membership, self.crash_loops)
        self._scheduler = Scheduler(self.membership, self._quarantine, expected_workers)
        self._stalls = StallDetector(self.membership)

    # ------------------------------------------------------------------------------------------- jobs

    def recover(self, now: float) -> None:
        """Take over the jobs of the store: those that had not ended go on from their checkpoints.

        One that cannot be understood fails, and takes no other with it.
        """
        for record in self._store.jobs():
            if record.state in FINAL_STATES:
                self.ended[record.id] = None
                continue
            try:
                config = JobConfig.model_validate_json(record.spec)
            except ValidationError as error:
                reason = checks.settings_reason(error)
                self._store.commit_result(record.id, "failed", None, reason, self._clock())
                self.ended[record.id] = None
                self.events.record("failed", reason, record.id)
            else:
                self.jobs[record.id] = Job(record, config, now)
                self.crash_loops.recover(record.id)

    def submit(self, body: Submit, now: float, submitter: str | None = None) -> None:
        """Take in a job. The same id with the same contents again changes nothing, nor does it whose job it is.

        Raises:
            RefusedError: The id belongs to another job, or the table has not been uploaded.
        """
        spec = body.config.model_dump_json()
        known = self._store.job(body.job)
        if known is not None:
            if (known.spec, known.table_digest, known.priority) != (spec, body.table, body.priority):
                raise RefusedError(f"job {body.job} exists already with other contents; submit under another id")
            return
        if not self._store.has_blob(body.table):
            raise RefusedError(f"the table of job {body.job} has not been uploaded; upload it, then submit again")
        submitted = self._clock()
        record = JobRecord(body.job, body.name, spec, body.table, submitted, priority=body.priority)
        self._store.add_job(record, submitter)
        self.jobs[body.job] = Job(record, body.config, now)
        self.events.record_submission(body)
        self._prepare_next(now)

    def cancel(self, job_id: str, now: float) -> None:
        """End a job and keep what it has found; without effect when it has ended."""
        job = self.jobs.get(job_id)
        if job is not None:
            self._carry_out(job, job.cancel(), now)

    def start_search(self, job_id: str, prepared: Prepared, now: float) -> None:
        """Begin the search of a job whose data are prepared: announce it and place its islands."""
        job, record = self.jobs.get(job_id), self._store.job(job_id)
        if job is None or record is None or job.state != "preparing":
            return
        unknown = checks.epoch_limit_reason(job.config, prepared)
        if unknown is not None:
            self.fail_job(job_id, "data", unknown, now)
            return
        cuts = {name: decode(data, Cut) for name, data in self._store.cuts(job_id).items()}
        stored = self._store.checkpoints(job_id)
        resumed = {name: decode(data, StoredSearchState) for name, (_, data) in stored.items()}
        reason = checks.resume_reason(prepared, record.dataset_digest, bool(cuts), resumed)
        if reason is not None:
            self.fail_job(job_id, "internal", reason, now)
            return
        actions = job.start(prepared, cuts, resumed)
        self._store.update_job(job_id, state="running", dataset_digest=prepared.blob)
        self.events.record_preparation(job)
        self._channel.publish(job.announcement())
        self._carry_out(job, actions, now)
        self.place(now)

    def finish_job(self, job_id: str, refinement: Refinement, now: float) -> None:
        """End a job with what refining gave."""
        job = self.jobs.get(job_id)
        if job is not None:
            self._carry_out(job, job.finish(refinement), now)

    def fail_job(self, job_id: str, fault: Fault, sentence: str, now: float) -> None:
        """Let a job fail; without effect when it has ended."""
        job = self.jobs.get(job_id)
        if job is not None:
            self._carry_out(job, job.fail(fault, sentence), now)

    def view(self, job_id: str, now: float) -> JobView | None:
        """Return what people are shown of a job; None for an unknown one."""
        if job_id in self.jobs:
            return self._live_view(self.jobs[job_id], now)
        record = self._store.job(job_id) if job_id in self.ended and self.ended[job_id] is None else None
        if record is not None:
            self.ended[job_id] = ended_view(record, self._store.result(job_id))
        return self.ended.get(job_id)

    def result(self, job_id: str, now: float) -> str | None:
        """Return a job's result as JSON text, while it runs the best so far; None while there is none."""
        job = self.jobs.get(job_id)
        if job is not None:
            return result_text(job_result(job, now)) if job.prepared is not None else None
        return self._store.result(job_id)

    def announcement(self, job_id: str) -> JobAnnouncement | None:
        """Return what workers must know of a job that is being searched."""
        job = self.jobs.get(job_id)
        return job.announcement() if job is not None and job.state == "running" else None

    def placements(self, job_id: str) -> Placements:
        """Return the current placements of a job."""
        job = self.jobs.get(job_id)
        open_ones = job.open_archipelagos if job is not None else ()
        return Placements(placements=tuple(each.placement for each in open_ones if each.placement is not None))

    # ---------------------------------------------------------------------------------------- workers

    def register_worker(self, hello: Hello, now: float) -> str | None:
        """Take in a worker; return a sentence instead when it must be refused.

        A new process under a known name does not have the islands of the old one: they are placed anew.
        """
        is_new, before = self.membership.is_new(hello), self.membership.member(hello.name)
        refusal = self.membership.register(hello, now)
        if refusal is not None:
            self.events.record_refusal(hello.name, refusal)
        elif is_new:
            self.events.record_joining(hello)
            self.crash_loops.withdraw((hello.name, hello.instance))
            if before is not None:
                self._lose(before, "a new process has its name", now)
            for archipelago in self._open_archipelagos():
                if hello.name in archipelago.workers:
                    archipelago.unplace()
            self.place(now)
        return refusal

    def add_heartbeat(self, worker: str, status: WorkerStatus, now: float) -> None:
        """Take in a heartbeat, and correct what the worker holds and should not, or should and does not.

        Raises:
            RemoteProtocolError: The worker has heard of an incarnation that there is not.
            StoreError: There is: another coordinator has taken over.
        """
        self._check_incarnation(worker, status)
        was_ready, was_lost = self.membership.is_ready(worker), self.membership.is_lost(worker)
        if not self.membership.record_heartbeat(worker, status, now):
            self._channel.send(worker, Introduce())
            return
        if was_lost and not self.membership.is_lost(worker):
            self.events.record_return(worker)
            self.crash_loops.withdraw((worker, status.instance))
        if not was_ready and self.membership.is_ready(worker):
            self.place(now)
        self._fail_broken_jobs(worker, status, now)
        self._update_holdings(worker, status)
        for correction in corrections(self.jobs, worker, status):
            if isinstance(correction, PullReports):
                self._channel.pull(worker, correction)
            else:
                self._channel.send(worker, correction)
        if status.state == "leaving":
            self._let_leave(worker, now)
        for holding in status.holdings:
            self._advance_checkpoint(self.jobs.get(holding.job), holding.variable, now)

    def _check_incarnation(self, worker: str, status: WorkerStatus) -> None:
        if status.incarnation > self._store.incarnation:
            self._store.check()
            raise RemoteProtocolError(
                f"worker {worker} has heard of incarnation {status.incarnation}, but this is {self._store.incarnation}"
            )

    def _fail_broken_jobs(self, worker: str, status: WorkerStatus, now: float) -> None:
        """Let the jobs fail whose islands a worker cannot compute under their current term."""
        for failure in status.failures:
            if self._placed(failure.job, failure.variable, failure.term) is not None:
                self.fail_job(failure.job, "internal", f"{failure.sentence} (on worker {worker})", now)

    def _update_holdings(self, worker: str, status: WorkerStatus) -> None:
        """Take in how far a worker is with what is placed on it; publish commits that are due by that."""
        for holding in status.holdings:
            archipelago = self._placed(holding.job, holding.variable, holding.term)
            if archipelago is not None:
                archipelago.update_holding(worker, holding)
                self.counters.set_waited(worker, holding)
                commit = archipelago.due_commit()
                if commit is not None:
                    self._channel.publish(commit)

    def _let_leave(self, worker: str, now: float) -> None:
        """Place elsewhere what a worker has that wants to end; when it has nothing, tell it so."""
        self.place(now)
        if not any(worker in archipelago.workers for archipelago in self._open_archipelagos()):
            self._channel.send(worker, Shutdown(sentence="nothing is placed here any more"))

    def add_report(self, worker: str, report: EpochReport, now: float) -> None:
        """Take in a report; raises RemoteProtocolError when it cannot be."""
        job = self.jobs.get(report.job)
        if job is None:
            if report.job not in self.ended:
                raise RemoteProtocolError(f"a report of job {report.job} came, which does not exist")
            return
        self.counters.add(job.id, reports=1)
        self._carry_out(job, job.add_report(worker, report, now), now)
        self._advance_checkpoint(job, report.variable, now)

    def tick(self, now: float) -> None:
        """Let time pass: lost workers, `--max-time`, jobs that wait for their turn."""
        for member in self.membership.expire(now, self._leases.factors(self._open_archipelagos())):
            self._lose(member, member.lost_by, now)
        for job in list(self.jobs.values()):
            self._carry_out(job, job.tick(now), now)
        self._prepare_next(now)
        self.place(now)
        self._advance_checkpoints(now)
        self._check_stalls(now)
        self.events.flush()

    def _lose(self, member: Member, why: str, now: float) -> None:
        """Take in that a process is lost, and let the jobs fail that have cost one worker too many by that.

        One that had said that it would leave was not ended by what it computed.
        """
        name = member.hello.name
        lost = [each for each in self._open_archipelagos() if name in each.workers]
        for job in dict.fromkeys(each.job for each in lost) or (None,):
            self.events.record("worker-lost", why, job, worker=name)
        reasons: list[tuple[str, str]] = []
        for archipelago in lost if not member.is_leaving else ():
            self._leases.add_eviction(archipelago.key)
            self.counters.add(archipelago.job, deaths=1)
            term = archipelago.placement.term if archipelago.placement is not None else 0
            reason = self.crash_loops.add_death(archipelago.key, term, (name, member.hello.instance), why)
            reasons += [(archipelago.job, reason)] if reason is not None else []
        for job_id, reason in reasons:
            self.fail_job(job_id, "poison", reason, now)

    def _check_stalls(self, now: float) -> None:
        """Record which archipelagos stand still, and which get on again."""
        for (job, variable), stall in self._stalls.check(self._open_archipelagos(), now):
            if stall is None:
                self.events.record("moving", "it gets on again", job, variable=variable)
                continue
            self.counters.add(job, stalls=1)
            self.events.record(
                "stalled", stall.sentence, job, variable=variable, island=stall.islands[0], epoch=stall.epoch,
                term=stall.term, worker=stall.worker, cause=stall.cause,
            )  # fmt: skip

    def place(self, now: float) -> None:
        """Begin the terms that are due: first all of them in the store, since each commit takes its time."""
        self.crash_loops.save()
        plan = self._scheduler.plan(tuple(self.jobs.values()), now)
        for key in plan.broken:
            self.events.record_broken_placement(key)
        for held in plan.released:
            for worker in dict.fromkeys(held.workers):
                self._channel.send(worker, Close(job=held.job, variable=held.variable, term=held.term))
        placements: list[Placement] = []

        def encode_placement(index: int, term: int) -> bytes:
            placements.append(plan.assignments[index].placement(self._store.incarnation, term))
            return encode(placements[-1])

        if plan.assignments:
            self._store.begin_terms([each.archipelago.key for each in plan.assignments], encode_placement)
        for each, placement in zip(plan.assignments, placements, strict=True):
            each.archipelago.place(placement, now)
            each.job.start_search(now)
            self._channel.publish(Placements(placements=(placement,)))
            self.counters.add(placement.job, placements=1)
            self.events.record_placement(placement)

    # ------------------------------------------------------------------------------------- checkpoints

    def add_states(self, worker: str, pull: PullStates, body: States | None, now: float) -> None:
        """Take in the answer to a pull of states; None: there was none, and they are pulled again later.

        Raises:
            RemoteProtocolError: A state was damaged on its way.
        """
        job = self.jobs.get(pull.job)
        archipelago = job.archipelagos.get(pull.variable) if job is not None else None
        self.checkpoints.add_states(archipelago, worker, pull, body)
        if body is not None:
            self._advance_checkpoints(now)

    def commit_checkpoint(self, checkpoint: Checkpoint, now: float) -> None:
        """Take in that a checkpoint is durable: the commit is published, and what waits for it is placed."""
        self.checkpoints.mark_written(checkpoint)
        job = self.jobs.get(checkpoint.job)
        archipelago = job.archipelagos.get(checkpoint.variable) if job is not None else None
        if archipelago is not None and archipelago.is_writing:  # the id of a deleted job may be used again
            commit = archipelago.mark_durable(checkpoint, now)
            self._leases.add_commit(checkpoint.key)
            self.counters.add(checkpoint.job, commits=1)
            self.crash_loops.add_commit(checkpoint.key, checkpoint.epoch)
            self.events.record_commit(checkpoint)
            if commit is not None:
                self._channel.publish(commit)
        self.place(now)
        if self.checkpoints.is_short:
            self._advance_checkpoints(now)

    def _advance_checkpoints(self, now: float) -> None:
        """Pull the states that are due, and have complete checkpoints written."""
        self.checkpoints.begin_round({each.key: each for each in self._open_archipelagos()})
        for archipelago in self._open_archipelagos():
            self._advance_checkpoint(self.jobs[archipelago.job], archipelago.variable, now)

    def _advance_checkpoint(self, job: Job | None, variable: str, now: float) -> None:
        """Do so for one archipelago, of which there is news: to look at all of them each time would take its time."""
        archipelago = job.open_archipelago(variable) if job is not None else None
        if job is None or archipelago is None:
            return
        for worker, pull in self.checkpoints.next_pulls(archipelago):
            self._channel.pull(worker, pull)
        checkpoint = self.checkpoints.take_complete_checkpoint(archipelago)
        if checkpoint is not None:
            search_state = encode(checkpoint.stored_search_state(job.search_seconds(now)))
            self._tasks.write(checkpoint, search_state, now - job.submitted_at)

    # ---------------------------------------------------------------------------------------- outcomes

    def _carry_out(self, job: Job, actions: Sequence[JobAction], now: float) -> None:
        for action in actions:
            match action:
                case CommitCuts():
                    self._commit_cuts(job, action.cuts)
                case PublishCommit():
                    self._channel.publish(action.commit)
                case Refine():
                    if job.prepared is not None:
                        self.events.record_refining(job.id)
                        self._tasks.refine(job.id, job.prepared, action.pools)
                case CommitResult():
                    self._commit_result(job, now)

    def _commit_cuts(self, job: Job, cuts: Sequence[Cut]) -> None:
        self._store.commit_cuts(job.id, {cut.variable: encode(cut) for cut in cuts})
        for cut in cuts:
            placement = job.archipelagos[cut.variable].placement
            if placement is not None:
                self._channel.publish(Close(job=job.id, variable=cut.variable, term=placement.term))
            self.events.record_cut(job.id, cut)

    def _commit_result(self, job: Job, now: float) -> None:
        text = result_text(job_result(job, now)) if job.prepared is not None else None
        self._store.update_job(job.id, elapsed=now - job.submitted_at)
        is_crash_loop, finished = job.fault == "poison", self._clock()
        self._store.commit_result(job.id, job.state, text, job.reason, finished, keeps_checkpoints=is_crash_loop)
        self._channel.publish(CloseJob(job=job.id))
        self._tasks.cancel(job.id)
        self.ended[job.id] = self._live_view(job, now).model_copy(update={"workers": 0, "stalls": (), "ahead": None})
        del self.jobs[job.id]
        self.events.record_end(job)
        self._leases.forget(job.id)
        self.counters.forget(job.id)
        self.crash_loops.forget(job.id)
        self._prepare_next(now)

    def _prepare_next(self, now: float) -> None:
        """Begin to prepare the next job that waits, if it is its turn."""
        waiting = next_job(self.jobs.values())
        if waiting is None:
            return
        # What the store refuses, as on a full disk, must leave the job in the line, or nobody would prepare it.
        try:
            table = self._store.get_blob(waiting.table)
        except KeyError:
            self.fail_job(waiting.id, "internal", "its table is not in the store any more; submit it again", now)
            return
        self._store.update_job(waiting.id, state="preparing")
        waiting.start_preparing()
        self._tasks.prepare(waiting.id, table, waiting.config)

    def _live_view(self, job: Job, now: float) -> JobView:
        quarantined = self._quarantine.waiting(job.open_archipelagos)
        waits = f"islands of {', '.join(quarantined)} are isolated and wait for a worker of their own"
        return job_view(
            job,
            tuple(self.jobs.values()),
            now,
            waits if quarantined else self.membership.waiting_reason(),
            self.counters.counters(job),
            self._stalls.sentences(job.id),
        )

    def _open_archipelagos(self) -> list[Archipelago]:
        return [each for job in self.jobs.values() for each in job.open_archipelagos]

    def _placed(self, job_id: str, variable: str, term: int) -> Archipelago | None:
        """Return the archipelago that is placed under a term now; None: there is none."""
        job = self.jobs.get(job_id)
        archipelago = job.open_archipelago(variable) if job is not None else None
        placement = archipelago.placement if archipelago is not None else None
        return archipelago if placement is not None and placement.term == term else None
