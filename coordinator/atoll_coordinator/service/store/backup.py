"""A copy of a store while it is served, and a store made of a copy. SQLite's backup API; no coordinator is asked.

A copy is one file, of one instant: it is read through a transaction of its own, which in WAL mode neither keeps others
from writing nor sees what they write. It is read in steps, with pauses in which the disk is the coordinator's.
"""

import contextlib
import os
import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from atoll_coordinator.service.store.lock import Lock
from atoll_coordinator.service.store.schema import BUSY_LIMIT_S, FILE_NAME, check_kind, rename_cluster
from atoll_core.errors import StoreError, WrongStoreError

STEP_PAGES: Final = 1024
"""Pages of 4 KB that are read at once: 4 MB, some milliseconds of a disk, for which a commit waits at most."""

PAUSE_S: Final = 0.005
"""Between two steps: at most half of the disk's time is taken, where 4 MB take as long."""

_COMPANIONS: Final = ("-wal", "-shm", "-journal")
"""What SQLite keeps beside a file of that name, and plays into whatever file it finds there at the next opening."""


@dataclass(frozen=True, slots=True)
class Copy:
    """What was copied: the cluster of the store, its last incarnation, its jobs, and the bytes of the file."""

    cluster: str
    incarnation: int
    jobs: int
    size: int


@dataclass(frozen=True, slots=True)
class Restored:
    """A store made of a copy: what was copied, the new name of its cluster, and the files that were put aside.

    `former` is the store that was there; None: there was none. `aside` has all that was, also what was left of a store
    whose file had been moved away.
    """

    copy: Copy
    cluster: str
    former: Path | None
    aside: tuple[Path, ...] = ()


def back_up(directory: Path, target: Path, show: Callable[[int, int], None] = lambda done, pages: None) -> Copy:
    """Copy the store in `directory`, which may be served meanwhile, into the file `target`.

    `show` is called with the pages copied and all pages. The copy is checked; `target` is there whole or not at all.

    Raises:
        StoreError: there is no store, or it is damaged or foreign; `target` exists already or cannot be written.
    """
    source = directory / FILE_NAME
    if not source.is_file():
        raise WrongStoreError(f"there is no store in {directory}; name the folder of `coordinator serve` with --state")
    with _draft_of(target) as draft, contextlib.closing(_connected(source)) as store:
        with _translated(f"the store {source} cannot be copied", "choose a sound one"):
            check_kind(store, source)
            store.execute("BEGIN")
            store.execute("SELECT count(*) FROM realm").fetchone()  # from here on this instant is what is seen
        with (
            _translated(f"the copy {target} cannot be written", "see that there is room"),
            contextlib.closing(sqlite3.connect(draft, isolation_level=None)) as copy,
        ):

            def take_step(_: int, left: int, pages: int) -> None:
                _sync(draft)  # else all of it is written at the end, and every commit meanwhile waits for that
                show(pages - left, pages)

            store.backup(copy, pages=STEP_PAGES, progress=take_step, sleep=PAUSE_S)
            copy.execute("PRAGMA journal_mode = DELETE")  # one file, without those of the WAL
        return check_copy(draft, f"the copy of {source}")


def check_copy(file: Path, what: str, mode: str = "ro") -> Copy:
    """Look through all of a copy, called `what`, and return what it holds; opened to read alone, or as `mode` says.

    Raises:
        StoreError: it is damaged, no store, of a newer version, or cannot be read.
    """
    advice = "use another copy"
    with _translated(f"{what} cannot be read", advice), contextlib.closing(_connected(file, mode)) as copy:
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
    """Make the store in `directory` of the copy `source`, under a new name of its cluster.

    The name is new since what the copy does not know of has happened under the old one: terms would be issued twice,
    and the store that was copied may still be served elsewhere. With `replaces` a store that is there is put aside, and
    always what SQLite left beside one that was moved away: it would be played into the new one. The new store is opened
    once, and has the jobs of the copy, before this returns.

    Raises:
        StoreError: the copy is missing, damaged or no store; the directory has a store or a coordinator, or no room.
    """
    if not source.is_file():
        raise WrongStoreError(f"there is no copy {source}; name a file that `coordinator backup` has written")
    lock = Lock(directory)
    try:
        place = directory / FILE_NAME
        if place.exists() and not replaces:
            raise WrongStoreError(
                f"{directory} has a store already; choose another directory with --state, or put that one aside with "
                "--replace"
            )
        found = check_copy(source, f"the copy {source}")
        with _draft_of(place, exists=True) as draft:
            with _translated(f"the store {place} cannot be written", "see that there is room"):
                name = _renamed_copy(source, draft)
            aside = _put_aside(place)
        _require_restored(place, name, found)
        former = aside[0] if aside and aside[0].suffix == place.suffix else None
        return Restored(found, name, former, aside)
    finally:
        lock.release()


