"""Placements: plans which archipelagos begin a term now, and on which workers; corrects the holdings of workers. Pure.

Placements decide when and where islands are computed, and never their results.

`Placer.plan_placements` visits all archipelagos at each event that may change something. A placement that has lost a
worker ends at once, and the next term continues from the last commit. For all other changes (a leaving worker, a better
balance, a held job) the archipelago first gets a barrier, so that no work is lost. Soon after a placement there is no
barrier, because little has been computed. *Doubts.* The load of a worker is its number of islands; differences between
islands or machines are not measured.
"""

import math
from collections import Counter
from collections.abc import Collection, Container, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.monitoring.breakages import JobGuard, unguarded
from atoll_coordinator.service.search.archipelago import Archipelago, ArchipelagoKey
from atoll_coordinator.service.workers.crash_loops import Quarantine
from atoll_coordinator.service.workers.membership import Membership
from atoll_core.wire.messages.epochs import PullReports
from atoll_core.wire.messages.workers import (
    AssignmentStatus,
    Close,
    CloseJob,
    Commit,
    JobAnnouncement,
    Placement,
    Placements,
    WorkerStatus,
)

REPLACE_WITHIN_S: Final = 5.0
"""Seconds after a placement in which it may be replaced at once, for example when a worker joins; the few results since
the placement are computed again."""

EXPECT_S: Final = 10.0
"""Seconds for which the first ready worker waits for the other expected workers."""

MOST_PULLS: Final = 500
"""Most pulls of migrants in an epoch of all archipelagos for which these are spread over as many workers as possible.
A pull, its answer and its end take 0.1 ms of the router's threads (docs/scale.md), so 500 take 5 % of a core at one
epoch a second."""

DATASET_ROOM: Final = 3
"""Memory that a dataset needs on a worker, in multiples of its bytes: 50 MB took 130 MB (docs/scale.md)."""


@dataclass(frozen=True, slots=True)
class Assignment:
    """An archipelago that begins a term, and the worker of each of its islands."""

    job: Job
    archipelago: Archipelago
    workers: tuple[str, ...]

    def placement(self, incarnation: int, term: int) -> Placement:
        """Return the placement under a term."""
        limits = self.archipelago.collector.limits
        return Placement(
            incarnation=incarnation,
            term=term,
            job=self.archipelago.job,
            variable=self.archipelago.variable,
            workers=self.workers,
            epoch=self.archipelago.durable,
            epochs=limits.epochs,
            interval=self.archipelago.interval,
            commit_order=limits.commit_order,
        )


@dataclass(slots=True)
class PlacementPlan:
    """Terms that begin, placements broken by a lost worker, and placements that end without a next term."""

    assignments: list[Assignment] = field(default_factory=list)
    broken: list[ArchipelagoKey] = field(default_factory=list)
    released: list[Placement] = field(default_factory=list)


