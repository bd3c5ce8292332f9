"""Worker controller: handles greetings, heartbeats and silence of workers, and begins terms of archipelagos.

Changes are stored before messages about them are sent. A step that concerns several jobs is guarded for each job, so
that an error in one job does not affect the others. `LiveJobs.fail_job` fails a job if an island failed or too
many workers were lost.
"""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Final, Protocol

from atoll_coordinator.service.jobs.job import Fault, Job
from atoll_coordinator.service.monitoring.breakages import Breakages, JobGuard, ask_for_report
from atoll_coordinator.service.monitoring.event_log import EventLog
from atoll_coordinator.service.monitoring.job_views import CounterRegistry
from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.workers.channel import WorkerChannel
from atoll_coordinator.service.workers.crash_loops import CrashLoops, Quarantine
from atoll_coordinator.service.workers.membership import Membership, RegisteredWorker
from atoll_coordinator.service.workers.placement import Assignment, Placer, corrections
from atoll_coordinator.service.workers.stalls import StallDetector
from atoll_core.compilation.cache import WORKER, source_digest
from atoll_core.errors import RemoteProtocolError
from atoll_core.wire.codec import encode
from atoll_core.wire.messages import workers as messages
from atoll_core.wire.messages.epochs import PullReports
from atoll_core.wire.messages.handshake import Hello


class LiveJobs(Protocol):
    """The part of `atoll_coordinator.service.job_controller.JobController` that the worker controller uses."""

    @property
    def jobs(self) -> Mapping[str, Job]: ...  # by id

    @property
    def ending(self) -> Mapping[str, object]: ...  # jobs whose ends are decided but not stored

    @property
    def begun(self) -> Mapping[str, Job]: ...  # jobs that may have islands

    @property
    def breakages(self) -> Breakages: ...  # for errors that concern no particular job

    def fail_job(self, job_id: str, fault: Fault, sentence: str, now: float) -> None: ...

    def has_task(self, worker: str) -> bool: ...

    def lose_tasks(self, worker: str, now: float, *, had_left: bool) -> tuple[str, ...]: ...

    def guarded(self, job_id: str, task: str, now: float) -> AbstractContextManager[None]: ...


