"""Deletes jobs that have ended: those that a client names, and those that the retention no longer keeps."""

from typing import Final

from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.store.retention import KEEP_ALL, Retention
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import RefusedError

CHECK_INTERVAL_S: Final = 60.0
"""How often expired jobs are looked for; while there are some, one is deleted at each tick."""


class JobDeletion:
    """Deletes ended jobs, each in one transaction of the store."""

    def __init__(self, controller: JobController, store: Store, retention: Retention = KEEP_ALL) -> None:
        """`retention` says which ended jobs are kept."""
        self._controller = controller
        self._store = store
        self._retention = retention
        self._check_at = 0.0

    def delete(self, job: str, reason: str) -> None:
        """Delete a job; without effect when there is none. Raises RefusedError when it has not ended."""
        live = self._controller.jobs.get(job)
        if live is not None:
            raise RefusedError(f"job {job} is {live.state}; cancel it, or wait for its end, before you delete it")
        if self._store.job(job) is None:
            return
        self._controller.forget_ended(job, reason)

    def delete_expired(self, now: float) -> None:
        """Delete the oldest ended job if it is not to be kept, at most one in a call; `now` in seconds of the bus."""
        if self._retention == KEEP_ALL or now < self._check_at:
            return
        self._store.keep_served()
        oldest = self._store.oldest_ended_job()
        reason = None
        if oldest is not None:
            reason = self._retention.reason_to_delete(oldest, self._store.served_s, self._store.used_bytes())
        if oldest is None or reason is None:
            self._check_at = now + CHECK_INTERVAL_S
        else:
            self.delete(oldest.id, reason)
