"""How the search of one system of many states ended."""

from collections.abc import Mapping
from dataclasses import dataclass

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
