"""What becomes of workers and placements: takes in greetings, heartbeats and silence, and begins terms.

A job that cannot go on because of its workers is handed to `LiveJobs.fail_job`. What is sent has been stored before.
What is done for one job after the other is guarded by job: whatever breaks over one, the others have their turn.
"""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Final, Protocol

from atoll_coordinator.service.jobs.job import Fault, Job
from atoll_coordinator.service.monitoring.breakages import Breakages, JobGuard, what_to_send
from atoll_coordinator.service.monitoring.counters import CounterRegistry
from atoll_coordinator.service.monitoring.event_log import EventLog
from atoll_coordinator.service.search.archipelago import Archipelago, Checkpoint
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.workers.channel import WorkerChannel
from atoll_coordinator.service.workers.crash_loops import CrashLoops
from atoll_coordinator.service.workers.lease_backoff import LeaseBackoff
from atoll_coordinator.service.workers.membership import Member, Membership
from atoll_coordinator.service.workers.quarantine import Quarantine
from atoll_coordinator.service.workers.reconciliation import corrections
from atoll_coordinator.service.workers.scheduling import Assignment, Scheduler
from atoll_coordinator.service.workers.stalls import StallDetector
from atoll_core.compilation.cache import WORKER, source_digest
from atoll_core.errors import RemoteProtocolError
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.epochs import PullReports
from atoll_core.wire.messages.handshake import Hello
from atoll_core.wire.messages.workers import (
    AssignmentStatus,
    Close,
    IslandFailure,
    Placement,
    Placements,
    Reregister,
    Shutdown,
    WorkerStatus,
)


class LiveJobs(Protocol):
    """The part of `atoll_coordinator.service.job_controller.JobController` that workers have to do with."""

    @property
    def jobs(self) -> Mapping[str, Job]: ...  # by id, as they come and go

    @property
    def ending(self) -> Mapping[str, object]: ...  # those whose ends are decided and not in the store

    @property
    def begun(self) -> Mapping[str, Job]: ...  # those that do not wait any more: others have no islands

    @property
    def breakages(self) -> Breakages: ...  # for what breaks over no job in particular

    def fail_job(self, job_id: str, fault: Fault, sentence: str, now: float) -> None: ...

    def has_task(self, worker: str) -> bool: ...

    def lose_tasks(self, worker: str, now: float, *, had_left: bool) -> tuple[str, ...]: ...

    def guarded(self, job_id: str, task: str, now: float) -> AbstractContextManager[None]: ...


