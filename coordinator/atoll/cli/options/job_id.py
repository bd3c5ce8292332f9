"""The id of a job, as ``--id`` gives it or made up."""

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
