"""Everybody who takes part in a schedule: the real coordinator, store and workers on the simulated bus and disk.

They can be started, killed, dismissed; what they do is watched, and every event is taken down.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any, Final

from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.service.background.dependencies import Dependencies
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.retention import Retention
from atoll_core.config import JobConfig
from atoll_core.errors import StoreError
from atoll_core.wire.bus.interface import Event
from atoll_core.wire.messages.workers import EpochReport
from atoll_island_worker.session.events import Computed
from atoll_island_worker.worker import Worker
from tests.simulation.bus.network import SimulatedNetwork
from tests.simulation.bus.participant import SimulatedBus
from tests.simulation.harness.fault_schedule import Schedule, job_config
from tests.simulation.harness.simulated_cluster import prepare
from tests.simulation.harness.simulated_disk import CoordinatorDied, Disk, DiskStore
from tests.simulation.harness.stub_islands import StubCompute
from tests.task_pools import LocalPool

WAIT_S: Final = 60.0
"""How long a worker bears that the coordinator is away."""

SUPERVISED_S: Final = 2.0
"""After which a worker that ended with an error is started again."""

RETENTION: Final = Retention(age_s=90 * 86400.0, size_bytes=8_000_000)
"""Room for all that jobs of a schedule leave behind, but not for all that guests upload."""

USUAL_BACKGROUND_S: Final = 0.001
_MORNING: Final = datetime(2026, 1, 1, tzinfo=UTC)


@dataclass(frozen=True)
class Cast:
    """What the islands are made of: stubs that hash, or real ones."""

    compute: type[StubCompute] = StubCompute
    prepare: Callable[..., Any] = prepare
    job: Callable[[int], tuple[JobConfig, str]] = job_config


STUBS: Final = Cast()


@dataclass
class Participants:
    """All participants but the client.

    `wrong` is what must not happen and did, `story` what happened; `is_over`: nobody is struck any more, and somebody
    must be there to compute.
    """

    schedule: Schedule
    cast: Cast = STUBS
    wrong: list[str] = field(default_factory=list)
    story: list[str] = field(default_factory=list)
    workers: dict[str, Worker] = field(default_factory=dict)
    computes: dict[str, StubCompute] = field(default_factory=dict)
    buses: dict[str, SimulatedBus] = field(default_factory=dict)
    made: dict[tuple[object, ...], list[int]] = field(default_factory=dict)
    service: Service | None = None
    is_over: bool = False
    background_s: float = USUAL_BACKGROUND_S
    down_s: float = 0.0
    jumped_s: float = 0.0
    broken: int = 0

    def __post_init__(self) -> None:
        self.network = SimulatedNetwork(self.schedule.seed, self.schedule.plan)
        self.disk = Disk()
        self.history = hashlib.sha256()
        self._store: DiskStore | None = None
        self._written_at = 0.0
        self._processes = 0
        self.start_router()
        self.start_coordinator()
        for number in range(self.schedule.workers):
            self.start_worker(f"w{number}")

    def at(self, time_s: float, act: Callable[[], object]) -> None:
        """Let something happen."""
        self.network.at(time_s, lambda: (act(), None)[1])

    def note(self, sentence: str) -> None:
        """Add to the story."""
        self.story.append(f"{self.network.now:8.3f}  {sentence}")

    def start_router(self) -> None:
        """Start the router, if there is one of its own and it does not run."""
        if self.schedule.has_own_router and "router" not in self.network.participants:
            self.network.bus("router", is_router=True)

    # ----------------------------------------------------------------------------------------- service

    def start_coordinator(self) -> None:
        if self.service is not None:
            return
        bus = self.buses["coordinator"] = self.network.bus("coordinator", is_router=not self.schedule.has_own_router)
        store = self._store = self.disk.open(bus.spend, bus.now)
        pool = LocalPool(partial(self._do_later, bus, store))
        writer = partial(self._write_later, bus, store)
        dependencies = Dependencies(
            pool, self._time_of_day, self.cast.prepare, lambda *_: Refinement(), retention=RETENTION, writer=writer
        )
        service = self.service = Service(bus, store, dependencies=dependencies)
        self._watch_reports(service)

        def step(event: Event) -> None:
            self._take_down(bus, event)
            self._guarded(store, lambda: service.step(event))
            self._check_breakages(service)
            for job in service.controller.jobs.values():
                job.validate()

        bus.handle_with(step)
        self.note(f"the coordinator starts, incarnation {store.incarnation}")
        self._guarded(store, service.start)

    def _check_breakages(self, service: Service) -> None:
        """Nothing breaks, also where that would end one job only."""
        if service.controller.breakages.total > self.broken:
            self.wrong.append("something broke in the coordinator")
        self.broken = service.controller.breakages.total

    def _do_later(self, bus: SimulatedBus, store: DiskStore, work: Callable[[], None]) -> None:
        """Do background work of one incarnation, if that one is still alive then."""
        self.at(bus.now() + self.background_s, lambda: None if store.is_dead else self._guarded(store, work))

    def _write_later(self, bus: SimulatedBus, store: DiskStore, work: Callable[[], None]) -> None:
        """Do what one incarnation's writer is given, one piece after the other; the disk keeps nobody else busy."""

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
            for each in report.islands:
                key = (report.job, report.variable, report.term, each.island, report.epoch)
                if len(self.made.get(key, ())) != 1:
                    self.wrong.append(f"{key} was evolved by {self.made.get(key)} and accepted")

        service.controller.add_report = report  # type: ignore[method-assign]

    # ----------------------------------------------------------------------------------------- workers

    def start_worker(self, name: str, slowness: float = 1.0, lifetime_s: float | None = None) -> None:
        if name in self.workers:
            return
        bus = self.network.bus(name)
        self._processes += 1
        process, post = self._processes, bus.post
        compute = self.cast.compute(self.network, name, self.schedule.seed, self.schedule.slowness * slowness)

        def witnessed(item: object) -> None:
            if isinstance(item, Computed):
                key = item.key
                made = self.made.setdefault((key.job, key.variable, key.term, key.island, key.epoch), [])
                made.append(process)
            post(item)

        bus.post = witnessed  # type: ignore[method-assign]
        worker = Worker(bus, compute, name, WAIT_S, lifetime_s)

        def step(event: Event) -> None:
            self._take_down(bus, event)
            worker.step(event)
            worker.session.validate()
            if worker.exit_code is not None:
                self._worker_ended(name, worker)

        bus.handle_with(step)
        self.workers[name], self.computes[name], self.buses[name] = worker, compute, bus
        worker.start()

    def _worker_ended(self, name: str, worker: Worker) -> None:
        if self.workers.get(name) is not worker:
            return
        self.note(f"{name} ends with {worker.exit_code}: {worker.error}")
        self.dismiss(name)
        if worker.exit_code:
            self.at(self.network.now + SUPERVISED_S, lambda: self.start_worker(name))

    def dismiss(self, name: str) -> None:
        """Let a worker's process end in order."""
        self.computes.pop(name).close()
        self.workers.pop(name)
        self.buses.pop(name).close()
        if self.is_over:
            self.see_to_workers()

    def see_to_workers(self) -> None:
        """See that somebody is there to compute."""
        if not self.workers:
            self.start_worker("rescue")

    def crash(self, name: str) -> None:
        self.computes.pop(name).close()
        self.workers.pop(name)
        del self.buses[name]
        self.network.crash(name)

    def _take_down(self, bus: SimulatedBus, event: Event) -> None:
        self.history.update(f"{self.network.now:.9f} {bus.name} {type(event).__name__}\n".encode())

    def _time_of_day(self) -> str:
        return (_MORNING + timedelta(seconds=self.network.now + self.jumped_s)).isoformat(timespec="milliseconds")
