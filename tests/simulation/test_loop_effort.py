"""No event costs the service's loop more for a large table, or for many stored jobs: bytes and queries are counted.

Bytes are those that an event has hashed, and the most that it has allocated at a time: what is read from the store,
joined, copied or decoded is allocated. Queries are statements of SQL. Rows are those on which equations are evaluated
for their errors, in parts. What the background thread does is not counted.
"""

import contextlib
import hashlib
import tracemalloc
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np
import pytest

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.model.regression import errors
from atoll_coordinator.service.monitoring.job_views import ended_view
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.tasks.background import Dependencies, PreparationFailed
from atoll_coordinator.tasks.refining import Refiner
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, FloatArray, Target
from atoll_core.expression.program import Program
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Event, Message, Posted, Query
from atoll_core.wire.codec import decode
from atoll_core.wire.messages.clients import ClientRequest
from atoll_core.wire.messages.limits import CHUNK_SIZE, MAX_MESSAGE, MAX_PAGE_JOBS
from tests.blobs import put_blob
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World

SMALL, LARGE = 2, 8
"""Chunks of a table: of the small one, too, messages are as large as they get."""

FEW, MANY = MAX_PAGE_JOBS + 1, 8 * MAX_PAGE_JOBS
"""Stored jobs that have ended: of the few, too, a list has as many as it ever has."""


def prepare_in_proportion(table: bytes, config: JobConfig) -> Preparation:
    """Return a dataset of x with as many bytes as the table, in round numbers; a quarter of its rows are held out."""
    rows = len(table) // 64
    return Preparation(dataset_of(3 * rows), held_out=dataset_of(rows))


def dataset_of(rows: int) -> Dataset:
    values = np.linspace(0.0, 1.0, rows)
    return Dataset(("x",), values[None, :], (Target("x", "dx/dt", values, 0.0, 0.3),), {"x": "x"})


@dataclass
class Effort:
    """The most that one event of each kind has cost."""

    hashed: Counter[str] = field(default_factory=Counter)
    allocated: Counter[str] = field(default_factory=Counter)
    queries: Counter[str] = field(default_factory=Counter)
    rows: Counter[str] = field(default_factory=Counter)

    def note(self, kind: str, **counts: int) -> None:
        for name, count in counts.items():
            most = getattr(self, name)
            most[kind] = max(most[kind], count)


class CountedWorld(World):
    """A world whose coordinator's events are counted; what it does in the background happens between events."""

    def __init__(self, jobs: int, refiner: Refiner) -> None:
        self.effort = Effort()
        self.hashed = self.queried = self.evaluated = 0
        self.kind = ""
        self.jobs = jobs
        super().__init__(workers=1, slowness=20.0, prepare=prepare_in_proportion, refiner=refiner)

    def start_service(self) -> Service:
        for number in range(self.jobs):
            name = f"stored{number:06}"
            table = put_blob(self.store, b"table %d" % (number % 7))
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
        self.hashed = self.queried = self.evaluated = 0
        self.kind = kind_of(event)
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        service.step(event)
        _, peak = tracemalloc.get_traced_memory()
        self.effort.note(
            self.kind, hashed=self.hashed, allocated=peak - before, queries=self.queried, rows=self.evaluated
        )


def kind_of(event: Event) -> str:
    """Return the kind of an event: of which message, question or outcome it is."""
    match event:
        case Posted():
            return type(event.item).__name__
        case Query() if isinstance(topics.parse(event.key), topics.ClientKey):
            return str(decode(event.payload, ClientRequest, MAX_MESSAGE).body.kind)
        case Query() | Message():
            key = topics.parse(event.key)
            return f"{type(key).__name__} {getattr(key, 'part', '')}"
    return type(event).__name__


@contextlib.contextmanager
def hashes_and_rows_counted(world: CountedWorld, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    sha256, values_of = hashlib.sha256, errors.values_of

    def evaluated(program: Program, inputs: FloatArray) -> FloatArray:
        world.evaluated += inputs.shape[1]
        return values_of(program, inputs)

    def counted(data: bytes = b"", **named: Any) -> Any:
        world.hashed += len(data)
        return sha256(data, **named)

    with monkeypatch.context() as patch:
        patch.setattr(hashlib, "sha256", counted)
        patch.setattr(errors, "values_of", evaluated)
        yield


End = Literal["refined", "cancelled", "out of time", "refining breaks", "failed"]


def broken(*_: object) -> Refinement:
    raise ZeroDivisionError("planted")


def effort(monkeypatch: pytest.MonkeyPatch, chunks: int, jobs: int, end: End = "refined") -> Effort:
    """Return what events cost while a job goes from its upload to its deletion, and ends in some way in between."""
    tracemalloc.start()
    try:
        world = CountedWorld(jobs, broken if end == "refining breaks" else lambda *_: Refinement())
        with contextlib.closing(world), hashes_and_rows_counted(world, monkeypatch):
            table = np.random.default_rng(1).bytes(chunks * CHUNK_SIZE)
            digest = world.client.upload(table)
            lasts = end in ("cancelled", "failed")
            limits = {"max_epochs": 10**6 if lasts else 8, "max_time": 20.0 if end == "out of time" else None}
            world.client.submit("job", "a job", short_job(1, islands=2, stagnation=10**6, **limits), digest)
            while not any(each.expression for each in world.client.status("job").variables):
                world.client.pause(0.05)
            if end == "out of time":
                world.background_s = 1e6
            world.result()
            if end == "cancelled":
                world.client.cancel("job")
            elif end == "failed":
                world.service._bus.post(PreparationFailed("job", "internal", "planted"))
            assert world.finish().state == {"cancelled": "cancelled", "failed": "failed"}.get(end, "done")
            assert (world.result()["refining"] == "finished") == (end == "refined")
            world.client.jobs()
            world.client.table("job")
            world.client.delete("job")
            world.client.pause(2.0)
        return world.effort
    finally:
        tracemalloc.stop()


def compare(small: Effort, more: Effort) -> None:
    for name, margin in (("hashed", 10_000), ("allocated", CHUNK_SIZE), ("queries", 10), ("rows", 1000)):
        usual, most = getattr(small, name), getattr(more, name)
        assert usual.keys() == most.keys()
        over = {kind: (usual[kind], count) for kind, count in most.items() if count > usual[kind] + margin}
        assert not over, f"{name}: of these events, with little and with much: {over}"


def test_no_event_costs_more_for_a_large_table_or_for_many_stored_jobs(monkeypatch: pytest.MonkeyPatch) -> None:
    small = effort(monkeypatch, SMALL, FEW)
    compare(small, effort(monkeypatch, LARGE, FEW))
    compare(small, effort(monkeypatch, SMALL, MANY))


@pytest.mark.parametrize(
    "end",
    [pytest.param(end, marks=[pytest.mark.slow] * (end != "cancelled")) for end in get_args(End) if end != "refined"],
)
def test_nor_does_one_where_a_job_ends_without_being_refined(end: End, monkeypatch: pytest.MonkeyPatch) -> None:
    compare(effort(monkeypatch, SMALL, 0, end), effort(monkeypatch, LARGE, 0, end))
