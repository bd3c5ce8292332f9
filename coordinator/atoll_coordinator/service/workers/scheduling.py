"""Decides which archipelagos begin a term now, and on which workers. Pure; it decides about time, never about bits."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Final

from atoll.wire.messages.workers import Placement
from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.search.archipelago import Archipelago, ArchipelagoKey
from atoll_coordinator.service.workers.membership import Membership
from atoll_coordinator.service.workers.quarantine import Quarantine

REPLACE_WITHIN_S: Final = 5.0
"""A worker that joins this soon after a placement takes part in it: the little that was computed is computed again."""

EXPECT_S: Final = 10.0
"""How long the first ready worker waits for the others that are expected."""


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
    """What changes: terms that begin, placements broken by a lost worker, held ones that have nobody to go to."""

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

    def plan(self, jobs: Collection[Job], now: float) -> Plan:
        """Plan terms for all archipelagos that have no workers, or lost ones, or could use more. `now` in bus seconds.

        Archipelagos whose placements end are unplaced, and those that are to move are asked to hold.
        """
        self._quarantine.reserve([each for job in jobs for each in job.open_archipelagos])
        plan = Plan()
        for job in jobs:
            first = 0
            for archipelago in job.archipelagos.values() if job.state == "running" else ():
                # The term after the current one begins at the checkpoint that is being written.
                if archipelago.cut is None and not archipelago.is_writing:
                    self._plan_one(plan, job, archipelago, first, now)
                first += archipelago.collector.limits.islands
        return plan

    def _plan_one(self, plan: Plan, job: Job, archipelago: Archipelago, first: int, now: float) -> None:
        held = archipelago.placement if archipelago.is_held else None
        if self.is_broken(archipelago):
            archipelago.unplace()
            plan.broken.append(archipelago.key)
        else:
            self._prepare_change(archipelago, now)
        self._update_expected(now)
        workers = self.choose_workers(archipelago, first, now)
        if workers is not None:
            plan.assignments.append(Assignment(job, archipelago, workers))
        elif held is not None:
            plan.released.append(held)

    def _prepare_change(self, archipelago: Archipelago, now: float) -> None:
        """Prepare a change of placement that loses nothing, because workers leave or have joined.

        All islands are held at a checkpoint; when it is durable they are placed anew, or, if there is nobody left, kept
        until somebody comes. Soon after a placement it is quicker to compute the little that there is again.
        """
        if archipelago.is_held:
            archipelago.unplace()
        elif any(self._membership.is_leaving(worker) for worker in archipelago.workers):
            if archipelago.has_no_commit and self._is_young(archipelago, now) and self._membership.ready():
                archipelago.unplace()
            else:
                archipelago.request_hold()
        elif archipelago.may_plan and self._could_use_more(archipelago) and not self._is_young(archipelago, now):
            archipelago.request_hold()

    def is_broken(self, archipelago: Archipelago) -> bool:
        """Tell whether islands of this placement have nobody to compute them, or may not be where they are."""
        return any(
            self._membership.is_lost(worker) or not self._quarantine.allows(archipelago.key, worker)
            for worker in archipelago.workers
        )

    def choose_workers(self, archipelago: Archipelago, first: int, now: float) -> tuple[str, ...] | None:
        """Return the worker of each island, or None when the archipelago keeps its placement or must wait.

        Args:
            archipelago: not cut yet.
            first: islands of the job's variables before this one.
            now: the bus's seconds.
        """
        ready = self._quarantine.ready_for(archipelago.key)
        if not ready or len(self._membership.ready()) < self._expected:
            return None
        is_placed = archipelago.placement is not None
        if is_placed and not (self._is_young(archipelago, now) and self._could_use_more(archipelago)):
            return None
        return spread(archipelago.collector.limits.islands, first, ready)

    def _is_young(self, archipelago: Archipelago, now: float) -> bool:
        """Tell whether little has been computed since the archipelago was placed."""
        return now - archipelago.placed_at <= REPLACE_WITHIN_S

    def _could_use_more(self, archipelago: Archipelago) -> bool:
        """Tell whether more workers could be used than are."""
        ready = len(self._quarantine.ready_for(archipelago.key))
        return min(ready, archipelago.collector.limits.islands) > len(archipelago.workers)

    def _update_expected(self, now: float) -> None:
        """Expect one worker only, once all have been ready or the first one has waited long enough."""
        ready = len(self._membership.ready())
        if not ready:
            return
        if self._first_ready_at is None:
            self._first_ready_at = now
        if ready >= self._expected or now - self._first_ready_at >= EXPECT_S:
            self._expected = 1


def spread(islands: int, first: int, workers: Sequence[str]) -> tuple[str, ...]:
    """Return for each island its worker: evenly, in turn over the sorted workers.

    Args:
        islands: how many there are.
        first: islands placed before (of the job's other variables), so that the turn goes on where it stopped and
            variables with fewer islands than workers come to lie on different workers.
        workers: at least one, names unique.
    """
    order = sorted(workers)
    return tuple(order[(first + island) % len(order)] for island in range(islands))
