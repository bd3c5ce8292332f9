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
from atoll_coordinator.model.refinement import LawsByGroup, Pools, Refinement
from atoll_coordinator.service.background.dependencies import Dependencies
from atoll_coordinator.service.background.job_tasks import Preparer, Refiner
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.store import Store
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, Target
from atoll_core.errors import UnreachableError
from atoll_core.wire.bus.interface import Event
from atoll_core.wire.messages.views import FINAL_STATES, JobView
from atoll_island_worker.worker import Worker
from tests.simulation.bus.faults import Plan
from tests.simulation.bus.network import SimulatedNetwork
from tests.simulation.bus.participant import SimulatedBus
from tests.simulation.harness.stub_islands import StubCompute
from tests.task_pools import LocalPool, call

LIMIT_S = 600.0
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


class World:
    """Everything that takes part, and what a test does with it."""

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
        self.has_own_router = has_own_router
        self.seed = seed
        self.compute = compute
        self.prepare = prepare
        self.refiner = refiner
        self.network = SimulatedNetwork(seed, plan)
        if has_own_router:
            self.network.bus("router", is_router=True)
        self.store = Store.open(None)
        self.expected = expected
        self.workers: dict[str, Worker] = {}
        self.computes: dict[str, StubCompute] = {}
        self.service = self.start_service()
        for index in range(workers):
            self.start_worker(f"w{index}", **options)
        self.client = Client(self.network.bus("client"), "simulated")

    def close(self) -> None:
        self.store.close()

    def clock(self) -> str:
        return f"2026-01-01T00:00:{self.network.now:09.3f}"

    def start_service(self) -> Service:
        bus = self.network.bus("coordinator", is_router=not self.has_own_router)
        dependencies = Dependencies(LocalPool(), self.clock, self.prepare, self.refiner, writer=call)
        service = Service(bus, self.store, expected_workers=self.expected, dependencies=dependencies)

        def step(event: Event) -> None:
            service.step(event)
            for job in service.controller.jobs.values():
                job.validate()

        bus.handle_with(step)
        service.start()
        return service

    def start_worker(self, name: str, **options: Any) -> Worker:
        bus = self.network.bus(name)
        stub = self.compute(self.network, name, self.seed, **options)
        stub.kill = lambda: self.crash(name) if self.computes.get(name) is stub else None
        worker = Worker(bus, stub, name, wait_s=60.0)

        def step(event: Event) -> None:
            worker.step(event)
            worker.session.validate()
            if worker.exit_code is not None and not bus.closed:
                stub.close()
                bus.close()

        bus.handle_with(step)
        worker.start()
        self.workers[name], self.computes[name] = worker, stub
        return worker

    def crash(self, name: str) -> None:
        self.computes.pop(name).close()
        self.workers.pop(name)
        self.network.crash(name)

    def at(self, time_s: float, action: Callable[[], object]) -> None:
        self.network.at(time_s, lambda: (action(), None)[1])

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
    equations = [{k: v for k, v in each.items() if k != "seconds"} for each in result["equations"]]
    return json.dumps({"equations": equations, "digest": result["digest"], "points": result["point_evaluations"]})
