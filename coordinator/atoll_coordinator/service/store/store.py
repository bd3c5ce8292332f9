"""The coordinator's durable memory, in SQLite. Every method is one transaction.

Methods may be called from any thread. When a method returns, its changes are on the disk (``synchronous=FULL``), so
that a message sent afterwards never has to be withdrawn. The store does not interpret contents, which are JSON text and
bytes. The parts are in `jobs`, `checkpoints`, `blobs`, `events` and `holdings`. This module has the methods that change
several parts in one transaction.

*Doubts.* Five classes share one connection by inheritance, so that one transaction can change several tables. Names of
methods must therefore be unique over all parts.
"""

import hashlib
import sqlite3
from collections.abc import Iterable, Mapping

from atoll_coordinator.service.store import blobs, checkpoints, holdings
from atoll_coordinator.service.store import jobs as job_table
from atoll_coordinator.service.store.blobs import BlobStore
from atoll_coordinator.service.store.checkpoints import CheckpointStore
from atoll_coordinator.service.store.events import EventStore
from atoll_coordinator.service.store.holdings import HoldingStore, Kind
from atoll_coordinator.service.store.jobs import JobRecord, Viewer
from atoll_coordinator.service.store.open_file import first_value
from atoll_core.errors import LocalProtocolError
from atoll_core.wire.messages.views import FINAL_STATES


