"""A file of JSON lines to which a campaign writes each search as it ends, and from which it can be resumed.

The first line of a run holds the machine and the options; each following one a search: what came of it, and where it is
given the answer itself, so that it can be judged anew without searching again.
"""

import json
from collections.abc import Hashable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final, Generic, Protocol, TypeVar

from pydantic import TypeAdapter

from atoll_core.errors import DataError, UsageError
from benchmarks.harness.record import head

KEPT: Final = (
    "equations", "noise", "simulation", "warnings", "seconds", "search_seconds", "digest", "reason", "symbols",
    "refining",
)  # fmt: skip
"""Parts of a result that are kept."""


class Outcome(Protocol):
    """How one search ended: a dataclass of numbers, texts, tuples, mappings and dataclasses of these."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def key(self) -> Hashable:
        """What was searched."""
        ...


Ended = TypeVar("Ended", bound=Outcome)


class Journal(Generic[Ended]):
    """The searches of the benchmark `name` that have ended, and their answers, by key; written as they come."""

    def __init__(
        self, name: str, kind: type[Ended], path: Path | None, arguments: Sequence[str], *, resume: bool
    ) -> None:
        """Begin the file `path` (None: no file), or continue it.

        Raises UsageError where it exists and is not to be resumed, or cannot be read or written; DataError where it
        holds something else.
        """
        self.outcomes: Final[dict[Any, Ended]] = {}
        self.answers: Final[dict[Any, Mapping[str, Any]]] = {}
        self._kind: Final = TypeAdapter(kind)
        self._path = path
        if path is None:
            return
        if resume:
            for outcome, answer in _searches(path, kind):
                self._take(outcome, answer)
            _cut_off_torn_line(path)
        elif path.exists():
            raise UsageError(f"{path} exists already; continue it with --resume {path}, or name another file")
        self._write({"head": head(name, arguments)})

    def add(self, outcome: Ended, answer: Mapping[str, Any] | None = None) -> None:
        """Take in a search that has ended, with the contents of its result.json if that is to be kept."""
        kept = kept_of(answer) if answer else None
        self._take(outcome, kept)
        self._write({"outcome": self._kind.dump_python(outcome, mode="json"), "answer": kept})

    def _take(self, outcome: Ended, answer: Mapping[str, Any] | None) -> None:
        self.outcomes[outcome.key] = outcome
        if answer is not None:
            self.answers[outcome.key] = answer

    def _write(self, value: object) -> None:
        if self._path is None:
            return
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(value, ensure_ascii=False) + "\n")
        except OSError as error:
            raise UsageError(f"{self._path} cannot be written ({error.strerror}); name another file") from error


def read(path: Path, kind: type[Ended]) -> dict[Any, Ended]:
    """Return the searches that a file holds by key; a last line that was not written to its end is left out.

    Raises UsageError where it cannot be read, DataError where it holds something else.
    """
    return {outcome.key: outcome for outcome, _ in _searches(path, kind)}


def _searches(path: Path, kind: type[Ended]) -> Iterator[tuple[Ended, Mapping[str, Any] | None]]:
    adapter = TypeAdapter(kind)
    try:
        whole, _, _ = path.read_text("utf-8").rpartition("\n")
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}); name a file that --out has written") from error
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            value = json.loads(line)
            if "outcome" in value:
                yield adapter.validate_python(value["outcome"]), value.get("answer")
        except (ValueError, TypeError) as error:
            message = f"line {number} of {path} is no search of this benchmark; name a file that --out has written"
            raise DataError(message) from error


def _cut_off_torn_line(path: Path) -> None:
    text = path.read_text("utf-8")
    if not text.endswith("\n"):
        path.write_text(text[: text.rfind("\n") + 1], "utf-8")


def kept_of(answer: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parts of a result that judging and reading need; of simulations R² without the curves."""
    kept = {name: answer[name] for name in KEPT if name in answer}
    if kept.get("simulation"):
        trajectories = kept["simulation"].get("trajectories") or []
        fields = ("name", "held_out", "r2")
        kept["simulation"] = {
            "trajectories": [{name: trajectory.get(name) for name in fields} for trajectory in trajectories]
        }
    return kept
