"""What the coordinator keeps an eye on beside the search itself: events, deaths, patience, stalls, counters.

The controller tells it what happens; it answers which archipelagos must be computed apart, how patient to be with a
worker, and which jobs cannot go on. Nothing here can change a bit of a result.
"""

from collections.abc import Callable, Iterable
from typing import Final

from atoll.wire.messages.clients import Submit
from atoll.wire.messages.handshake import Hello
from atoll.wire.messages.views import EventKind, JobCounters, JobView
from atoll.wire.messages.workers import Holding, Placement, WorkerStatus
from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.monitoring.event_log import Chronicle
from atoll_coordinator.service.monitoring.stalls import Stillness
from atoll_coordinator.service.ports import StorePort
from atoll_coordinator.service.search.archipelago import Archipelago, Checkpoint
from atoll_coordinator.service.search.cut import Cut
from atoll_coordinator.service.store.deaths import Death
from atoll_coordinator.service.workers.crash_loops import Dead, Suspicion
from atoll_coordinator.service.workers.leases import Leases
from atoll_coordinator.service.workers.membership import Member, Membership, Patience
from atoll_coordinator.service.workers.quarantine import Isolation, Key

MAX_REFUSED: Final = 1000
"""Refusals that are told; each only once, and no flood of them fills the log."""

Verdicts = list[tuple[str, str]]
"""Jobs that cannot go on, and why."""


