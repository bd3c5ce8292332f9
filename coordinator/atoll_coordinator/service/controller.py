"""What becomes of jobs and workers: who computes what, what is committed, and what everybody is told.

Knows no bus: what is to be said goes through an `Outlet`, what must last through the store. The order is always the
same: first commit, then say.
"""

from collections.abc import Callable, Sequence
from typing import Final

from pydantic import ValidationError

from atoll import ENGINE_REVISION, VERSION
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
    Placements,
    PullStates,
    Shutdown,
    States,
    WorkerStatus,
)
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.service.effects import Outlet
from atoll_coordinator.service.jobs.job import Conclude, Fault, Job, JobAction, KeepCuts, Prepared, Refine, TellCommit
from atoll_coordinator.service.jobs.queue import next_job
from atoll_coordinator.service.monitoring.monitor import Watch
from atoll_coordinator.service.monitoring.views import ended_view, job_result, job_view, result_text
from atoll_coordinator.service.ports import StorePort
from atoll_coordinator.service.search.archipelago import Checkpoint
from atoll_coordinator.service.search.checkpoint_coordinator import Keeper
from atoll_coordinator.service.search.checkpoints import StoredProgress
from atoll_coordinator.service.search.cut import Cut
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.workers.membership import Member, Membership
from atoll_coordinator.service.workers.reconciliation import Holdings
from atoll_coordinator.service.workers.scheduling import Terms


