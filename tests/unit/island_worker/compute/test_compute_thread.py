"""The compute thread, over islands that behave as each test wants."""

import queue
import sys
import threading
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, Target
from atoll_core.errors import RemoteProtocolError
from atoll_core.search.commit_order import CommitOrder, Position
from atoll_core.wire.codec import dataset_to_bytes
from atoll_core.wire.messages.epochs import IslandReport, SliceCounters
from atoll_island_worker.compute.compute_thread import ComputeFailed, ComputeThread, WarmedUp, WarmUpNote
from atoll_island_worker.session.interface import (
    Abandoned,
    Broken,
    EpochComputed,
    EpochTask,
    JobReady,
    LoadFailed,
    Rejected,
    TaskKey,
)

LIMIT_S = 20.0
COMMIT_ORDER = CommitOrder(generations=100, stride=10, joining=8)


class FakeIsland:
    """Its epochs have ten slices; island 7 never ends, and waits before slice 50 for `may_go_on`; island 8 breaks."""

    may_go_on = threading.Event()

    def __init__(self, problem: Any, config: JobConfig, island: int) -> None:
        self.island = island
        self.slices = 0
        self.immigrants: dict[int, bytes] = {}

    @property
    def generation(self) -> int:
        return 10 * (self.slices if self.island == 7 else (self.slices - 1) % 10 + 1 if self.slices else 0)

    def advance(self, generations: int) -> bool:
        if self.island == 8:
            raise ZeroDivisionError("no such epoch")
        if self.island == 7 and self.slices == 49:
            self.may_go_on.wait(LIMIT_S)
        self.slices += 1
        return self.island != 7 and self.slices % 10 == 0

    def report(self) -> IslandReport:
        counters = (SliceCounters(generation=self.generation, evaluations={"offspring": self.slices}),)
        return IslandReport(
            island=self.island,
            generations=self.generation,
            hit=None,
            additions=(),
            counters=counters,
            best_error=None,
            digest="ab" * 16,
        )

    def emigrants(self) -> dict[int, bytes]:
        return {self.island: b"own", 1: b"other"}

    def senders(self) -> frozenset[int]:
        return frozenset({1, 2})

    def to_bytes(self) -> bytes:
        return b"state"

    def immigrate(self, blocks: Mapping[int, bytes]) -> None:
        if b"bad" in blocks.values():
            raise RemoteProtocolError("a block is malformed")
        self.immigrants.update(blocks)


@pytest.fixture
def results(monkeypatch: pytest.MonkeyPatch) -> "queue.Queue[object]":
    FakeIsland.may_go_on.set()
    module = ModuleType("atoll_island_worker.evolution.island")
    module.Island = FakeIsland  # type: ignore[attr-defined]
    warmup = ModuleType("atoll_island_worker.compute.warmup")
    warmup.warm_up = lambda report: report("compiling")  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "atoll_island_worker.evolution.island", module)
    monkeypatch.setitem(sys.modules, "atoll_island_worker.compute.warmup", warmup)
    return queue.Queue()


@pytest.fixture
def compute(results: "queue.Queue[object]") -> Iterator[ComputeThread]:
    thread = ComputeThread()
    thread.attach(results.put)
    values = np.linspace(0.0, 1.0, 5)
    dataset = Dataset(("x",), values[None, :].copy(), (Target("x", "dx/dt", values, 0.0, 1.0),), {"x": "x"})
    thread.load("job", JobConfig(), dataset_to_bytes(dataset))
    assert results.get(timeout=LIMIT_S) == JobReady("job")
    yield thread
    thread.close()


def key(island: int, epoch: int = 0, term: int = 1) -> TaskKey:
    return TaskKey("job", "x", term, island, epoch)


def task(of: TaskKey, blocks: Mapping[int, bytes] | None = None, is_last: bool = False) -> EpochTask:
    return EpochTask(of, blocks, is_last, commit_order=COMMIT_ORDER)


def test_refused_immigrants_are_said(compute: ComputeThread, results: "queue.Queue[object]") -> None:
    compute.run(task(key(0)))
    results.get(timeout=LIMIT_S)
    compute.run(task(key(0, 1), {1: b"bad"}))
    assert results.get(timeout=LIMIT_S) == Rejected(key(0, 1), "a block is malformed")


def test_what_breaks_is_said_and_the_thread_goes_on(compute: ComputeThread, results: "queue.Queue[object]") -> None:
    compute.run(task(key(8)))
    result = results.get(timeout=LIMIT_S)
    assert isinstance(result, Broken)
    assert "island 8 of x failed in epoch 0" in result.sentence
    assert "no such epoch" in result.sentence
    compute.run(task(key(0)))
    assert isinstance(results.get(timeout=LIMIT_S), EpochComputed)


def test_an_island_stops_where_the_target_was_met(compute: ComputeThread, results: "queue.Queue[object]") -> None:
    FakeIsland.may_go_on.clear()
    compute.run(task(key(7)))
    compute.stop_at(key(7).shard, Position(0, 500, 7), COMMIT_ORDER)
    FakeIsland.may_go_on.set()
    result = results.get(timeout=LIMIT_S)
    assert isinstance(result, EpochComputed)
    assert (result.report.generations, result.emigrants) == (500, {})
    compute.run(task(key(0, 1), {1: b"one"}))
    assert results.get(timeout=LIMIT_S) == Abandoned(key(0, 1))


def test_an_unreadable_dataset_is_said(compute: ComputeThread, results: "queue.Queue[object]") -> None:
    compute.load("other", JobConfig(), b"no dataset")
    result = results.get(timeout=LIMIT_S)
    assert isinstance(result, LoadFailed)
    assert result.job == "other"


def test_a_warm_up_says_what_it_does_also_before_anybody_listens(results: "queue.Queue[object]") -> None:
    compute = ComputeThread()
    compute.warm_up()
    compute.attach(results.put)
    assert results.get(timeout=LIMIT_S) == WarmUpNote("compiling")
    result = results.get(timeout=LIMIT_S)
    assert isinstance(result, WarmedUp)
    assert result.fingerprint
    compute.close()


def test_a_warm_up_that_fails_says_why(results: "queue.Queue[object]", monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(report: object) -> None:
        raise OSError("the disk is full")

    monkeypatch.setattr(sys.modules["atoll_island_worker.compute.warmup"], "warm_up", fail)
    compute = ComputeThread()
    compute.attach(results.put)
    compute.warm_up()
    result = results.get(timeout=LIMIT_S)
    assert isinstance(result, ComputeFailed)
    assert "the disk is full" in result.sentence
    compute.close()