class Watch:
    """The eye on all jobs and workers of one coordinator."""

    def __init__(self, membership: Membership, store: StorePort, clock: Callable[[], str]) -> None:
        """`clock` gives the time of day as ISO text."""
        self.chronicle: Final = Chronicle(store, clock)
        self.isolation: Final = Isolation(membership)
        self.stillness: Final = Stillness()
        self._membership = membership
        self._leases = Leases()
        self._suspicions: dict[Key, Suspicion] = {}
        self._store = store
        self._deaths: list[Death] = []
        self._counters: dict[str, JobCounters] = {}
        self._waited: dict[tuple[str, str, int, str], float] = {}
        self._refused: set[tuple[str, str]] = set()

    def started(self, realm: str, incarnation: int) -> None:
        """Take notice of the coordinator's own start."""
        self.chronicle.note("started", "the coordinator is ready", realm=realm, incarnation=incarnation)

    # ---------------------------------------------------------------------------------------------- jobs

    def submitted(self, body: Submit) -> None:
        """Take notice of a new job."""
        self.chronicle.note("submitted", f"submitted as {body.name!r}", body.job, priority=body.priority)

    def resumed(self, job: str) -> None:
        """Take over what was thought of a job's archipelagos before the coordinator was started again."""
        for death in self._store.deaths(job):
            suspicion = self._suspicions.setdefault((death.job, death.variable), Suspicion())
            suspicion.died(death.term, (death.worker, death.instance))

    def prepared(self, job: Job) -> None:
        """Take notice that a job's data are prepared."""
        sought = ", ".join(job.archipelagos)
        self.chronicle.note("prepared", f"data are prepared; sought: {sought or 'nothing'}", job.id)

    def placed(self, placement: Placement) -> None:
        """Take notice of a new term."""
        job, workers = placement.job, sorted(set(placement.workers))
        self._count(job, placements=1)
        where = f"on {len(workers)} worker{'s' * (len(workers) > 1)}: {', '.join(workers[:8])}"
        self.chronicle.note(
            "placed", f"{len(placement.workers)} islands {where}{' …' * (len(workers) > 8)}", job,
            variable=placement.variable, term=placement.term, epoch=placement.epoch, workers=len(workers),
        )  # fmt: skip

    def unplaced(self, archipelago: Archipelago) -> None:
        """Take notice that an archipelago has lost a worker that it was placed on."""
        text = "a worker of its placement is lost, or kept for another archipelago"
        self.chronicle.note("unplaced", text, archipelago.job, variable=archipelago.variable)

    def reported(self, job: str) -> None:
        """Count a report."""
        self._count(job, reports=1)

    def committed(self, checkpoint: Checkpoint) -> None:
        """Take notice that a checkpoint is durable: the archipelago gets on."""
        job, variable, epoch = checkpoint.job, checkpoint.variable, checkpoint.epoch
        self._leases.committed((job, variable))
        self._count(job, commits=1)
        suspicion = self._suspicions.get((job, variable))
        was_isolated = suspicion is not None and suspicion.is_isolated
        if suspicion is not None and suspicion.commits(epoch) and was_isolated:
            self.chronicle.note("pardoned", "it gets on, and is isolated no more", job, variable=variable)
        text = f"the checkpoint of epoch {epoch} is durable"
        self.chronicle.note(
            "commit", text, job, variable=variable, epoch=epoch, term=checkpoint.term, islands=len(checkpoint.states),
            bytes=checkpoint.size,
        )  # fmt: skip

    def cut(self, job: str, cut: Cut) -> None:
        """Take notice of an archipelago's end."""
        text = f"the search has ended after {cut.epochs} epochs: {cut.why}"
        self.chronicle.note("cut", text, job, variable=cut.variable, epoch=max(0, cut.epochs - 1), why=cut.why)

    def refining(self, job: str) -> None:
        """Take notice that a job is searched and is being refined."""
        self.chronicle.note("refining", "all searches have ended; its equations are being refined", job)

    def given_up(self, job: str, reason: str) -> None:
        """Take notice of a stored job that cannot be taken over."""
        self.chronicle.note("failed", reason, job)

    def ended(self, job: Job) -> None:
        """Take notice of a job's end, and forget it."""
        kinds: dict[str, EventKind] = {"failed": "failed", "cancelled": "cancelled"}
        kind = kinds.get(job.state, "done")
        self.chronicle.note(kind, job.reason or job.state, job.id, fault=job.fault)
        self.chronicle.flush()
        self._leases.forget(job.id)
        self._counters.pop(job.id, None)
        self._suspicions = {key: value for key, value in self._suspicions.items() if key[0] != job.id}
        self._deaths = [each for each in self._deaths if each.job != job.id]
        self._waited = {key: value for key, value in self._waited.items() if key[0] != job.id}

    def completed(self, view: JobView, job: Job) -> JobView:
        """Return the view of a live job with what is known here."""
        rooms = [each.variable for each in job.open_archipelagos if self.isolation.waits((job.id, each.variable))]
        waits = f"islands of {', '.join(rooms)} are isolated and wait for a worker of their own" if rooms else None
        return view.model_copy(
            update={
                "stalls": self.stillness.sentences(job.id), "counters": self.counters(job),
                "reason": waits or view.reason,
            }
        )  # fmt: skip

    def counters(self, job: Job) -> JobCounters:
        """Return what a live job has cost beside its point evaluations."""
        duplicates = sum(each.collector.duplicates for each in job.archipelagos.values())
        waited = sum(seconds for key, seconds in self._waited.items() if key[0] == job.id)
        known = self._counters.get(job.id, JobCounters())
        return known.model_copy(update={"duplicates": duplicates, "waited_s": waited})

    # ------------------------------------------------------------------------------------------- workers

    def greeted(self, hello: Hello, refusal: str | None) -> None:
        """Take notice of a new worker, or of one that was refused."""
        if refusal is not None:
            if (hello.name, refusal) not in self._refused and len(self._refused) < MAX_REFUSED:
                self._refused.add((hello.name, refusal))
                self.chronicle.note("refused", refusal, worker=hello.name)
        else:
            text = f"process {hello.pid} on {hello.host or 'an unnamed host'}"
            self.chronicle.note("worker-joined", text, worker=hello.name)
            self._take_back((hello.name, hello.instance))

    def waited(self, worker: str, holding: Holding) -> None:
        """Take notice of how long islands of a current placement have waited on a worker."""
        self._waited[holding.job, holding.variable, holding.term, worker] = holding.waited_s

    def heard(self, worker: str, status: WorkerStatus, was_lost: bool) -> None:
        """Take notice of a heartbeat: it may be of a process that was taken for dead."""
        if not was_lost or self._membership.is_lost(worker):
            return
        self.chronicle.note("worker-back", "it is there again, as the same process", worker=worker)
        self._take_back((worker, status.instance))

    def lost(self, member: Member, why: str, jobs: Iterable[Job]) -> Verdicts:
        """Take notice that a process is lost; return the jobs that it was one worker too many for.

        One that had said that it would leave was not killed by what it computed.
        """
        dead = (member.hello.name, member.hello.instance)
        held = held_by(member.hello.name, jobs)
        for job in dict.fromkeys(each.job for each in held) or (None,):
            self.chronicle.note("worker-lost", why, job, worker=member.hello.name)
        if member.is_leaving:
            return []
        return [verdict for each in held if (verdict := self._count_death(each, dead, why)) is not None]

    def keep_deaths(self) -> None:
        """Make durable which deaths were counted, before their islands are placed anew."""
        if self._deaths:
            deaths, self._deaths = self._deaths, []
            self._store.add_deaths(deaths)

    def patience(self, jobs: Iterable[Job]) -> Patience:
        """Return how patient to be with each worker."""
        keys: dict[str, set[Key]] = {}
        for archipelago in (each for job in jobs for each in job.open_archipelagos):
            for name in set(archipelago.placement.workers) if archipelago.placement is not None else ():
                keys.setdefault(name, set()).add((archipelago.job, archipelago.variable))
        return lambda worker: self._leases.patience(keys.get(worker, ()))

    # ---------------------------------------------------------------------------------------------- time

    def furnish(self, jobs: Iterable[Job]) -> None:
        """See to it that isolated archipelagos have rooms of their own, before anything is placed."""
        open_ones = [each for job in jobs for each in job.open_archipelagos]
        keys = [(each.job, each.variable) for each in open_ones]
        isolated = [key for key in keys if key in self._suspicions and self._suspicions[key].is_isolated]
        load: dict[str, int] = {}
        for each in open_ones:
            for name in set(each.placement.workers) if each.placement is not None else ():
                load[name] = load.get(name, 0) + 1
        self.isolation.furnish(isolated, len(keys) - len(isolated), load)

    def look(self, jobs: Iterable[Job], now: float) -> None:
        """Look for archipelagos that stand still, tell of each once, and of its end; write events."""
        open_ones = [each for job in jobs for each in job.open_archipelagos]
        for each in open_ones:
            before = self.stillness.stalls.get((each.job, each.variable))
            stall = self.stillness.look(each, self._membership, now)
            if stall is not None and (before is None or (before.cause, before.worker) != (stall.cause, stall.worker)):
                self._count(each.job, stalls=1)
                self.chronicle.note(
                    "stalled", stall.sentence, each.job, variable=each.variable, island=stall.islands[0],
                    epoch=stall.epoch, term=stall.term, worker=stall.worker, cause=stall.cause,
                )  # fmt: skip
            elif stall is None and before is not None:
                self.chronicle.note("moving", "it gets on again", each.job, variable=each.variable)
        self.stillness.keep_only({(each.job, each.variable) for each in open_ones})
        self.chronicle.flush()

    # ------------------------------------------------------------------------------------------- private

    def _take_back(self, dead: Dead) -> None:
        """Take back the death of a process that is there."""
        suspected = {key: each for key, each in self._suspicions.items() if each.counts(dead)}
        for (job, variable), suspicion in suspected.items():
            if suspicion.came_back(dead):
                text = f"worker {dead[0]} is alive after all; its loss does not count"
                self.chronicle.note("pardoned", text, job, variable=variable, worker=dead[0])
        self._deaths = [each for each in self._deaths if (each.worker, each.instance) != dead]
        if suspected:
            self._store.take_back_deaths(*dead)

    def _count_death(self, archipelago: Archipelago, dead: Dead, why: str) -> tuple[str, str] | None:
        """Count a death for an archipelago; return job and reason when it was one too many."""
        key = (archipelago.job, archipelago.variable)
        self._leases.evicted(key)
        self._count(archipelago.job, deaths=1)
        suspicion = self._suspicions.setdefault(key, Suspicion())
        term = archipelago.placement.term if archipelago.placement is not None else 0
        counts = suspicion.died(term, dead)
        if suspicion.state != "condemned":  # else its job ends now, and that is durable
            self._deaths.append(Death(*key, term, *dead))
        if not counts:
            return None
        if suspicion.state == "isolated":
            text = "three times in a row a worker died that computed its islands; they get one worker for themselves"
            self.chronicle.note("isolated", text, key[0], variable=key[1])
        if suspicion.state != "condemned":
            return None
        return key[0], (
            f"the islands of {key[1]} end the workers that compute them: in 5 placements in a row workers were lost "
            f"before there was a commit, in the last 2 they computed nothing else (the last was {dead[0]}: {why}); "
            "look at that worker's own log, at its memory, and at the data"
        )

    def _count(self, job: str, **more: int) -> None:
        known = self._counters.get(job, JobCounters())
        self._counters[job] = known.model_copy(update={name: getattr(known, name) + n for name, n in more.items()})


def held_by(worker: str, jobs: Iterable[Job]) -> list[Archipelago]:
    """Return the archipelagos that have islands placed on a worker."""
    return [
        each
        for job in jobs
        for each in job.open_archipelagos
        if each.placement is not None and worker in each.placement.workers
    ]
