"""A file of JSON lines with one search each, from which a campaign can be resumed."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from atoll.errors import DataError, UsageError
from benchmarks.harness.record import head

Key = tuple[str, float, int]
"""System, noise in percent, seed."""


@dataclass(frozen=True)
class Outcome:
    """One search: the form of each equation (see `benchmarks.corpus.forms`), its verdict, what was shown.

    `seconds` are those of the job, `phases` those of its states, `processor` processor seconds of these.
    """

    system: str
    noise: float
    seed: int
    forms: tuple[str, ...]
    verdicts: tuple[str | None, ...]
    equations: tuple[str | None, ...]
    seconds: float
    phases: Mapping[str, float]
    processor: Mapping[str, float]
    failure: str | None = None

    @property
    def key(self) -> Key:
        """What was searched."""
        return self.system, self.noise, self.seed

    @property
    def right(self) -> int:
        """How many equations have the truth's form."""
        return self.forms.count("right")


class Journal:
    """The searches that have ended, by key; written as they come."""

    def __init__(self, path: Path | None, arguments: Sequence[str], *, resume: bool) -> None:
        """Begin the file `path` (None: no file), or continue it; raises UsageError or DataError."""
        self.outcomes: Final[dict[Key, Outcome]] = {}
        self._path = path
        if path is None:
            return
        if resume:
            self.outcomes.update(read(path))
        elif path.exists():
            raise UsageError(f"{path} exists already; continue it with --resume {path}, or name another file")
        self._write({"head": head("many", arguments)})

    def add(self, outcome: Outcome) -> None:
        """Take in a search that has ended."""
        self.outcomes[outcome.key] = outcome
        self._write({"outcome": asdict(outcome)})

    def _write(self, value: object) -> None:
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(value, ensure_ascii=False) + "\n")


def read(path: Path) -> dict[Key, Outcome]:
    """Return the searches that a file holds; a last line that was not written to its end is left out."""
    found: dict[Key, Outcome] = {}
    try:
        whole, _, _ = path.read_text("utf-8").rpartition("\n")
        for line in whole.splitlines():
            value = json.loads(line)
            if "outcome" in value:
                fields = {
                    key: tuple(each) if isinstance(each, list) else each for key, each in value["outcome"].items()
                }
                outcome = Outcome(**fields)
                found[outcome.key] = outcome
    except (OSError, ValueError, TypeError) as error:
        raise DataError(f"{path} is no file of this benchmark; name one that --out has written") from error
    return found
