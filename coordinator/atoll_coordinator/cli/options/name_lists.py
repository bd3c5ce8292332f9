"""Lists of names, as options have them. Pure."""

import csv

from atoll.errors import UsageError


def names(text: str, option: str, noun: str = "column") -> tuple[str, ...]:
    """Split ``x,y`` into names, of columns or another `noun`; a name with a comma is written in double quotes."""
    parts = tuple(part.strip() for part in next(csv.reader([text], skipinitialspace=True), []))
    if not parts or not all(parts):
        raise UsageError(f"{option} must be {noun} names separated by commas, but {text!r} was given")
    twice = next((part for part in parts if parts.count(part) > 1), None)
    if twice is not None:
        raise UsageError(f"{option} names {twice!r} twice; name every {noun} once")
    return parts
