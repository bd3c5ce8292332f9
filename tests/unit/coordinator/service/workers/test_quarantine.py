"""Rooms for isolated archipelagos."""

from atoll_coordinator.service.workers.quarantine import rooms

X, Y, Z = ("bad", "x"), ("bad", "y"), ("worse", "z")


def test_each_gets_the_worker_with_the_least_to_do() -> None:
    load = {"a": 2, "b": 0, "c": 1}
    assert rooms([X, Y], True, ["a", "b", "c"], {}, load) == {X: "b", Y: "c"}


def test_one_worker_is_left_for_the_others_if_there_are_any() -> None:
    assert rooms([X, Y], True, ["a", "b"], {}, {}) == {X: "a", Y: None}
    assert rooms([X, Y], False, ["a", "b"], {}, {}) == {X: "a", Y: "b"}
    assert rooms([X], True, ["a"], {}, {}) == {X: None}
    assert rooms([X, Y], False, ["a"], {}, {}) == {X: "a", Y: None}
    assert rooms([X], False, [], {}, {}) == {X: None}


def test_who_has_a_room_keeps_it_while_its_worker_is_there() -> None:
    assert rooms([Z, X], True, ["a", "b", "c"], {X: "a"}, {"a": 5}) == {Z: "b", X: "a"}
    assert rooms([X], True, ["b", "c"], {X: "a"}, {}) == {X: "b"}


def test_rooms_are_given_back_when_others_need_the_last_worker() -> None:
    assert rooms([X, Y], True, ["a", "b"], {X: "a", Y: "b"}, {}) == {X: "a", Y: None}


def test_no_two_share_a_room() -> None:
    given = rooms([X, Y, Z], False, ["a", "b", "c"], {X: "b", Y: None}, {})
    assert sorted(given.values(), key=str) == ["a", "b", "c"]
    assert given[X] == "b"
