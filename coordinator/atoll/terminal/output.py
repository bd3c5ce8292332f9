"""The output of commands: lines on stdout, notes on stderr, JSON, and plain aligned tables."""

import contextlib
import json
import re
import sys
from collections.abc import Iterable, Mapping, Sequence

from atoll_core.command_line import unwritable
from atoll_core.quoting import visible, visible_line

_NUMBERS = re.compile(r"\[\n[^\[\]{}\"]+\]")
_FACTOR_OF_ONE = re.compile(r"(?<![\w.*/])(?<!e[+-])1\*(?!\*)")
_NUMBER = re.compile(r"(?<![\w.])\d+\.?\d*(?:[eE][+-]?\d+)?")


def say(text: str) -> None:
    """Print a result on stdout; raises AtollError if it cannot be written, unless the reader has closed the pipe."""
    try:
        sys.stdout.write(visible(text if text.endswith("\n") else text + "\n"))
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        raise unwritable(error) from error


def note(text: str) -> None:
    """Print progress or advice on stderr; errors are ignored."""
    with contextlib.suppress(OSError):
        sys.stderr.write(visible(text) + "\n")
        sys.stderr.flush()


def as_json(value: object) -> str:
    """Return `value` as indented JSON, rows of numbers on one line; raises ValueError for NaN and infinity."""
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)
    return _NUMBERS.sub(lambda match: " ".join(match[0].split()).replace("[ ", "[").replace(" ]", "]"), text)


def plain(value: Mapping[str, object]) -> dict[str, object]:
    """Return dataclasses, arrays and tuples as plain data for JSON, with None for numbers that are not finite."""
    from pydantic_core import to_jsonable_python  # slow to import; local runs start their workers before it

    data: dict[str, object] = to_jsonable_python(value, inf_nan_mode="null", fallback=lambda array: array.tolist())
    return data


def attributes(of: object, *names: str) -> dict[str, object]:
    """Return attributes by name."""
    return {name: getattr(of, name) for name in names}


def shorten(expression: str, digits: int = 6) -> str:
    """Return `expression` with its constants rounded to `digits` significant digits, without factors of 1."""
    return _FACTOR_OF_ONE.sub("", _NUMBER.sub(lambda match: _round(match[0], digits), expression))


def _round(number: str, digits: int) -> str:
    return number if number.isdigit() else f"{float(number):.{digits}g}"


def clip(text: str, width: int) -> str:
    """Return `text` in at most `width` characters."""
    return text if len(text) <= width else text[: width - 1] + "…"


def count(number: float | None) -> str:
    """Return a large number with three digits, such as ``1.25e+06``; ``-`` for None."""
    if number is None:
        return "-"
    return f"{number:.0f}" if number < 1000 else f"{number:.3g}"


def error_text(error: float | None) -> str:
    """Return an error with two digits; ``-`` for None."""
    return "-" if error is None else f"{error:.1e}"


def duration(seconds: float) -> str:
    """Return seconds as text: ``4.2 s``, ``3:05``, ``2:10:00``."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return rows under their heads, left-aligned, two spaces between columns."""
    lines = [tuple(heads), *(tuple(map(visible_line, row)) for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(heads))]
    padded = ("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines)
    return "\n".join(line.rstrip() for line in padded)
