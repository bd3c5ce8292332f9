"""No event costs the service's loop more for a large table, or for many stored jobs: bytes and queries are counted.

Bytes are those that an event has hashed, and the most that it has allocated at a time: what is read from the store,
joined, copied or decoded is allocated. Queries are statements of SQL. What the background thread does is not counted.

Not covered: the equations of a job that ends without being refined (cancelled, or failed) are judged on all rows.
"""

import contextlib
import hashlib
import tracemalloc
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.service.monitoring.views import ended_view
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.tasks.dependencies import Dependencies
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, Target
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Event, Message, Posted, Query
from atoll_core.wire.codec import decode
from atoll_core.wire.messages.clients import Request
from atoll_core.wire.messages.limits import CHUNK_SIZE, MAX_MESSAGE, MAX_PAGE_JOBS
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World

SMALL, LARGE = 2, 8
"""Chunks of a table: of the small one, too, messages are as large as they get."""

FEW, MANY = MAX_PAGE_JOBS + 1, 8 * MAX_PAGE_JOBS
"""Stored jobs that have ended: of the few, too, a list has as many as it ever has."""


def prepare_in_proportion(table: bytes, config: JobConfig) -> Preparation:
    """Return a dataset of x with as many bytes as the table, in round numbers."""
    values = np.linspace(0.0, 1.0, len(table) // 16)
    return Preparation(Dataset(("x",), values[None, :], (Target("x", "dx/dt", values, 0.0, 0.3),), {"x": "x"}))


@dataclass
class Effort:
    """The most that one event of each kind has cost."""

    hashed: Counter[str] = field(default_factory=Counter)
    allocated: Counter[str] = field(default_factory=Counter)
    queries: Counter[str] = field(default_factory=Counter)

    def note(self, kind: str, hashed: int, allocated: int, queries: int) -> None:
        for most, count in ((self.hashed, hashed), (self.allocated, allocated), (self.queries, queries)):
            most[kind] = max(most[kind], count)


class CountedWorld(World):
    """A world whose coordinator's events are counted; what it does in the background happens between events."""

    def __init__(self, jobs: int) -> None:
        self.effort = Effort()
        self.hashed = self.queried = 0
        self.kind = ""
        self.jobs = jobs
        super().__init__(workers=1, prepare=prepare_in_proportion, refiner=lambda *_: Refinement())

    def start_service(self) -> Service:
        for number in range(self.jobs):
            name = f"stored{number:06}"
            table = self.store.put_blob(b"table %d" % (number % 7))
            record = JobRecord(name, name, JobConfig().model_dump_json(), table, "2026", state="done")
            self.store.add_job(record)
            self.store.keep_views({name: ended_view(record, None).model_dump_json()})
        dependencies = Dependencies(self.clock, background=lambda work: self.at(self.network.now, work))
        service = self.serve(self.coordinator_bus(), self.store, dependencies)
        answer = service._requests.answer

        def answered(event: Query) -> bytes | None:
            self.kind = kind_of(event)
            return answer(event)

        service._requests.answer = answered  # type: ignore[method-assign]
        service.start()
        self.store._connection.set_trace_callback(lambda statement: setattr(self, "queried", self.queried + 1))
        return service

    def step_service(self, bus: Any, event: Event, service: Service, store: Any) -> None:
        self.hashed, self.queried, self.kind = 0, 0, kind_of(event)
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        service.step(event)
        _, peak = tracemalloc.get_traced_memory()
        self.effort.note(self.kind, self.hashed, peak - before, self.queried)


def kind_of(event: Event) -> str:
    """Return the kind of an event: of which message, question or outcome it is."""
    match event:
        case Posted():
            return type(event.item).__name__
        case Query() if isinstance(topics.parse(event.key), topics.ClientKey):
            return str(decode(event.payload, Request, MAX_MESSAGE).body.kind)
        case Query() | Message():
            key = topics.parse(event.key)
            return f"{type(key).__name__} {getattr(key, 'part', '')}"
    return type(event).__name__


@contextlib.contextmanager
def hashes_counted(world: CountedWorld, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    sha256 = hashlib.sha256

    def counted(data: bytes = b"", **named: Any) -> Any:
        world.hashed += len(data)
        return sha256(data, **named)

    with monkeypatch.context() as patch:
        patch.setattr(hashlib, "sha256", counted)
        yield


def effort(monkeypatch: pytest.MonkeyPatch, chunks: int, jobs: int) -> Effort:
    """Return what events cost while a job goes from its upload to its deletion."""
    tracemalloc.start()
    try:
        world = CountedWorld(jobs)
        with contextlib.closing(world), hashes_counted(world, monkeypatch):
            table = np.random.default_rng(1).bytes(chunks * CHUNK_SIZE)
            digest = world.client.upload(table)
            world.client.submit("job", "a job", short_job(1, islands=2, max_epochs=3), digest)
            while world.client.status("job").state != "running":
                world.client.pause(0.05)
            world.result()
            assert world.finish().state == "done"
            world.result()
            world.client.jobs()
            world.client.table("job")
            world.client.delete("job")
            world.client.pause(2.0)
        return world.effort
    finally:
        tracemalloc.stop()


def test_no_event_costs_more_for_a_large_table_or_for_many_stored_jobs(monkeypatch: pytest.MonkeyPatch) -> None:
    small = effort(monkeypatch, SMALL, FEW)
    for more in (effort(monkeypatch, LARGE, FEW), effort(monkeypatch, SMALL, MANY)):
        for name, margin in (("hashed", 10_000), ("allocated", CHUNK_SIZE), ("queries", 10)):
            usual, most = getattr(small, name), getattr(more, name)
            assert usual.keys() == most.keys()
            over = {kind: (usual[kind], count) for kind, count in most.items() if count > usual[kind] + margin}
            assert not over, f"{name}: of these events, with little and with much: {over}"
