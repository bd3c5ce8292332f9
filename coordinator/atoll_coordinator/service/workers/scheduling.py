"""Decides which archipelagos begin a term now, and on which workers. Pure; it decides about time, never about bits."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.monitoring.breakages import JobGuard, unguarded
from atoll_coordinator.service.search.archipelago import Archipelago, ArchipelagoKey
from atoll_coordinator.service.workers.membership import Membership
from atoll_coordinator.service.workers.quarantine import Quarantine
from atoll_core.wire.messages.workers import Placement

REPLACE_WITHIN_S: Final = 5.0
"""A worker that joins this soon after a placement takes part in it: the little that was computed is computed again."""

EXPECT_S: Final = 10.0
"""How long the first ready worker waits for the others that are expected."""


DATASET_ROOM: Final = 3
"""A dataset takes so many times its bytes of a worker's memory: 50 MB made one 130 MB larger (docs/scale.md)."""


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
class Plan:
    """What changes: terms that begin, placements broken by a lost worker, those at a barrier that lead nowhere."""

    assignments: list[Assignment] = field(default_factory=list)
    broken: list[ArchipelagoKey] = field(default_factory=list)
    released: list[Placement] = field(default_factory=list)


class Scheduler:
    """Plans the placements of all archipelagos from who is there now."""

    def __init__(self, membership: Membership, quarantine: Quarantine, expected_workers: int = 1) -> None:
        """No island is placed before `expected_workers` are ready, or have been waited for long enough."""
        self._membership = membership
        self._quarantine = quarantine
        self._expected = expected_workers
        self._first_ready_at: float | None = None
        self._sizes: dict[str, int] = {}

    def plan(self, jobs: Collection[Job], now: float, guarded: JobGuard = unguarded) -> Plan:
        """Plan terms for all archipelagos that have no workers, or lost ones, or could use more. `now` in bus seconds.

        Archipelagos whose placements end are unplaced, and those that are to move get a barrier. Each is looked at
        under `guarded`, so that one over which something breaks keeps no other from its workers.
        """
        wanted = [archipelago for job in jobs for archipelago in job.open_archipelagos if not _rests(job, archipelago)]
        self._quarantine.reserve(wanted, guarded)
        self._sizes = {job.id: job.prepared.size for job in jobs if job.prepared is not None}
        plan = Plan()
        # The term after the current one begins at the checkpoint that is being written.
        changing = [
            (job, archipelago)
            for job in jobs
            if job.state == "running"
            for archipelago in job.open_archipelagos
            if not archipelago.is_writing
        ]
        if changing:
            self._update_expected(now)
        load = _load(archipelago for job in jobs for archipelago in job.open_archipelagos)
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

    def _end_placement(self, job: Job, archipelago: Archipelago, plan: Plan, load: Counter[str], now: float) -> None:
        """Unplace an archipelago if its placement ends now, or prepare that it does."""
        if job.is_held:
            self._hold(archipelago, load, now)
        elif self.is_broken(archipelago):
            plan.broken.append(archipelago.key)
            _unplace(archipelago, load)
        else:
            self._prepare_change(archipelago, load, now)

    def _assign(
        self,
        job: Job,
        archipelago: Archipelago,
        released: Placement | None,
        plan: Plan,
        load: Counter[str],
        now: float,
    ) -> None:
        """Plan the next term of an archipelago, or its release if there is none and that of `released` has ended."""
        workers = self.choose_workers(archipelago, load, now) if not job.is_held else None
        if workers is not None:
            load.subtract(_islands(archipelago))
            load.update(workers)
            plan.assignments.append(Assignment(job, archipelago, workers))
        elif released is not None and archipelago.placement is None:
            plan.released.append(released)

    def _hold(self, archipelago: Archipelago, load: Counter[str], now: float) -> None:
        """Have an archipelago stop that is held: at a barrier, or at once where next to nothing would be lost."""
        is_new = archipelago.has_no_commit and self._is_young(archipelago, now)
        if archipelago.is_at_barrier or is_new or self.is_broken(archipelago):
            _unplace(archipelago, load)
        elif archipelago.placement is not None:
            archipelago.request_barrier()

    def _prepare_change(self, archipelago: Archipelago, load: Counter[str], now: float) -> None:
        """Prepare a change of placement that loses nothing, because workers leave or are idle.

        All islands wait at a barrier; when it is durable they are placed anew, or, if there is nobody left, kept
        until somebody comes. Soon after a placement it is quicker to compute the little that there is again.
        """
        if archipelago.is_at_barrier:
            _unplace(archipelago, load)
        elif any(self._membership.is_leaving(worker) for worker in archipelago.workers):
            if archipelago.has_no_commit and self._is_young(archipelago, now) and self._membership.ready():
                _unplace(archipelago, load)
            else:
                archipelago.request_barrier()
        elif archipelago.may_plan and not self._is_young(archipelago, now) and self._better(archipelago, load):
            archipelago.request_barrier()

    def is_broken(self, archipelago: Archipelago) -> bool:
        """Tell whether islands of this placement have nobody to compute them, or may not be where they are."""
        return any(
            self._membership.is_lost(worker) or not self._quarantine.allows(archipelago.key, worker)
            for worker in archipelago.workers
        )

    def choose_workers(self, archipelago: Archipelago, load: Mapping[str, int], now: float) -> tuple[str, ...] | None:
        """Return the worker of each island, or None when the archipelago keeps its placement or must wait.

        Args:
            archipelago: not cut yet.
            load: how many islands each worker has of all archipelagos.
            now: the bus's seconds.
        """
        if len(self._membership.ready()) < self._expected:
            return None
        if archipelago.placement is not None:
            return self._better(archipelago, load) if self._is_young(archipelago, now) else None
        return self._spread(archipelago, load)

    def _spread(self, archipelago: Archipelago, load: Mapping[str, int]) -> tuple[str, ...] | None:
        """Return the worker of each island, of those that are ready; None: there is none.

        Machines without room for the dataset are left out while there are others. Among workers with as much to do,
        those come first that have the dataset.
        """
        job, needed = archipelago.job, DATASET_ROOM * self._sizes.get(archipelago.job, 0)
        ready = self._quarantine.ready_for(archipelago.key)
        local = {worker for worker in ready if self._membership.has_dataset(worker, job)}
        roomy = [worker for worker in ready if worker in local or self._membership.has_room(worker, needed)]
        return spread(archipelago.collector.limits.islands, load, roomy or ready, local) if ready else None

    def _is_young(self, archipelago: Archipelago, now: float) -> bool:
        """Tell whether little has been computed since the archipelago was placed."""
        return now - archipelago.placed_at <= REPLACE_WITHIN_S

    def _better(self, archipelago: Archipelago, load: Mapping[str, int]) -> tuple[str, ...] | None:
        """Return a placement by which the busiest worker of a placed archipelago has less to do; None: there is none.

        Each such move lowers the sum of squares of all loads, so that moves come to an end.
        """
        own, others = _islands(archipelago), Counter(load)
        others.subtract(own)
        workers = self._spread(archipelago, others) if own else None
        if workers is None:
            return None
        busiest = max(others[worker] + islands for worker, islands in Counter(workers).items())
        return workers if busiest < max(load.get(worker, 0) for worker in own) else None

    def _update_expected(self, now: float) -> None:
        """Expect one worker only, once all have been ready or the first one has waited long enough."""
        ready = len(self._membership.ready())
        if not ready:
            return
        if self._first_ready_at is None:
            self._first_ready_at = now
        if ready >= self._expected or now - self._first_ready_at >= EXPECT_S:
            self._expected = 1