class Store(CheckpointStore, BlobStore, EventStore, HoldingStore):
    """An open store."""

    # jobs from submission to deletion

    def add_job(self, job: JobRecord) -> bool:
        """Store a new job; return False, changing nothing, when there is a job of this id."""
        with self._transaction() as sql:
            is_new = job_table.add(sql, job)
            blobs.take(sql, job.table_digest)
            if is_new:
                is_live = job.state not in FINAL_STATES
                holdings.use(sql, job.submitter, job.table_digest, "table", live=is_live, ended=not is_live)
            return is_new

    def share_job(self, job: str, is_shared: bool) -> None:
        """Make a job visible to all users, or not."""
        with self._transaction() as sql:
            job_table.require(sql, job)
            job_table.update(sql, job, {"shared": int(is_shared)})
            sql.execute(
                "UPDATE views SET view = json_set(view, '$.shared', json(?)) WHERE job = ? AND json_valid(view)",
                ("true" if is_shared else "false", job),
            )
            sql.execute("UPDATE events SET shared = ? WHERE job = ?", (int(is_shared), job))

    def keep_prepared(self, job: str, dataset: bytes, prepared: bytes) -> str | None:
        """Store the prepared data of a job: its dataset, and the rest until the job ends.

        Without the rest, equations found by the search could be neither shown nor refined after a restart. Return the
        digest of the dataset that was stored before, if any. That earlier dataset is kept if it is different and a
        search from it is stored. Without effect if the job has ended. Each chunk is one transaction. Call it in a
        separate
        thread: other threads wait for one chunk at most.
        """
        made = {hashlib.sha256(data).hexdigest(): data for data in (dataset, prepared)}
        digests = (next(iter(made)), next(reversed(made)))
        while True:
            for digest, data in made.items():
                self._write_blob(digest, data)
            with self._transaction() as sql:
                record = job_table.find(sql, job)
                if record is None or record.state in FINAL_STATES:
                    blobs.delete_unused(sql, made)
                    return None
                former = record.dataset_digest
                if former not in (None, digests[0]) and checkpoints.has_search(sql, job):
                    blobs.delete_unused(sql, made)
                    return former
                # Another job with the same data may have been deleted meanwhile, with the data: write them again.
                if all(blobs.finish(sql, digest, len(data)) for digest, data in made.items()):
                    job_table.update(sql, job, {"dataset_digest": digests[0], "prepared_digest": digests[1]})
                    for digest in digests:
                        holdings.use(sql, record.submitter, digest, "made", live=1)
                    _release_made(sql, record.submitter, (former, record.prepared_digest))
                    return former

    def commit_result(  # noqa: PLR0913  # the whole end of a job is written in one transaction
        self, job: str, state: str, result: str | None, reason: str | None = None, finished: str | None = None,
        *, keeps_checkpoints: bool = False, view: str | None = None,
    ) -> bool:  # fmt: skip
        """Store a job's final `state`, `result` (JSON) and `view` (JSON), and delete its checkpoints.

        With `keeps_checkpoints` the last checkpoint of each archipelago stays, until `checkpoints.MAX_FAILED` more jobs
        have failed. Return False, changing nothing, if the job had ended before: the first end counts.
        """
        with self._transaction() as sql:
            record = job_table.require(sql, job)
            if not job_table.end(sql, job, state, result, reason, finished):
                return False
            _release_made(sql, record.submitter, [record.prepared_digest])
            holdings.add_result(sql, record.submitter, len((result or "").encode()))
            for digest, kind in _used_blobs(record):
                holdings.use(sql, record.submitter, digest, kind, live=-1, ended=1)
            if keeps_checkpoints:
                checkpoints.keep_last_checkpoints(sql, job)
            else:
                checkpoints.forget_checkpoints(sql, job)
            checkpoints.forget_deaths(sql, job)
            if view is not None:
                job_table.keep_view(sql, job, view)
            job_table.update(sql, job, {"ended_at": self.served_s})
            sql.execute("UPDATE realm SET served = ?", (self.served_s,))
            return True

    def first_to_delete(self) -> JobRecord | None:
        """Return the job to delete for space: the oldest ended job of the user with the most freeable bytes."""
        with self._reading() as sql:
            owner = holdings.most_freeable(sql)
            return job_table.oldest_ended(sql, Viewer(owner or None)) if owner is not None else None

    def delete_job(self, job: str) -> None:
        """Delete an ended job with its result, events, checkpoints, and the blobs that no other job uses.

        The file does not shrink; SQLite uses its free pages again. Without effect for an unknown job.

        Raises:
            LocalProtocolError: the job has not ended.
        """
        with self._transaction() as sql:
            record = job_table.find(sql, job)
            if record is None:
                return
            if record.state not in FINAL_STATES:
                raise LocalProtocolError(f"job {job} is {record.state} and cannot be deleted")
            checkpoints.forget_checkpoints(sql, job)
            checkpoints.forget_deaths(sql, job)
            sql.execute("DELETE FROM archipelagos WHERE job = ?", (job,))
            sql.execute("DELETE FROM events WHERE job = ?", (job,))
            size = first_value(sql, "SELECT result_bytes FROM jobs WHERE id = ?", job) or 0
            holdings.add_result(sql, record.submitter, -size)
            job_table.delete(sql, job)
            for digest, kind in _used_blobs(record):
                holdings.use(sql, record.submitter, digest, kind, ended=-1)
            blobs.delete_unused(sql, [digest for digest, _ in _used_blobs(record)])

    # settings of admins, and task time used by users

    def is_queue_paused(self) -> bool:
        """Return whether the queue is paused, so that no further job is started."""
        return bool(self._value("SELECT queue_paused FROM realm"))

    def pause_queue(self, is_paused: bool) -> None:
        """Store whether further jobs are started."""
        with self._transaction() as sql:
            sql.execute("UPDATE realm SET queue_paused = ?", (int(is_paused),))

    def cordons(self) -> dict[str, bool]:
        """Return the cordoned workers, which get no more islands, and whether the islands of each are moved away."""
        return {worker: bool(is_draining) for worker, is_draining in self._rows("SELECT * FROM cordons")}

    def cordon(self, worker: str, is_draining: bool | None) -> None:
        """Store that a worker is cordoned, and whether it is also drained; None: it is neither."""
        with self._transaction() as sql:
            sql.execute("DELETE FROM cordons WHERE worker = ?", (worker,))
            if is_draining is not None:
                sql.execute("INSERT INTO cordons VALUES (?, ?)", (worker, int(is_draining)))

    def add_usage(self, day: int, seconds: Mapping[str | None, float]) -> None:
        """Add task time, in seconds, to the usage of users on a day of service; store `served_s` as well."""
        with self._transaction() as sql:
            sql.executemany(
                "INSERT INTO usage VALUES (?, ?, ?) ON CONFLICT DO UPDATE SET seconds = seconds + excluded.seconds",
                [(user or "", day, spent) for user, spent in seconds.items()],
            )
            sql.execute("DELETE FROM usage WHERE day < ?", (day - 1,))
            sql.execute("UPDATE realm SET served = ?", (self.served_s,))

    def usage(self, day: int) -> dict[str | None, float]:
        """Return the seconds of task time that users have used on a day of service."""
        rows = self._rows("SELECT submitter, seconds FROM usage WHERE day = ?", day)
        return {user or None: seconds for user, seconds in rows}


def _release_made(sql: sqlite3.Connection, submitter: str | None, digests: Iterable[str | None]) -> None:
    """Record that a job that has not ended no longer uses these prepared data."""
    released = [digest for digest in digests if digest is not None]
    for digest in released:
        holdings.use(sql, submitter, digest, "made", live=-1)
    blobs.delete_unused(sql, released)


def _used_blobs(job: JobRecord) -> tuple[tuple[str, Kind], ...]:
    """Return the blobs that a job uses as long as it is stored, with their kinds."""
    made: tuple[tuple[str, Kind], ...] = ((job.dataset_digest, "made"),) if job.dataset_digest is not None else ()
    return ((job.table_digest, "table"), *made)
