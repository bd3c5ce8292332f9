"""What is simulated, counted and computed of a coordinator that holds many islands; measuring takes minutes."""

import json
import math
import os
import time
from dataclasses import replace
from pathlib import Path

import pytest

from atoll_core.config import PRESETS
from atoll_core.data.table import Table
from atoll_core.errors import AtollError
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire.messages.epochs import Addition, EpochReport, IslandReport, SliceCounters
from atoll_island_worker.session.interface import EpochComputed, EpochTask, JobReady, Snapshot, TaskKey
from benchmarks.harness.accounts import status
from benchmarks.operations import big_data as bigdata
from benchmarks.operations import scale, scaling
from benchmarks.operations.island_samples import Samples
from benchmarks.operations.scale import Account, Load, growth, load_of, loads_table, shape
from benchmarks.operations.simulated_islands import Books, PacedCompute, Pacer, pretended

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


@pytest.mark.parametrize("islands", [1, 7, 12, 1000 + 1])
def test_islands_that_make_no_archipelagos_are_refused(islands: int) -> None:
    with pytest.raises(AtollError, match="ask for a multiple"):
        shape(islands)


def test_the_measured_signals_are_a_table() -> None:
    table = scale.signals(3)
    assert table.names == ("t", "v0", "v1", "v2")
    assert Table.from_bytes(table.to_bytes()).names == table.names


def test_samples_come_back_from_their_file_and_go_round(samples: Samples, tmp_path: Path) -> None:
    again = Samples.load(samples.save(tmp_path))
    assert again == samples
    programs = [again.report(epoch, 5).additions[0].program[0] for epoch in range(6)]
    assert programs == [0, 1, 2, 1, 2, 1], "the first epoch is not like the others"


def test_a_pretended_report_is_a_real_one_of_another_island(samples: Samples) -> None:
    pretended_report = pretended(samples, 1, 7, "a")
    assert (pretended_report.island, pretended_report.counters) == (7, samples.report(1, 7).counters)
    assert pretended_report.additions[0].error == pytest.approx(0.5, rel=0.1)
    assert pretended_report.digest != pretended(samples, 1, 7, "b").digest


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


def test_an_island_that_is_held_gives_its_state_and_nothing_else(samples: Samples) -> None:
    said: list[object] = []
    compute = PacedCompute(samples, 0.0, Pacer(), Books())
    compute.attach(said.append)
    compute.load("j", PRESETS["default"], b"")
    order = CommitOrder(generations=10, stride=10, joining=8)
    compute.run(EpochTask(TaskKey("j", "x", 1, 2, 1), {}, False, order, takes_snapshot=True, is_at_barrier=True))
    time.sleep(0.05)
    assert isinstance(said[-1], Snapshot)
    assert said[-1].is_at_barrier


def test_puts_are_counted_by_kind() -> None:
    books = Books()
    books.note_put("atoll/r/worker/a/report", 10)
    books.note_put("atoll/r/worker/a/to/b", 20)
    books.note_put("atoll/r/worker/a/status", 30)
    counts = books.take()
    assert (counts.reports, counts.report_bytes, counts.mails, counts.mail_bytes) == (1, 10, 1, 20)
    assert books.take().reports == 0


def test_the_account_of_a_process_is_the_systems() -> None:
    mine = Account.of(os.getpid())
    assert mine.resident > 2**20
    assert 0.0 < mine.loop_s <= mine.cpu_s + 0.02


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


def test_a_large_table_has_the_size_that_was_asked_for(tmp_path: Path) -> None:
    rows = bigdata.write_data(tmp_path / "big.csv", 1)
    lines = (tmp_path / "big.csv").read_text().splitlines()
    assert len(lines) == rows + 1
    assert rows * len(lines[0].split(",")) * 8 == pytest.approx(1e6, rel=1e-3)


def test_the_most_memory_is_what_the_system_says(tmp_path: Path) -> None:
    assert status(os.getpid(), bigdata.PEAK) > 2**20
    (tmp_path / "7").mkdir()
    (tmp_path / "7" / "status").write_text("Name: x\n")
    with pytest.raises(AtollError, match="does not say"):
        status(7, bigdata.PEAK, tmp_path)


def test_figures_can_be_written_as_json() -> None:
    assert json.dumps({"microseconds": LOAD.microseconds})
    assert math.isfinite(LOAD.microseconds)
    options = scaling.main.parser.parse_args(["--simulated-islands", "16,64"])
    assert options.simulated_islands == [16, 64]
