"""In which order jobs are taken up."""

from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.jobs.queue import MAX_RUNNING, Line, next_job, waiting_jobs
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_core.config import JobConfig


def job(name: str, priority: int = 0, state: str = "queued") -> Job:
    made = Job(JobRecord(name, name, "{}", "", "", priority=priority), JobConfig(), 0.0)
    made.state = state  # type: ignore[assignment]
    return made


def test_higher_priority_comes_first_then_who_came_first() -> None:
    jobs = [job("a"), job("b", 2), job("c", -1), job("d", 2), job("e", state="running")]
    assert [job.id for job in waiting_jobs(jobs)] == ["b", "d", "a", "c"]
    assert [Line(jobs).ahead_of(job) for job in jobs] == [2, 0, 3, 1, None]


def test_one_job_is_prepared_at_a_time_while_there_is_room() -> None:
    running = [job(f"r{n}", state="running") for n in range(MAX_RUNNING)]
    assert next_job([*running[1:], job("a")]) is not None
    assert next_job([*running, job("a")]) is None
    assert next_job([job("p", state="preparing"), job("a")]) is None
    assert next_job(running[1:]) is None
    assert next_job([*[job(f"f{n}", state="refining") for n in range(9)], job("a")]) is not None


def test_what_a_queued_job_waits_for_is_said() -> None:
    jobs = [job("r", state="running"), job("a"), job("b"), job("c")]
    said = [Line(jobs).waiting_reason(job) for job in jobs[1:]]
    assert said == [
        "waits for its turn (it is next; 1 job is under way)",
        "waits for its turn (1 job before it)",
        "waits for its turn (2 jobs before it)",
    ]
