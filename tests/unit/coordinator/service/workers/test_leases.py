"""Patience with slow work."""

from atoll_coordinator.service.workers.leases import MAX_PATIENCE, Leases

X, Y = ("job", "x"), ("job", "y")


def test_each_eviction_without_a_commit_since_the_last_doubles_the_patience() -> None:
    leases = Leases()
    seen = []
    for _ in range(9):
        leases.evicted(X)
        seen.append(leases.patience([X]))
    assert seen == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, MAX_PATIENCE, MAX_PATIENCE, MAX_PATIENCE]


def test_after_a_commit_the_next_eviction_does_not() -> None:
    leases = Leases()
    leases.evicted(X)
    leases.committed(X)
    leases.evicted(X)
    assert leases.patience([X]) == 1.0
    leases.evicted(X)
    assert leases.patience([X]) == 2.0


def test_a_worker_is_waited_for_as_long_as_its_most_patient_archipelago_says() -> None:
    leases = Leases()
    leases.evicted(X)
    leases.evicted(X)
    assert leases.patience([X, Y]) == 2.0
    assert leases.patience([Y]) == leases.patience([]) == 1.0
    leases.forget("job")
    assert leases.patience([X]) == 1.0
