"""Longer leases for workers whose work is slow."""

from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.workers.lease_backoff import MAX_FACTOR, LeaseBackoff
from tests.unit.coordinator.service.workers.archipelagos import archipelago

X, Y = archipelago("a", "b", islands=2), archipelago("b", "c", islands=2, variable="y")


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
