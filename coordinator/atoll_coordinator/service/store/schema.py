"""The store's file, SQLite in WAL mode: its tables, their versions, opening, and refusing files that are no stores."""

import contextlib
import sqlite3
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from atoll_core.errors import StoreError, WrongStoreError

FILE_NAME: Final = "atoll.sqlite3"
_APPLICATION: Final = 0x41544F4C  # "ATOL"; SQLite keeps it in the file's header
BUSY_LIMIT_S: Final = 5.0
"""Seconds for which another process may lock the file. Litestream locks it while it moves pages out of the WAL, and
recommends this limit."""

_CHECKED_BYTES: Final = 256 * 1024 * 1024

_LAYOUT_1: Final = """
CREATE TABLE realm (id TEXT NOT NULL, incarnation INTEGER NOT NULL);
CREATE TABLE jobs (
    number INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE, name TEXT NOT NULL, spec TEXT NOT NULL,
    table_digest TEXT NOT NULL, submitted TEXT NOT NULL, state TEXT NOT NULL, reason TEXT, dataset_digest TEXT,
    elapsed REAL NOT NULL, finished TEXT, result TEXT
);
CREATE TABLE blobs (digest TEXT PRIMARY KEY, size INTEGER NOT NULL, complete INTEGER NOT NULL);
CREATE TABLE chunks (
    digest TEXT NOT NULL REFERENCES blobs ON DELETE CASCADE, number INTEGER NOT NULL, data BLOB NOT NULL,
    PRIMARY KEY (digest, number)
);
CREATE TABLE archipelagos (
    job TEXT NOT NULL REFERENCES jobs (id), variable TEXT NOT NULL, term INTEGER NOT NULL DEFAULT 0, placement BLOB,
    cut BLOB, PRIMARY KEY (job, variable)
);
"""

_LAYOUT_2: Final = """
ALTER TABLE jobs ADD COLUMN priority INTEGER NOT NULL DEFAULT 0;
CREATE TABLE events (
    number INTEGER PRIMARY KEY AUTOINCREMENT, job TEXT, time TEXT NOT NULL, kind TEXT NOT NULL, contents TEXT NOT NULL
);
CREATE INDEX events_of_job ON events (job, number);
CREATE TABLE checkpoints (
    job TEXT NOT NULL, variable TEXT NOT NULL, epoch INTEGER NOT NULL, progress BLOB NOT NULL,
    PRIMARY KEY (job, variable, epoch), FOREIGN KEY (job, variable) REFERENCES archipelagos
);
CREATE TABLE states (
    job TEXT NOT NULL, variable TEXT NOT NULL, epoch INTEGER NOT NULL, island INTEGER NOT NULL, digest TEXT NOT NULL,
    data BLOB NOT NULL, PRIMARY KEY (job, variable, epoch, island),
    FOREIGN KEY (job, variable, epoch) REFERENCES checkpoints ON DELETE CASCADE
);
CREATE TABLE submitters (job TEXT PRIMARY KEY, name TEXT NOT NULL)
"""

_LAYOUT_3_DEATHS: Final = """
CREATE TABLE deaths (
    job TEXT NOT NULL, variable TEXT NOT NULL, term INTEGER NOT NULL, worker TEXT NOT NULL, instance TEXT NOT NULL,
    PRIMARY KEY (job, variable, term, worker, instance)
)
"""

_LAYOUT_4_DELETED_JOBS: Final = "CREATE TABLE deleted_jobs (id TEXT PRIMARY KEY)"

_LAYOUT_5_SERVED: Final = """
ALTER TABLE realm ADD COLUMN served REAL NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN ended_at REAL NOT NULL DEFAULT 0;
CREATE INDEX jobs_by_table ON jobs (table_digest);
CREATE INDEX jobs_by_dataset ON jobs (dataset_digest);
CREATE INDEX jobs_by_state ON jobs (state)
"""

