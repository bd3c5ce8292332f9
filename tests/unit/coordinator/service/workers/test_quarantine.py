"""Workers reserved for quarantined archipelagos."""

from atoll_coordinator.service.workers.quarantine import reserve_workers

X, Y, Z = ("bad", "x"), ("bad", "y"), ("worse", "z")


def test_each_gets_the_worker_with_the_least_to_do() -> None:
    load = {"a": 2, "b": 0, "c": 1}
    assert reserve_workers([X, Y], True, ["a", "b", "c"], {}, load) == {X: "b", Y: "c"}


def test_one_worker_is_left_for_the_others_if_there_are_any() -> None:
    assert reserve_workers([X, Y], True, ["a", "b"], {}, {}) == {X: "a", Y: None}
    assert reserve_workers([X, Y], False, ["a", "b"], {}, {}) == {X: "a", Y: "b"}
    assert reserve_workers([X], True, ["a"], {}, {}) == {X: None}
    assert reserve_workers([X, Y], False, ["a"], {}, {}) == {X: "a", Y: None}
    assert reserve_workers([X], False, [], {}, {}) == {X: None}


def test_a_reserved_worker_stays_while_it_is_there() -> None:
    assert reserve_workers([Z, X], True, ["a", "b", "c"], {X: "a"}, {"a": 5}) == {Z: "b", X: "a"}
    assert reserve_workers([X], True, ["b", "c"], {X: "a"}, {}) == {X: "b"}


def test_a_reservation_ends_when_others_need_the_last_worker() -> None:
    assert reserve_workers([X, Y], True, ["a", "b"], {X: "a", Y: "b"}, {}) == {X: "a", Y: None}


def test_no_worker_is_reserved_twice() -> None:
    given = reserve_workers([X, Y, Z], False, ["a", "b", "c"], {X: "b", Y: None}, {})
    assert sorted(given.values(), key=str) == ["a", "b", "c"]
    assert given[X] == "b"
