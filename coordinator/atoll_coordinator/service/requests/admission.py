"""Admission: refuses uploads and submissions beyond the limits, with a sentence about use, limit and remedy."""

from typing import Final

from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.requests.uploads import Uploads
from atoll_coordinator.service.scheduling.limits import Limits
from atoll_coordinator.service.store.holdings import ALL
from atoll_coordinator.service.store.retention import KEEP_ALL, Retention
from atoll_coordinator.service.store.store import Store
from atoll_core.config import JobConfig
from atoll_core.errors import RefusedError
from atoll_core.wire.messages.clients import Submit, Upload

RESULT_RESERVE: Final = 512 * 1024
"""Bytes reserved for the result of each job that has not ended; results of tests and examples have 1 to 275 kB."""


class Admission:
    """Decides by the current limits. A known job is admitted again: its client may not have got the answer."""

    def __init__(
        self, controller: JobController, store: Store, uploads: Uploads, retention: Retention = KEEP_ALL
    ) -> None:  # fmt: skip
        """`retention` limits the bytes of jobs that have not ended."""
        self._controller = controller
        self._retention = retention
        self._store = store
        self._uploads = uploads

    @property
    def _limits(self) -> Limits:
        return self._controller.queue.limits

    def admit_upload(self, upload: Upload, user: str | None, session: str) -> None:
        """Raise RefusedError for a table beyond the limits of its user, or of all users together."""
        if not self._store.uses_table_of(upload.blob, user):
            pending = self._uploads.pending_bytes(user, upload.blob, session)
            self._admit_live(user, upload.size + pending[0])
            self._admit_bytes(user, upload.size, pending)

    def admit(self, body: Submit, user: str | None, session: str) -> Submit:
        """Return a submission with its time limit; raises RefusedError if it exceeds a limit."""
        known = self._store.job(body.job)
        if known is not None:
            return body.model_copy(update={"config": _as_known(body.config, known.spec, self._limits)})
        self._admit_count(user)
        size = 0 if self._store.uses_table_of(body.table, user) else self._store.blob_size(body.table)
        self._admit_live(user, size)
        self._admit_bytes(user, size, self._uploads.pending_bytes(user, body.table, session))
        return body.model_copy(update={"config": self._limits.with_time(body.config)})

    def _admit_count(self, user: str | None) -> None:
        queue, most = self._controller.queue, self._limits.of(user).queued
        if most is not None and queue.queued_of(user) >= most:
            raise RefusedError(
                f"{queue.queued_of(user)} jobs of {_name(user)} wait, and limits allow {most}; cancel some, or submit "
                "again when some have started"
            )
        if queue.queued >= self._limits.total.queued:
            raise RefusedError(
                f"{queue.queued} jobs wait, and limits allow {self._limits.total.queued}; submit again when some have "
                "started"
            )

    def _admit_live(self, user: str | None, size: int) -> None:
        """Refuse a new table of `size` bytes if the tables of jobs that have not ended would exceed their limit.

        Deleting ended jobs cannot help here. A user who stores less than an equal share is admitted nevertheless.
        """
        most = self._retention.most_live
        if most is None or not size:
            return
        live, own = self._store.held(ALL).live, self._store.held(user).live
        share = most // max(1, self._store.count_holders() + (not own))
        if live + size > most and own + size > share:
            raise RefusedError(
                f"tables of jobs that have not ended take {live} bytes ({own} of them belong to {_name(user)}); {size} "
                f"more exceed the {most} that the coordinator's --keep allows; cancel a job, or submit again when one "
                "has ended"
            )

    def _admit_bytes(self, user: str | None, size: int, pending: tuple[int, int]) -> None:
        """Raise RefusedError if a table of `size` bytes and one more job exceed a limit.

        `pending` are the bytes of other uploads of the user, and of all users together.
        """
        live = self._controller.live_of
        own, total = self._limits.of(user).stored, self._limits.total.stored
        if own is not None:
            used, kept = self._store.held(user).stored + pending[0], RESULT_RESERVE * (live[user] + 1)
            if used + size + kept > own:
                raise RefusedError(
                    f"{_name(user)} stores {used} bytes of tables and results; {size} more, and {kept} reserved for "
                    f"results of jobs that have not ended, exceed the {own} that limits allow; delete ended jobs "
                    "(coordinator delete ID)"
                )
        if total is not None:
            used, kept = self._store.held(ALL).stored + pending[1], RESULT_RESERVE * (live.total() + 1)
            if used + size + kept > total:
                raise RefusedError(
                    f"all users store {used} bytes of tables and results; {size} more, and {kept} reserved for results "
                    f"of jobs that have not ended, exceed the {total} that limits allow; try again when "
                    "jobs are deleted"
                )


def _as_known(config: JobConfig, spec: str, limits: Limits) -> JobConfig:
    """Return a configuration with the time limit of the stored job, regardless of the present limits.

    If the configuration has a time limit, it is returned unchanged: another time limit means another job.
    """
    if config.budget.max_time is not None:
        return config
    try:
        kept = JobConfig.model_validate_json(spec).budget.max_time
    except ValueError:
        return limits.with_time(config)
    return config.model_copy(update={"budget": config.budget.model_copy(update={"max_time": kept})})


def _name(user: str | None) -> str:
    return user if user is not None else "users without certificates"