_LAYOUT_6_ENDED_JOBS: Final = """
CREATE TABLE views (job TEXT PRIMARY KEY, view TEXT NOT NULL);
CREATE INDEX open_jobs ON jobs (number) WHERE state NOT IN ('done', 'failed', 'cancelled');
CREATE INDEX ended_jobs ON jobs (ended_at, coalesce(finished, submitted), number)
    WHERE state IN ('done', 'failed', 'cancelled');
CREATE TABLE uploads (digest TEXT PRIMARY KEY REFERENCES blobs ON DELETE CASCADE);
INSERT INTO uploads SELECT digest FROM blobs;
DELETE FROM uploads WHERE digest IN (SELECT table_digest FROM jobs);
DELETE FROM uploads WHERE digest IN (SELECT dataset_digest FROM jobs);
CREATE INDEX sizes_of_blobs ON blobs (size)
"""
"""Stores the view of each ended job, so that lists need not read its result (up to megabytes). So no operation becomes
slower with the number of ended jobs."""

_LAYOUT_7_USERS: Final = """
ALTER TABLE jobs ADD COLUMN submitter TEXT;
ALTER TABLE jobs ADD COLUMN shared INTEGER NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN paused INTEGER NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN result_bytes INTEGER NOT NULL DEFAULT 0;
UPDATE jobs SET submitter = (SELECT name FROM submitters WHERE submitters.job = jobs.id);
UPDATE jobs SET result_bytes = length(CAST(result AS BLOB)) WHERE result IS NOT NULL;
DROP TABLE submitters;
CREATE INDEX jobs_by_submitter ON jobs (submitter, table_digest, result_bytes);
ALTER TABLE realm ADD COLUMN queue_paused INTEGER NOT NULL DEFAULT 0;
CREATE TABLE cordons (worker TEXT PRIMARY KEY, is_draining INTEGER NOT NULL);
CREATE TABLE usage (
    submitter TEXT NOT NULL, day INTEGER NOT NULL, seconds REAL NOT NULL, PRIMARY KEY (submitter, day)
)
"""

OPEN: Final = "state NOT IN ('done', 'failed', 'cancelled')"
ENDED: Final = "state IN ('done', 'failed', 'cancelled')"
"""Conditions of partial indices. SQLite uses such an index only for a query with literally the same condition."""

