"""What is simulated, counted and computed of a coordinator that holds many islands; measuring takes minutes."""

import time
from dataclasses import replace
from pathlib import Path

import pytest

from atoll_core.config import PRESETS
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire.messages.epochs import Addition, EpochReport, IslandReport, SliceCounters
from atoll_island_worker.session.interface import EpochComputed, EpochTask, JobReady, Snapshot, TaskKey
from benchmarks.operations import scale
from benchmarks.operations.island_samples import Samples
from benchmarks.operations.scale import Account, Load, growth, load_of, loads_table, shape
from benchmarks.operations.simulated_islands import Books, PacedCompute, Pacer

LOAD = Load(64, 8, 8, 10.0, 1.0, 60.0, 400.0, 2e6, 1e5, 0.05, 0.03, 200 * 2**20, 5.0, 50.0, 1.0)


def report(epoch: int, island: int) -> IslandReport:
    addition = Addition(complexity=3, error=0.5, mse=0.25, generation=10, program=bytes([epoch]))
    counters = (SliceCounters(generation=10, evaluations={"offspring": 5}),)
    return IslandReport(
        island=island, generations=10, hit=None, additions=(addition,), counters=counters, best_error=0.5,
        digest="0" * 16,
    )  # fmt: skip


@pytest.fixture
def samples() -> Samples:
    epochs = [(report(epoch, 0), report(epoch, 1)) for epoch in range(3)]
    reports = tuple(
        EpochReport(job="j", variable="x", term=1, epoch=epoch, islands=event) for epoch, event in enumerate(epochs)
    )
    return Samples(reports, emigrant=600, snapshot=5000)


@pytest.mark.parametrize(
    ("islands", "jobs", "variables"), [(16, 1, 2), (64, 1, 8), (256, 2, 16), (512, 4, 16), (1024, 4, 32)]
)
def test_islands_are_those_of_jobs_and_variables(islands: int, jobs: int, variables: int) -> None:
    assert shape(islands) == (jobs, variables)
    assert jobs * variables * scale.ISLANDS_EACH == islands


def test_samples_come_back_from_their_file_and_go_round(samples: Samples, tmp_path: Path) -> None:
    again = Samples.load(samples.save(tmp_path))
    assert again == samples
    programs = [again.report(epoch, 5).additions[0].program[0] for epoch in range(6)]
    assert programs == [0, 1, 2, 1, 2, 1], "the first epoch is not like the others"


def test_an_island_that_pretends_takes_its_time_and_sends_what_is_expected(samples: Samples) -> None:
    said: list[object] = []
    books = Books()
    compute = PacedCompute(samples, 0.01, Pacer(), books)
    compute.attach(said.append)
    compute.load("j", PRESETS["default"], b"")
    order = CommitOrder(generations=10, stride=10, joining=8)
    key = TaskKey("j", "x", 1, 2, 1)
    compute.run(EpochTask(key, {}, False, order, takes_snapshot=True))
    end = time.monotonic() + 30.0
    while not isinstance(said[-1], EpochComputed):
        assert time.monotonic() < end
        time.sleep(0.005)
    assert JobReady("j") in said
    (snapshot,) = [event for event in said if isinstance(event, Snapshot)]
    assert len(snapshot.data) == 5000
    computed = said[-1]
    assert isinstance(computed, EpochComputed)
    assert computed.senders == frozenset(range(8)) - {2}
    assert sum(map(len, computed.emigrants.values())) == 64 * 600
    compute.run(EpochTask(replace(key, epoch=2), {}, False, order))
    counts = books.take()
    assert (counts.epochs, len(counts.waits)) == (1, 1)


def test_a_load_is_what_happened_between_two_accounts() -> None:
    lines = [
        {"epochs": 30, "reports": 10, "report_bytes": 100, "mails": 20, "mail_bytes": 400, "waits": [1.0, 3.0]}
    ] * 2  # fmt: skip
    load = load_of(6, 2, 1, (Account(1.0, 0.5, 100, 10.0), Account(2.0, 1.0, 200, 20.0)), lines)
    assert (load.epochs, load.reports, load.mails) == (1.0, 2.0, 4.0)
    assert (load.cores, load.loop, load.resident) == (0.1, 0.05, 200)
    assert (load.wait_50, load.microseconds) == (2.0, pytest.approx(1e6 * 0.1 / 6))
    assert "6" in loads_table([load])


def test_growth_is_the_power_of_the_number_of_islands() -> None:
    assert growth([LOAD]) is None
    several = [replace(LOAD, islands=64 * n, cores=0.05 * n**1.5) for n in (1, 4, 16)]
    assert growth(several) == pytest.approx(1.5)
    assert growth([replace(LOAD, epochs=0.5), replace(LOAD, islands=128, cores=0.2)]) == pytest.approx(1.0)
