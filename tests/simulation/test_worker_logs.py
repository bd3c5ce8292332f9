"""What workers log of a job is with the job, and no worker fills the store by it."""

import logging
from collections.abc import Iterator

import pytest

from atoll_coordinator.service.monitoring.event_log import BURST
from atoll_core.wire import topics
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.views import EventView
from atoll_core.wire.messages.workers import MAX_LINES, LogLine, WorkerLog
from atoll_island_worker.job_logs import JobLogs
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World

CONFIG = short_job(1, islands=3, max_epochs=5, stagnation=1000)


@pytest.fixture
def world() -> Iterator[World]:
    """A world with one worker, whose log is told."""
    made = World(workers=1)
    logs = JobLogs(lambda: made.network.now)
    made.workers["w0"]._logs = logs
    root, logger = logging.getLogger(), logging.getLogger("atoll_island_worker")
    before = logger.level
    logger.setLevel(logging.INFO)
    root.addHandler(logs)
    yield made
    root.removeHandler(logs)
    logger.setLevel(before)
    made.close()


def lines(world: World, job: str | None) -> list[EventView]:
    return [event for event in world.client.events(job, 0, 1000, of_workers=True) if event.job == job]


def send(world: World, worker: str, *told: LogLine, dropped: int = 0) -> None:
    key = topics.worker(world.store.cluster, worker, "log")
    world.network.bus(f"as-{worker}-{world.network.now}").put(key, encode(WorkerLog(lines=told, dropped=dropped)))
    world.client.pause(1.0)


def line(text: str, job: str | None = "job") -> LogLine:
    return LogLine(time="2026-01-01T00:00:00.000+00:00", level="info", text=text, job=job)


def test_what_a_worker_says_of_a_job_is_among_its_events(world: World) -> None:
    world.submit(CONFIG, "x")
    assert world.finish().state == "done"
    world.client.pause(2.0)
    told = lines(world, "job")
    assert {event.text.split(" ")[0] for event in told} >= {"data", "islands"}
    assert {event.worker for event in told} == {"w0"}
    assert {event.event for event in told} == {"log"}
    everything = world.client.events("job", 0, 1000)
    assert {event.event for event in everything} > {"log", "submitted", "done"}


def test_lines_of_jobs_that_are_not_there_and_of_strangers_are_not_kept(world: World) -> None:
    world.submit(CONFIG, "x")
    world.finish()
    send(world, "w0", line("of a job that is not there", "nothing"))
    send(world, "stranger", line("of nobody"))
    texts = {event.text for event in world.client.events(None, 0, 1000)}
    assert not texts & {"of a job that is not there", "of nobody"}
    assert world.service.rejects.total == 1


def test_a_flood_of_lines_is_bounded_and_said(world: World) -> None:
    world.submit(CONFIG, "x")
    world.finish()
    before = len(lines(world, "job"))
    key = topics.worker(world.store.cluster, "w0", "log")
    bus = world.network.bus("as-w0")
    for _ in range(20):
        bus.put(key, encode(WorkerLog(lines=tuple(line("again") for _ in range(MAX_LINES)))))
    world.client.pause(1.0)
    told = lines(world, "job")
    assert len(told) - before <= BURST + 20
    assert any("exceeded the limit" in event.text for event in world.client.events(None, 0, 1000, of_workers=True))
    assert world.service._worker_logs.dropped >= 20 * MAX_LINES - BURST - 100
    kinds = {event.event for event in world.client.events("job", 0, 1000)}
    assert {"submitted", "done"} <= kinds
