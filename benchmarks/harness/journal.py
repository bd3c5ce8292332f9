"""A file of JSON lines with one search each, from which a campaign can be resumed."""

import json
from collections.abc import Hashable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Final, Generic, Protocol, TypeVar

from atoll.errors import DataError, UsageError
from benchmarks.harness.record import head


class Outcome(Protocol):
    """How one search ended: a dataclass of what JSON has, lists being tuples."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def key(self) -> Hashable:
        """What was searched."""
        ...


Ended = TypeVar("Ended", bound=Outcome)


class Journal(Generic[Ended]):
    """The searches of the benchmark `name` that have ended, by key; written as they come."""

    def __init__(
        self, name: str, kind: type[Ended], path: Path | None, arguments: Sequence[str], *, resume: bool
    ) -> None:
        """Begin the file `path` (None: no file), or continue it; raises UsageError or DataError."""
        self.outcomes: Final[dict[Hashable, Ended]] = {}
        self._path = path
        if path is None:
            return
        if resume:
            self.outcomes.update(read(path, kind))
        elif path.exists():
            raise UsageError(f"{path} exists already; continue it with --resume {path}, or name another file")
        self._write({"head": head(name, arguments)})

    def add(self, outcome: Ended) -> None:
        """Take in a search that has ended."""
        self.outcomes[outcome.key] = outcome
        self._write({"outcome": asdict(outcome)})

    def _write(self, value: object) -> None:
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(value, ensure_ascii=False) + "\n")


def read(path: Path, kind: type[Ended]) -> dict[Hashable, Ended]:
    """Return the searches that a file holds; a last line that was not written to its end is left out."""
    found: dict[Hashable, Ended] = {}
    try:
        whole, _, _ = path.read_text("utf-8").rpartition("\n")
        for line in whole.splitlines():
            value = json.loads(line)
            if "outcome" in value:
                fields = {
                    key: tuple(each) if isinstance(each, list) else each for key, each in value["outcome"].items()
                }
                outcome = kind(**fields)
                found[outcome.key] = outcome
    except (OSError, ValueError, TypeError) as error:
        raise DataError(f"{path} is no file of this benchmark; name one that --out has written") from error
    return found
