"""Deletes ended jobs: jobs named by a client, and jobs that the retention no longer keeps."""

from typing import Final

from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.store.holdings import ALL
from atoll_coordinator.service.store.retention import KEEP_ALL, Retention
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import RefusedError

CHECK_INTERVAL_S: Final = 60.0
"""Seconds between two searches for expired jobs. While there are expired jobs, one job is deleted at each tick."""


class JobDeletion:
    """Deletes ended jobs, each in one transaction of the store."""

    def __init__(self, controller: JobController, store: Store, retention: Retention = KEEP_ALL) -> None:
        """`retention` decides which ended jobs are kept."""
        self._controller = controller
        self._store = store
        self.retention: Final = retention
        self._check_at = 0.0

    def delete(self, job: str, reason: str) -> None:
        """Delete a job; without effect for an unknown job. Raises RefusedError if it has not ended."""
        state = self._controller.shown.state(job)
        if state is not None:
            raise RefusedError(f"job {job} is {state}; cancel it, or wait for its end, before you delete it")
        if self._store.job(job) is None:
            return
        self._controller.forget_ended(job, reason)

    def delete_expired(self, now: float) -> None:
        """Delete one ended job that the retention no longer keeps, if any; `now` is in seconds of the bus."""
        if self.retention == KEEP_ALL or now < self._check_at:
            return
        self._store.keep_served()
        expired = self._expired()
        if expired is None:
            self._check_at = now + CHECK_INTERVAL_S
        else:
            self.delete(*expired)

    def _expired(self) -> tuple[str, str] | None:
        """Return the next job that is no longer kept, and the reason; None: all are kept."""
        oldest = self._store.oldest_ended_job()
        if oldest is not None and self.retention.is_too_old(oldest, self._store.served_s):
            return oldest.id, f"it ended more than {(self.retention.age_s or 0.0) / 86400:g} days ago"
        if not self.retention.is_too_much(self._store.held(ALL).freeable):
            return None
        first = self._store.first_to_delete()
        if first is None:
            return None
        size = (self.retention.size_bytes or 0) / 1e9
        return (
            first.id,
            f"ended jobs take more than {size:g} GB, and it is the oldest ended job of the user with the most",
        )
