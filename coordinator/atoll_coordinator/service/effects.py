"""What a controller says, asks and has done: how it reaches workers, and what takes long."""

from typing import Protocol

from atoll.config import JobConfig
from atoll.wire.messages.workers import (
    Close,
    CloseJob,
    Commit,
    Introduce,
    JobAnnouncement,
    Placements,
    PullReports,
    PullStates,
    Shutdown,
)
from atoll_coordinator.model.refinement import Pools
from atoll_coordinator.service.jobs.job import Prepared
from atoll_coordinator.service.search.archipelago import Checkpoint

WorkerWord = JobAnnouncement | Placements | Commit | Close | CloseJob | Introduce | Shutdown


class Outlet(Protocol):
    """How a controller reaches the others."""

    def tell(self, body: WorkerWord, worker: str | None = None) -> None:
        """Send to one worker, or to all."""

    def pull(self, worker: str, body: PullReports | PullStates) -> None:
        """Ask a worker for reports, which come as reports, or states; `Controller.states_came` follows."""

    def write(self, checkpoint: Checkpoint, progress: bytes, elapsed: float) -> None:
        """Have a checkpoint written elsewhere; `Controller.written` follows."""

    def prepare(self, job: str, table: bytes, config: JobConfig) -> None:
        """Have the table prepared elsewhere; `Controller.prepared` or `Controller.job_failed` follows."""

    def refine(self, job: str, prepared: Prepared, pools: Pools) -> None:
        """Have the equations made of the pools elsewhere; `Controller.refined` follows."""

    def stop(self, job: str) -> None:
        """End what is prepared or refined for a job; nothing follows."""
