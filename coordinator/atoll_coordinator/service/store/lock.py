"""The lock on the store's directory: one coordinator serves from it, and shows by its lock that it gets on.

The lock is gone with its process. One that hangs keeps it, but its beats stop, and then it may be replaced: what keeps
the hung one from writing when it goes on is the incarnation (`OpenFile.beat`), not the lock.
"""

import contextlib
import errno
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from atoll_core.errors import StoreError, WrongStoreError, may_pass

LOCK_NAME: Final = "lock"
_GUARD_NAME: Final = "takeover"
_BEATS: Final = "beats"
"""Stands in the lock of a coordinator that beats; one of an older version never does, and is not taken for hung."""

_ATTEMPTS: Final = 5
"""How often a lock is tried that is replaced meanwhile; each replacement is another coordinator's takeover."""


class StoreInUseError(StoreError):
    """Raised when another coordinator has the lock; its process is named where that is known."""


@dataclass(frozen=True, slots=True)
class Beat:
    """What a look at a lock finds: while its coordinator gets on, two looks a second apart differ."""

    file: int
    time_ns: int


class Lock:
    """A lock on the store's directory, so that no second coordinator serves from it. Gone with its process."""

    def __init__(self, directory: Path) -> None:
        """Take the lock; raises StoreInUseError when another process has it, StoreError if it cannot be written."""
        for _ in range(_ATTEMPTS):
            file = _opened(directory, directory / LOCK_NAME)
            if not _locks(file):
                holder = os.read(file, 32).decode("ascii", "replace").split()[:1] or ["unknown"]
                os.close(file)
                raise StoreInUseError(
                    f"the store {directory} is in use by another coordinator (process {holder[0]}); "
                    "stop that one, or choose another directory with --state"
                )
            if _is_at(file, directory / LOCK_NAME):
                break
            os.close(file)  # it was replaced between opening and locking it
        else:
            raise StoreInUseError(f"other coordinators take over the store {directory} again and again; stop them")
        _sign(file, directory)
        self._file = file

    @classmethod
    def seize(cls, directory: Path, beat: Beat) -> Self | None:
        """Put a lock of ours into the place of one whose coordinator hangs; None: it, or another one, gets on.

        `beat` is the last that was seen of it. Raises StoreError when the directory cannot be written.
        """
        guard = _opened(directory, directory / _GUARD_NAME)
        try:
            if not _locks(guard) or last_beat(directory) != beat:
                return None
            draft = directory / f".{LOCK_NAME}.{os.getpid()}"
            file = _opened(directory, draft)
            if not _locks(file):
                os.close(file)
                return None
            _sign(file, directory)
            draft.replace(directory / LOCK_NAME)
        finally:
            os.close(guard)
        lock = cls.__new__(cls)
        lock._file = file
        return lock

    def beat(self) -> None:
        """Show that this coordinator gets on."""
        with contextlib.suppress(OSError):  # whoever cannot write this cannot write the store, which says so
            os.utime(self._file)

    def release(self) -> None:
        """Give the lock back."""
        os.close(self._file)


def last_beat(directory: Path) -> Beat | None:
    """Return the last beat of the coordinator that has the lock; None: there is none, or it is of one that never beats.

    Whether it has changed since an earlier look says whether that coordinator gets on; no clocks are compared.
    """
    path = directory / LOCK_NAME
    try:
        if _BEATS not in path.read_text("ascii", "replace"):
            return None
        status = path.stat()
    except OSError:
        return None
    return Beat(status.st_ino, status.st_mtime_ns)


def _opened(directory: Path, path: Path) -> int:
    """Open a file of the directory that its user alone may open: whoever opens a file may lock it."""
    try:
        _make_private(directory)
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        if os.fstat(file).st_mode & 0o077:  # of an earlier version
            os.fchmod(file, 0o600)
        return file
    except OSError as error:
        reason = (error.strerror or "").lower()
        if may_pass(error):
            raise StoreError(f"the store {directory} cannot be written: {reason}; see that there is room") from error
        raise WrongStoreError(
            f"the store {directory} cannot be written: {reason}; choose another directory with --state"
        ) from error


def _make_private(directory: Path) -> None:
    """Make a directory, unless it is there, which its user alone may enter, in folders which others do not write."""
    for parent in reversed(directory.parents):
        if not parent.exists():
            parent.mkdir(mode=0o755, exist_ok=True)
    directory.mkdir(mode=0o700, exist_ok=True)


def _locks(file: int) -> bool:
    """Take the lock on an open file; return whether nobody else has it."""
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            return False
        os.close(file)
        raise StoreError(f"the store cannot be locked: {error}; keep it on a disk of this machine") from error
    return True


def _is_at(file: int, path: Path) -> bool:
    """Tell whether an open file is still the one at `path`."""
    try:
        there = path.stat()
    except OSError:
        return False
    here = os.fstat(file)
    return (here.st_dev, here.st_ino) == (there.st_dev, there.st_ino)


def _sign(file: int, directory: Path) -> None:
    """Write into a locked file whose it is."""
    try:
        os.ftruncate(file, 0)
        os.pwrite(file, f"{os.getpid()} {_BEATS}\n".encode(), 0)
    except OSError as error:
        os.close(file)
        reason = (error.strerror or "").lower()
        raise StoreError(f"the store {directory} cannot be written: {reason}; see that there is room") from error
