"""Tables: what is shown of each of many things, described in a line; in Markdown; and the numbers in them."""

import statistics
import string
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, TypeVar

from atoll.terminal.output import count, error_text, table


def percent(share: float | None) -> str:
    """Return a share in % with three digits, ``-`` for None."""
    return "-" if share is None else f"{100.0 * share:.3g} %"


def share(part: int, whole: int) -> str:
    """Return a count and the share that it is."""
    return f"{part} of {whole} ({100.0 * part / whole:.0f} %)" if whole else "-"


def median(values: Sequence[float]) -> float | None:
    """Return the median, None of nothing."""
    return statistics.median(values) if values else None


Thing = TypeVar("Thing")
Key = TypeVar("Key")


def grouped(things: Iterable[Thing], key: Callable[[Thing], Key]) -> dict[Key, list[Thing]]:
    """Return the things by their keys, both in the order in which they come."""
    groups: dict[Key, list[Thing]] = {}
    for thing in things:
        groups.setdefault(key(thing), []).append(thing)
    return groups


GRADES: Final = ("exact", "good", "doubtful", "no model", "-")


def by_grade(equations: Iterable[Thing], grade_of: Callable[[Thing], str | None]) -> dict[str, list[Thing]]:
    """Return equations by their verdicts, the best verdict first, ``-`` for none."""
    graded = grouped(equations, lambda equation: grade_of(equation) or "-")
    return {grade: graded[grade] for grade in GRADES if grade in graded}


def markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


UNITS: Final = {"k": 1e3, "M": 1e6, "G": 1e9, "B": 2.0**20}
"""What a number is divided by whose format begins with one of these."""


class _Cells(string.Formatter):
    """Fills in attributes of one thing; ``-`` for None, and formats that are functions by their names."""

    formats: Final[dict[str, Callable[[Any], str]]] = {
        "count": count,
        "error": error_text,
        "percent": percent,
        "same": lambda is_same: "same" if is_same else "DIFFERS",
        "yes": lambda is_so: "yes" if is_so else "NO",
        "met": lambda is_met: "met" if is_met else "NOT MET",
    }

    def get_value(self, key: int | str, args: Sequence[Any], kwargs: Any) -> Any:
        return getattr(args[0], str(key))

    def format_field(self, value: Any, format_spec: str) -> str:
        if format_spec in self.formats:
            return self.formats[format_spec](value)
        if value is None:
            return "-"
        unit = UNITS.get(format_spec[:1])
        return format(value, format_spec) if unit is None else format(value / unit, format_spec[1:])


class Columns:
    """Heads and cells, between bars: ``head={attribute:format}``, or an attribute that is its own head."""

    def __init__(self, text: str) -> None:
        parts = [part.partition("=") for part in text.split(" | ")]
        self.heads: Final = tuple(head for head, _, _ in parts)
        self._cells = tuple(cell or f"{{{head}}}" for head, _, cell in parts)

    def row(self, thing: Any) -> tuple[str, ...]:
        """Return the cells of one thing."""
        fill = _Cells()
        return tuple(fill.format(cell, thing) for cell in self._cells)

    def table(self, things: Iterable[Any]) -> str:
        """Return the table, a row for each thing."""
        return table(self.heads, [self.row(thing) for thing in things])
