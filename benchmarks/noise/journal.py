"""A file of JSON lines to which a long benchmark writes each search as it ends, and from which it can be resumed.

The first line of a run holds the machine and the options; each following one a search: what came of it, and the answer
itself, so that it can be judged anew without searching again.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from atoll.errors import DataError, UsageError
from benchmarks.harness.record import head
from benchmarks.judging.coverage import Covered
from benchmarks.noise.data import Key
from benchmarks.noise.judging import EquationOutcome, Outcome

KEPT = ("equations", "noise", "simulation", "warnings", "seconds", "search_seconds", "digest", "reason", "symbols")
"""Parts of a result that are kept."""


class Journal:
    """The searches that have ended, by key; written as they come."""

    def __init__(self, path: Path | None, resume: bool, arguments: Sequence[str]) -> None:
        """Begin the file `path` (None: no file), or continue it.

        Raises:
            UsageError: the file exists and is not to be resumed, or cannot be written.
            DataError: the file to be resumed holds something else.
        """
        self.outcomes: dict[Key, Outcome] = {}
        self.answers: dict[Key, dict[str, Any]] = {}
        self._path = path
        if path is None:
            return
        if resume:
            self._read(path)
        elif path.exists():
            raise UsageError(f"{path} exists already; continue it with --resume {path}, or name another file")
        self._write({"head": head("noise", arguments)})

    def add(self, outcome: Outcome, answer: Mapping[str, Any] | None = None) -> None:
        """Take in a search that has ended, with the contents of its result.json if it has one."""
        kept = kept_of(answer) if answer else None
        self.outcomes[outcome.key] = outcome
        if kept is not None:
            self.answers[outcome.key] = kept
        self._write({"outcome": asdict(outcome), "answer": kept})

    def _write(self, value: Mapping[str, Any]) -> None:
        if self._path is None:
            return
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(value, ensure_ascii=False, allow_nan=False) + "\n")
        except OSError as error:
            raise UsageError(f"{self._path} cannot be written ({error.strerror}); name another file") from error

    def _read(self, path: Path) -> None:
        """Take in what `path` holds, and cut off a last line that was not written to its end."""
        try:
            text = path.read_text("utf-8")
        except OSError as error:
            raise UsageError(f"{path} cannot be read ({error.strerror}); name a file that --out has written") from error
        whole, _, torn = text.rpartition("\n")
        if torn:
            path.write_text(whole + "\n" if whole else "", "utf-8")
        for number, line in enumerate(whole.splitlines(), start=1):
            try:
                value = json.loads(line)
                if "outcome" in value:
                    self._take(value)
            except (ValueError, TypeError, KeyError) as error:
                message = f"line {number} of {path} is no search of this benchmark; name a file that --out has written"
                raise DataError(message) from error

    def _take(self, value: Mapping[str, Any]) -> None:
        outcome = outcome_from(value["outcome"])
        self.outcomes[outcome.key] = outcome
        if value.get("answer") is not None:
            self.answers[outcome.key] = value["answer"]


def kept_of(answer: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parts of a result that judging and reading need; of simulations R² without the curves."""
    kept = {name: answer[name] for name in KEPT if name in answer}
    if kept.get("simulation"):
        trajectories = kept["simulation"].get("trajectories") or []
        fields = ("name", "held_out", "r2")
        kept["simulation"] = {"trajectories": [{name: each.get(name) for name in fields} for each in trajectories]}
    return kept


def outcome_from(value: Mapping[str, Any]) -> Outcome:
    """Return the outcome that was written as `value`; raises KeyError or TypeError when it is something else."""
    equations = tuple(_equation(each) for each in value["equations"])
    return Outcome(**{**value, "key": Key(**value["key"]), "equations": equations})


def _equation(value: Mapping[str, Any]) -> EquationOutcome:
    constants = value["constants"]
    known = None if constants is None else tuple(Covered(**each) for each in constants)
    return EquationOutcome(**{**value, "constants": known})
