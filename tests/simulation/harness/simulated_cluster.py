"""A whole Atoll in virtual time: coordinator, workers and a client on the simulated bus; only the islands are stubs.

After every step of a participant its invariants are checked.
"""

import contextlib
import json
import pickle
from collections.abc import Callable
from typing import Any, Final, TypeVar

import numpy as np

from atoll.client.client import Client
from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.pools import LawsByGroup, Pools
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.tasks.background import Dependencies
from atoll_coordinator.tasks.preparing import Preparer
from atoll_coordinator.tasks.refining import Refiner
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, Target
from atoll_core.errors import UnreachableError
from atoll_core.wire.bus.interface import Event
from atoll_core.wire.messages.views import FINAL_STATES, JobView
from atoll_island_worker.worker import Worker
from tests.simulation.bus.fault_plan import Plan
from tests.simulation.bus.network import SimulatedNetwork
from tests.simulation.bus.participant import SimulatedBus
from tests.simulation.harness.stub_islands import StubCompute
from tests.simulation.harness.stub_tasks import USUAL_S, Fate, StubTasks

LIMIT_S = 600.0
WAIT_S: Final = 60.0
"""How long a worker bears that the coordinator is away."""
T = TypeVar("T")


def prepare(table: bytes, config: JobConfig) -> Preparation:
    """Return a dataset of the variables that the table's text lists."""
    names = tuple(table.decode().split(","))
    values = np.linspace(0.0, 1.0, 20)
    targets = tuple(Target(name, f"d{name}/dt", values, 0.0, 0.3) for name in names)
    return Preparation(Dataset(names, np.stack([values] * len(names)), targets, {name: name for name in names}))


_REFINEMENTS: Final[dict[bytes, Refinement]] = {}


def refine_once(
    preparation: Preparation, config: JobConfig, pools: Pools, deadline: Deadline, laws: LawsByGroup | None
) -> Refinement:
    """Return what `refine_all` does, kept by its arguments: most worlds of a seed end with the same pools."""
    if deadline.seconds is not None:
        return refine_all(preparation, config, pools, deadline, laws)
    key = pickle.dumps((preparation, config, pools, laws))
    if key not in _REFINEMENTS:
        _REFINEMENTS[key] = refine_all(preparation, config, pools, deadline, laws)
    return _REFINEMENTS[key]


class Programs:
    """Coordinator, workers and perhaps a router on a simulated bus, each watched at every event that it takes.

    They can be started and crashed. `start_coordinator` is for those who have a store and dependencies to give.
    """

    def __init__(
        self, seed: int, plan: Plan | None, has_own_router: bool, compute: type[StubCompute], expected: int = 1
    ) -> None:
        self.seed = seed
        self.has_own_router = has_own_router
        self.compute = compute
        self.expected = expected
        self.network = SimulatedNetwork(seed, plan)
        self.workers: dict[str, Worker] = {}
        self.computes: dict[str, StubCompute] = {}
        self.tasks: dict[str, StubTasks] = {}
        self.preparer: Preparer = prepare
        self.refiner: Refiner = refine_once
        self.background_s = USUAL_S
        self.fate = Fate()
        self.start_router()

    def at(self, time_s: float, act: Callable[[], object]) -> None:
        """Let something happen."""
        self.network.at(time_s, lambda: (act(), None)[1])

    def start_router(self) -> None:
        """Start the router, if there is one of its own and it does not run."""
        if self.has_own_router and "router" not in self.network.participants:
            self.network.bus("router", is_router=True)

    def coordinator_bus(self) -> SimulatedBus:
        return self.network.bus("coordinator", is_router=not self.has_own_router)

    def serve(self, bus: SimulatedBus, store: Any, dependencies: Dependencies) -> Service:
        """Return a coordinator that is about to start."""
        service = Service(bus, store, expected_workers=self.expected, dependencies=dependencies)
        service.controller.tasks.help_after_s = 0.0  # tasks take milliseconds here

        def step(event: Event) -> None:
            self.step_service(bus, event, service, store)
            for job in service.controller.jobs.values():
                job.validate()
            service.controller.tasks.table.validate()

        bus.handle_with(step)
        return service

    def step_service(self, bus: SimulatedBus, event: Event, service: Service, store: Any) -> None:
        service.step(event)

    def start_worker(self, name: str, slowness: float = 1.0, lifetime_s: float | None = None, **options: Any) -> Worker:
        """Start a worker; `slowness` and `options` are those of its islands."""
        bus = self.network.bus(name)
        compute = self.compute(self.network, name, self.seed, slowness, **options)
        self.watch_worker(name, bus, compute)
        tasks = self.tasks[name] = StubTasks(
            self.network, self.preparer, self.refiner, self.task_seconds, self.fate,
            lambda: self.die_in_task(name) if self.tasks.get(name) is tasks else None,
        )  # fmt: skip
        worker = Worker(bus, compute, name, WAIT_S, lifetime_s, task_process=tasks)

        def step(event: Event) -> None:
            self.step_worker(bus, event, worker)
            worker.session.validate()
            if worker.exit_code is not None:
                self.end_worker(name, worker, bus, compute)

        bus.handle_with(step)
        self.workers[name], self.computes[name] = worker, compute
        worker.start()
        return worker

    def task_seconds(self) -> float:
        """Return how long a task takes now."""
        return self.background_s

    def watch_worker(self, name: str, bus: SimulatedBus, compute: StubCompute) -> None:
        """Get ready for a worker that is about to start."""
        compute.kill = lambda: self.crash(name) if self.computes.get(name) is compute else None

    def step_worker(self, bus: SimulatedBus, event: Event, worker: Worker) -> None:
        worker.step(event)

    def end_worker(self, name: str, worker: Worker, bus: SimulatedBus, compute: StubCompute) -> None:
        """Close what a worker has that has ended; it can still be looked at."""
        self.tasks.pop(name).stop()
        if not bus.closed:
            compute.close()
            bus.close()

    def die_in_task(self, name: str) -> None:
        """Let a worker die of what its task does."""
        self.crash(name)

    def crash(self, name: str) -> None:
        """Let a worker die without a word."""
        self.computes.pop(name).close()
        self.tasks.pop(name).stop()
        self.workers.pop(name)
        self.network.crash(name)


