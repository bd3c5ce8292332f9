"""Values of options: a job's id, numbers, intervals, and values by name. Raises UsageError."""

import math
import uuid
from collections.abc import Callable, Sequence
from typing import TypeVar

from atoll_core.errors import UsageError
from atoll_core.wire.topics import is_id

T = TypeVar("T")


def job_id(text: str | None) -> str:
    """Return the id that ``--id`` gives, or a new one."""
    if text is None:
        return uuid.uuid4().hex[:8]
    if not is_id(text):
        raise UsageError(f"--id must be 1 to 64 letters, digits, _ or -, but {text!r} was given")
    return text


def finite_number(text: str, option: str) -> float:
    """Return a number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{option} must be a finite number, but {text!r} was given")
    return value


def whole_number(text: str, option: str) -> int:
    """Return a whole number, 0 or more."""
    if not text.isdecimal():
        raise UsageError(f"{option} must be a whole number, but {text!r} was given")
    return int(text)


def if_given(read: Callable[[str, str], T], text: str | None, option: str) -> T | None:
    """Return what `read` makes of the text of an option; None where it was not given."""
    return None if text is None else read(text, option)


def interval(text: str, option: str) -> tuple[float, float]:
    """Return the bounds of ``0:3``."""
    lower, separator, upper = text.partition(":")
    if not separator:
        raise UsageError(f"{option} wants LOWER:UPPER, but got {text!r}")
    low, high = finite_number(lower, option), finite_number(upper, option)
    if not low < high:
        raise UsageError(f"{option} wants LOWER below UPPER, but got {text!r}")
    return low, high


def assignments(texts: Sequence[str], option: str, example: str) -> dict[str, str]:
    """Return the values by name of ``x=0:3``; several may stand in one text, separated by commas."""
    values: dict[str, str] = {}
    for text in (part for line in texts for part in line.split(",")):
        name, separator, value = (part.strip() for part in text.partition("="))
        if not separator or not name or not value:
            raise UsageError(f"{option} wants {example}, but got {text!r}")
        if name in values:
            raise UsageError(f"{option} names '{name}' twice; give one")
        values[name] = value
    return values


def numbers(texts: Sequence[str], option: str, example: str) -> dict[str, float]:
    """Return the numbers by name of ``u=1``."""
    return {name: finite_number(text, f"{option} {name}") for name, text in assignments(texts, option, example).items()}


def intervals(texts: Sequence[str], option: str) -> dict[str, tuple[float, float]]:
    """Return the bounds by name of ``x=0:3``."""
    return {name: interval(text, f"{option} {name}") for name, text in assignments(texts, option, "x=0:3").items()}
