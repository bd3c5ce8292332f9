"""Whose task is next: users in turn, within a user by priority and age, whatever else they have under way."""

from typing import Any

from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.scheduling.task_turns import TaskTurns
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_core.config import JobConfig


def job(name: str, user: str, priority: int = 0, since: float = 0.0) -> Job:
    record = JobRecord(name, name, "{}", "c" * 64, "2026", priority=priority, submitter=user)
    return Job(record, JobConfig(), since)


def test_users_take_turns_and_within_a_user_priority_then_age_decide() -> None:
    own = [job("a1", "ann", since=1.0), job("a2", "ann", priority=1, since=2.0), job("a0", "ann", since=0.0)]
    assert TaskTurns().order([*own, job("b", "bob", since=9.0)], []) == ["a2", "b", "a0", "a1"]


def test_who_has_tasks_that_run_lets_others_go_before() -> None:
    running = [job("a0", "ann"), job("a1", "ann")]
    assert TaskTurns().order([job("a2", "ann"), job("b", "bob", since=9.0)], running) == ["b", "a2"]


def test_who_was_charged_a_quantum_more_waits_for_the_others() -> None:
    turns = TaskTurns()
    waiting: Any = [job("a", "ann"), job("b0", "bob"), job("b1", "bob")]
    assert turns.order(waiting, [])[0] == "a"
    turns.charge("ann", 200.0)
    assert turns.order(waiting, []) == ["b0", "b1", "a"]


def test_jobs_that_have_ended_are_forgotten() -> None:
    turns = TaskTurns()
    turns.order([job("a", "ann")], [])
    turns.forget("a")
    assert not turns._fair_share._accounts
