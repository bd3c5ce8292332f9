"""What a worker's heartbeat says: what it holds and computes, what went through it, what it takes of its machine."""

from atoll.machine import usage
from atoll.wire.bus.metered_bus import MeteredBus
from atoll.wire.messages.views import Counters
from atoll.wire.messages.workers import Doing
from atoll.wire.rejects import Rejects
from atoll_island_worker.session.session import Session
from atoll_island_worker.session.tasks import TaskKey


def doing(key: TaskKey | None) -> Doing | None:
    """Return what the compute thread is at."""
    if key is None:
        return None
    return Doing(job=key.job, variable=key.variable, island=key.island, epoch=key.epoch)


def counters(bus: MeteredBus, session: Session, rejects: Rejects) -> Counters:
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
