"""Values that a person has given, as a sentence quotes them."""

from os import PathLike
from pathlib import Path
from typing import Final

from atoll_core.errors import UsageError

_LONGEST: Final = 40
"""Characters of a value that a sentence shows."""
_MOST_LINES: Final = 20
_WIDEST: Final = 160
"""Lines, and characters of each, of what a value shows of itself in a notebook."""


def shown(value: object) -> str:
    """Return a value as one short line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def first_lines(text: str, more: str) -> str:
    """Return the beginning of a text for people, in lines that a screen holds; where lines are left out, say `more`."""
    lines = [line if len(line) <= _WIDEST else f"{line[: _WIDEST - 1]}…" for line in text.splitlines()]
    if len(lines) <= _MOST_LINES:
        return "\n".join(lines)
    return "\n".join([*lines[: _MOST_LINES - 1], f"… {len(lines) - _MOST_LINES + 1} more lines; {more}"])


def path_of(value: object) -> Path:
    """Return a path; raises UsageError."""
    if not isinstance(value, (str, PathLike)):
        raise UsageError(f"a path must be text, but {shown(value)} was given")
    return Path(value)
