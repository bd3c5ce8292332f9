"""The lock on the store's directory: only one coordinator serves the store, and beats show that this coordinator runs.

A beat is a new modification time of the lock file.
The operating system releases the lock when its process dies. A process that hangs keeps the lock, but its beats stop,
and then another coordinator may replace the lock file. If the hung process continues later, the incarnation
(`OpenFile.beat`), not the lock, keeps it from writing.

Any user who may open a file may lock it. Therefore a lock file of an earlier version, which other users could open, is
replaced by a new file.
"""

import contextlib
import errno
import logging
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from atoll_coordinator.service.store.privacy import close_to_others, is_open
from atoll_core.errors import StoreError, WrongStoreError, may_pass
from atoll_core.logs import fields

_LOG = logging.getLogger("coordinator")

LOCK_NAME: Final = "lock"
_GUARD_NAME: Final = "guard"
"""Name of a second lock, which a process takes while it replaces the lock. Earlier versions used a file of another
name, which other users could open."""

_BEATS: Final = "beats"
"""A mark in the lock file: the coordinator that has the lock writes beats. Coordinators of older versions never beat,
and are not treated as hung."""

_SIGN_OF_LIFE_S: Final = 3.0
"""Seconds to wait for a beat (six ticks of a coordinator) if other users could open the lock and it has no process
id."""

_ATTEMPTS: Final = 5
"""Attempts to take a lock that other coordinators replace during the attempt."""


class StoreInUseError(StoreError):
    """Raised when another coordinator has the lock; the message has its process id if that is known."""


@dataclass(frozen=True, slots=True)
class Beat:
    """The last beat read from a lock. While its coordinator runs, two beats read a second apart differ."""

    file: int
    time_ns: int


class Lock:
    """A lock on the store's directory, so that no second coordinator serves from it. The operating system releases it
    when the process dies."""

    def __init__(self, directory: Path) -> None:
        """Take the lock; raises StoreInUseError when another process has it, StoreError if it cannot be written."""
        closed = _close_to_others(directory)
        if closed:
            sentence = "other users of this machine could read the store; their access has been removed"
            _LOG.warning(sentence, extra=fields(store=str(directory), closed=", ".join(closed)))
        for _ in range(_ATTEMPTS):
            file = _open_private(directory, directory / LOCK_NAME)
            if not _take_lock(file):
                holder = _holder_process(file)
                os.close(file)
                process = f" (process {holder})" if holder is not None else ""
                raise StoreInUseError(
                    f"the store {directory} is in use by another coordinator{process}; "
                    "stop it, or choose another directory with --state"
                )
            if _is_at(file, directory / LOCK_NAME):
                break
            os.close(file)  # it was replaced between opening and locking it
        else:
            raise StoreInUseError(f"other coordinators keep taking over the store {directory}; stop them")
        _write_process_id(file, directory)
        self._file = file

    @classmethod
    def seize(cls, directory: Path, beat: Beat) -> Self | None:
        """Replace the lock of a hung coordinator, and return the new lock; None: that coordinator or another one runs.

        `beat` is its last known beat. Raises StoreError when the directory cannot be written.
        """
        with _guard_replacement(directory) as is_ours:
            if not is_ours or last_beat(directory) != beat:
                return None
            file = _open_replacement(directory)
            _write_process_id(file, directory)
            _draft(directory).replace(directory / LOCK_NAME)
        lock = cls.__new__(cls)
        lock._file = file
        return lock

    def beat(self) -> None:
        """Write a beat, which shows that this coordinator runs."""
        with contextlib.suppress(OSError):  # if this fails, writing the store fails as well and reports it
            os.utime(self._file)

    def release(self) -> None:
        """Release the lock."""
        os.close(self._file)


def last_beat(directory: Path) -> Beat | None:
    """Return the last beat of the coordinator with the lock; None: there is none, or it never beats.

    If the beat has changed since it was last read, the coordinator runs; no clocks are compared.
    """
    path = directory / LOCK_NAME
    try:
        if _BEATS not in path.read_text("ascii", "replace"):
            return None
        status = path.stat()
    except OSError:
        return None
    return Beat(status.st_ino, status.st_mtime_ns)


def _close_to_others(directory: Path) -> tuple[str, ...]:
    """Remove the access of other users to a store made by an earlier version; return the names of the files changed.

    Raises StoreError when the directory cannot be written.
    """
    path = directory / LOCK_NAME
    closed = close_to_others(directory)
    try:
        if not is_open(path.stat()):
            return closed
    except OSError:
        return closed
    with _guard_replacement(directory, waits=True):
        return (*closed, LOCK_NAME) if _replace_open(directory) else closed


