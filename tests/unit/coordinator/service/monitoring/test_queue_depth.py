"""The depth of the queue counts what could be computed, and not what waits for others to end."""

from types import SimpleNamespace
from typing import Any

from atoll_coordinator.service.monitoring.job_views import queue_depth
from atoll_core.config import EvolutionConfig, JobConfig


def job(state: str, islands: int = 8, equations: int = 0, priority: int = 0, is_held: bool = False) -> Any:
    """Return as much of a job as is looked at, with so many equations that are still searched."""
    archipelago = SimpleNamespace(collector=SimpleNamespace(limits=SimpleNamespace(islands=islands)))
    config = JobConfig(evolution=EvolutionConfig(islands=islands))
    return SimpleNamespace(
        state=state, config=config, open_archipelagos=(archipelago,) * equations, priority=priority, is_held=is_held
    )


def test_without_jobs_nothing_is_wanted() -> None:
    depth = queue_depth([], 0, 0, 4)
    assert (depth.tasks_ready, depth.workers_wanted) == (0, 0)


def test_islands_of_open_searches_are_ready_and_jobs_to_come_count_with_one_equation() -> None:
    depth = queue_depth([job("running", 4, 3), job("preparing", 6), job("refining", 5)], 1, 1, 4)
    assert (depth.queued, depth.preparing, depth.running, depth.refining) == (1, 1, 1, 1)
    assert depth.tasks_ready == 12 + 1 + 1
    assert depth.workers_wanted == 12 + 6 + 5 + JobConfig().evolution.islands


def test_jobs_that_wait_for_others_to_end_want_nobody() -> None:
    depth = queue_depth([job("running", 4, 1) for _ in range(4)], 100, 100, 4)
    assert depth.queued == 100
    assert depth.workers_wanted == depth.tasks_ready == 4 * 4


def test_jobs_that_are_held_or_paused_want_nobody() -> None:
    depth = queue_depth([job("running", 4, 1), job("running", 4, 1, is_held=True)], 5, 0, 4)
    assert (depth.queued, depth.running) == (5, 2)
    assert depth.workers_wanted == depth.tasks_ready == 4