class Controller:
    """All live jobs, all workers, and the views of the jobs that have ended."""

    def __init__(self, store: StorePort, outlet: Outlet, clock: Callable[[], str], expected_workers: int = 1) -> None:
        """`clock` gives the time of day as ISO text; no island is placed before the expected workers are ready."""
        self.membership: Final = Membership()
        self.jobs: dict[str, Job] = {}
        self.ended: dict[str, JobView | None] = {}
        """Jobs that have ended; None: the view has not been made of what is stored yet."""
        self._store = store
        self._outlet = outlet
        self._clock = clock
        self.watch: Final = Watch(self.membership, store, clock)
        self._terms = Terms(self.membership, store, outlet, self.watch, expected_workers)
        self._holdings = Holdings(self.jobs, outlet, self.watch)
        self._keeper = Keeper(outlet)

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
                self._give_up(record, error)
            else:
                self.jobs[record.id] = Job(record, config, now)
                self.watch.resumed(record.id)

    def _give_up(self, record: JobRecord, error: ValidationError) -> None:
        """Let a job of the store fail whose settings this version does not understand."""
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "all of them"
        reason = (
            f"its settings in the store are not understood by version {VERSION} ({where}: {first['msg']}); serve its "
            "store with the version that it was submitted to, or submit it again under another id"
        )
        self._store.commit_result(record.id, "failed", None, reason, self._clock())
        self.ended[record.id] = None
        self.watch.given_up(record.id, reason)

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
        self.watch.submitted(body)
        self._prepare_next(now)

    def cancel(self, job_id: str, now: float) -> None:
        """End a job and keep what it has found; without effect when it has ended."""
        job = self.jobs.get(job_id)
        if job is not None:
            self._carry_out(job, job.cancel(), now)

    def prepared(self, job_id: str, prepared: Prepared, now: float) -> None:
        """Take in a prepared dataset: announce the job and place its islands."""
        job = self.jobs.get(job_id)
        if job is None or job.state != "preparing":
            return
        sought = [target.variable for target in prepared.sought]
        unknown = sorted(set(job.config.budget.max_epochs_of) - set(sought))
        if unknown:
            there = ", ".join(sought) or "none"
            sentence = f"--max-epochs names {unknown[0]!r}, for which no equation is sought; sought are {there}"
            self.job_failed(job_id, "data", sentence, now)
            return
        cuts = {name: decode(data, Cut) for name, data in self._store.cuts(job_id).items()}
        resumed = {name: decode(data, StoredProgress) for name, (_, data) in self._store.checkpoints(job_id).items()}
        changed = self._changed(job_id, prepared, cuts, resumed)
        if changed is not None:
            self.job_failed(job_id, "internal", changed, now)
            return
        actions = job.begin(prepared, cuts, resumed)
        self._store.update_job(job_id, state="running", dataset_digest=prepared.blob)
        self.watch.prepared(job)
        self._outlet.tell(job.announcement())
        self._carry_out(job, actions, now)
        self.place(now)

    def _changed(
        self, job_id: str, prepared: Prepared, cuts: dict[str, Cut], resumed: dict[str, StoredProgress]
    ) -> str | None:
        """Return why what was committed earlier does not go together with what is computed now; None: it does."""
        record = self._store.job(job_id)
        before = record.dataset_digest if record is not None else None
        if (cuts or resumed) and before not in (None, prepared.blob):
            return "its data, prepared again after a restart, came out differently; submit it again under another id"
        engines = {each.engine for each in resumed.values()} - {ENGINE_REVISION}
        if engines:
            return (
                f"it was begun by engine revision {min(engines)}, and this is revision {ENGINE_REVISION}, which "
                "computes otherwise; serve its store with the earlier version, or submit it again under another id"
            )
        return None

    def refined(self, job_id: str, refinement: Refinement, now: float) -> None:
        """Take in what was made of a job's pools: it is done."""
        job = self.jobs.get(job_id)
        if job is not None:
            self._carry_out(job, job.take_refined(refinement), now)

    def job_failed(self, job_id: str, fault: Fault, sentence: str, now: float) -> None:
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

    def greet(self, hello: Hello, now: float) -> str | None:
        """Take in a worker; return a sentence instead when it must be refused.

        A new process under a known name does not have the islands of the old one: they are placed anew.
        """
        is_new, before = self.membership.is_new(hello), self.membership.member(hello.name)
        refusal = self.membership.greet(hello, now)
        if is_new or refusal is not None:
            self.watch.greeted(hello, refusal)
        if refusal is None and is_new:
            if before is not None:
                self._lose(before, "a new process has its name", now)
            for job in self.jobs.values():
                for archipelago in job.open_archipelagos:
                    if archipelago.placement is not None and hello.name in archipelago.placement.workers:
                        archipelago.unplace()
            self.place(now)
        return refusal

    def heartbeat(self, worker: str, status: WorkerStatus, now: float) -> None:
        """Take in a heartbeat and set right what the worker holds and should not, or should and does not.

        Raises:
            RemoteProtocolError: The worker has heard of an incarnation that there is not.
            StoreError: There is: another coordinator has taken over.
        """
        self._check_incarnation(worker, status)
        was_ready, was_lost = self.membership.is_ready(worker), self.membership.is_lost(worker)
        if not self.membership.hear(worker, status, now):
            self._outlet.tell(Introduce(), worker)
            return
        self.watch.heard(worker, status, was_lost)
        if not was_ready and self.membership.is_ready(worker):
            self.place(now)
        for failure in status.failures:
            if self._holdings.is_current(failure.job, failure.variable, failure.term):
                self.job_failed(failure.job, "internal", f"{failure.sentence} (on worker {worker})", now)
        self._holdings.look(worker, status)
        if status.state == "leaving":
            self._let_go(worker, now)
        for holding in status.holdings:
            self._keeper.look_at(self.jobs.get(holding.job), holding.variable, now)

    def _let_go(self, worker: str, now: float) -> None:
        """Place elsewhere what a worker has that wants to end; when it has nothing, tell it so."""
        self.place(now)
        placements = (each.placement for job in self.jobs.values() for each in job.open_archipelagos)
        if not any(worker in placement.workers for placement in placements if placement is not None):
            self._outlet.tell(Shutdown(sentence="nothing is placed here any more"), worker)

    def _check_incarnation(self, worker: str, status: WorkerStatus) -> None:
        if status.incarnation > self._store.incarnation:
            self._store.check()
            raise RemoteProtocolError(
                f"worker {worker} has heard of incarnation {status.incarnation}, but this is {self._store.incarnation}"
            )

    def report(self, worker: str, report: EpochReport, now: float) -> None:
        """Take in a report; raises RemoteProtocolError when it cannot be."""
        job = self.jobs.get(report.job)
        if job is None:
            if report.job not in self.ended:
                raise RemoteProtocolError(f"a report of job {report.job} came, which does not exist")
            return
        self.watch.reported(job.id)
        self._carry_out(job, job.receive(worker, report, now), now)
        self._keeper.look_at(job, report.variable, now)

    def states_came(self, worker: str, asked: PullStates, body: States | None, now: float) -> None:
        """Take in the answer to a question for states; None: there was none, and it is asked again later.

        Raises:
            RemoteProtocolError: A state was damaged on its way.
        """
        self._keeper.states_came(self.jobs.get(asked.job), worker, asked, body)
        if body is not None:
            self._keeper.look(self.jobs.values(), now)

    def written(self, checkpoint: Checkpoint, now: float) -> None:
        """Take in that a checkpoint is durable: it is told, and whoever waits for it is placed."""
        job = self.jobs.get(checkpoint.job)
        commit = self._keeper.written(job, checkpoint, now)
        if job is not None:
            self.watch.committed(checkpoint)
        if commit is not None:
            self._outlet.tell(commit)
        self.place(now)
        if self._keeper.is_short:
            self._keeper.look(self.jobs.values(), now)

    def tick(self, now: float) -> None:
        """Let time pass: lost workers, `--max-time`, jobs that wait for their turn."""
        for worker in self.membership.expire(now, self.watch.patience(self.jobs.values())):
            member = self.membership.member(worker)
            if member is not None:
                self._lose(member, member.lost_by, now)
        for job in list(self.jobs.values()):
            self._carry_out(job, job.tick(now), now)
        self._prepare_next(now)
        self.place(now)
        self._keeper.look(self.jobs.values(), now)
        self.watch.look(self.jobs.values(), now)

    def _lose(self, member: Member, why: str, now: float) -> None:
        """Take notice that a process is lost, which may be the last one that a job can cost."""
        for job, sentence in self.watch.lost(member, why, self.jobs.values()):
            self.job_failed(job, "poison", sentence, now)

    def place(self, now: float) -> None:
        """Begin the terms that are due; deaths that the last ones ended with are durable by then."""
        self.watch.keep_deaths()
        self._terms.begin(tuple(self.jobs.values()), now)

    # ----------------------------------------------------------------------------------------- outcomes

    def _carry_out(self, job: Job, actions: list[JobAction], now: float) -> None:
        for action in actions:
            match action:
                case KeepCuts():
                    self._keep_cuts(job, action.cuts)
                case TellCommit():
                    self._outlet.tell(action.commit)
                case Refine():
                    if job.prepared is not None:
                        self.watch.refining(job.id)
                        self._outlet.refine(job.id, job.prepared, action.pools)
                case Conclude():
                    self._conclude(job, now)

    def _keep_cuts(self, job: Job, cuts: Sequence[Cut]) -> None:
        self._store.commit_cuts(job.id, {cut.variable: encode(cut) for cut in cuts})
        for cut in cuts:
            placement = job.archipelagos[cut.variable].placement
            if placement is not None:
                self._outlet.tell(Close(job=job.id, variable=cut.variable, term=placement.term))
            self.watch.cut(job.id, cut)

    def _live_view(self, job: Job, now: float) -> JobView:
        return self.watch.completed(job_view(job, self.membership, now, tuple(self.jobs.values())), job)

    def _conclude(self, job: Job, now: float) -> None:
        text = result_text(job_result(job, now)) if job.prepared is not None else None
        self._store.update_job(job.id, elapsed=now - job.submitted_at)
        is_poison = job.fault == "poison"
        self._store.commit_result(job.id, job.state, text, job.reason, self._clock(), keeps_checkpoints=is_poison)
        self._outlet.tell(CloseJob(job=job.id))
        self._outlet.stop(job.id)
        self.ended[job.id] = replace_workers(self._live_view(job, now))
        del self.jobs[job.id]
        self.watch.ended(job)
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
            self.job_failed(waiting.id, "internal", "its table is not in the store any more; submit it again", now)
            return
        self._store.update_job(waiting.id, state="preparing")
        waiting.prepare()
        self._outlet.prepare(waiting.id, table, waiting.config)


def replace_workers(view: JobView) -> JobView:
    """Return the view of a job that has ended: nobody works on it."""
    return view.model_copy(update={"workers": 0, "stalls": (), "ahead": None})
