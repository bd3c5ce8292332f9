"""Names as options have them: ids of jobs and lists of columns. Pure."""

import csv
import re
import uuid
from typing import Final

from atoll_core.errors import UsageError

_ID: Final = re.compile(r"[A-Za-z0-9_-]{1,64}")


def job_id(text: str | None) -> str:
    """Return the id given, checked, or a new one; raises UsageError."""
    if text is None:
        return uuid.uuid4().hex[:8]
    if not _ID.fullmatch(text):
        raise UsageError(f"--id must be 1 to 64 letters, digits, _ or -, but {text!r} was given")
    return text


def names(text: str, option: str, noun: str = "column") -> tuple[str, ...]:
    """Split ``x,y`` into names, of columns or another `noun`; a name with a comma is written in double quotes."""
    parts = tuple(part.strip() for part in next(csv.reader([text], skipinitialspace=True), []))
    if not parts or not all(parts):
        raise UsageError(f"{option} must be {noun} names separated by commas, but {text!r} was given")
    twice = next((part for part in parts if parts.count(part) > 1), None)
    if twice is not None:
        raise UsageError(f"{option} names {twice!r} twice; name every {noun} once")
    return parts