class Placer:
    """Plans the placements of all archipelagos on the present workers."""

    def __init__(self, membership: Membership, quarantine: Quarantine, expected_workers: int = 1) -> None:
        """No island is placed before `expected_workers` are ready, or `EXPECT_S` have passed."""
        self._membership = membership
        self._quarantine = quarantine
        self._expected = expected_workers
        self._first_ready_at: float | None = None
        self._sizes: dict[str, int] = {}
        self._all_islands: int | None = None

    def plan_placements(self, jobs: Collection[Job], now: float, guarded: JobGuard = unguarded) -> PlacementPlan:
        """Plan terms for archipelagos that have no workers or lost workers, or could use more; `now` in bus seconds.

        Archipelagos whose placements end are unplaced; archipelagos that should move get a barrier. Each is handled
        under `guarded`, so that an error affects no other archipelago.
        """
        wanted = [
            archipelago
            for job in jobs
            for archipelago in job.open_archipelagos
            if not job.is_held or archipelago.placement is not None
        ]
        self._quarantine.reserve(wanted, guarded)
        self._sizes = {job.id: job.prepared.size for job in jobs if job.prepared is not None}
        self._update_spread(wanted)
        plan = PlacementPlan()
        # While a checkpoint is being written, no term begins: the next term begins at this checkpoint.
        changing = [
            (job, archipelago)
            for job in jobs
            if job.state == "running"
            for archipelago in job.open_archipelagos
            if not archipelago.is_writing
        ]
        if changing:
            self._update_expected(now)
        load = sum((_islands(one) for job in jobs for one in job.open_archipelagos), Counter[str]())
        released: dict[ArchipelagoKey, Placement | None] = {}
        for job, archipelago in changing:
            with guarded(archipelago.job):
                if archipelago.is_at_barrier or job.is_held:
                    released[archipelago.key] = archipelago.placement
                self._end_placement(job, archipelago, plan, load, now)
        for job, archipelago in changing:
            with guarded(archipelago.job):
                self._assign(job, archipelago, released.get(archipelago.key), plan, load, now)
        return plan

    def _end_placement(
        self, job: Job, archipelago: Archipelago, plan: PlacementPlan, load: Counter[str], now: float
    ) -> None:
        """Unplace an archipelago if its placement ends now, or request a barrier."""
        if job.is_held:
            self._hold(archipelago, load, now)
        elif self.is_broken(archipelago):
            plan.broken.append(archipelago.key)
            _unplace(archipelago, load)
        else:
            self._prepare_change(archipelago, load, now)

    def _assign(
        self, job: Job, archipelago: Archipelago, released: Placement | None, plan: PlacementPlan, load: Counter[str],
        now: float,
    ) -> None:  # fmt: skip
        """Plan the next term of an archipelago; without a next term, plan the release of an ended placement."""
        workers = self.choose_workers(archipelago, load, now) if not job.is_held else None
        if workers is not None:
            load.subtract(_islands(archipelago))
            load.update(workers)
            plan.assignments.append(Assignment(job, archipelago, workers))
        elif released is not None and archipelago.placement is None:
            plan.released.append(released)

    def _hold(self, archipelago: Archipelago, load: Counter[str], now: float) -> None:
        """Stop an archipelago of a held job: at a barrier, or at once if little work is lost."""
        is_new = archipelago.has_no_commit and self._is_young(archipelago, now)
        if archipelago.is_at_barrier or is_new or self.is_broken(archipelago):
            _unplace(archipelago, load)
        elif archipelago.placement is not None:
            archipelago.request_barrier()

    def _prepare_change(self, archipelago: Archipelago, load: Counter[str], now: float) -> None:
        """Prepare a change of placement because workers leave or are idle, without losing work.

        All islands wait at a barrier. When it is durable, they are placed again, or wait if there is no worker. Soon
        after a placement there is no barrier, because computing the few results again is faster.
        """
        if archipelago.is_at_barrier:
            _unplace(archipelago, load)
        elif any(self._membership.is_leaving(worker) for worker in archipelago.workers):
            if archipelago.has_no_commit and self._is_young(archipelago, now) and self._membership.ready():
                _unplace(archipelago, load)
            else:
                archipelago.request_barrier()
        elif (
            archipelago.may_plan and not self._is_young(archipelago, now) and self._better_placement(archipelago, load)
        ):
            archipelago.request_barrier()

    def is_broken(self, archipelago: Archipelago) -> bool:
        """Return whether a worker of this placement is lost, or reserved for another archipelago."""
        return any(
            self._membership.is_lost(worker) or not self._quarantine.allows(archipelago.key, worker)
            for worker in archipelago.workers
        )

    def choose_workers(self, archipelago: Archipelago, load: Mapping[str, int], now: float) -> tuple[str, ...] | None:
        """Return the worker of each island; None: the archipelago keeps its placement or must wait.

        `load` is the number of islands of each worker, `now` in seconds of the bus.
        """
        if len(self._membership.ready()) < self._expected:
            return None
        if archipelago.placement is not None:
            return self._better_placement(archipelago, load) if self._is_young(archipelago, now) else None
        return self._spread(archipelago, load)

    def _spread(self, archipelago: Archipelago, load: Mapping[str, int]) -> tuple[str, ...] | None:
        """Return the worker of each island, among the ready workers; None: no worker is ready.

        Workers without memory for the dataset are used only if there are no other workers. Among workers with the same
        load, workers that have the dataset come first.
        """
        job, needed = archipelago.job, DATASET_ROOM * self._sizes.get(archipelago.job, 0)
        ready = self._quarantine.ready_for(archipelago.key)
        local = {worker for worker in ready if self._membership.has_dataset(worker, job)}
        roomy = [worker for worker in ready if worker in local or self._membership.has_room(worker, needed)]
        islands = archipelago.collector.limits.islands
        return spread(islands, load, roomy or ready, local, self._all_islands) if ready else None

    def _update_spread(self, wanted: Collection[Archipelago]) -> None:
        """Decide whether archipelagos are on as many workers as possible, or on few because of their messages."""
        workers = len(self._membership.ready())
        sizes = [archipelago.collector.limits.islands for archipelago in wanted]
        pulls = sum(_pulls(min(islands, workers)) for islands in sizes)
        self._all_islands = sum(sizes) if pulls > MOST_PULLS else None

    def _is_young(self, archipelago: Archipelago, now: float) -> bool:
        """Return whether little has been computed since the archipelago was placed."""
        return now - archipelago.placed_at <= REPLACE_WITHIN_S

    def _better_placement(self, archipelago: Archipelago, load: Mapping[str, int]) -> tuple[str, ...] | None:
        """Return a placement that lowers the largest load of the archipelago's workers; None: there is none.

        Each such move lowers the number of workers with the largest of these loads or a larger load, so there are only
        finitely many moves.
        """
        own = _islands(archipelago)
        most = max((load.get(worker, 0) for worker in own), default=0)
        if min((load.get(worker, 0) for worker in self._membership.ready()), default=0) >= most - 1:
            return None  # if each new worker had fewer than `most` islands, there would be no place for all of them
        others = Counter(load)
        others.subtract(own)
        workers = self._spread(archipelago, others)
        if workers is None:
            return None
        busiest = max(others[worker] + islands for worker, islands in Counter(workers).items())
        return workers if busiest < most else None

    def _update_expected(self, now: float) -> None:
        """Stop waiting for workers when all expected workers are ready, or the first has waited for `EXPECT_S`."""
        ready = len(self._membership.ready())
        if not ready:
            return
        if self._first_ready_at is None:
            self._first_ready_at = now
        if ready >= self._expected or now - self._first_ready_at >= EXPECT_S:
            self._expected = 1