_LAYOUT_8_HOLDINGS: Final = f"""
ALTER TABLE jobs ADD COLUMN prepared_digest TEXT;
ALTER TABLE jobs ADD COLUMN submitted_s REAL;
CREATE INDEX jobs_by_prepared ON jobs (prepared_digest) WHERE prepared_digest IS NOT NULL;
DROP INDEX jobs_by_submitter;
CREATE INDEX jobs_by_submitter ON jobs (submitter);
CREATE INDEX jobs_by_submitter_and_state ON jobs (submitter, state);
CREATE INDEX open_jobs_by_submitter ON jobs (submitter) WHERE {OPEN};
CREATE INDEX shared_jobs ON jobs (number) WHERE shared;
CREATE INDEX shared_jobs_by_state ON jobs (state) WHERE shared;
CREATE INDEX shared_open_jobs ON jobs (number) WHERE shared AND {OPEN};
CREATE INDEX jobs_by_submitter_and_id ON jobs (submitter, id);
CREATE INDEX shared_jobs_by_id ON jobs (id) WHERE shared;
CREATE INDEX ended_jobs_by_submitter ON jobs (submitter, ended_at, coalesce(finished, submitted), number)
    WHERE {ENDED};
ALTER TABLE realm ADD COLUMN blob_bytes INTEGER NOT NULL DEFAULT 0;
UPDATE realm SET blob_bytes = (SELECT coalesce(sum(size), 0) FROM blobs);
DROP INDEX sizes_of_blobs;
CREATE TABLE uses (
    owner TEXT NOT NULL, digest TEXT NOT NULL, kind TEXT NOT NULL, size INTEGER NOT NULL, live INTEGER NOT NULL,
    ended INTEGER NOT NULL, PRIMARY KEY (owner, digest, kind)
) WITHOUT ROWID;
INSERT INTO uses SELECT coalesce(submitter, ''), table_digest, 'table', coalesce(size, 0), sum({OPEN}), sum({ENDED})
    FROM jobs LEFT JOIN blobs ON digest = table_digest GROUP BY 1, 2;
INSERT INTO uses SELECT coalesce(submitter, ''), dataset_digest, 'made', coalesce(size, 0), sum({OPEN}), sum({ENDED})
    FROM jobs LEFT JOIN blobs ON digest = dataset_digest WHERE dataset_digest IS NOT NULL GROUP BY 1, 2;
INSERT INTO uses SELECT '*', digest, kind, max(size), sum(live), sum(ended) FROM uses GROUP BY digest, kind;
CREATE TABLE holdings (
    owner TEXT PRIMARY KEY, tables INTEGER NOT NULL, results INTEGER NOT NULL, live INTEGER NOT NULL,
    freeable INTEGER NOT NULL
);
INSERT INTO holdings SELECT owner, sum((kind = 'table') * size), 0, sum((live > 0) * size), sum((live = 0) * size)
    FROM uses GROUP BY owner;
UPDATE holdings SET results = (
    SELECT coalesce(sum(result_bytes), 0) FROM jobs WHERE coalesce(submitter, '') = owner OR owner = '*'
);
ALTER TABLE events ADD COLUMN owner TEXT;
ALTER TABLE events ADD COLUMN shared INTEGER NOT NULL DEFAULT 0;
UPDATE events SET shared = 1 WHERE job IS NULL AND kind NOT IN ('deleted', 'broken', 'log');
UPDATE events SET (owner, shared) = (SELECT submitter, shared FROM jobs WHERE id = job)
    WHERE job IN (SELECT id FROM jobs);
CREATE INDEX events_by_owner ON events (owner) WHERE owner IS NOT NULL;
CREATE INDEX shared_events ON events (number) WHERE shared;
CREATE INDEX logs ON events (number) WHERE kind = 'log';
CREATE INDEX logs_by_owner ON events (owner) WHERE owner IS NOT NULL AND kind = 'log';
CREATE INDEX shared_logs ON events (number) WHERE shared AND kind = 'log'
"""
"""Keeps requests and decisions fast in a large store: each kind of list has an index, and sums of bytes are updated
with every change."""

_LAYOUT_9_SHARED_BLOBS: Final = """
CREATE INDEX uses_of_blob ON uses (digest, kind);
UPDATE holdings SET freeable = (
    SELECT coalesce(sum(size), 0) FROM uses WHERE uses.owner = holdings.owner AND ended > 0 AND NOT EXISTS (
        SELECT 1 FROM uses AS of_all
        WHERE of_all.owner = '*' AND of_all.digest = uses.digest AND of_all.kind = uses.kind AND of_all.live > 0
    )
)
"""
"""Blobs that jobs of other users need do not count as freeable."""

_LAYOUTS: Final = (
    _LAYOUT_1, _LAYOUT_2, _LAYOUT_3_DEATHS, _LAYOUT_4_DELETED_JOBS, _LAYOUT_5_SERVED, _LAYOUT_6_ENDED_JOBS,
    _LAYOUT_7_USERS, _LAYOUT_8_HOLDINGS, _LAYOUT_9_SHARED_BLOBS,
)  # fmt: skip
"""Changes of each version of the layout. A new store gets all changes in order, an old store the missing changes."""

SCHEMA_VERSION: Final = len(_LAYOUTS)


