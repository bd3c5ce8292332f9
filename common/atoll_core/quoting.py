"""Values that a person has given, as a sentence quotes them."""

from os import PathLike
from pathlib import Path
from typing import Final

from atoll_core.errors import UsageError

_LONGEST: Final = 40
"""Characters of a value that a sentence shows."""


def shown(value: object) -> str:
    """Return a value as one short line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def path_of(value: object) -> Path:
    """Return a path; raises UsageError."""
    if not isinstance(value, (str, PathLike)):
        raise UsageError(f"a path must be text, but {shown(value)} was given")
    return Path(value)
