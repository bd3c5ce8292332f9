"""Copies a store while it is served, and restores a store from a copy. No coordinator is needed for either.

A copy is one file with the contents of one instant. SQLite's backup API reads the store in one transaction, which in
WAL mode neither blocks writers nor sees their changes. It reads in steps; in the pauses the coordinator can use the
disk.
"""

import contextlib
import os
import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from atoll_coordinator.service.store.lock import Lock
from atoll_coordinator.service.store.schema import BUSY_LIMIT_S, FILE_NAME, check_kind, new_cluster_name
from atoll_core.errors import StoreError, WrongStoreError

STEP_PAGES: Final = 1024
"""Pages of 4 KB that are read in one step: 4 MB, which a disk reads in some milliseconds. A commit waits for at most
one step."""

PAUSE_S: Final = 0.005
"""Pause between two steps, about as long as a step takes, so that a backup uses at most half of the disk's time."""

_COMPANIONS: Final = ("-wal", "-shm", "-journal")
"""Suffixes of the files that SQLite keeps next to a store. SQLite applies them to any store of that name on opening."""


@dataclass(frozen=True, slots=True)
class Copy:
    """A copy: the name of the cluster, the last incarnation, the number of jobs, and the size in bytes."""

    cluster: str
    incarnation: int
    jobs: int
    size: int


@dataclass(frozen=True, slots=True)
class Restored:
    """A restored store: its copy, its new cluster name, the former store, and all renamed files.

    `aside` also has SQLite's files of a store whose main file had been moved away (then `former` is None).
    """

    copy: Copy
    cluster: str
    former: Path | None
    aside: tuple[Path, ...] = ()


def back_up(directory: Path, target: Path, show: Callable[[int, int], None] = lambda done, pages: None) -> Copy:
    """Copy the store in `directory`, which may be served meanwhile, into the new file `target`, and check the copy.

    `show` is called with the number of copied pages and of all pages. After an error there is no `target`.

    Raises:
        StoreError: There is no store, or it is damaged or foreign; `target` exists already or cannot be written.
    """
    source = directory / FILE_NAME
    if not source.is_file():
        raise WrongStoreError(f"there is no store in {directory}; name the folder of `coordinator serve` with --state")
    with _draft_for(target) as draft, contextlib.closing(_connect(source)) as store:
        with _translate_errors(f"the store {source} cannot be copied", "choose an undamaged store"):
            check_kind(store, source)
            store.execute("BEGIN")
            store.execute("SELECT count(*) FROM realm").fetchone()  # the copy has the contents of this instant
        with (
            _translate_errors(f"the copy {target} cannot be written", "check that there is room"),
            contextlib.closing(sqlite3.connect(draft, isolation_level=None)) as copy,
        ):

            def take_step(_: int, left: int, pages: int) -> None:
                _sync(draft)  # otherwise everything is written at the end, and every commit waits for it
                show(pages - left, pages)

            store.backup(copy, pages=STEP_PAGES, progress=take_step, sleep=PAUSE_S)
            copy.execute("PRAGMA journal_mode = DELETE")  # one file, without a WAL
        return check_copy(draft, f"the copy of {source}")


def check_copy(file: Path, what: str, mode: str = "ro") -> Copy:
    """Check a whole file, opened in SQLite's `mode`, and return a summary; error messages call the file `what`.

    Raises:
        StoreError: The file is damaged, no store, of a newer version, or cannot be read.
    """
    advice = "use another copy"
    with _translate_errors(f"{what} cannot be read", advice), contextlib.closing(_connect(file, mode)) as copy:
        if not check_kind(copy, file):
            raise WrongStoreError(f"{what} holds no store; {advice}")
        (finding,) = copy.execute("PRAGMA integrity_check(1)").fetchone()
        rows = copy.execute("SELECT id, incarnation FROM realm").fetchall() if finding == "ok" else []
        if len(rows) != 1:
            reason = finding.splitlines()[-1] if finding != "ok" else "it has no name"
            raise WrongStoreError(f"{what} is damaged ({reason}); {advice}")
        (jobs,) = copy.execute("SELECT count(*) FROM jobs").fetchone()
    return Copy(rows[0][0], int(rows[0][1]), int(jobs), file.stat().st_size)


