"""Begins terms: sees which archipelagos are to be placed, or placed anew, and does so. Knows no bus.

The order is always the same: first the placement is durable, then it is told.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from atoll.wire.codec import encode
from atoll.wire.messages.workers import Close, Placement, Placements
from atoll_coordinator.service.effects import Outlet
from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.monitoring.monitor import Watch
from atoll_coordinator.service.ports import StorePort
from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.workers.membership import Membership
from atoll_coordinator.service.workers.placement import Placer


@dataclass(frozen=True, slots=True)
class _Chosen:
    """An archipelago that is to be placed, and the worker of each of its islands."""

    job: Job
    archipelago: Archipelago
    workers: tuple[str, ...]


class Terms:
    """The placements of all archipelagos, as they follow each other."""

    def __init__(
        self, membership: Membership, store: StorePort, outlet: Outlet, watch: Watch, expected_workers: int = 1
    ) -> None:
        """No island is placed before the expected workers are ready."""
        self._membership = membership
        self._store = store
        self._outlet = outlet
        self._watch = watch
        self._placer = Placer(membership, expected_workers, watch.isolation)

    def begin(self, jobs: Collection[Job], now: float) -> None:
        """Place, or place anew, every archipelago that has nobody, or somebody who is lost, or newcomers to use."""
        self._watch.furnish(jobs)
        chosen: list[_Chosen] = []
        for job in jobs:
            placed_before = 0
            for archipelago in job.archipelagos.values():
                if archipelago.cut is None and job.state == "running":
                    workers = self._choose(job, archipelago, placed_before, now)
                    chosen += [_Chosen(job, archipelago, workers)] if workers is not None else []
                placed_before += archipelago.collector.limits.islands
        self._issue(chosen, now)

    def _choose(self, job: Job, archipelago: Archipelago, first: int, now: float) -> tuple[str, ...] | None:
        """Return the workers on which an archipelago is to be placed now; None: it stays as it is."""
        if archipelago.is_writing:
            return None  # the term after this one begins where that is durable
        held = archipelago.placement if archipelago.is_held else None
        if self._placer.is_broken(archipelago):
            archipelago.unplace()
            self._watch.unplaced(archipelago)
        else:
            self._plan(archipelago, now)
        workers = self._placer.choose(archipelago, first, now)
        if workers is None and held is not None:
            for worker in dict.fromkeys(held.workers):
                self._outlet.tell(Close(job=job.id, variable=archipelago.variable, term=held.term), worker)
        return workers

    def _plan(self, archipelago: Archipelago, now: float) -> None:
        """Prepare a change of placement that loses nothing: for workers who leave, or newcomers.

        All islands are held at a checkpoint; when it is durable they are placed anew, or, if there is nobody left, kept
        until somebody comes. Soon after a placement it is quicker to compute the little that there is again.
        """
        if archipelago.is_held:
            archipelago.unplace()
        elif self._placer.is_left(archipelago):
            if archipelago.has_begun_only and self._placer.is_young(archipelago, now) and self._membership.ready():
                archipelago.unplace()
            else:
                archipelago.request_hold()
        elif self._placer.is_worth_planning(archipelago) and not self._placer.is_young(archipelago, now):
            archipelago.request_hold()

    def _issue(self, chosen: Sequence[_Chosen], now: float) -> None:
        """Begin terms: first all of them in the store, since each commit takes its time, then on the bus."""
        if not chosen:
            return
        placements: list[Placement] = []

        def place(index: int, term: int) -> bytes:
            placements.append(self._placement(chosen[index], term))
            return encode(placements[-1])

        self._store.begin_terms([(each.job.id, each.archipelago.variable) for each in chosen], place)
        for each, placement in zip(chosen, placements, strict=True):
            each.archipelago.place(placement, now)
            each.job.start(now)
            self._outlet.tell(Placements(placements=(placement,)))
            self._watch.placed(placement)

    def _placement(self, chosen: _Chosen, term: int) -> Placement:
        archipelago = chosen.archipelago
        return Placement(
            incarnation=self._store.incarnation,
            term=term,
            job=archipelago.job,
            variable=archipelago.variable,
            workers=chosen.workers,
            epoch=archipelago.durable,
            epochs=archipelago.collector.limits.epochs,
            interval=archipelago.interval,
            commit_order=archipelago.collector.limits.commit_order,
        )
