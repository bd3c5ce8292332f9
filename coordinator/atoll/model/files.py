"""Files that users name."""

from pathlib import Path

from atoll_core.errors import UsageError
from atoll_core.quoting import path_of


def write_text(path: str | Path, text: str) -> None:
    """Write a file; raises UsageError."""
    try:
        path_of(path).write_text(text, "utf-8")
    except OSError as error:
        raise UsageError(f"{path} cannot be written ({error.strerror}); name another file") from error
