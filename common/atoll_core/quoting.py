"""Values in messages: quoted, shortened, made safe for terminals, and suggestions for names that are not known."""

import re
import unicodedata
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import Final

from atoll_core.errors import UsageError

_LIKENESS: Final = 0.6
"""Smallest share of characters that two similar names have in common, in order, as `difflib` measures it."""


def similar_file(path: Path) -> str:
    """Return ``; did you mean 'a.csv'?`` for a missing file, "" where its folder has no similar name."""
    try:
        return did_you_mean(
            path.name, [neighbour.name for neighbour in path.parent.iterdir() if neighbour.name != path.name]
        )
    except OSError:
        return ""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return ``; did you mean 'states'?`` for the end of a sentence, "" where no known name is similar to `name`."""
    import difflib  # takes a few milliseconds, and is rarely needed

    by_lower = {word.lower(): word for word in known}
    close = difflib.get_close_matches(name.lower(), by_lower, n=1, cutoff=_LIKENESS)
    return f"; did you mean '{by_lower[close[0]]}'?" if close else ""


_LONGEST: Final = 40
"""Largest number of characters of a value in a sentence."""
_MOST_LINES: Final = 20
_WIDEST: Final = 160
"""Largest number of lines, and of characters in a line, of a value in a notebook."""


_SPECIAL: Final = re.compile(r"[^\x20-\x7e\t\n\r]|\r(?!\n)")
_UNSEEN: Final = ("Cc", "Cf", "Co", "Cs", "Zl", "Zp")
"""Categories in Unicode of characters that can control a terminal or are invisible: control, format and private-use
characters, surrogates, separators of lines."""


def visible(text: str) -> str:
    """Return a text in which special characters cannot control a terminal; escapes as in JSON."""
    return _SPECIAL.sub(_escaped, text)


def _escaped(found: re.Match[str]) -> str:
    character = found[0]
    if unicodedata.category(character) not in _UNSEEN:
        return character
    units = character.encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{units[place : place + 4]}" for place in range(0, len(units), 4))


def visible_line(text: str) -> str:
    """Return `visible` text as one line."""
    return visible(text).replace("\r\n", "\\u000a").replace("\n", "\\u000a").replace("\t", "\\u0009")


def shown(value: object) -> str:
    """Return a value as one short line; of a value that cannot be shown, its type."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # a class of the caller
        text = f"an object of type {type(value).__name__}"
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def enumerated(names: Sequence[str], most: int | None = None) -> str:
    """Return names as ``a, b and c``; with more than `most`, the first ones and the number of the others."""
    if most is not None and len(names) > most:
        return f"{', '.join(names[:most])} and {len(names) - most} more"
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


def first_lines(text: str, more: str) -> str:
    """Return the beginning of a text in lines that fit on a screen; where lines are missing, add `more`."""
    lines = [line if len(line) <= _WIDEST else f"{line[: _WIDEST - 1]}…" for line in text.splitlines()]
    if len(lines) <= _MOST_LINES:
        return "\n".join(lines)
    return "\n".join([*lines[: _MOST_LINES - 1], f"… {len(lines) - _MOST_LINES + 1} more lines; {more}"])


def path_of(value: object) -> Path:
    """Return a path; raises UsageError."""
    if not isinstance(value, (str, PathLike)):
        raise UsageError(f"a path must be text, but {shown(value)} was given")
    return Path(value)


def write_text(path: str | Path, text: str) -> None:
    """Write a file; raises UsageError."""
    try:
        path_of(path).write_text(text, "utf-8")
    except OSError as error:
        raise UsageError(f"{path} cannot be written ({error.strerror}); name another file") from error
