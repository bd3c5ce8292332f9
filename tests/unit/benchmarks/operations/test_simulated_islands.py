"""Simulated islands take the place of the compute thread, so they must have all that a worker uses of it."""

import inspect
import queue

import pytest

from atoll_core.config import JobConfig
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire.messages.epochs import EpochReport, IslandReport
from atoll_island_worker.compute.compute_thread import ComputeThread
from atoll_island_worker.session.interface import EpochComputed, EpochTask, TaskKey
from benchmarks.operations.island_samples import Samples
from benchmarks.operations.simulated_islands import Books, PacedCompute, Pacer, SerialCompute


def test_simulated_islands_have_the_interface_of_the_compute_thread() -> None:
    thread, paced = ComputeThread(), PacedCompute(Samples((), 1, 1), 1.0, Pacer(), Books())
    thread.close()
    names = [name for name in dir(thread) if not name.startswith("_")]
    assert [name for name in names if not hasattr(paced, name)] == []
    methods = [name for name in names if inspect.isfunction(getattr(ComputeThread, name, None))]
    for name in methods:
        assert inspect.signature(getattr(paced, name)).parameters.keys() == (
            inspect.signature(getattr(thread, name)).parameters.keys()
        ), name


def test_a_worker_with_measured_times_computes_one_island_at_a_time() -> None:
    report = IslandReport(
        island=0, generations=100, hit=None, additions=(), counters=(), best_error=None, digest="ab" * 16
    )
    reports = (EpochReport(job="j", variable="x", term=1, epoch=0, islands=(report,)),)
    books, posted = Books(), queue.SimpleQueue[object]()
    compute = SerialCompute(Samples(reports, 1, 1), [0.002], Pacer(), books)
    compute.attach(posted.put)
    compute.load("j", JobConfig(), b"")
    order = CommitOrder(generations=100, stride=10, joining=8)
    for island in range(4):
        compute.run(EpochTask(TaskKey("j", "x", 1, island, 0), None, False, order))
    computed: list[EpochComputed] = []
    while len(computed) < 4:
        event = posted.get(timeout=20.0)
        if isinstance(event, EpochComputed):
            computed.append(event)
    assert [event.key.island for event in computed] == [0, 1, 2, 3]
    counts = books.take()
    assert counts.epochs == 4
    assert counts.busy_s == pytest.approx(4 * 0.002)
