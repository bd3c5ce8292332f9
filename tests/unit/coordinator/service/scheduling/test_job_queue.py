"""The line and the places: who is taken up, held and released."""

import pytest

from atoll_coordinator.service.scheduling.fair_share import QUANTUM_S, FairShare
from atoll_coordinator.service.scheduling.job_queue import JobQueue, SchedulingDecision
from atoll_coordinator.service.scheduling.limits import Allowance, Limits, Total


def queue_of(running: int = 4, **changes: object) -> JobQueue:
    return JobQueue(Limits(total=Total(running=running)).model_copy(update=changes))


def take(queue: JobQueue) -> SchedulingDecision:
    """Do what is decided: what is taken up is prepared at once."""
    decision = queue.decide()
    for job in decision.take_up:
        queue.begin(job)
        queue.search(job)
    queue.validate()
    return decision


def fill(queue: JobQueue) -> list[str]:
    """Take up all there is room for; return it in order."""
    taken: list[str] = []
    while step := take(queue).take_up:
        taken += step
    return taken


def test_several_jobs_of_one_user_are_prepared_at_the_same_time_while_there_is_room() -> None:
    queue = queue_of(3)
    for job in "abcd":
        queue.add(job, "ann", 0, 0.0)
    queue.add("z", "bob", 0, 0.0)
    assert queue.decide().take_up == ("a", "z", "b")
    for job in "azb":
        queue.begin(job)
    assert queue.decide() == SchedulingDecision()
    queue.search("a")
    assert queue.decide() == SchedulingDecision()
    queue.remove("a")
    assert queue.decide().take_up == ("c",)


def test_what_a_queued_job_waits_for_is_said() -> None:
    queue = queue_of()
    for job in "rabc":
        queue.add(job, None, 0, 0.0)
    queue.begin("r")
    assert [queue.waiting_reason(job) for job in "rabc"] == [
        None,
        "waits for its turn (it is next; 1 job is under way)",
        "waits for its turn (1 job before it)",
        "waits for its turn (2 jobs before it)",
    ]


def test_users_share_places_however_many_jobs_one_has_and_each_is_told_its_place() -> None:
    queue = queue_of(2)
    for number in range(50):
        queue.add(f"a{number}", "ann", 0, 0.0)
    for number in range(2):
        queue.add(f"b{number}", "bob", 0, 1.0)
    queue.decide()
    assert queue.ahead_of("b0") == 1
    assert queue.ahead_of("b1") == 3
    assert queue.ahead_of("a2") == 4
    assert fill(queue) == ["a0", "b0"]


def test_endless_jobs_lose_their_places_after_a_quantum_and_get_them_back() -> None:
    queue = queue_of(2)
    for job in ("a0", "a1"):
        queue.add(job, "ann", 0, 0.0)
    fill(queue)
    queue.charge(0.0)
    queue.add("b0", "bob", 0, 1.0)
    assert take(queue) == SchedulingDecision(take_up=("b0",), hold=("a1",))  # the second of one user gives way at once
    assert queue.waiting_reason("a1") == "waits for its user's next turn: jobs of other users run now"
    queue.add("c0", "cem", 0, 1.0)
    queue.charge(0.9 * QUANTUM_S)
    assert take(queue) == SchedulingDecision()
    queue.charge(1.1 * QUANTUM_S)
    decision = take(queue)
    assert decision.take_up == ("c0",)
    assert len(decision.hold) == 1
    queue.remove("c0")
    assert take(queue).release == decision.hold


def test_a_user_has_no_more_places_than_allowed_and_others_pass() -> None:
    queue = queue_of(4, user=Allowance(running=1), users={"bob": Allowance(running=2)})
    for user in ("ann", "bob"):
        for number in range(3):
            queue.add(f"{user}{number}", user, 0, 0.0)
    assert fill(queue) == ["ann0", "bob0", "bob1"]
    assert queue.waiting_reason("ann1") == "waits: 1 of its user's jobs are under way, as many as limits allow"
    queue.limits = Limits(total=Total(running=1))
    assert len(take(queue).hold) == 2


def test_what_is_not_there_is_let_go_without_effect_and_counts_are_kept() -> None:
    queue = queue_of(1)
    queue.remove("nobody")
    for job in "abc":
        queue.add(job, None, 0, 0.0)
    fill(queue)
    queue.pause("c", True)
    assert (queue.under_way, queue.queued, queue.queued_of(None), queue.queued_of("ann")) == (1, 2, 2, 0)
    for job in "abc":
        queue.remove(job)
    assert (queue.under_way, queue.queued, queue._users, queue._entries) == (0, 0, {}, {})


@pytest.mark.parametrize("users", [2, 5, 9])
def test_a_small_job_waits_no_longer_than_derived(users: int) -> None:
    places, tick = 2, 0.5
    queue = JobQueue(Limits(total=Total(running=places)), FairShare())
    for user in range(users - 1):
        for number in range(3):
            queue.add(f"u{user}-{number}", f"u{user}", 0, 0.0)
    now = 0.0
    while now < 500.0:
        queue.charge(now)
        fill(queue)
        now += tick
    queue.add("small", "newcomer", 0, now)
    began = now
    while "small" not in fill(queue):
        now += tick
        queue.charge(now)
    assert now - began <= (users - 1) * (QUANTUM_S + tick) / places + tick