def restore(source: Path, directory: Path, *, replaces: bool = False) -> Restored:
    """Create the store in `directory` from the copy `source`, with a new cluster name, open it once and check it.

    The name is new because the copied store may still be served elsewhere, and both stores would issue the same terms.
    With `replaces` an existing store is renamed. SQLite's files of a store that was moved away are always renamed,
    because SQLite would apply them to the new store.

    Raises:
        StoreError: The copy is missing, damaged or no store; the directory has a store or a coordinator, or no room.
    """
    if not source.is_file():
        raise WrongStoreError(f"there is no copy {source}; name a file that `coordinator backup` has written")
    lock = Lock(directory)
    try:
        place = directory / FILE_NAME
        if place.exists() and not replaces:
            raise WrongStoreError(
                f"{directory} has a store already; choose another directory with --state, or rename that store with "
                "--replace"
            )
        found = check_copy(source, f"the copy {source}")
        with _draft_for(place, exists=True) as draft:
            with _translate_errors(f"the store {place} cannot be written", "check that there is room"):
                name = _copy_renamed(source, draft)
            aside = _put_aside(place)
        there = check_copy(place, f"the restored store {place}", "rw")  # opened as `serve` opens it
        if (there.cluster, there.jobs) != (name, found.jobs):
            raise StoreError(
                f"the restored store {place} holds {there.jobs} jobs of the cluster {there.cluster}, but {found.jobs} "
                f"of {name} were expected; restore into an empty directory"
            )
        former = aside[0] if aside and aside[0].suffix == place.suffix else None
        return Restored(found, name, former, aside)
    finally:
        lock.release()


def _copy_renamed(source: Path, target: Path) -> str:
    """Copy a store into another file under a new cluster name; return the name."""
    with (
        contextlib.closing(_connect(source, "ro")) as copy,
        contextlib.closing(sqlite3.connect(target, isolation_level=None)) as store,
    ):
        copy.backup(store)
        name = new_cluster_name()
        store.execute("UPDATE realm SET id = ?", (name,))
        return name


def _put_aside(place: Path) -> tuple[Path, ...]:
    """Rename the files of a store that is not served; return the new names, the store itself first.

    An undamaged store is one file afterwards. If the store was moved away, only SQLite's other files exist.
    """
    with _translate_errors(f"the store {place} cannot be renamed", "move it away by hand"):
        if place.exists():
            try:
                with contextlib.closing(sqlite3.connect(place, isolation_level=None, timeout=BUSY_LIMIT_S)) as former:
                    former.execute("PRAGMA journal_mode = DELETE")
            except sqlite3.DatabaseError:  # a damaged store may be replaced
                pass
        there = [end for end in ("", *_COMPANIONS) if place.with_name(place.name + end).exists()]
        if not there:
            return ()
        numbers = (place.with_name(f"replaced-{number}{place.suffix}") for number in range(1, 10**6))
        base = next(path for path in numbers if not _companions(path))
        aside = tuple(base.with_name(base.name + end) for end in there)
        for end, target in zip(there, aside, strict=True):
            place.with_name(place.name + end).rename(target)
        return aside


def _companions(path: Path) -> list[Path]:
    """Return the existing files of a store: its main file, and SQLite's files next to it."""
    files = (path.with_name(path.name + end) for end in ("", *_COMPANIONS))
    return [file for file in files if file.exists()]


@contextlib.contextmanager
def _draft_for(target: Path, *, exists: bool = False) -> Iterator[Path]:
    """Yield a file that is durably renamed to `target` at the end of the block; after an error it is deleted.

    Raises:
        StoreError: The folder cannot be written; or, unless `exists`, `target` or another file of that store exists
            already.
    """
    there = [] if exists else _companions(target)
    if there:
        raise WrongStoreError(f"{there[0]} exists already; name another file for the copy, or remove this file")
    draft = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with _translate_errors(f"the file {target} cannot be written", "name another file"):
            draft.touch(mode=0o600)  # measurements are private
        yield draft
        with _translate_errors(f"the file {target} cannot be written", "check that there is room"):
            _sync(draft)
            draft.replace(target)
            _sync(target.parent)
    finally:
        for end in ("", *_COMPANIONS):
            draft.with_name(draft.name + end).unlink(missing_ok=True)


def _sync(path: Path) -> None:
    opened = os.open(path, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def _connect(file: Path, mode: str = "rw") -> sqlite3.Connection:
    """Open an existing file. Readers of a store that is served need "rw" because they write to the index of the WAL."""
    uri = f"{file.absolute().as_uri()}?mode={mode}"
    return sqlite3.connect(uri, uri=True, isolation_level=None, timeout=BUSY_LIMIT_S)


@contextlib.contextmanager
def _translate_errors(what: str, advice: str) -> Iterator[None]:
    """Turn errors of SQLite and the system into a StoreError with `what` failed, the reason, and advice."""
    try:
        yield
    except sqlite3.Error as error:
        raise StoreError(f"{what}: {error}; {advice}") from error
    except OSError as error:
        raise StoreError(f"{what}: {(error.strerror or str(error)).lower()}; {advice}") from error
