"""How many jobs of a batch system there are, look by look: at once more, later fewer, never beyond the bounds."""

import random
from collections.abc import Mapping

import pytest

from atoll.cli.adapt_policy import MOST_FAILURES, AdaptDecision, AdaptLimits, AdaptPolicy, BatchJob, BatchState, Need
from atoll_core.errors import AtollError

LIMITS = AdaptLimits(minimum=1, maximum=5, workers=4, idle_s=100.0)


def need(workers: int, others: int = 0, islands: Mapping[str, int] | None = None) -> Need:
    return Need(workers, others, islands or {})


def batch(*states: BatchState) -> list[BatchJob]:
    return [BatchJob(str(number), number, state) for number, state in enumerate(states)]


@pytest.mark.parametrize(
    ("workers", "others", "expected"),
    [(0, 0, 1), (1, 0, 1), (4, 0, 1), (5, 0, 2), (20, 0, 5), (900, 0, 5), (20, 13, 2)],
)
def test_it_grows_at_once_within_its_bounds_by_what_others_do_not_do(workers: int, others: int, expected: int) -> None:
    assert AdaptPolicy(LIMITS).decide(0.0, need(workers, others), []) == AdaptDecision(submit=expected)


def test_it_shrinks_when_fewer_have_been_enough_for_a_while() -> None:
    policy, jobs = AdaptPolicy(LIMITS), batch("running", "running", "running")
    assert policy.decide(0.0, need(12), jobs) == AdaptDecision()
    assert policy.decide(10.0, need(4), jobs) == AdaptDecision()
    assert policy.decide(99.0, need(4), jobs) == AdaptDecision()
    assert policy.decide(100.0, need(4), jobs) == AdaptDecision(drain=("0", "1")), "what was needed at 0 is long ago"


def test_those_end_first_that_cost_least() -> None:
    policy = AdaptPolicy(AdaptLimits(0, 9, 4, 0.0))
    jobs = batch("running", "pending", "running", "pending", "running")
    islands = {"0": 3, "2": 0, "4": 3}
    assert policy.decide(0.0, need(8, islands=islands), jobs) == AdaptDecision(take_back=("3", "1"), drain=("2",))
    assert policy.decide(1.0, need(4, islands=islands), [jobs[0], jobs[4]]) == AdaptDecision(drain=("0",)), (
        "the older one"
    )


def test_jobs_that_end_before_a_worker_has_joined_are_not_submitted_for_ever() -> None:
    policy = AdaptPolicy(LIMITS)
    for number in range(MOST_FAILURES - 1):
        policy.decide(number, need(4), [BatchJob(str(number), number, "pending")])
    policy.decide(5.0, need(4), [BatchJob("7", 7, "running")])
    with pytest.raises(AtollError, match=r"3 consecutive jobs ended .* the last one was 7; read their output"):
        policy.decide(6.0, need(4), [])


def test_a_job_in_error_is_cancelled_replaced_and_counts_as_a_failure() -> None:
    policy = AdaptPolicy(LIMITS)
    for number in range(MOST_FAILURES):
        in_error = [BatchJob(str(number), number, "failed")]
        assert policy.decide(number, need(4), in_error) == AdaptDecision(submit=1, take_back=(str(number),))
        assert policy.decide(number + 0.3, need(4), in_error) == AdaptDecision(submit=1), "it is cancelled once"
    with pytest.raises(AtollError, match="the last one was 2"):
        policy.decide(9.0, need(4), [])


def test_a_job_that_began_before_it_could_be_cancelled_is_drained() -> None:
    policy = AdaptPolicy(AdaptLimits(0, 5, 4, 0.0))
    assert policy.decide(0.0, need(0), batch("pending")) == AdaptDecision(take_back=("0",))
    assert policy.decide(1.0, need(0), batch("running")) == AdaptDecision(drain=("0",))
    assert policy.decide(2.0, need(0), batch("running")) == AdaptDecision()


@pytest.mark.parametrize("seed", range(20))
def test_the_bounds_hold_whatever_comes(seed: int) -> None:
    """A batch system that begins and ends jobs as it likes, and a queue that jumps: 500 looks."""
    draw = random.Random(seed)
    limits = AdaptLimits(draw.randint(0, 3), draw.randint(3, 8), draw.randint(1, 8), 60.0)
    policy, jobs, number, told, drained = AdaptPolicy(limits), {}, 0, set(), set()
    for look in range(500):
        workers = draw.choice([0, 1, 5, 30, 100])
        islands = {job.id: draw.randint(0, 9) for job in jobs.values() if job.state == "running"}
        decision = policy.decide(15.0 * look, Need(workers, draw.choice([0, 0, 3]), islands), list(jobs.values()))
        ends = {*decision.take_back, *decision.drain}
        assert not drained & {*decision.drain}, "a second SIGTERM would end workers without handing over"
        assert not ends & told
        told |= ends
        drained |= {*decision.drain}
        assert not (decision.submit and ends)
        for _ in range(decision.submit):
            number += 1
            jobs[str(number)] = BatchJob(str(number), number, "pending")
        kept = [job for job in jobs.values() if job.id not in told]
        assert limits.minimum <= len(kept) <= limits.maximum
        for job in list(jobs.values()):
            if job.id in told and draw.random() < 0.5:
                del jobs[job.id]
            elif job.state == "pending" and draw.random() < 0.5:
                jobs[job.id] = BatchJob(job.id, job.number, "running")
                told.discard(job.id)
            elif job.id in islands and draw.random() < 0.02:
                del jobs[job.id]
