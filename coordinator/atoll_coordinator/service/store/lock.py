"""The lock on the store's directory: one coordinator serves from it, and shows by its lock that it gets on.

The lock is gone with its process. One that hangs keeps it, but its beats stop, and then it may be replaced: what keeps
the hung one from writing when it goes on is the incarnation (`OpenFile.beat`), not the lock.

Whoever may open a file may lock it. A lock that others could open, of an earlier version, is replaced by another file.
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
"""The lock under which a lock is replaced. Earlier versions had another name, of a file that others could open."""

_BEATS: Final = "beats"
"""Stands in the lock of a coordinator that beats; one of an older version never does, and is not taken for hung."""

_SIGN_OF_LIFE_S: Final = 3.0
"""How long a beat is waited for, six ticks of a coordinator, where a lock that others could open names no process."""

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
        closed = _close_to_others(directory)
        if closed:
            sentence = "the store could be read by other users of this machine; it is closed to them now"
            _LOG.warning(sentence, extra=fields(store=str(directory), closed=", ".join(closed)))
        for _ in range(_ATTEMPTS):
            file = _opened(directory, directory / LOCK_NAME)
            if not _locks(file):
                holder = _holder(file)
                os.close(file)
                process = f" (process {holder})" if holder is not None else ""
                raise StoreInUseError(
                    f"the store {directory} is in use by another coordinator{process}; "
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
        with _guarded(directory) as is_ours:
            if not is_ours or last_beat(directory) != beat:
                return None
            file = _replacement(directory)
            _sign(file, directory)
            _draft(directory).replace(directory / LOCK_NAME)
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


def _close_to_others(directory: Path) -> tuple[str, ...]:
    """Close a store that an earlier version made to all other users; return the names of what was open.

    Raises StoreError when the directory cannot be written.
    """
    path = directory / LOCK_NAME
    closed = close_to_others(directory)
    try:
        if not is_open(path.stat()):
            return closed
    except OSError:
        return closed
    with _guarded(directory, waits=True):
        return (*closed, LOCK_NAME) if _replace_open(directory) else closed


def _replace_open(directory: Path) -> bool:
    """Put another file in the place of a lock that others could open, unless a coordinator has it.

    Whoever opened it may hold its lock for ever. A coordinator is told from them by its process, which is one of ours,
    or by its beats. One that opened the former file meanwhile finds that it was replaced, and opens the new one.
    """
    path = directory / LOCK_NAME
    file = _opened(directory, path)
    try:
        if not is_open(os.fstat(file)) or not _is_at(file, path):
            return False  # another one was faster
        if not _locks(file) and (_holder(file) is not None or _beats(directory)):
            return False
        os.close(_replacement(directory))
        _draft(directory).replace(path)
        return True
    finally:
        os.close(file)


def _beats(directory: Path) -> bool:
    """Tell whether the coordinator that has the lock shows that it gets on; others cannot write to the lock."""
    before = last_beat(directory)
    time.sleep(_SIGN_OF_LIFE_S)
    return last_beat(directory) != before


def _holder(file: int) -> int | None:
    """Return the process that has signed an open lock; None unless it is there, has the lock open, and is ours."""
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
def _guarded(directory: Path, *, waits: bool = False) -> Iterator[bool]:
    """Yield whether we alone may replace the lock of a directory during the block; perhaps once others have done so."""
    guard = _opened(directory, directory / _GUARD_NAME)
    try:
        yield _locks(guard, waits=waits)
    finally:
        os.close(guard)


def _draft(directory: Path) -> Path:
    return directory / f".{LOCK_NAME}.{os.getpid()}"


def _replacement(directory: Path) -> int:
    """Return a file, open and locked, that is to become the lock; only under the guard."""
    _draft(directory).unlink(missing_ok=True)  # of a process of the same number that died here
    file = _opened(directory, _draft(directory))
    _locks(file)
    return file


def _opened(directory: Path, path: Path) -> int:
    """Open a file of the directory, making it if need be, for its user alone: whoever opens a file may lock it."""
    try:
        _make_private(directory)
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
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


def _locks(file: int, *, waits: bool = False) -> bool:
    """Take the lock on an open file, perhaps once it is free; return whether nobody else has it."""
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
