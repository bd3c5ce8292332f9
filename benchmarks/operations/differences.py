"""Two JSON values beside each other: what is left out of them, and the places where they differ."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

NOT_COMPARED: Final = frozenset({"job", "seconds", "search_seconds", "versions"})
"""Keys of ``result.json`` that say when and by what a job was run, not what it found."""

DURATION: Final = re.compile(r"\bin [^,]+ of search\b")
PROGRESS: Final = re.compile(r"job \S+ |note: |  |start-up |for the ")
"""What messages begin with that come while a job runs: which of them are seen depends on how fast it is.

Notes come again as warnings, at the end.
"""

ABSENT: Final = "(absent)"


@dataclass(frozen=True)
class Difference:
    """A place such as ``equations[0].size``, and what both values have there, as JSON."""

    place: str
    ours: str
    theirs: str

    def shown(self, width: int) -> str:
        """Return it as one line; values are cut at `width` characters."""
        ours, theirs = (text if len(text) <= width else text[: width - 1] + "…" for text in (self.ours, self.theirs))
        return f"{self.place}: {ours} beside {theirs}"


def masked(value: Any) -> Any:
    """Return `value` without the keys `NOT_COMPARED`, at any depth."""
    if isinstance(value, Mapping):
        return {key: masked(part) for key, part in value.items() if key not in NOT_COMPARED}
    return [masked(part) for part in value] if isinstance(value, list) else value


def masked_line(line: str) -> str:
    """Return a printed line without the time that the search took."""
    return DURATION.sub("in TIME of search", line)


def without_progress(lines: Iterable[str]) -> list[str]:
    """Return those of a command's messages that say how data are read and what came of it."""
    return [line for line in lines if not PROGRESS.match(line)]


def differences(ours: Any, theirs: Any, place: str = "") -> Iterator[Difference]:
    """Yield the places where two JSON values differ, in the order of ours.

    Values are equal when they are written alike: 1, 1.0 and true are three values. The order of keys does not count.
    """
    if isinstance(ours, Mapping) and isinstance(theirs, Mapping):
        yield from _inside(ours, theirs, f"{place}." if place else "", "")
    elif isinstance(ours, list) and isinstance(theirs, list):
        yield from _inside(dict(enumerate(ours)), dict(enumerate(theirs)), f"{place}[", "]")
    elif _written(ours) != _written(theirs):
        yield Difference(place, _written(ours), _written(theirs))


def _inside(ours: Mapping[Any, Any], theirs: Mapping[Any, Any], before: str, after: str) -> Iterator[Difference]:
    for key in dict.fromkeys((*ours, *theirs)):
        where = f"{before}{key}{after}"
        if key in ours and key in theirs:
            yield from differences(ours[key], theirs[key], where)
        else:
            yield Difference(where, *(_written(side[key]) if key in side else ABSENT for side in (ours, theirs)))


def _written(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, sort_keys=True)


def report(name: str, differing: Sequence[Difference], places: int) -> str:
    """Return what is to be said of one job: that both are equal, or the first `places` where they differ."""
    if not differing:
        return f"{name}: equal"
    rest = [f"and {len(differing) - places} more"] if len(differing) > places else []
    lines = [f"{name}: DIFFERS", *(difference.shown(80) for difference in differing[:places]), *rest]
    return "\n    ".join(lines)
