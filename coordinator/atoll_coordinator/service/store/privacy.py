"""Removes other users' access to a store's folder and files, which earlier versions did not restrict."""

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from atoll_coordinator.service.store.schema import FILE_NAME

OTHERS: Final = 0o077
"""Permission bits of the group and of other users."""

_OWN_FILES: Final = (f"{FILE_NAME}*", "replaced-*", "lock", "guard", "takeover", ".lock.*", f".{FILE_NAME}.*")
"""The store, SQLite's files next to it, replaced stores, and locks."""


def is_open(status: os.stat_result) -> bool:
    """Return whether users other than its owner have any access to a file."""
    return bool(status.st_mode & OTHERS)


def close_to_others(directory: Path) -> tuple[str, ...]:
    """Remove other users' access to our files of the store in a directory; return the names of the files changed.

    The directory itself is restricted only if it has no other files. The lock file is not changed (`Lock` replaces it).
    """
    own = {path for pattern in _OWN_FILES for path in directory.glob(pattern)}
    files = sorted(path for path in own if path.name != "lock")
    closed = [path.name for path in files if _close(path)]
    if own and own.issuperset(_entries(directory)) and _close(directory):
        closed.insert(0, "its folder")
    return tuple(closed)


def _close(path: Path) -> bool:
    """Remove the permissions of other users; return whether there were any. Links and files of other owners are not
    changed."""
    with contextlib.suppress(OSError):  # SQLite has removed the file, or the file system has no modes
        status = path.lstat()
        if is_open(status) and status.st_uid == os.geteuid() and not stat.S_ISLNK(status.st_mode):
            path.chmod(stat.S_IMODE(status.st_mode) & ~OTHERS)
            return not is_open(path.lstat())
    return False


def _entries(directory: Path) -> Iterator[Path]:
    with contextlib.suppress(OSError):
        yield from directory.iterdir()