class WorkerController:
    """All workers, and the placements of all archipelagos on them."""

    def __init__(
        self, live: LiveJobs, store: Store, channel: WorkerChannel, events: EventLog, expected_workers: int
    ) -> None:
        """`expected_workers`: see `Placer`."""
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
        self._quarantine = Quarantine(self.membership, self.crash_loops)
        self._placer = Placer(self.membership, self._quarantine, expected_workers)
        self._stalls = StallDetector(self.membership)

    def register(self, hello: Hello, now: float) -> str | None:
        """Add a worker, or return a sentence on why it is refused.

        A new process under a known name does not have the islands of the old process: they are placed again.
        """
        is_new, before = self.membership.is_new(hello), self.membership.member(hello.name)
        was_ready = self.membership.is_ready(hello.name)
        refusal = self.membership.register(hello, now)
        if refusal is not None:
            self._events.record_refusal(hello.name, refusal)
        elif is_new:
            text = f"process {hello.pid} on {hello.host or 'an unnamed host'}"
            self._events.record("worker-joined", text, worker=hello.name)
            self.crash_loops.withdraw((hello.name, hello.instance))
            if before is not None:
                self._lose(before, "a new process has its name", now)
            for archipelago in self._open_archipelagos():
                with self._guarded(archipelago.job, "taking islands from a worker that was started again", now):
                    if hello.name in archipelago.workers:
                        archipelago.unplace()
            self.place(now)
        elif not was_ready and self.membership.is_ready(hello.name):
            self.place(now)
        return refusal

    def add_heartbeat(self, worker: str, status: messages.WorkerStatus, now: float) -> bool:
        """Handle a heartbeat, and correct differences in the worker's holdings by messages.

        Return False if this process is not known; it is asked to greet.

        Raises:
            RemoteProtocolError: The worker names a later incarnation that does not exist, or islands that are placed
                elsewhere.
            StoreError: The later incarnation exists: another coordinator has taken over.
        """
        if status.incarnation > self._store.incarnation:
            self._store.check()
            raise RemoteProtocolError(
                f"worker {worker} names incarnation {status.incarnation}, but the latest is {self._store.incarnation}"
            )
        self._check_places(worker, status, now)
        was_ready, was_lost = self.membership.is_ready(worker), self.membership.is_lost(worker)
        if not self.membership.record_heartbeat(worker, status, now):
            self._channel.send(worker, messages.Reregister())
            return False
        if was_lost and not self.membership.is_lost(worker):
            self._events.record("worker-back", "it has returned, as the same process", worker=worker)
            self.crash_loops.withdraw((worker, status.instance))
        if not was_ready and self.membership.is_ready(worker):
            self.place(now)
        for failure in status.failures:
            with self._guarded(failure.job, "handling a failed island", now):
                if self._placed(failure.job, failure.variable, failure.term) is not None:
                    to_send = ask_for_report(self._jobs[failure.job].config)
                    sentence = f"{failure.sentence} (on worker {worker}){to_send}"
                    self._fail_job(failure.job, "internal", sentence, now)
        for assignment_status in status.holdings:
            with self._guarded(assignment_status.job, "recording the progress of islands", now):
                self._update_assignment_status(worker, assignment_status)
        self._correct(worker, status, now)
        if status.state == "leaving":
            self._let_leave(worker, now)
        return True

    def _correct(self, worker: str, status: messages.WorkerStatus, now: float) -> None:
        """Send a worker missing placements and releases."""

        def guarded(job: str) -> AbstractContextManager[None]:
            return self._guarded(job, "correcting the holdings of a worker", now)

        for correction in corrections(self._jobs, self._begun, worker, status, guarded, self._ending):
            if isinstance(correction, PullReports):
                self._channel.pull(worker, correction)
            else:
                self._channel.send(worker, correction)

    def _check_places(self, worker: str, status: messages.WorkerStatus, now: float) -> None:
        """Raise RemoteProtocolError when a worker names islands that are placed elsewhere."""
        wrong: list[str] = []
        claims: tuple[messages.AssignmentStatus | messages.IslandFailure, ...] = (*status.holdings, *status.failures)
        for claim in claims:
            with self._guarded(claim.job, "checking where islands are placed", now):
                archipelago = self._placed(claim.job, claim.variable, claim.term)
                islands = archipelago.islands_of(worker) if archipelago is not None else None
                if islands is not None and isinstance(claim, messages.AssignmentStatus) and not islands:
                    placed = f"{claim.variable} of job {claim.job}"
                    wrong.append(f"worker {worker} has {placed}, which is placed elsewhere")
                elif islands is not None and isinstance(claim, messages.IslandFailure) and claim.island not in islands:
                    island = f"island {claim.island} of {claim.variable} of job {claim.job}"
                    wrong.append(f"worker {worker} reports that {island} failed, which is placed elsewhere")
        if wrong:
            raise RemoteProtocolError(wrong[0])

    def _update_assignment_status(self, worker: str, assignment_status: messages.AssignmentStatus) -> None:
        """Record a worker's progress with its islands; publish a commit that becomes due."""
        archipelago = self._placed(assignment_status.job, assignment_status.variable, assignment_status.term)
        if archipelago is not None:
            commit = archipelago.update_assignment_status(worker, assignment_status)
            self.counters.set_waited(worker, assignment_status)
            if commit is not None:
                self.tell(archipelago, commit)

    def tell(self, archipelago: Archipelago, body: messages.Commit | messages.Close) -> None:
        """Send a message to the workers of an archipelago.

        One message to all workers is sent if these are at least half of all workers. Otherwise, with many archipelagos,
        most messages would go to workers that ignore them.
        """
        workers = archipelago.workers
        if 2 * len(workers) < len(self.membership):
            self._channel.send_to(workers, body)
        else:
            self._channel.publish(body)

    def _let_leave(self, worker: str, now: float) -> None:
        """Place the islands of a leaving worker elsewhere; let it end when it has no islands and no task."""
        self.place(now)
        has_islands = any(worker in archipelago.workers for archipelago in self._open_archipelagos())
        if not has_islands and not self._has_task(worker):
            self._channel.send(worker, messages.Shutdown(sentence="it has no more islands or tasks"))

    def send_away(self, worker: str, why: str, now: float) -> None:
        """Treat a worker that may no longer take part as lost; its islands are placed again."""
        member = self.membership.send_away(worker)
        if member is not None:
            self._lose(member, why, now)
            self.place(now)

    def expire(self, now: float) -> None:
        """Treat the workers whose leases have ended as lost."""
        for member in self.membership.expire(now, self.crash_loops.lease_factors(self._open_archipelagos())):
            self._lose(member, member.lost_by, now)

    def _lose(self, member: RegisteredWorker, why: str, now: float) -> None:
        """Record that a process is lost, and fail jobs that have now lost too many workers.

        The loss of a process that had announced its end does not count: its islands were not the cause.
        """
        name = member.hello.name
        of_tasks = self._lose_tasks(name, now, had_left=member.is_leaving)
        lost = [archipelago for archipelago in self._open_archipelagos() if name in archipelago.workers]
        jobs = dict.fromkeys([*(archipelago.job for archipelago in lost), *of_tasks])
        if not jobs:
            self._events.record("worker-lost", why, worker=name)
        for job in jobs:
            with self._guarded(job, "recording that a worker is lost", now):
                self._events.record("worker-lost", why, job, worker=name)
        reasons: list[tuple[str, str]] = []
        for archipelago in lost if not member.is_leaving else ():
            with self._guarded(archipelago.job, "recording that a worker is lost", now):
                reason = self._add_death(archipelago, member, why)
                reasons += [(archipelago.job, reason)] if reason is not None else []
        for job_id, reason in reasons:
            self._fail_job(job_id, "poison", reason, now)

    def _add_death(self, archipelago: Archipelago, member: RegisteredWorker, why: str) -> str | None:
        """Count the loss of a process for an archipelago; return the reason if its job fails by it."""
        self.counters.add(archipelago.job, deaths=1)
        term = archipelago.placement.term if archipelago.placement is not None else 0
        return self.crash_loops.add_death(archipelago.key, term, (member.hello.name, member.hello.instance), why)

    def place(self, now: float) -> None:
        """Begin the terms that are due. An error ends only the job that it concerns."""

        def guarded(job: str) -> AbstractContextManager[None]:
            return self._guarded(job, "placing islands", now)

        self.crash_loops.save()
        plan = self._placer.plan_placements(tuple(self._begun.values()), now, guarded)
        for key in plan.broken:
            with guarded(key[0]):
                text = "a worker of its placement is lost, or reserved for another archipelago"
                self._events.record("unplaced", text, key[0], variable=key[1])
        for placement in plan.released:
            for worker in dict.fromkeys(placement.workers):
                self._channel.send(
                    worker, messages.Close(job=placement.job, variable=placement.variable, term=placement.term)
                )
        begun = self._begin_terms(plan.assignments, guarded)
        for job in {assignment.job.id: assignment.job for assignment, _ in begun}.values():
            with guarded(job.id):
                self._channel.publish(job.announcement())
        for assignment, placement in begun:
            with guarded(placement.job):
                self._place(assignment, placement, now)

    def _begin_terms(
        self, assignments: Sequence[Assignment], guarded: JobGuard
    ) -> list[tuple[Assignment, messages.Placement]]:
        """Store all terms in one transaction, which is faster; after an error, each in a separate transaction."""
        live = [assignment for assignment in assignments if assignment.job.id in self._jobs]
        with self._breakages.tolerated("beginning terms"):
            return self._store_terms(live)
        begun: list[tuple[Assignment, messages.Placement]] = []
        for assignment in live:
            with guarded(assignment.job.id):
                begun += self._store_terms([assignment]) if assignment.job.id in self._jobs else []
        return begun

    def _store_terms(self, assignments: Sequence[Assignment]) -> list[tuple[Assignment, messages.Placement]]:
        placements: list[messages.Placement] = []

        def encode_placement(index: int, term: int) -> bytes:
            placements.append(assignments[index].placement(self._store.incarnation, term))
            return encode(placements[-1])

        if assignments:
            self._store.begin_terms([assignment.archipelago.key for assignment in assignments], encode_placement)
        return list(zip(assignments, placements, strict=True))

    def _place(self, assignment: Assignment, placement: messages.Placement, now: float) -> None:
        """Begin a stored term, unless its job has ended in the meantime."""
        if placement.job not in self._jobs:
            return
        assignment.archipelago.place(placement, now)
        assignment.job.start_search(now)
        self._channel.publish(messages.Placements(placements=(placement,)))
        self.counters.add(placement.job, placements=1)
        self._events.record_placement(placement)

    def check_stalls(self, now: float) -> None:
        """Record which archipelagos make no progress, and which make progress again."""
        for (job, variable), stall in self._stalls.check(self._open_archipelagos(), now):
            if stall is None:
                self._events.record("moving", "it makes progress again", job, variable=variable)
                continue
            self.counters.add(job, stalls=1)
            self._events.record(
                "stalled", stall.sentence, job, variable=variable, island=stall.islands[0], epoch=stall.epoch,
                term=stall.term, worker=stall.worker, cause=stall.cause,
            )  # fmt: skip

    def stalls(self, job_id: str) -> tuple[str, ...]:
        """Return sentences on why archipelagos of a job make no progress, by variable."""
        return self._stalls.sentences(job_id)

    def waiting_reason(self, job: Job) -> str | None:
        """Return a sentence on why archipelagos of a job without workers wait; None: all have workers."""
        quarantined = self._quarantine.waiting(job.open_archipelagos)
        if quarantined:
            return f"islands of {', '.join(quarantined)} are isolated and wait for a worker of their own"
        is_waiting = any(archipelago.placement is None for archipelago in job.open_archipelagos)
        return self.membership.waiting_reason() if is_waiting else None

    def _open_archipelagos(self) -> list[Archipelago]:
        return [archipelago for job in self._begun.values() for archipelago in job.open_archipelagos]

    def _placed(self, job_id: str, variable: str, term: int) -> Archipelago | None:
        """Return the archipelago that is placed under this term now; None: there is none."""
        job = self._jobs.get(job_id)
        archipelago = job.open_archipelago(variable) if job is not None else None
        placement = archipelago.placement if archipelago is not None else None
        return archipelago if placement is not None and placement.term == term else None
