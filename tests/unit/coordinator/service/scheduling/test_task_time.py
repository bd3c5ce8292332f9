"""Task time: what heartbeats say of it is counted once, by the day."""

from atoll_coordinator.service.scheduling.limits import Allowance, Limits, TaskTime, Total

LIMITS = Limits(user=Allowance(task_time=10.0), users={"bob": Allowance(task_time=100.0)})


def test_what_a_process_has_computed_is_counted_once() -> None:
    time = TaskTime()
    time.add_heartbeat("w", "first", [("ann", 5.0)])  # it computed that for a coordinator before this one
    time.add_heartbeat("w", "first", [("ann", 8.0), ("bob", 1.0)])
    time.add_heartbeat("w", "first", [("ann", 8.0), ("bob", 1.0)])
    time.add_heartbeat("w", "first", [("ann", 7.0)])  # come late
    time.add_heartbeat("w", "second", [])
    time.add_heartbeat("w", "second", [("ann", 2.0)])
    assert time.take_unsaved() == {"ann": 3.0 + 2.0, "bob": 1.0}


def test_who_has_used_up_a_day_waits_for_the_next() -> None:
    time = TaskTime(3, {"ann": 9.0, None: 9.5})

    def exhausted() -> set[str | None]:
        return {user for user in ("ann", "bob", None) if time.is_used_up(user, LIMITS)}

    assert exhausted() == set()
    for user in ("ann", "bob"):
        time.charge(user, 1.0)
    assert exhausted() == {"ann"}
    time.charge(None, 1.0)
    assert exhausted() == {"ann", None}
    time.begin_day(3)
    assert exhausted() == {"ann", None}
    time.begin_day(4)
    assert exhausted() == set()
    assert time.take_unsaved() == {"ann": 1.0, "bob": 1.0, None: 1.0}
    assert time.take_unsaved() == {}


def test_all_together_may_have_used_up_theirs() -> None:
    time = TaskTime()
    time.charge("ann", 3.0)
    time.charge("bob", 3.0)
    assert time.is_used_up("ann", Limits(total=Total(task_time=6.0)))
    assert not time.is_used_up("ann", Limits(total=Total(task_time=6.5)))
    assert not time.is_used_up("ann", Limits())