def spread(
    islands: int, load: Mapping[str, int], workers: Sequence[str], preferred: Collection[str] = ()
) -> tuple[str, ...]:  # fmt: skip
    """Return for each island its worker: evenly, in turn over the workers, the least loaded first.

    So workers that are loaded evenly, but for one island, stay so; and each archipelago lies on as many as there are,
    to go on whoever is lost and to have its share wherever jobs share workers by priority.

    Args:
        islands: how many there are.
        load: how many islands each worker has already; none where it is not among them.
        workers: at least one, names unique.
        preferred: who comes first of those that are loaded equally.
    """
    order = sorted(workers, key=lambda worker: (load.get(worker, 0), worker not in preferred, worker))
    return tuple(order[island % len(order)] for island in range(islands))


def _rests(job: Job, archipelago: Archipelago) -> bool:
    """Tell whether nobody computes an archipelago, and nobody shall."""
    return job.is_held and archipelago.placement is None


def _islands(archipelago: Archipelago) -> Counter[str]:
    """Return how many islands of it each worker has."""
    return Counter(archipelago.placement.workers if archipelago.placement is not None else ())


def _load(archipelagos: Iterable[Archipelago]) -> Counter[str]:
    return sum(map(_islands, archipelagos), Counter())


def _unplace(archipelago: Archipelago, load: Counter[str]) -> None:
    load.subtract(_islands(archipelago))
    archipelago.unplace()
