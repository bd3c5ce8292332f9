"""What real islands send: reports, bytes of an emigrant and of a snapshot; and how many seconds an epoch takes."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.service.jobs.job import commit_order_of
from atoll_coordinator.tasks.defaults import resolve
from atoll_core.data.table import Table
from atoll_core.wire.codec import dataset_to_bytes, decode, encode
from atoll_core.wire.messages.epochs import EpochReport, IslandReport, Reports
from atoll_island_worker.compute.compute_thread import Engine
from atoll_island_worker.session.interface import EpochComputed, EpochTask, TaskKey
from benchmarks.harness.jobs import UNMET, configured
from benchmarks.harness.systems import table_of, trajectories

SYSTEM: Final = "predator_prey"
ISLANDS: Final = 8
EPOCHS: Final = 4
_JOB: Final = "sample"


@dataclass(frozen=True)
class Samples:
    """Reports by epoch and island; bytes of an emigrant, with its share of what a block has besides; of a snapshot."""

    reports: tuple[EpochReport, ...]
    emigrant: int
    snapshot: int

    def report(self, epoch: int, island: int) -> IslandReport:
        """Return a real report of that epoch, or, once the samples are used up, of one of those after the first."""
        last = len(self.reports) - 1
        reports = self.reports[epoch if epoch <= last else 1 + (epoch - 1) % last].islands
        return reports[island % len(reports)]

    def save(self, folder: Path) -> Path:
        """Write them to a file and return it."""
        file = folder / f"samples-{self.emigrant}-{self.snapshot}"
        file.write_bytes(encode(Reports(reports=self.reports)))
        return file

    @classmethod
    def load(cls, file: Path) -> "Samples":
        """Return what `save` wrote."""
        _, emigrant, snapshot = file.name.split("-")
        return cls(decode(file.read_bytes(), Reports).reports, int(emigrant), int(snapshot))


def sampled(noise: float = 0.0) -> Samples:
    """Compute some epochs of an archipelago, with measurements to which noise of that share of sd was added."""
    config = configured(budget={"target_error": UNMET}, islands=ISLANDS)
    prepared = prepare(table_of(trajectories(SYSTEM, 0.1, 0, noise)), config)
    config = resolve(config, prepared.dataset)
    engine = Engine()
    engine.load(_JOB, config, dataset_to_bytes(prepared.dataset))
    variable, commit_order = prepared.dataset.targets[0].variable, commit_order_of(config)
    blocks: Mapping[int, Mapping[int, bytes] | None] = dict.fromkeys(range(ISLANDS))
    reports, done = [], []
    for epoch in range(EPOCHS):
        keys = [TaskKey(_JOB, variable, 1, island, epoch) for island in range(ISLANDS)]
        done = [_computed(engine, EpochTask(key, blocks[key.island], False, commit_order)) for key in keys]
        blocks = {
            to: {at: computed.emigrants[to] for at, computed in enumerate(done) if to in computed.emigrants}
            for to in blocks
        }
        islands = tuple(computed.report for computed in done)
        reports.append(EpochReport(job=_JOB, variable=variable, term=1, epoch=epoch, islands=islands))
    sent = sum(len(block) for computed in done for block in computed.emigrants.values())
    key = TaskKey(_JOB, variable, 1, 0, EPOCHS)
    last = engine.begin(EpochTask(key, blocks[0], False, commit_order, takes_snapshot=True))
    return Samples(tuple(reports), round(sent / (ISLANDS * config.evolution.population)), len(last.snapshot or b""))


def epoch_seconds(table: Table, islands: int, number: int) -> tuple[list[float], list[float]]:
    """Measure epochs of one equation with so many islands: processor seconds of first epochs, and of second epochs.

    All islands compute their first epoch; `number` of them continue with the immigrants from all others. The seconds
    include what an island reads and writes: its immigrants, emigrants and report.
    """
    config = configured(budget={"target_error": UNMET}, islands=islands)
    prepared = prepare(table, config)
    config = resolve(config, prepared.dataset)
    engine = Engine()
    engine.load(_JOB, config, dataset_to_bytes(prepared.dataset))
    variable, commit_order = prepared.dataset.targets[0].variable, commit_order_of(config)

    def timed(island: int, epoch: int, blocks: Mapping[int, bytes] | None) -> tuple[float, EpochComputed]:
        began = time.process_time()
        key = TaskKey(_JOB, variable, 1, island, epoch)
        computed = _computed(engine, EpochTask(key, blocks, False, commit_order))
        return time.process_time() - began, computed

    timed(0, 0, None)  # loads the kernels
    first = [timed(island, 0, None) for island in range(islands)]
    second = []
    for island in range(0, islands, max(1, islands // number)):
        sent = {at: computed.emigrants for at, (_, computed) in enumerate(first) if island in computed.emigrants}
        second.append(timed(island, 1, {at: emigrants[island] for at, emigrants in sent.items()})[0])
    return [seconds for seconds, _ in first], second


def _computed(engine: Engine, task: EpochTask) -> EpochComputed:
    work = engine.begin(task)
    while not work.advance():
        pass
    return work.computed()