def spread(
    islands: int, load: Mapping[str, int], workers: Sequence[str], preferred: Collection[str] = (),
    all_islands: int | None = None,
) -> tuple[str, ...]:  # fmt: skip
    """Return the worker of each island.

    By default workers come in turn, the least loaded first. Loads that differ by at most one island before still do so
    afterwards, and each archipelago is on as many workers as possible. Then the loss of a worker affects few islands of
    an archipelago, and each archipelago has its share of every worker.

    With `all_islands`, the archipelago is on few workers: on k workers, the largest number for which its k (k - 1)
    pulls in an epoch are no more than its islands, or on more workers if the loads would become uneven otherwise. When
    all archipelagos are placed, loads differ by at most one island.

    Args:
        islands: number of islands.
        load: number of islands of each worker; a missing worker has none.
        workers: Unique names of workers, at least one.
        preferred: Workers that come first among equally loaded workers.
        all_islands: number of islands of all archipelagos that are or will be placed.
    """

    def rank(worker: str) -> tuple[int, bool, str]:
        return (load.get(worker, 0), worker not in preferred, worker)

    order = sorted(workers, key=rank)
    if all_islands is None:
        return tuple(order[island % len(order)] for island in range(islands))
    few = max(count for count in range(1, islands + 1) if _pulls(count) <= islands)
    counts = Counter[str]()
    for worker in order:
        room = all_islands // len(order) - load.get(worker, 0)
        counts[worker] = max(0, min(math.ceil(islands / few), room, islands - counts.total()))
    for _ in range(islands - counts.total()):
        counts[min(order, key=lambda worker: (load.get(worker, 0) + counts[worker], rank(worker)))] += 1
    return tuple(worker for worker in order for _ in range(counts[worker]))


