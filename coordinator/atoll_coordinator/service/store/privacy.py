"""A store's folder and files, closed to all other users: those that an earlier version made were open to them."""

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from atoll_coordinator.service.store.schema import FILE_NAME

OTHERS: Final = 0o077
"""What group and other users may do with a file."""

_OWN_FILES: Final = (f"{FILE_NAME}*", "replaced-*", "lock", "guard", "takeover", ".lock.*", f".{FILE_NAME}.*")
"""The store, what SQLite puts next to it, former stores, and locks."""


def is_open(status: os.stat_result) -> bool:
    """Tell whether others than its user may do anything with a file."""
    return bool(status.st_mode & OTHERS)


def close_to_others(directory: Path) -> tuple[str, ...]:
    """Close the store in a directory to all other users, as far as it is ours; return the names of what was open.

    The directory itself is closed where it holds nothing else. A lock stays as it is (`Lock` replaces it).
    """
    own = {path for pattern in _OWN_FILES for path in directory.glob(pattern)}
    files = sorted(path for path in own if path.name != "lock")
    closed = [path.name for path in files if _close(path)]
    if own and own.issuperset(_entries(directory)) and _close(directory):
        closed.insert(0, "its folder")
    return tuple(closed)


def _close(path: Path) -> bool:
    """Take all rights from others; return whether they had some. What is not ours, or a link, stays as it is."""
    with contextlib.suppress(OSError):  # it is gone, as SQLite removes its files, or the file system has no modes
        status = path.lstat()
        if is_open(status) and status.st_uid == os.geteuid() and not stat.S_ISLNK(status.st_mode):
            path.chmod(stat.S_IMODE(status.st_mode) & ~OTHERS)
            return not is_open(path.lstat())
    return False


def _entries(directory: Path) -> Iterator[Path]:
    with contextlib.suppress(OSError):
        yield from directory.iterdir()