class WorkerController:
    """All workers, and the placements of all archipelagos on them."""

    def __init__(
        self, live: LiveJobs, store: Store, channel: WorkerChannel, events: EventLog, expected_workers: int
    ) -> None:
        """See `Scheduler` for the expected workers."""
        self.membership: Final = Membership(source_digest(WORKER))
        self.counters: Final = CounterRegistry()
        self.crash_loops: Final = CrashLoops(store, events)
        self._jobs = live.jobs
        self._ending = live.ending
        self._begun = live.begun
        self._store = store
        self._channel = channel
        self._events = events
        self._fail_job = live.fail_job
        self._has_task = live.has_task
        self._lose_tasks = live.lose_tasks
        self._guarded = live.guarded
        self._breakages = live.breakages
        self._leases = LeaseBackoff()
        self._quarantine = Quarantine(self.membership, self.crash_loops)
        self._scheduler = Scheduler(self.membership, self._quarantine, expected_workers)
        self._stalls = StallDetector(self.membership)

    def register(self, hello: Hello, now: float) -> str | None:
        """Take in a worker; return a sentence instead when it must be refused.

        A new process under a known name does not have the islands of the old one: they are placed anew.
        """
        is_new, before = self.membership.is_new(hello), self.membership.member(hello.name)
        was_ready = self.membership.is_ready(hello.name)
        refusal = self.membership.register(hello, now)
        if refusal is not None:
            self._events.record_refusal(hello.name, refusal)
        elif is_new:
            self._events.record_joining(hello)
            self.crash_loops.withdraw((hello.name, hello.instance))
            if before is not None:
                self._lose(before, "a new process has its name", now)
            for archipelago in self._open_archipelagos():
                with self._guarded(archipelago.job, "taking islands from a worker that was started anew", now):
                    if hello.name in archipelago.workers:
                        archipelago.unplace()
            self.place(now)
        elif not was_ready and self.membership.is_ready(hello.name):
            self.place(now)
        return refusal

    def add_heartbeat(self, worker: str, status: WorkerStatus, now: float) -> bool:
        """Take in a heartbeat, and correct what the worker holds and should not, or should and does not.

        Returns False when this process is not known; it is asked to greet.

        Raises:
            RemoteProtocolError: The worker has heard of an incarnation that there is not, or speaks for islands that
                are placed elsewhere.
            StoreError: There is: another coordinator has taken over.
        """
        self._check_incarnation(worker, status)
        self._check_places(worker, status, now)
        was_ready, was_lost = self.membership.is_ready(worker), self.membership.is_lost(worker)
        if not self.membership.record_heartbeat(worker, status, now):
            self._channel.send(worker, Reregister())
            return False
        if was_lost and not self.membership.is_lost(worker):
            self._events.record_return(worker)
            self.crash_loops.withdraw((worker, status.instance))
        if not was_ready and self.membership.is_ready(worker):
            self.place(now)
        for failure in status.failures:
            with self._guarded(failure.job, "taking in that an island failed", now):
                self._add_failure(worker, failure, now)
        for assignment_status in status.holdings:
            with self._guarded(assignment_status.job, "taking in how far islands are", now):
                self._update_assignment_status(worker, assignment_status)
        self._correct(worker, status, now)
        if status.state == "leaving":
            self._let_leave(worker, now)
        return True

    def _correct(self, worker: str, status: WorkerStatus, now: float) -> None:
        """Send a worker what it lacks, and what it may forget."""

        def guarded(job: str) -> AbstractContextManager[None]:
            return self._guarded(job, "correcting what a worker holds", now)

        for correction in corrections(self._jobs, self._begun, worker, status, guarded, self._ending):
            if isinstance(correction, PullReports):
                self._channel.pull(worker, correction)
            else:
                self._channel.send(worker, correction)

    def _check_incarnation(self, worker: str, status: WorkerStatus) -> None:
        if status.incarnation > self._store.incarnation:
            self._store.check()
            raise RemoteProtocolError(
                f"worker {worker} has heard of incarnation {status.incarnation}, but this is {self._store.incarnation}"
            )

    def _check_places(self, worker: str, status: WorkerStatus, now: float) -> None:
        """Raise RemoteProtocolError when a worker speaks for islands that are placed elsewhere."""
        wrong: list[str] = []
        claims: tuple[AssignmentStatus | IslandFailure, ...] = (*status.holdings, *status.failures)
        for claim in claims:
            with self._guarded(claim.job, "looking where islands are placed", now):
                archipelago = self._placed(claim.job, claim.variable, claim.term)
                islands = archipelago.islands_of(worker) if archipelago is not None else None
                if islands is not None and isinstance(claim, AssignmentStatus) and not islands:
                    placed = f"{claim.variable} of job {claim.job}"
                    wrong.append(f"worker {worker} holds {placed}, which is placed elsewhere")
                elif islands is not None and isinstance(claim, IslandFailure) and claim.island not in islands:
                    island = f"island {claim.island} of {claim.variable} of job {claim.job}"
                    wrong.append(f"worker {worker} says that {island} failed, which is placed elsewhere")
        if wrong:
            raise RemoteProtocolError(wrong[0])

    def _add_failure(self, worker: str, failure: IslandFailure, now: float) -> None:
        """Let the job of an island that broke on a worker fail."""
        if self._placed(failure.job, failure.variable, failure.term) is not None:
            to_send = what_to_send(self._jobs[failure.job].config)
            self._fail_job(failure.job, "internal", f"{failure.sentence} (on worker {worker}){to_send}", now)

    def _update_assignment_status(self, worker: str, assignment_status: AssignmentStatus) -> None:
        """Take in how far a worker is with what is placed on it; publish a commit that is due by that."""
        archipelago = self._placed(assignment_status.job, assignment_status.variable, assignment_status.term)
        if archipelago is not None:
            archipelago.update_assignment_status(worker, assignment_status)
            self.counters.set_waited(worker, assignment_status)
            commit = archipelago.due_commit()
            if commit is not None:
                self._channel.publish(commit)

    def _let_leave(self, worker: str, now: float) -> None:
        """Place elsewhere what a worker has that wants to end; when it has nothing, tell it so."""
        self.place(now)
        has_islands = any(worker in archipelago.workers for archipelago in self._open_archipelagos())
        if not has_islands and not self._has_task(worker):
            self._channel.send(worker, Shutdown(sentence="nothing is placed here any more"))

    def send_away(self, worker: str, why: str, now: float) -> None:
        """Give up a worker that may not take part any more; its islands are placed anew."""
        member = self.membership.send_away(worker)
        if member is not None:
            self._lose(member, why, now)
            self.place(now)

    def expire(self, now: float) -> None:
        """Give up the workers whose leases are over."""
        for member in self.membership.expire(now, self._leases.factors(self._open_archipelagos())):
            self._lose(member, member.lost_by, now)

    def _lose(self, member: Member, why: str, now: float) -> None:
        """Take in that a process is lost, and let the jobs fail that have cost one worker too many by that.

        One that had said that it would leave was not ended by what it computed.
        """
        name = member.hello.name
        of_tasks = self._lose_tasks(name, now, had_left=member.is_leaving)
        lost = [archipelago for archipelago in self._open_archipelagos() if name in archipelago.workers]
        jobs = dict.fromkeys([*(archipelago.job for archipelago in lost), *of_tasks])
        if not jobs:
            self._events.record("worker-lost", why, worker=name)
        for job in jobs:
            with self._guarded(job, "taking in that a worker is lost", now):
                self._events.record("worker-lost", why, job, worker=name)
        reasons: list[tuple[str, str]] = []
        for archipelago in lost if not member.is_leaving else ():
            with self._guarded(archipelago.job, "taking in that a worker is lost", now):
                reason = self._add_death(archipelago, member, why)
                reasons += [(archipelago.job, reason)] if reason is not None else []
        for job_id, reason in reasons:
            self._fail_job(job_id, "poison", reason, now)

    def _add_death(self, archipelago: Archipelago, member: Member, why: str) -> str | None:
        """Count the loss of a process for an archipelago; return the reason for which its job fails, if it does."""
        self._leases.add_eviction(archipelago.key)
        self.counters.add(archipelago.job, deaths=1)
        term = archipelago.placement.term if archipelago.placement is not None else 0
        return self.crash_loops.add_death(archipelago.key, term, (member.hello.name, member.hello.instance), why)

    def place(self, now: float) -> None:
        """Begin the terms that are due. A job over which something breaks ends, and the others are placed."""

        def guarded(job: str) -> AbstractContextManager[None]:
            return self._guarded(job, "placing islands", now)

        self.crash_loops.save()
        plan = self._scheduler.plan(tuple(self._begun.values()), now, guarded)
        for key in plan.broken:
            with guarded(key[0]):
                self._events.record_broken_placement(key)
        for placement in plan.released:
            for worker in dict.fromkeys(placement.workers):
                self._channel.send(worker, Close(job=placement.job, variable=placement.variable, term=placement.term))
        for assignment, placement in self._begin_terms(plan.assignments, guarded):
            with guarded(placement.job):
                self._place(assignment, placement, now)

    def _begin_terms(self, assignments: Sequence[Assignment], guarded: JobGuard) -> list[tuple[Assignment, Placement]]:
        """Make terms durable: all of them at once, since each commit takes its time; where that breaks, one by one."""
        live = [assignment for assignment in assignments if assignment.job.id in self._jobs]
        with self._breakages.tolerated("beginning terms"):
            return self._store_terms(live)
        begun: list[tuple[Assignment, Placement]] = []
        for assignment in live:
            with guarded(assignment.job.id):
                begun += self._store_terms([assignment]) if assignment.job.id in self._jobs else []
        return begun

    def _store_terms(self, assignments: Sequence[Assignment]) -> list[tuple[Assignment, Placement]]:
        placements: list[Placement] = []

        def encode_placement(index: int, term: int) -> bytes:
            placements.append(assignments[index].placement(self._store.incarnation, term))
            return encode(placements[-1])

        if assignments:
            self._store.begin_terms([assignment.archipelago.key for assignment in assignments], encode_placement)
        return list(zip(assignments, placements, strict=True))

    def _place(self, assignment: Assignment, placement: Placement, now: float) -> None:
        """Begin a term that is durable, unless its job has ended meanwhile."""
        if placement.job not in self._jobs:
            return
        assignment.archipelago.place(placement, now)
        assignment.job.start_search(now)
        self._channel.publish(Placements(placements=(placement,)))
        self.counters.add(placement.job, placements=1)
        self._events.record_placement(placement)

    def add_commit(self, checkpoint: Checkpoint) -> None:
        """Take in that a checkpoint is durable: its archipelago gets on."""
        self._leases.add_commit(checkpoint.key)
        self.crash_loops.add_commit(checkpoint.key, checkpoint.epoch)

    def check_stalls(self, now: float) -> None:
        """Record which archipelagos stand still, and which get on again."""
        for (job, variable), stall in self._stalls.check(self._open_archipelagos(), now):
            if stall is None:
                self._events.record("moving", "it gets on again", job, variable=variable)
                continue
            self.counters.add(job, stalls=1)
            self._events.record(
                "stalled", stall.sentence, job, variable=variable, island=stall.islands[0], epoch=stall.epoch,
                term=stall.term, worker=stall.worker, cause=stall.cause,
            )  # fmt: skip

    def stalls(self, job_id: str) -> tuple[str, ...]:
        """Return why archipelagos of a job stand still, in words, by variable."""
        return self._stalls.sentences(job_id)

    def waiting_reason(self, job: Job) -> str | None:
        """Return in words what the archipelagos of a job wait for that have no workers; None: all have."""
        quarantined = self._quarantine.waiting(job.open_archipelagos)
        if quarantined:
            return f"islands of {', '.join(quarantined)} are isolated and wait for a worker of their own"
        is_waiting = any(archipelago.placement is None for archipelago in job.open_archipelagos)
        return self.membership.waiting_reason() if is_waiting else None

    def forget(self, job: str) -> None:
        """Forget a job that has ended."""
        self._leases.forget(job)
        self.crash_loops.forget(job)

    def _open_archipelagos(self) -> list[Archipelago]:
        return [archipelago for job in self._begun.values() for archipelago in job.open_archipelagos]

    def _placed(self, job_id: str, variable: str, term: int) -> Archipelago | None:
        """Return the archipelago that is placed under a term now; None: there is none."""
        job = self._jobs.get(job_id)
        archipelago = job.open_archipelago(variable) if job is not None else None
        placement = archipelago.placement if archipelago is not None else None
        return archipelago if placement is not None and placement.term == term else None
