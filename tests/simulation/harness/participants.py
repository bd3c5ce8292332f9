"""Everybody who takes part in a schedule: the real coordinator, store and workers on the simulated bus and disk.

They can be started, killed, dismissed; what they do is watched, and every event is taken down.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any, Final

from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.retention import Retention
from atoll_coordinator.service.tasks.background import Dependencies
from atoll_core.config import JobConfig
from atoll_core.errors import StoreError
from atoll_core.wire.bus.interface import Event
from atoll_core.wire.messages.epochs import EpochReport
from atoll_island_worker.session.interface import EpochComputed
from atoll_island_worker.worker import Worker
from tests.simulation.bus.participant import SimulatedBus
from tests.simulation.harness.fault_schedule import Schedule, job_config
from tests.simulation.harness.simulated_cluster import Programs, prepare
from tests.simulation.harness.simulated_disk import CoordinatorDied, Disk, DiskStore
from tests.simulation.harness.stub_islands import StubCompute
from tests.simulation.harness.stub_tasks import USUAL_S

SUPERVISED_S: Final = 2.0
"""After which a worker that ended with an error is started again."""

RETENTION: Final = Retention(age_s=90 * 86400.0, size_bytes=8_000_000)
"""Room for all that jobs of a schedule leave behind, but not for all that guests upload."""

USUAL_BACKGROUND_S: Final = USUAL_S
_MORNING: Final = datetime(2026, 1, 1, tzinfo=UTC)


@dataclass(frozen=True)
class Cast:
    """What the islands are made of: stubs that hash, or real ones."""

    compute: type[StubCompute] = StubCompute
    prepare: Callable[..., Any] = prepare
    job: Callable[[int], tuple[JobConfig, str]] = job_config


STUBS: Final = Cast()


class Participants(Programs):
    """All participants but the client.

    `wrong` is what must not happen and did, `story` what happened; `is_over`: nobody is struck any more, and somebody
    must be there to compute.
    """

    def __init__(self, schedule: Schedule, cast: Cast = STUBS) -> None:
        self.schedule = schedule
        self.cast = cast
        self.wrong: list[str] = []
        self.story: list[str] = []
        self.buses: dict[str, SimulatedBus] = {}
        self.made: dict[tuple[object, ...], list[int]] = {}
        self.service: Service | None = None
        self.is_over = False
        self.background_s = USUAL_BACKGROUND_S
        self.down_s = 0.0
        self.jumped_s = 0.0
        self.broken = 0
        self.disk = Disk()
        self.history = hashlib.sha256()
        self._store: DiskStore | None = None
        self._written_at = 0.0
        self._processes = 0
        super().__init__(schedule.seed, schedule.plan, schedule.has_own_router, cast.compute)
        self.preparer, self.refiner = cast.prepare, lambda *_: Refinement()
        self.start_coordinator()
        for number in range(schedule.workers):
            self.start_worker(f"w{number}")

    def note(self, sentence: str) -> None:
        """Add to the story."""
        self.story.append(f"{self.network.now:8.3f}  {sentence}")

    # ----------------------------------------------------------------------------------------- service

    def start_coordinator(self) -> None:
        if self.service is not None:
            return
        bus = self.buses["coordinator"] = self.coordinator_bus()
        store = self._store = self.disk.open(bus.spend, bus.now)
        background = partial(self._write_later, bus, store)
        dependencies = Dependencies(self._time_of_day, RETENTION, background)
        service = self.service = self.serve(bus, store, dependencies)
        self._watch_reports(service)
        self.note(f"the coordinator starts, incarnation {store.incarnation}")
        self._guarded(store, service.start)

    def step_service(self, bus: SimulatedBus, event: Event, service: Service, store: DiskStore) -> None:
        """Nothing breaks, also where that would end one job only."""
        self._take_down(bus, event)
        self._guarded(store, lambda: service.step(event))
        if service.controller.breakages.total > self.broken:
            self.wrong.append("something broke in the coordinator")
        self.broken = service.controller.breakages.total

    def _write_later(self, bus: SimulatedBus, store: DiskStore, work: Callable[[], None]) -> None:
        """Do what one incarnation's background thread does, piece by piece; the disk keeps nobody else busy."""

        def write() -> None:
            if not store.is_dead:
                slow_s, self.disk.slow_s = self.disk.slow_s, 0.0
                self._guarded(store, work)
                self.disk.slow_s = slow_s

        self._written_at = max(self._written_at, bus.now()) + self.background_s + self.disk.slow_s
        self.at(self._written_at, write)

    def _guarded(self, store: DiskStore, act: Callable[[], None]) -> None:
        try:
            act()
        except CoordinatorDied:
            self.note(f"the coordinator dies at commit {self.disk.commits}")
            self.kill_coordinator(self.down_s)
        except StoreError as error:
            if not self.disk.is_full:
                raise
            self.note(f"the coordinator ends: {error}")
            self.kill_coordinator(SUPERVISED_S)

    def kill_coordinator(self, for_s: float) -> None:
        if self.service is None or self._store is None:
            return
        self._store.is_dead, self.service, self.broken = True, None, 0
        self.network.crash("coordinator")
        self.at(self.network.now + for_s, self.start_coordinator)

    def _watch_reports(self, service: Service) -> None:
        """Have every report that is accepted compared with who computed it."""
        take = service.controller.add_report

        def report(worker: str, report: EpochReport, now: float) -> None:
            job = service.controller.jobs.get(report.job)
            archipelago = job.archipelagos.get(report.variable) if job is not None else None
            placement = archipelago.placement if archipelago is not None and archipelago.cut is None else None
            take(worker, report, now)
            if placement is None or placement.term != report.term:
                return
            for island in report.islands:
                key = (report.job, report.variable, report.term, island.island, report.epoch)
                if len(self.made.get(key, ())) != 1:
                    self.wrong.append(f"{key} was evolved by {self.made.get(key)} and accepted")

        service.controller.add_report = report  # type: ignore[method-assign]

    # ----------------------------------------------------------------------------------------- workers

    def start_worker(self, name: str, slowness: float = 1.0, lifetime_s: float | None = None, **options: Any) -> Worker:
        """Start a worker, unless it runs."""
        if name in self.workers:
            return self.workers[name]
        return super().start_worker(name, self.schedule.slowness * slowness, lifetime_s, **options)

    def watch_worker(self, name: str, bus: SimulatedBus, compute: StubCompute) -> None:
        """Take down which process evolves what."""
        self._processes += 1
        process, post = self._processes, bus.post

        def witnessed(item: object) -> None:
            if isinstance(item, EpochComputed):
                key = item.key
                made = self.made.setdefault((key.job, key.variable, key.term, key.island, key.epoch), [])
                made.append(process)
            post(item)

        bus.post = witnessed  # type: ignore[method-assign]
        self.buses[name] = bus

    def step_worker(self, bus: SimulatedBus, event: Event, worker: Worker) -> None:
        self._take_down(bus, event)
        worker.step(event)

    def end_worker(self, name: str, worker: Worker, bus: SimulatedBus, compute: StubCompute) -> None:
        """Let it go, and start it again if it failed."""
        if self.workers.get(name) is not worker:
            return
        self.note(f"{name} ends with {worker.exit_code}: {worker.error}")
        self.dismiss(name)
        if worker.exit_code:
            self.at(self.network.now + SUPERVISED_S, lambda: self.start_worker(name))

    def dismiss(self, name: str) -> None:
        """Let a worker's process end in order."""
        self.computes.pop(name).close()
        self.tasks.pop(name).stop()
        self.workers.pop(name)
        self.buses.pop(name).close()
        if self.is_over:
            self.see_to_workers()

    def die_in_task(self, name: str) -> None:
        self.note(f"{name} dies in the middle of a task, and is started again")
        super().die_in_task(name)
        self.at(self.network.now + SUPERVISED_S, lambda: self.start_worker(name))

    def crash(self, name: str) -> None:
        del self.buses[name]
        super().crash(name)
        if self.is_over:
            self.see_to_workers()

    def see_to_workers(self) -> None:
        """See that somebody is there to compute."""
        if not self.workers:
            self.start_worker("rescue")

    def _take_down(self, bus: SimulatedBus, event: Event) -> None:
        self.history.update(f"{self.network.now:.9f} {bus.name} {type(event).__name__}\n".encode())

    def _time_of_day(self) -> str:
        return (_MORNING + timedelta(seconds=self.network.now + self.jumped_s)).isoformat(timespec="milliseconds")
