"""What a person may have meant by a name that is not known. Light, because the command line is."""

from collections.abc import Iterable
from pathlib import Path
from typing import Final

_LIKENESS: Final = 0.6
"""Least share of characters that two names have in common, in order, as `difflib` measures it by default."""


def similar_file(path: Path) -> str:
    """Return ``; did you mean 'a.csv'?`` for a file that is not there, "" where its folder has none like it."""
    try:
        return did_you_mean(
            path.name, [neighbour.name for neighbour in path.parent.iterdir() if neighbour.name != path.name]
        )
    except OSError:
        return ""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return ``; did you mean 'states'?`` for the end of a sentence, "" where nothing known is like `name`."""
    import difflib  # takes a few milliseconds, and is rarely needed

    by_lower = {word.lower(): word for word in known}
    close = difflib.get_close_matches(name.lower(), by_lower, n=1, cutoff=_LIKENESS)
    return f"; did you mean '{by_lower[close[0]]}'?" if close else ""