def _replace_open(directory: Path) -> bool:
    """Replace a lock file that other users could open by a new file, unless a coordinator has the lock.

    Another user who opened the file may hold its lock for ever. A coordinator is recognised by its process, which
    belongs to our user, or by its beats. A coordinator that opened the former file in the meantime finds that the file
    was replaced, and opens the new file.
    """
    path = directory / LOCK_NAME
    file = _open_private(directory, path)
    try:
        if not is_open(os.fstat(file)) or not _is_at(file, path):
            return False  # another coordinator was faster
        if not _take_lock(file) and (_holder_process(file) is not None or _is_beating(directory)):
            return False
        os.close(_open_replacement(directory))
        _draft(directory).replace(path)
        return True
    finally:
        os.close(file)


def _is_beating(directory: Path) -> bool:
    """Return whether the coordinator that has the lock beats; other processes cannot write to the lock."""
    before = last_beat(directory)
    time.sleep(_SIGN_OF_LIFE_S)
    return last_beat(directory) != before


def _holder_process(file: int) -> int | None:
    """Return the process whose id is in an open lock file; None: it does not run, or is not the holder.

    A holder has this file open and belongs to our user.
    """
    try:
        process = int(os.pread(file, 32, 0).split()[0])
        if not Path("/proc/self/fd").exists():  # not Linux
            os.kill(process, 0)
            return process
        here, owner = os.fstat(file), Path(f"/proc/{process}").stat().st_uid
        is_ours = owner in (os.geteuid(), here.st_uid)
        return process if is_ours and _has_open(process, here) else None
    except (OSError, ValueError, IndexError, OverflowError):
        return None


def _has_open(process: int, file: os.stat_result) -> bool:
    for entry in Path(f"/proc/{process}/fd").iterdir():
        with contextlib.suppress(OSError):  # closed meanwhile
            if os.path.samestat(entry.stat(), file):
                return True
    return False


@contextlib.contextmanager
def _guard_replacement(directory: Path, *, waits: bool = False) -> Iterator[bool]:
    """Yield whether this process alone may replace the lock during the block; `waits`: wait for other processes."""
    guard = _open_private(directory, directory / _GUARD_NAME)
    try:
        yield _take_lock(guard, waits=waits)
    finally:
        os.close(guard)


def _draft(directory: Path) -> Path:
    return directory / f".{LOCK_NAME}.{os.getpid()}"


def _open_replacement(directory: Path) -> int:
    """Return an open and locked file that will become the lock; call it only within the guard."""
    _draft(directory).unlink(missing_ok=True)  # left by a dead process that had the same id
    file = _open_private(directory, _draft(directory))
    _take_lock(file)
    return file


def _open_private(directory: Path, path: Path) -> int:
    """Open a file of the directory, creating it if necessary. Only its user gets access, because any user who can open
    a file can lock it."""
    try:
        _make_private(directory)
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        reason = (error.strerror or "").lower()
        if may_pass(error):
            raise StoreError(f"the store {directory} cannot be written: {reason}; check that there is room") from error
        raise WrongStoreError(
            f"the store {directory} cannot be written: {reason}; choose another directory with --state"
        ) from error


def _make_private(directory: Path) -> None:
    """Create a missing directory that only its user may enter; only this user may write in new parent folders."""
    for parent in reversed(directory.parents):
        if not parent.exists():
            parent.mkdir(mode=0o755, exist_ok=True)
    directory.mkdir(mode=0o700, exist_ok=True)


def _take_lock(file: int, *, waits: bool = False) -> bool:
    """Take the lock on an open file, waiting for it if `waits`; return whether this process has it now."""
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if waits else fcntl.LOCK_NB))
    except OSError as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            return False
        os.close(file)
        raise StoreError(f"the store cannot be locked: {error}; keep it on a disk of this machine") from error
    return True


def _is_at(file: int, path: Path) -> bool:
    """Return whether an open file is still the file at `path`."""
    try:
        there = path.stat()
    except OSError:
        return False
    here = os.fstat(file)
    return (here.st_dev, here.st_ino) == (there.st_dev, there.st_ino)


def _write_process_id(file: int, directory: Path) -> None:
    """Write the id of this process into a locked file."""
    try:
        os.ftruncate(file, 0)
        os.pwrite(file, f"{os.getpid()} {_BEATS}\n".encode(), 0)
    except OSError as error:
        os.close(file)
        reason = (error.strerror or "").lower()
        raise StoreError(f"the store {directory} cannot be written: {reason}; check that there is room") from error
