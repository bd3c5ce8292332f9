"""Task processes that run tasks on a thread of this process, for tests whose islands only hash."""

import threading

from tests.simulation.harness.simulated_cluster import prepare, refine_once
from tests.simulation.harness.stub_tasks import StubTasks


class _AtOnce:
    """Does on a thread of its own what is to happen later."""

    now = 0.0

    def at(self, time_s: float, action: object) -> None:
        threading.Thread(target=action, daemon=True).start()  # type: ignore[arg-type]


class LocalTasks(StubTasks):
    """The tasks of the simulated cluster, in real time."""

    def __init__(self) -> None:
        super().__init__(_AtOnce(), prepare, refine_once)  # type: ignore[arg-type]
