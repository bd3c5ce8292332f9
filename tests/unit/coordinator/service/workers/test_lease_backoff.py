"""Longer leases for workers whose work is slow."""

from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.search.ending import Limits, Stagnation
from atoll_coordinator.service.workers.lease_backoff import MAX_FACTOR, LeaseBackoff
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire.messages.workers import Placement

COMMIT_ORDER = CommitOrder(generations=100, stride=10, joining=8)


def archipelago(variable: str, *workers: str) -> Archipelago:
    """Return an archipelago with one island on each of these workers."""
    limits = Limits(islands=len(workers), epochs=10, stagnation=Stagnation(5), commit_order=COMMIT_ORDER)
    made = Archipelago("job", variable, limits, lambda front: 0.0, lambda program: None)
    placement = Placement(
        incarnation=1, term=1, job="job", variable=variable, workers=workers, epochs=10, interval=16,
        commit_order=COMMIT_ORDER,
    )  # fmt: skip
    made.place(placement, 0.0)
    return made


X, Y = archipelago("x", "a", "b"), archipelago("y", "b", "c")


def factor(leases: LeaseBackoff, of: Archipelago) -> float:
    (value,) = set(leases.factors([of]).values())
    return value


def test_each_eviction_without_a_commit_since_the_last_doubles_the_leases() -> None:
    leases = LeaseBackoff()
    seen = []
    for _ in range(9):
        leases.add_eviction(X.key)
        seen.append(factor(leases, X))
    assert seen == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, MAX_FACTOR, MAX_FACTOR, MAX_FACTOR]


def test_after_a_commit_the_next_eviction_does_not() -> None:
    leases = LeaseBackoff()
    leases.add_eviction(X.key)
    leases.add_commit(X.key)
    leases.add_eviction(X.key)
    assert factor(leases, X) == 1.0
    leases.add_eviction(X.key)
    assert factor(leases, X) == 2.0


def test_a_worker_has_the_longest_lease_of_its_archipelagos() -> None:
    leases = LeaseBackoff()
    leases.add_eviction(X.key)
    leases.add_eviction(X.key)
    for archipelagos in ([X, Y], [Y, X]):
        assert leases.factors(archipelagos) == {"a": 2.0, "b": 2.0, "c": 1.0}
    assert leases.factors([]) == {}
    leases.forget("job")
    assert factor(leases, X) == 1.0
