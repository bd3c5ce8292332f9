"""A coordinator whose background thread can be held, so that results and equations are written later."""

from collections.abc import Callable
from typing import Any

from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.tasks.background import Dependencies
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World

LONG = short_job(1, islands=3, max_epochs=10**6, stagnation=10**6)
SHORT = short_job(1, islands=3, max_epochs=6, stagnation=10**6)


class Held(World):
    """A world whose background thread does nothing while it `is_held`; a coordinator's work dies with it."""

    def __init__(self, **options: Any) -> None:
        self.is_held = False
        self.waiting: list[Callable[[], None]] = []
        super().__init__(slowness=10.0, **options)

    def start_service(self) -> Service:
        self.waiting.clear()
        dependencies = Dependencies(self.clock, background=self.take)
        service = self.serve(self.coordinator_bus(), self.store, dependencies)
        service.start()
        return service

    def take(self, work: Callable[[], None]) -> None:
        if self.is_held:
            self.waiting.append(work)
        else:
            work()

    def release(self) -> None:
        self.is_held = False
        while self.waiting:
            self.waiting.pop(0)()

    def restart(self) -> None:
        """Kill the coordinator and start it again; what its background had not done is never done."""
        self.network.crash("coordinator")
        self.waiting.clear()
        self.is_held = False
        self.service = self.start_service()

    def search(self, job: str = "job") -> None:
        """Submit a long job and wait until each of its equations has a checkpoint."""
        self.submit(LONG, job=job)
        while len(self.store.checkpoints(job)) < 2:
            self.client.pause(0.5)
