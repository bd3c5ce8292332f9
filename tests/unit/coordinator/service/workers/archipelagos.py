"""Archipelagos that are placed on workers."""

from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.search.ending import SearchLimits, Stagnation
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire.messages.workers import Placement

COMMIT_ORDER = CommitOrder(generations=100, stride=10, joining=8)


def archipelago(*workers: str, islands: int = 4, job: str = "job", variable: str = "x", term: int = 1) -> Archipelago:
    """Return an archipelago, placed on these workers if there are any."""
    limits = SearchLimits(islands=islands, epochs=10, stagnation=Stagnation(5), commit_order=COMMIT_ORDER)
    made = Archipelago(job, variable, limits, lambda front: 0.0, lambda program: None)
    if workers:
        placement = Placement(
            incarnation=1, term=term, job=job, variable=variable, workers=workers, epochs=10, interval=16,
            commit_order=COMMIT_ORDER,
        )  # fmt: skip
        made.place(placement, 0.0)
    return made
