"""The coordinator's memory: what it must still know after its own end. SQLite; every method is one transaction.

Any thread may call. When a method returns, what it wrote is on the disk (``synchronous=FULL``): what is announced
afterwards is never taken back. Contents are opaque here: JSON text and bytes whose meaning others know.
"""

import hashlib
import sqlite3
from collections.abc import Callable, Iterable, Mapping, Sequence

from atoll_coordinator.service.store import archipelagos as archipelago_table
from atoll_coordinator.service.store import blobs as blob_table
from atoll_coordinator.service.store import checkpoint_table, holdings, service_state
from atoll_coordinator.service.store import deaths as death_table
from atoll_coordinator.service.store import events as event_table
from atoll_coordinator.service.store import jobs as job_table
from atoll_coordinator.service.store.deaths import Death
from atoll_coordinator.service.store.events import EventRecord
from atoll_coordinator.service.store.holdings import Held, Kind
from atoll_coordinator.service.store.jobs import JobRecord, Viewer
from atoll_coordinator.service.store.open_file import OpenFile
from atoll_core.errors import LocalProtocolError
from atoll_core.wire.messages.limits import CHUNK_SIZE, chunk_count
from atoll_core.wire.messages.views import FINAL_STATES
from atoll_core.wire.state_pieces import IslandState