def _pulls(workers: int) -> int:
    """Return how many pulls of migrants an archipelago causes in an epoch: each worker pulls from each other worker."""
    return workers * (workers - 1)


def _islands(archipelago: Archipelago) -> Counter[str]:
    """Return the number of islands of an archipelago on each worker."""
    return Counter(archipelago.placement.workers if archipelago.placement is not None else ())


def _unplace(archipelago: Archipelago, load: Counter[str]) -> None:
    load.subtract(_islands(archipelago))
    archipelago.unplace()


Correction = Close | CloseJob | Commit | JobAnnouncement | Placements | PullReports


def corrections(
    jobs: Mapping[str, Job], begun: Mapping[str, Job], worker: str, status: WorkerStatus,
    guarded: JobGuard = unguarded, ending: Container[str] = (),
) -> list[Correction]:  # fmt: skip
    """Return the messages to a worker after its heartbeat: releases, missing placements, announcements and pulls.

    Only live `jobs` that have `begun` can have placements. Jobs that are `ending` are left out: they continue if the
    coordinator dies before their ends are stored. Each job is handled under `guarded`, so that an error affects no
    other job.
    """
    messages: list[Correction] = []
    for assignment_status in status.holdings:
        if assignment_status.job in ending:
            continue
        with guarded(assignment_status.job):
            messages += _correct_assignment(jobs, worker, assignment_status)
    messages += [CloseJob(job=job) for job in status.jobs if job not in ending and not _is_open(jobs, job)]
    held = {(assignment_status.job, assignment_status.variable) for assignment_status in status.holdings}
    missing: list[Placement] = []
    for job_id, job in tuple(begun.items()):
        with guarded(job_id):
            placed = [archipelago for archipelago in job.open_archipelagos if worker in archipelago.workers]
            missing += [one.placement for one in placed if one.placement is not None and one.key not in held]
            if placed and job_id not in status.jobs and job_id not in ending:
                messages.append(job.announcement())
    return [*messages, Placements(placements=tuple(missing))] if missing else messages


def _correct_assignment(jobs: Mapping[str, Job], worker: str, assignment_status: AssignmentStatus) -> list[Correction]:
    job = jobs.get(assignment_status.job)
    if job is None or not _is_open(jobs, assignment_status.job):
        return [CloseJob(job=assignment_status.job)]
    archipelago = job.archipelagos.get(assignment_status.variable)
    if archipelago is None or job.state != "running":
        return []
    if archipelago.cut is not None:
        return [Close(job=assignment_status.job, variable=assignment_status.variable, term=assignment_status.term)]
    placement = archipelago.placement
    if placement is None or assignment_status.term > placement.term:
        return []
    if assignment_status.term < placement.term:
        return [Placements(placements=(placement,))]
    pull, commit = archipelago.missing_reports(worker, assignment_status), archipelago.missed_commit(assignment_status)
    return [message for message in (pull, commit) if message is not None]


def _is_open(jobs: Mapping[str, Job], job_id: str) -> bool:
    """Return whether islands of a job are computed now or later."""
    job = jobs.get(job_id)
    return job is not None and job.state in ("queued", "preparing", "running")