def _require_restored(place: Path, name: str, copied: Copy) -> None:
    """Raise StoreError unless the store at `place` is the one that was restored: opened as `serve` opens it."""
    there = check_copy(place, f"the restored store {place}", "rw")
    if (there.cluster, there.jobs) != (name, copied.jobs):
        raise StoreError(
            f"the restored store {place} holds {there.jobs} jobs of the cluster {there.cluster}, but {copied.jobs} of "
            f"{name} were expected; restore into an empty directory"
        )


def _renamed_copy(source: Path, target: Path) -> str:
    """Copy a file into another, which becomes a cluster of another name; return that name."""
    with (
        contextlib.closing(_connected(source, "ro")) as copy,
        contextlib.closing(sqlite3.connect(target, isolation_level=None)) as store,
    ):
        copy.backup(store)
        store.execute("BEGIN IMMEDIATE")
        name = rename_cluster(store)
        store.execute("COMMIT")
        return name


def _put_aside(place: Path) -> tuple[Path, ...]:
    """Give all that is there of a store that nobody serves other file names, and return them, that of the store first.

    A store that is sound is whole in one file then; of one that was moved away its companions alone are left.
    """
    with _translated(f"the store {place} cannot be put aside", "move it away by hand"):
        if place.exists():
            try:
                with contextlib.closing(sqlite3.connect(place, isolation_level=None, timeout=BUSY_LIMIT_S)) as former:
                    former.execute("PRAGMA journal_mode = DELETE")
            except sqlite3.DatabaseError:  # it may be replaced just because it is damaged
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
    """Return what there is of a store: its file, and what SQLite has put beside it."""
    files = (path.with_name(path.name + end) for end in ("", *_COMPANIONS))
    return [file for file in files if file.exists()]


@contextlib.contextmanager
def _draft_of(target: Path, *, exists: bool = False) -> Iterator[Path]:
    """Yield a file beside `target` that takes its place at the end of the block, durably; after an error it is gone.

    Raises:
        StoreError: `target` exists, or what SQLite left beside a file of that name, unless that is as it should be; or
            its folder cannot be written.
    """
    there = [] if exists else _companions(target)
    if there:
        raise WrongStoreError(f"{there[0]} exists already; name another file for the copy, or remove it")
    draft = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with _translated(f"the file {target} cannot be written", "name another"):
            draft.touch(mode=0o600)  # what users have measured is nobody else's
        yield draft
        with _translated(f"the file {target} cannot be written", "see that there is room"):
            _sync(draft)
            draft.replace(target)
            _sync(target.parent)
    finally:
        for end in ("", *_COMPANIONS):
            draft.with_name(draft.name + end).unlink(missing_ok=True)


def _sync(path: Path) -> None:
    """Have what was written to a file or a folder be on the disk."""
    opened = os.open(path, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def _connected(file: Path, mode: str = "rw") -> sqlite3.Connection:
    """Open an existing file; "ro": for reading. Of a store that is served readers write to the index of the WAL."""
    uri = f"{file.absolute().as_uri()}?mode={mode}"
    return sqlite3.connect(uri, uri=True, isolation_level=None, timeout=BUSY_LIMIT_S)


@contextlib.contextmanager
def _translated(what: str, advice: str) -> Iterator[None]:
    """Turn what SQLite and the system raise into a StoreError: `what` went wrong, why, and what to do."""
    try:
        yield
    except sqlite3.Error as error:
        raise StoreError(f"{what}: {error}; {advice}") from error
    except OSError as error:
        raise StoreError(f"{what}: {(error.strerror or str(error)).lower()}; {advice}") from error
