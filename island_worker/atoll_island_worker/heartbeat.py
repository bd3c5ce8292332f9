"""The heartbeat of a worker: its state, what it holds and computes, what failed, and its counters."""

from atoll_core.machine import usage
from atoll_core.wire.bus.metered_bus import MeteredBus
from atoll_core.wire.messages.views import Counters, WorkerState
from atoll_core.wire.messages.workers import Doing, WorkerStatus
from atoll_core.wire.rejects import Rejects
from atoll_island_worker.compute.compute_thread import ComputeThread
from atoll_island_worker.connection.connection import CoordinatorConnection
from atoll_island_worker.datasets import Datasets
from atoll_island_worker.session.worker_session import Session


def worker_status(
    connection: CoordinatorConnection,
    session: Session,
    datasets: Datasets,
    compute: ComputeThread,
    counters: Counters,
    detail: str,
) -> WorkerStatus | None:
    """Return the heartbeat; `detail` is what a person should know. None before the coordinator's welcome."""
    if connection.welcome is None:
        return None
    state, task = _state(connection, session), compute.current
    doing = Doing(job=task.job, variable=task.variable, island=task.island, epoch=task.epoch) if task else None
    return WorkerStatus(
        instance=connection.instance,
        incarnation=connection.welcome.incarnation,
        state=state,
        progress=compute.progress,
        holdings=session.assignment_statuses(),
        failures=session.failures(),
        jobs=tuple(dict.fromkeys((*session.jobs(), *datasets.jobs()))),
        detail=detail,
        doing=doing if state == "computing" else None,
        counters=counters,
    )


def counters_of(bus: MeteredBus, session: Session, rejects: Rejects) -> Counters:
    """Return what has gone through this process, and what it takes of its machine now."""
    return Counters(
        traffic=bus.traffic(),
        dropped=bus.dropped,
        refused=rejects.total,
        duplicates=session.duplicates,
        waited_s=session.waited_s,
        memory_bytes=usage.memory_bytes(),
        cpu_s=usage.cpu_s(),
    )


def _state(connection: CoordinatorConnection, session: Session) -> WorkerState:
    if connection.is_draining:
        return "leaving"
    return session.state() if connection.is_accepted else "compiling"
