"""Fair share: rounds between users, age and priority within one, and turns of tasks."""

from atoll_coordinator.service.scheduling.fair_share import AGE_S, FairShare, TaskTurns, Turn


def jobs(names: str, user: str | None = None) -> list[Turn]:
    return [Turn(name, user, since=float(place)) for place, name in enumerate(names.split())]


def served(share: FairShare, asked: list[Turn], turns: int, seconds: float = 1.0) -> list[str]:
    """Return which jobs are served when the user of the first is charged each time."""
    order, user_of = [], {job.id: job.user for job in asked}
    for _ in range(turns):
        order.append(share.order(asked)[0])
        share.charge(user_of[order[-1]], seconds)
    return order


def test_jobs_of_users_alternate_however_many_one_has() -> None:
    share = FairShare()
    assert share.order([*jobs("a1 a2 a3 a4", "ann"), *jobs("b1", "bob")]) == ["a1", "b1", "a2", "a3", "a4"]
    assert share.order([]) == []


def test_a_user_is_served_for_a_quantum_then_the_next_one_is() -> None:
    share = FairShare(quantum_s=3.0)
    order = served(share, [*jobs("a", "ann"), *jobs("b", "bob")], 12)
    assert "".join(order) == "aaabbbaaabbb"


def test_what_is_overdrawn_is_taken_off_the_next_turns() -> None:
    share = FairShare(quantum_s=10.0)
    asked = [*jobs("a", "ann"), *jobs("b", "bob")]
    share.order(asked)
    share.charge("ann", 45.0)
    order = served(share, asked, 13, 5.0)
    assert "".join(order) == "bbbbbbbbabbaa"


def test_idleness_saves_nothing_up_and_a_newcomer_stands_behind_those_of_the_round() -> None:
    share = FairShare(quantum_s=1.0)
    both = [*jobs("a", "ann"), *jobs("b", "bob")]
    served(share, both, 2)
    served(share, jobs("a", "ann"), 1000)  # bob has nothing to do
    order = served(share, both, 100)
    assert abs(order.count("a") - order.count("b")) <= 1
    assert share.order([*both, *jobs("c", "cem")]) == ["b", "c", "a"]  # a has had its turn of this round


def test_a_user_who_cannot_be_served_holds_nobody_up_and_owes_what_was_owed() -> None:
    share = FairShare(quantum_s=1.0)
    everybody = [*jobs("a", "ann"), *jobs("b", "bob"), *jobs("c", "cem")]
    share.order(everybody)
    share.charge("cem", 50.0)
    order = served(share, everybody, 40)
    assert "c" not in order
    share.forget("c")
    assert share.order(everybody)[-1] == "c"  # who comes back under another job still owes it


def test_who_took_what_nobody_else_wanted_owes_nothing_for_it() -> None:
    share = FairShare(quantum_s=1.0)
    both = [*jobs("a1 a2 a3", "ann"), *jobs("b", "bob")]
    for _ in range(100):
        share.order(both, content={"bob"})  # one job is all that bob has
        for user in ("ann", "ann", "ann", "bob"):
            share.charge(user, 1.0)
    order = served(share, [*both, *jobs("c", "cem")], 30)
    assert max(sum(name.startswith(who) for name in order) for who in "abc") <= 11


def test_within_a_user_priority_counts_then_age_and_age_overtakes_priority() -> None:
    share = FairShare()
    asked = [
        Turn("late", None, since=5.0),
        Turn("early", None, since=1.0),
        Turn("high", None, priority=1, since=0.9 * AGE_S),
    ]
    assert share.order(asked) == ["high", "early", "late"]
    assert share.order([Turn("old", None), Turn("higher", None, priority=3, since=3.1 * AGE_S)]) == ["old", "higher"]


def test_who_has_tasks_that_run_lets_others_go_before_and_who_was_charged_waits() -> None:
    running, waiting = jobs("a0 a1", "ann"), [Turn("a2", "ann", 1), Turn("a3", "ann"), Turn("b", "bob", since=9.0)]
    assert TaskTurns().order_tasks(waiting, running) == ["b", "a2", "a3"]
    turns = TaskTurns()
    assert turns.order_tasks(waiting, []) == ["a2", "b", "a3"]
    turns.charge("ann", 200.0)
    assert turns.order_tasks(waiting, []) == ["b", "a2", "a3"]
