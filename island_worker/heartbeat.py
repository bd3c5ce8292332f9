"""What a worker's heartbeat says: what it holds and computes, what went through it, what it takes of its machine."""

from common import usage
from common.wire.messages import Doing
from common.wire.metered_bus import MeteredBus
from common.wire.rejects import Rejects
from common.wire.views import Counters
from island_worker.session import Session
from island_worker.tasks import TaskKey


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
