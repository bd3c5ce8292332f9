"""Folders of files that were sent: a process that is killed leaves them, and the next one of its user removes them."""

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

PREFIX: Final = "atoll-web-"
_LOCK: Final = "lock"


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold a folder while the block lasts: the system lets it go however this process ends."""
    made = folder / f"{_LOCK}.new"
    descriptor = os.open(made, os.O_CREAT | os.O_RDWR, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        made.rename(folder / _LOCK)  # only now can `remove_left` find it: there is no moment at which it is not held
        yield
    finally:
        os.close(descriptor)


def remove_left() -> None:
    """Remove the folders of this user's processes that are gone: those whose lock nobody holds.

    One that is being made has no lock yet. A process that is killed then leaves it, empty.
    """
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            if folder.is_symlink() or folder.stat().st_uid != os.getuid():
                continue
            descriptor = os.open(folder / _LOCK, os.O_RDWR)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(descriptor)