class Store(OpenFile):
    """An open store: what is kept, table by table. Every method is one transaction."""

    # jobs

    def add_job(self, job: JobRecord) -> bool:
        """Keep a new job; return False, changing nothing, when a job of this id is kept already."""
        with self._transaction() as sql:
            is_new = job_table.add(sql, job)
            blob_table.take(sql, job.table_digest)
            if is_new:
                is_live = job.state not in FINAL_STATES
                holdings.use(sql, job.submitter, job.table_digest, "table", live=is_live, ended=not is_live)
            return is_new

    def job(self, job: str) -> JobRecord | None:
        """Return one job; None for an unknown id."""
        with self._reading() as sql:
            return job_table.find(sql, job)

    def jobs(self) -> tuple[JobRecord, ...]:
        """Return all jobs, in the order in which they came."""
        with self._reading() as sql:
            return job_table.read_all(sql)

    def open_jobs(self) -> tuple[JobRecord, ...]:
        """Return the jobs that have not ended, in the order in which they came."""
        with self._reading() as sql:
            return job_table.read_open(sql)

    def job_page(
        self, prefix: str = "", *, is_open: bool = False, before: int | None = None, limit: int = 1,
        viewer: Viewer | None = None, state: str | None = None,
    ) -> tuple[tuple[int, str], ...]:  # fmt: skip
        """Return numbers and ids of the last jobs that came, the last first; see `wire.messages.clients.Jobs`.

        A `viewer` is shown what it sees; None sees all.
        """
        with self._reading() as sql:
            return job_table.page(sql, prefix, is_open, before, limit, viewer, state)

    def count_jobs(self, prefix: str, viewer: Viewer | None = None) -> int:
        """Return how many ids of jobs that the viewer sees begin with `prefix`: `MAX_COUNTED` at most."""
        with self._reading() as sql:
            return job_table.matches(sql, prefix, viewer)

    def is_seen(self, job: str, viewer: Viewer) -> bool:
        """Tell whether there is a job of this id that the viewer sees."""
        with self._reading() as sql:
            return job_table.is_seen(sql, job, viewer)

    def uses_table(self, digest: str, viewer: Viewer) -> bool:
        """Tell whether a job that the viewer sees uses a table."""
        with self._reading() as sql:
            return job_table.uses_table(sql, digest, viewer)

    def uses_table_of(self, digest: str, submitter: str | None) -> bool:
        """Tell whether a job of this user uses a table: it counts once for all of them."""
        with self._reading() as sql:
            return job_table.uses_table_of(sql, digest, submitter)

    def blob_size(self, digest: str) -> int:
        """Return the bytes of a blob, 0 where it is not there, whole."""
        with self._reading() as sql:
            return blob_table.size(sql, digest) if blob_table.is_complete(sql, digest) else 0

    def stored_bytes(self, submitter: str | None) -> int:
        """Return the bytes of the tables of a user's jobs, each counted once, and of their results."""
        with self._reading() as sql:
            return holdings.read(sql, submitter).stored

    def all_stored_bytes(self) -> int:
        """Return the bytes of all tables that jobs use, each counted once, and of all results."""
        with self._reading() as sql:
            return holdings.read(sql, holdings.ALL).stored

    def held(self, submitter: str | None) -> Held:
        """Return how many bytes are held for a user, by what can be done about them."""
        with self._reading() as sql:
            return holdings.read(sql, submitter)

    def held_for_all(self) -> Held:
        """Return how many bytes are held for all users together; what several use counts once."""
        with self._reading() as sql:
            return holdings.read(sql, holdings.ALL)

    def count_holders(self) -> int:
        """Return for how many users something is held."""
        with self._reading() as sql:
            return holdings.owners(sql)

    def submitter(self, job: str) -> str | None:
        """Return who submitted a job; None when nobody proved it."""
        with self._reading() as sql:
            return job_table.submitter(sql, job)

    def update_job(self, job: str, **changes: str | float | None) -> None:
        """Change fields of a job; raises LocalProtocolError for an unknown job or field, and one that cannot change."""
        job_table.require_changeable(job, changes)
        with self._transaction() as sql:
            job_table.require(sql, job)
            job_table.update(sql, job, changes)

    def share_job(self, job: str, is_shared: bool) -> None:
        """Let everybody see a job, or not, whether it has ended or not."""
        with self._transaction() as sql:
            job_table.require(sql, job)
            job_table.update(sql, job, {"shared": int(is_shared)})
            job_table.share_view(sql, job, is_shared)
            event_table.share(sql, job, is_shared)

    def keep_prepared(self, job: str, dataset: bytes, prepared: bytes) -> str | None:
        """Keep what preparing a job gave: its dataset, and the rest of it until the job ends; without the rest nobody
        could show or finish after a restart what has been found.

        Return the digest of the dataset that was kept of the job before, if one was; where that is another one and
        something of the search is durable, it stays. Without effect where the job has ended. Each chunk is a
        transaction: others, who wait for no more than that, call it in a thread.
        """
        made = {hashlib.sha256(data).hexdigest(): data for data in (dataset, prepared)}
        digests = (next(iter(made)), next(reversed(made)))
        while True:
            for digest, data in made.items():
                self._write_blob(digest, data)
            with self._transaction() as sql:
                record = job_table.find(sql, job)
                if record is None or record.state in FINAL_STATES:
                    blob_table.delete_unused(sql, made)
                    return None
                former = record.dataset_digest
                if former not in (None, digests[0]) and _has_search(sql, job):
                    blob_table.delete_unused(sql, made)
                    return former
                # Another job with the same data may have been deleted meanwhile, and the data with it: once more.
                if all(blob_table.finish(sql, digest, len(data)) for digest, data in made.items()):
                    self._use_made(sql, record, *digests)
                    return former

    def _write_blob(self, digest: str, data: bytes) -> None:
        """Write a blob that is not there; it is whole when `blobs.finish` has said so, in the caller's transaction."""
        if self.has_blob(digest) and self.is_sound(digest):
            return
        with self._transaction() as sql:
            blob_table.begin(sql, digest)
        for index in range(chunk_count(len(data))):
            with self._transaction() as sql:
                blob_table.append(sql, digest, index, data[index * CHUNK_SIZE : (index + 1) * CHUNK_SIZE])

    def _use_made(self, sql: sqlite3.Connection, job: JobRecord, dataset: str, prepared: str) -> None:
        """Take in that a job uses what was made of its table, and no more what was made of it before."""
        job_table.update(sql, job.id, {"dataset_digest": dataset, "prepared_digest": prepared})
        for digest in (dataset, prepared):
            holdings.use(sql, job.submitter, digest, "made", live=1)
        self._forget_made(sql, job.submitter, (job.dataset_digest, job.prepared_digest))

    def _forget_made(self, sql: sqlite3.Connection, submitter: str | None, digests: Iterable[str | None]) -> None:
        """Take in that a job that has not ended does not use any more what was made of its table."""
        unused = [digest for digest in digests if digest is not None]
        for digest in unused:
            holdings.use(sql, submitter, digest, "made", live=-1)
        blob_table.delete_unused(sql, unused)

    def commit_result(  # noqa: PLR0913  # all that ends a job is written in one transaction
        self, job: str, state: str, result: str | None, reason: str | None = None, finished: str | None = None,
        *, keeps_checkpoints: bool = False, view: str | None = None,
    ) -> bool:  # fmt: skip
        """Make a job's final `state` and `result` (JSON) durable and forget its checkpoints, or all but the last.

        `view` is what people are shown of it (JSON), if that is known already.

        With `keeps_checkpoints` the last of each archipelago stays, until `checkpoint_table.MAX_FAILED` more jobs have
        failed so. Return False, changing nothing, when it had ended before: the first end wins.
        """
        with self._transaction() as sql:
            record = job_table.require(sql, job)
            if not job_table.end(sql, job, state, result, reason, finished):
                return False
            self._forget_made(sql, record.submitter, [record.prepared_digest])
            holdings.add_result(sql, record.submitter, job_table.size_of(result))
            for digest, kind in _used(record):
                holdings.use(sql, record.submitter, digest, kind, live=-1, ended=1)
            if keeps_checkpoints:
                checkpoint_table.keep_last(sql, job)
            else:
                checkpoint_table.forget(sql, job)
            death_table.forget(sql, job)
            if view is not None:
                job_table.keep_view(sql, job, view)
            job_table.update(sql, job, {"ended_at": self.served_s})
            sql.execute("UPDATE realm SET served = ?", (self.served_s,))
            return True

    def result(self, job: str) -> str | None:
        """Return a job's result as JSON; None while there is none."""
        with self._reading() as sql:
            return job_table.result(sql, job)

    def keep_views(self, views: Mapping[str, str]) -> None:
        """Keep what people are shown of jobs that have ended (JSON), by id; unknown ones are left out."""
        with self._transaction() as sql:
            for job, view in views.items():
                job_table.keep_view(sql, job, view)

    def views(self, jobs: Iterable[str]) -> dict[str, str]:
        """Return what people are shown of those jobs that have ended and of which it has been kept (JSON), by id."""
        with self._reading() as sql:
            return job_table.views(sql, jobs)

    def oldest_ended_job(self, of: Viewer | None = None) -> JobRecord | None:
        """Return the job that ended first of those that have ended, all or one user's; None when there is none."""
        with self._reading() as sql:
            return job_table.oldest_ended(sql, of)

    def first_to_go(self) -> JobRecord | None:
        """Return the job to be deleted for room: the oldest ended one of the user of whose ended jobs most is held."""
        with self._reading() as sql:
            owner = holdings.most_freeable(sql)
            return job_table.oldest_ended(sql, Viewer(owner or None)) if owner is not None else None

    def delete_job(self, job: str) -> None:
        """Delete an ended job with its result, events, checkpoints, and the blobs that no other job uses.

        The file does not shrink; SQLite uses its free pages again. Without effect when there is no such job.

        Raises:
            LocalProtocolError: the job has not ended.
        """
        with self._transaction() as sql:
            record = job_table.find(sql, job)
            if record is None:
                return
            if record.state not in FINAL_STATES:
                raise LocalProtocolError(f"job {job} is {record.state} and cannot be deleted")
            checkpoint_table.forget(sql, job)
            death_table.forget(sql, job)
            archipelago_table.delete(sql, job)
            event_table.delete(sql, job)
            holdings.add_result(sql, record.submitter, -job_table.result_bytes(sql, job))
            job_table.delete(sql, job)
            for digest, kind in _used(record):
                holdings.use(sql, record.submitter, digest, kind, ended=-1)
            blob_table.delete_unused(sql, [digest for digest, _ in _used(record)])

    def is_deleted(self, job: str) -> bool:
        """Tell whether there was a job of this id that has been deleted."""
        with self._reading() as sql:
            return job_table.is_deleted(sql, job)

    # archipelagos

    def begin_terms(self, archipelagos: Sequence[tuple[str, str]], place: Callable[[int, int], bytes]) -> None:
        """Raise the terms of archipelagos and make their placements durable, all or none of them, at the cost of one.

        Args:
            archipelagos: by job and variable.
            place: returns the placement of number `index` of them under its new `term`.
        """
        with self._transaction() as sql:
            for index, (job, variable) in enumerate(archipelagos):
                term = archipelago_table.raise_term(sql, job, variable)
                archipelago_table.place(sql, job, variable, place(index, term))

    def commit_cuts(self, job: str, cuts: Mapping[str, bytes]) -> bool:
        """Make the ends of archipelagos durable, by variable, in one transaction.

        Return False when one of them had ended before: its first end stays, the others are made durable all the same.
        """
        with self._transaction() as sql:
            are_first = [archipelago_table.cut(sql, job, variable, cut) for variable, cut in cuts.items()]
            for variable in cuts:
                checkpoint_table.forget(sql, job, variable)
                death_table.forget(sql, job, variable)
            return all(are_first)

    def cuts(self, job: str) -> dict[str, bytes]:
        """Return the committed cuts by variable."""
        with self._reading() as sql:
            return archipelago_table.cuts(sql, job)

    def has_search(self, job: str) -> bool:
        """Tell whether anything of the search of a job is durable."""
        with self._reading() as sql:
            return _has_search(sql, job)

    # deaths

    def add_deaths(self, deaths: Sequence[Death]) -> None:
        """Keep deaths that count for archipelagos until they have a newer commit, or end."""
        with self._transaction() as sql:
            death_table.add(sql, deaths)

    def deaths(self, job: str) -> tuple[Death, ...]:
        """Return the deaths that count for archipelagos of a job, by variable, then by term."""
        with self._reading() as sql:
            return death_table.read(sql, job)

    def take_back_deaths(self, worker: str, instance: str) -> None:
        """Forget the death of a process, which lives after all."""
        with self._transaction() as sql:
            death_table.take_back(sql, worker, instance)

    # events

    def add_events(self, events: Iterable[EventRecord]) -> None:
        """Keep what has happened; of each job, and of no job in particular, `MAX_EVENTS` are kept: commits go first."""
        with self._transaction() as sql:
            event_table.add(sql, tuple(events))

    def events(
        self, job: str | None, after: int, limit: int, viewer: Viewer | None = None, *, of_workers: bool = False
    ) -> tuple[EventRecord, ...]:  # fmt: skip
        """Return what happened to a job, or at all (None), after the event of that number; `limit` of it at most.

        With `after` 0 these are the last ones, otherwise those that come next. A `viewer` is told of what it sees.
        """
        with self._reading() as sql:
            return event_table.read(sql, job, after, limit, viewer, of_workers)

    # what admins have set, and users have used up

    def is_queue_paused(self) -> bool:
        """Tell whether no job is to be taken up."""
        with self._reading() as sql:
            return service_state.is_queue_paused(sql)

    def pause_queue(self, is_paused: bool) -> None:
        """Keep whether jobs are to be taken up."""
        with self._transaction() as sql:
            service_state.pause_queue(sql, is_paused)

    def cordons(self) -> dict[str, bool]:
        """Return the workers that are given no more islands, and whether they hand over those that they have."""
        with self._reading() as sql:
            return service_state.cordons(sql)

    def cordon(self, worker: str, is_draining: bool | None) -> None:
        """Keep that a worker is cordoned, and perhaps drained; None: that it is neither any more."""
        with self._transaction() as sql:
            service_state.cordon(sql, worker, is_draining)

    def add_usage(self, day: int, seconds: Mapping[str | None, float]) -> None:
        """Add task time, in seconds, to what users have used on a day of service; keep `served_s` as well."""
        with self._transaction() as sql:
            service_state.add_usage(sql, day, seconds)
            sql.execute("UPDATE realm SET served = ?", (self.served_s,))

    def usage(self, day: int) -> dict[str | None, float]:
        """Return the seconds of task time that users have used on a day of service."""
        with self._reading() as sql:
            return service_state.usage(sql, day)

    # checkpoints

    def commit_checkpoint(
        self, job: str, variable: str, epoch: int, progress: bytes, states: Mapping[int, IslandState], elapsed: float
    ) -> bool:
        """Make a checkpoint of an archipelago durable, and `elapsed` of its job; keep the one before, but no older one.

        Deaths that counted until now count no more. Return False, changing nothing, when the archipelago or its job has
        ended, or the job has been deleted meanwhile.
        """
        with self._transaction() as sql:
            if job_table.find(sql, job) is None or archipelago_table.has_ended(sql, job, variable):
                return False
            checkpoint_table.add(sql, job, variable, epoch, progress, states)
            death_table.forget(sql, job, variable)
            job_table.update(sql, job, {"elapsed": elapsed})
            return True

    def checkpoints(self, job: str) -> dict[str, tuple[int, bytes]]:
        """Return epoch and progress of the last checkpoint by variable."""
        with self._reading() as sql:
            return checkpoint_table.last(sql, job)

    def whole_checkpoints(self, job: str, islands: int) -> dict[str, tuple[int, bytes]]:
        """Return what `checkpoints` does, but of each variable the last checkpoint whose states are undamaged."""
        with self._transaction() as sql:
            return checkpoint_table.last_whole(sql, job, islands)

    def state(self, job: str, variable: str, epoch: int, island: int) -> IslandState:
        """Return the state of an island at a checkpoint; raises KeyError when it is not there."""
        with self._reading() as sql:
            return checkpoint_table.state(sql, job, variable, epoch, island)

    # blobs

    def put_blob(self, data: bytes) -> str:
        """Keep `data`; return its digest (SHA-256, hex) under which it is found again."""
        digest = hashlib.sha256(data).hexdigest()
        with self._transaction() as sql:
            blob_table.add(sql, digest, data)
        return digest

    def has_blob(self, digest: str) -> bool:
        """Return whether the blob is there, whole."""
        with self._reading() as sql:
            return blob_table.is_complete(sql, digest)

    def is_begun(self, digest: str) -> bool:
        """Return whether there is a blob or an upload of this name, whole or not."""
        with self._reading() as sql:
            return blob_table.is_begun(sql, digest)

    def is_sound(self, digest: str) -> bool:
        """Tell whether a blob is there, whole and undamaged; one that is damaged is forgotten.

        It reads all of it, one chunk a transaction: others, who wait for no more than that, call it in a thread.
        """
        actual = hashlib.sha256()
        try:
            for index in range(chunk_count(self.blob_size(digest))):
                actual.update(self.get_chunk(digest, index))
        except KeyError:
            return False
        if actual.hexdigest() == digest:
            return True
        with self._transaction() as sql:
            blob_table.keep_if_sound(sql, digest)
        return False

    def get_blob(self, digest: str) -> bytes:
        """Return a blob; raises KeyError when it is not there, whole, or damaged: then it is forgotten."""
        if not self.is_sound(digest):
            raise KeyError(digest)
        return b"".join(self.get_chunk(digest, index) for index in range(chunk_count(self.blob_size(digest))))

    def get_chunk(self, digest: str, index: int) -> bytes:
        """Return chunk `index` (of `CHUNK_SIZE` bytes, the last one shorter) of a blob; raises KeyError."""
        with self._reading() as sql:
            return blob_table.chunk(sql, digest, index)

    def put_chunk(self, upload: str, index: int, data: bytes, digest: str | None = None) -> bool:
        """Keep the next chunk of an upload, of any name; return False when the chunks before it are not there.

        With chunk 0 the upload begins anew. A `digest` says that this is the last chunk, and that all bytes have this
        digest: they are a blob from now on. Where there is a blob of this name or digest already, that one stays.
        """
        with self._transaction() as sql:
            return blob_table.put_chunk(sql, upload, index, data, digest)

    def blob_bytes(self) -> int:
        """Return how many bytes are stored of all blobs, of unfinished uploads as well."""
        with self._reading() as sql:
            return blob_table.total_bytes(sql)

    def unused_blobs(self) -> tuple[str, ...]:
        """Return the digests of all blobs, finished or not, that no job uses."""
        with self._reading() as sql:
            return blob_table.unused(sql)

    def delete_unused_blobs(self, digests: Iterable[str]) -> None:
        """Delete those of these blobs, finished or not, that no job uses."""
        with self._transaction() as sql:
            blob_table.delete_unused(sql, digests)


def _has_search(sql: sqlite3.Connection, job: str) -> bool:
    return bool(archipelago_table.cuts(sql, job) or checkpoint_table.last(sql, job))


def _used(job: JobRecord) -> tuple[tuple[str, Kind], ...]:
    """Return the blobs that a job uses as long as it is kept, with what they are."""
    made: tuple[tuple[str, Kind], ...] = ((job.dataset_digest, "made"),) if job.dataset_digest is not None else ()
    return ((job.table_digest, "table"), *made)
