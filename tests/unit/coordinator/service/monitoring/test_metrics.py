"""What is measured is what Prometheus reads, and the board asks for nothing else."""

import json
import re
import socket
import urllib.request
from pathlib import Path
from typing import Any

import pytest

from atoll_coordinator.service.monitoring import metrics as module
from atoll_coordinator.service.monitoring.metrics import MAX_USERS, OTHERS, Metrics, served
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import UsageError
from atoll_core.wire.messages.views import CoordinatorView, Counters, StoreView, Traffic, UserView
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World

DEPLOY = Path(__file__).parents[5] / "deploy"


def value(metrics: Metrics, name: str, **labels: str) -> float | None:
    return metrics.registry.get_sample_value(f"atoll_{name}", labels)


def view(**counters: Any) -> CoordinatorView:
    return CoordinatorView(
        version="1", incarnation=1, seconds=1.0, counters=Counters(**counters),
        store=StoreView(transactions=4, total_s=0.5),
    )  # fmt: skip


def test_waits_and_tasks_are_told_by_the_states_of_a_job() -> None:
    metrics = Metrics()
    for state, now in (("queued", 10.0), ("queued", 12.0), ("preparing", 14.0), ("running", 17.0), ("refining", 30.0)):
        metrics.note_state("a", state, 10.0, now)  # type: ignore[arg-type]
    metrics.note_state("a", None, 0.0, 32.0)
    metrics.note_state("a", None, 0.0, 33.0)
    assert value(metrics, "queue_wait_seconds_sum") == 4.0
    assert value(metrics, "queue_wait_seconds_count") == 1.0
    assert value(metrics, "task_seconds_sum", kind="preparing") == 3.0
    assert value(metrics, "task_seconds_sum", kind="refining") == 2.0


def test_totals_that_are_counted_elsewhere_rise_by_what_has_come() -> None:
    metrics = Metrics()
    for dropped, size in ((1, 10), (1, 10), (4, 25)):
        traffic = (Traffic(kind="report", messages_in=1, bytes_in=size),)
        metrics.set_process(view(dropped=dropped, traffic=traffic, memory_bytes=7), 9, 2, 0)
    assert value(metrics, "messages_dropped_total") == 4.0
    assert value(metrics, "bus_bytes_total", direction="in", kind="report") == 25.0
    assert (value(metrics, "store_bytes"), value(metrics, "memory_bytes"), value(metrics, "followers")) == (9, 7, 2)


def test_users_are_told_apart_but_not_without_end() -> None:
    metrics = Metrics()
    many = {(f"user{number}", "queued"): 1 for number in range(MAX_USERS + 5)}
    metrics.set_jobs({**many, (None, "running"): 1, ("ann", "running"): 2})
    assert value(metrics, "jobs", state="running") == 3.0
    assert value(metrics, "user_jobs", user="ann", state="running") == 2.0
    users = re.findall(r'atoll_user_jobs{state="\w+",user="(\w+)"}', metrics.exposition())
    assert len(set(users)) <= MAX_USERS + 1
    assert OTHERS in users
    metrics.set_jobs({})
    assert value(metrics, "jobs", state="running") is None


def test_scrapes_are_answered_while_the_block_lasts() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
        with pytest.raises(UsageError, match=f"cannot be served at 127.0.0.1:{port}: .*--metrics"):  # noqa: SIM117
            with probe, served(("127.0.0.1", port)):
                pass
    with served(("127.0.0.1", port)) as metrics:
        assert metrics is not None
        metrics.observe_lag(0.004)
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10.0) as answer:
            assert 'atoll_loop_lag_seconds_bucket{le="0.005"} 1.0' in answer.read().decode()
    with served(None) as nothing:
        assert nothing is None


def test_every_metric_of_the_board_is_in_the_exposition() -> None:
    metrics = Metrics()
    metrics.note_state("j", "preparing", 0.0, 0.0)
    metrics.note_state("j", None, 0.0, 1.0)
    metrics.note_event("done")
    metrics.set_jobs({("ann", "running"): 1})
    metrics.set_tasks(3, {("refine", "running"): 1}, 2)
    metrics.set_workers(["ready"])
    metrics.set_process(view(traffic=(Traffic(kind="report", messages_in=1, bytes_in=1),)), 1, 0, 0)
    exposed = set(re.findall(r"^(atoll_\w+)", metrics.exposition(), re.MULTILINE))
    board = json.loads((DEPLOY / "grafana" / "atoll.json").read_text("utf-8"))
    asked = {name for panel in board["panels"] for target in panel["targets"] for name in _names(target["expr"])}
    assert len(asked) > 15
    assert asked <= exposed
    of_histograms = {re.sub("_(bucket|sum|count)$", "", name) for name in exposed}
    named = {re.sub("_(bucket|sum|count)$", "", name) for name in asked}
    assert {name for name in of_histograms if not name.endswith("_created")} <= named  # the board shows all


def _names(expression: str) -> list[str]:
    return re.findall(r"atoll_\w+", expression)


class MeasuredWorld(World):
    """A world whose coordinator measures."""

    def serve(self, bus: Any, store: Any, dependencies: Any) -> Service:
        self.metrics = Metrics()
        service = Service(bus, store, dependencies=dependencies, metrics=self.metrics)
        bus.handle_with(service.step)
        return service


def test_a_coordinator_measures_its_jobs_workers_and_loop() -> None:
    world = MeasuredWorld(workers=2)
    world.submit(short_job(1, islands=2, max_epochs=3), "x")
    assert world.finish().state == "done"
    world.client.pause(module.UPDATE_S + 1.0)
    world.crash("w1")
    world.client.pause(module.UPDATE_S + 20.0)
    metrics = world.metrics
    assert value(metrics, "jobs_ended_total", state="done") == 1.0
    assert value(metrics, "queue_wait_seconds_count") == 1.0
    assert value(metrics, "task_seconds_count", kind="refining") == 1.0
    assert value(metrics, "workers", state="ready") == 1.0
    assert value(metrics, "leases_lost_total") == 1.0
    assert (value(metrics, "loop_lag_seconds_count") or 0) > 100
    assert (value(metrics, "bus_bytes_total", direction="in", kind="status") or 0) > 0
    assert isinstance(world.store, Store)


def test_people_are_shown_who_has_jobs_and_how_late_the_loop_was() -> None:
    world = World(workers=1)
    for number in range(3):
        world.submit(short_job(number, islands=2, max_epochs=3), "x", f"job{number}")
    assert world.service.view().users == (UserView(user=None, queued=0, begun=3),)
    for number in range(3):
        world.finish(f"job{number}")
    assert world.service.view().users == ()
    assert world.service.view().lag_s < module.LAG_S, "nothing holds up a simulated loop"
