"""Folders of the user in which programs keep what outlives them."""

import os
import stat
import tempfile
from pathlib import Path

from atoll_core.errors import UsageError


def user_folder(variable: str, usual: str) -> Path:
    """Return the folder that `variable` names, else `usual` in the home folder, else a temporary one of this user.

    `variable` is one of the environment, such as ``XDG_CACHE_HOME``. A user without an entry in the list of users, as a
    container may have, has no home folder. Raises UsageError where the temporary one is somebody else's.
    """
    chosen = os.environ.get(variable)
    if chosen:
        return Path(chosen)
    try:
        return Path.home() / usual
    except RuntimeError:
        return _own_temporary_folder(variable) / usual


def _own_temporary_folder(variable: str) -> Path:
    """Return a folder whose contents nobody else has written: machine code is loaded from there."""
    folder = Path(tempfile.gettempdir()) / f"atoll-of-user-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError as error:
        raise _without_home(folder, variable, error.strerror or str(error)) from error
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o022:
        raise _without_home(folder, variable, "somebody else may write there")
    return folder


def _without_home(folder: Path, variable: str, reason: str) -> UsageError:
    return UsageError(
        f"user {os.getuid()} has no home folder, and {folder} cannot be used instead ({reason}); set HOME or {variable}"
    )