def connect(directory: Path | None) -> sqlite3.Connection:
    """Open the store's file in `directory` (None: in memory), creating it if necessary; raise its incarnation.

    Raises:
        StoreError: the file is damaged, foreign or of a newer version, or cannot be written.
    """
    file = directory / FILE_NAME if directory else None
    with translated(file):
        if file is not None:
            wal = file.with_name(f"{file.name}-wal")
            if not file.exists() and wal.exists() and wal.stat().st_size:  # SQLite would delete the last changes
                raise WrongStoreError(
                    f"{wal} is there, but its store {file.name} is not; put the store back, create one from a copy "
                    "with `coordinator restore`, or move both away"
                )
            with contextlib.suppress(OSError):  # SQLite reports it
                file.touch(mode=0o600)  # measurements are private, and SQLite gives its other files the same mode
        connection = sqlite3.connect(
            file or ":memory:", isolation_level=None, check_same_thread=False, timeout=BUSY_LIMIT_S
        )
    try:
        with translated(file):
            _prepare(connection, file)
    except BaseException:
        connection.close()
        raise
    return connection


def connect_to_read(directory: Path) -> sqlite3.Connection:
    """Open a second connection to an open store's file, for reading only: it does not wait for writers."""
    file = directory / FILE_NAME
    with translated(file):
        connection = sqlite3.connect(file, isolation_level=None, check_same_thread=False, timeout=1.0)
        connection.execute("PRAGMA query_only = ON")
    return connection


@contextlib.contextmanager
def translated(place: Path | None) -> Iterator[None]:
    """Turn errors of SQLite at the store `place` into StoreError, or WrongStoreError if the file is damaged."""
    try:
        yield
    except sqlite3.Error as error:
        if getattr(error, "sqlite_errorcode", None) in (sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CORRUPT):
            advice = "restore it from a copy, or choose another directory with --state"
            raise WrongStoreError(f"the store {place or 'in memory'} fails: {error}; {advice}") from error
        advice = "check that its directory can be written and that there is room"
        raise StoreError(f"the store {place or 'in memory'} fails: {error}; {advice}") from error


def check_kind(connection: sqlite3.Connection, file: Path | None) -> int:
    """Return the layout version of a file, 0 for an empty file; raises StoreError for a foreign or newer file."""
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if application != _APPLICATION and (tables or application):
        raise WrongStoreError(f"{file} is a database, but not a store of Atoll; name another directory")
    if version > SCHEMA_VERSION:
        raise WrongStoreError(
            f"the store {file} was written by a newer version (layout {version}, this version knows {SCHEMA_VERSION}); "
            "use that version, or name another directory"
        )
    return int(version) if tables else 0


def _prepare(connection: sqlite3.Connection, file: Path | None) -> None:
    """Set up the connection, check for damage (a large file is not checked in advance), and bring the layout up to
    date."""
    version = check_kind(connection, file)
    # Deleted data are not overwritten, regardless of SQLite's default: overwriting took 0.9 s for 100 MB.
    for pragma in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON", "secure_delete = FAST"):
        connection.execute(f"PRAGMA {pragma}")
    if file is not None and file.stat().st_size <= _CHECKED_BYTES:
        (finding,) = connection.execute("PRAGMA quick_check(1)").fetchone()
        if finding != "ok":
            raise WrongStoreError(f"the store {file} is damaged ({finding.splitlines()[-1]}); restore it from a copy")
    connection.execute("BEGIN IMMEDIATE")
    for layout in _LAYOUTS[version:]:
        for statement in filter(str.strip, layout.split(";")):
            connection.execute(statement)
    connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
    if not version:
        connection.execute(f"PRAGMA application_id = {_APPLICATION}")
        connection.execute("INSERT INTO realm (id, incarnation) VALUES (?, 0)", (new_cluster_name(),))
    # Blobs that an earlier coordinator did not finish are deleted like abandoned uploads.
    connection.execute("INSERT OR IGNORE INTO uploads SELECT digest FROM blobs WHERE NOT complete")
    if connection.execute("UPDATE realm SET incarnation = incarnation + 1").rowcount != 1:
        raise WrongStoreError(f"the store {file} is damaged (it has no name); restore it from a copy")
    connection.execute("COMMIT")


def new_cluster_name() -> str:
    """Return a random name for a cluster."""
    return uuid.uuid4().hex[:12]