class World(Programs):
    """The programs and a client, on a store that never fails, and what a test does with them."""

    def __init__(
        self,
        workers: int = 2,
        seed: int = 0,
        plan: Plan | None = None,
        expected: int = 1,
        compute: type[StubCompute] = StubCompute,
        prepare: Preparer = prepare,
        refiner: Refiner = refine_once,
        has_own_router: bool = False,
        **options: Any,
    ) -> None:
        """`options` are those of the workers' `compute`."""
        super().__init__(seed, plan, has_own_router, compute, expected)
        self.preparer = prepare
        self.refiner = refiner
        self.store = Store.open(None, lambda: self.network.now)
        self.service = self.start_service()
        for index in range(workers):
            self.start_worker(f"w{index}", **options)
        self.client = Client(self.network.bus("client"), "simulated")

    def close(self) -> None:
        self.store.close()

    def clock(self) -> str:
        return f"2026-01-01T00:00:{self.network.now:09.3f}"

    def start_service(self) -> Service:
        dependencies = Dependencies(self.clock, background=lambda work: work())
        service = self.serve(self.coordinator_bus(), self.store, dependencies)
        service.start()
        return service

    def submit(self, config: JobConfig, variables: str = "x,y", job: str = "job", priority: int = 0) -> str:
        """Submit a job through the client, which tries again whatever is lost."""
        table = patiently(lambda: self.client.upload(variables.encode()))
        patiently(lambda: self.client.submit(job, "a simulated job", config, table, priority))
        return job

    def finish(self, job: str = "job", limit_s: float = LIMIT_S) -> JobView:
        """Follow a job to its end."""
        end = self.network.now + limit_s
        while (view := patiently(lambda: self.client.status(job))).state not in FINAL_STATES:
            assert self.network.now < end, f"job {job} has not ended after {limit_s} s: {view}"
            self.client.pause(0.5)
        return view

    def result(self, job: str = "job") -> dict[str, Any]:
        return patiently(lambda: self.client.result(job))

    def run(self, config: JobConfig, variables: str = "x,y") -> dict[str, Any]:
        """Submit, follow, return the result."""
        self.submit(config, variables)
        view = self.finish()
        assert view.state == "done", view
        return self.result()


def patiently(ask: Callable[[], T]) -> T:
    """Ask again what got lost more often than a client bears; on the real network nothing is lost that often."""
    for _ in range(10):
        with contextlib.suppress(UnreachableError):
            return ask()
    return ask()


def bus_of(world: World, name: str) -> SimulatedBus:
    """Return a new participant's bus, for a stranger."""
    return world.network.bus(name)


def comparable(result: dict[str, Any]) -> str:
    """Return what of a result must not depend on workers, faults and time."""
    equations = [{k: v for k, v in equation.items() if k != "seconds"} for equation in result["equations"]]
    return json.dumps({"equations": equations, "digest": result["digest"], "points": result["point_evaluations"]})
