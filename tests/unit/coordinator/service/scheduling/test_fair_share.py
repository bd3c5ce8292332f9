"""Fair share: rounds between users, weights and age within one."""

from dataclasses import dataclass

from atoll_coordinator.service.scheduling.fair_share import AGE_S, FairShare, Principal


@dataclass
class Asked:
    id: str
    principal: str | None = None
    priority: int = 0
    since: float = 0.0


def jobs(names: str, principal: str | None = None) -> list[Asked]:
    return [Asked(name, principal, since=float(place)) for place, name in enumerate(names.split())]


def served(share: FairShare, asked: list[Asked], turns: int, seconds: float = 1.0) -> list[str]:
    """Return who is served when the first is charged each time."""
    order = []
    for _ in range(turns):
        first = share.order(asked)[0]
        share.charge(first, seconds)
        order.append(first)
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
    share.charge("a", 45.0)
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
    share.charge("c", 50.0)
    order = served(share, everybody, 40)
    assert "c" not in order
    share.forget("c")
    assert share.order(everybody)[-1] == "c"  # who comes back under another job still owes it


def test_who_took_what_nobody_else_wanted_owes_nothing_for_it() -> None:
    share = FairShare(quantum_s=1.0)
    both = [*jobs("a1 a2 a3", "ann"), *jobs("b", "bob")]
    for _ in range(100):
        share.order(both, content={"bob"})  # one job is all that bob has
        for job in ("a1", "a2", "a3", "b"):
            share.charge(job, 1.0)
    order = served(share, [*both, *jobs("c", "cem")], 30)
    assert max(sum(name.startswith(who) for name in order) for who in "abc") <= 11


def test_within_a_user_time_goes_by_the_weight_of_priorities() -> None:
    share = FairShare()
    order = served(share, [Asked("low", "ann", 0), Asked("high", "ann", 2)], 100)
    assert order.count("high") == 80


def test_within_a_user_priority_counts_then_age_and_age_overtakes_priority() -> None:
    share = FairShare()
    asked = [Asked("late", since=5.0), Asked("early", since=1.0), Asked("high", priority=1, since=0.9 * AGE_S)]
    assert share.order(asked) == ["high", "early", "late"]
    assert share.order([Asked("old"), Asked("higher", priority=3, since=3.1 * AGE_S)]) == ["old", "higher"]


def test_a_charge_of_a_user_counts_and_that_of_a_stranger_is_nobodys() -> None:
    share = FairShare(quantum_s=1.0)
    asked = [*jobs("a", "ann"), *jobs("b", "bob")]
    share.order(asked)
    share.charge(Principal("ann"), 3.0)
    share.charge("nobody", 100.0)
    assert served(share, asked, 4) == ["b", "b", "b", "a"]


def test_whoever_has_gone_and_owes_nothing_is_forgotten() -> None:
    share = FairShare(quantum_s=1.0)
    for number in range(1000):
        share.order([*jobs("a", "ann"), Asked(f"j{number}", f"u{number}")])
        share.charge("a", 1.0)
        share.forget(f"j{number}")
    assert len(share._shares) <= 2
    assert len(share._accounts) == 1
