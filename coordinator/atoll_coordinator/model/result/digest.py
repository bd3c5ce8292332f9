"""The digest of a result: two runs found the same if and only if it is the same.

It covers what the search found (fronts and runners-up with every bit of constants and errors, epochs, counters) and not
how long that took, on how many workers, nor what is made of them afterwards. Of a job without a search it covers the
known equations with their errors on the data.
"""

import hashlib
import struct
from collections.abc import Mapping, Sequence
from typing import Protocol

from atoll_core.search.pareto import FrontEntry


class Found(Protocol):
    """What one variable's search found; `atoll_coordinator.model.result.result.VariableOutcome` is one."""

    @property
    def variable(self) -> str:
        """Name of the equation."""
        ...

    @property
    def front(self) -> tuple[FrontEntry, ...]:
        """The merged front up to the cut."""
        ...

    @property
    def runners_up(self) -> tuple[FrontEntry, ...]:
        """What was kept beside the front."""
        ...

    @property
    def epoch(self) -> int:
        """Complete epochs up to the cut."""
        ...

    @property
    def generation(self) -> int | None:
        """Generation that met the target, if one did."""
        ...

    @property
    def evaluations(self) -> Mapping[str, int]:
        """Cumulative point evaluations by part."""
        ...


def result_digest(outcomes: Sequence[Found]) -> str:
    """Return the hex digest (sha256) of what was found, in the order given."""
    digest = hashlib.sha256()
    for outcome in outcomes:
        _update(digest, outcome.variable.encode())
        _update(digest, struct.pack("<qq", outcome.epoch, -1 if outcome.generation is None else outcome.generation))
        for part in sorted(outcome.evaluations):
            _update(digest, part.encode() + struct.pack("<q", outcome.evaluations[part]))
        _update(digest, struct.pack("<q", len(outcome.front)))
        for entry in outcome.front:
            _update(digest, _entry_bytes(entry))
        if outcome.runners_up:
            _update(digest, b"runners-up" + struct.pack("<q", len(outcome.runners_up)))
        for entry in outcome.runners_up:
            _update(digest, _entry_bytes(entry))
    return digest.hexdigest()


def _entry_bytes(entry: FrontEntry) -> bytes:
    numbers = struct.pack(
        "<qddqqq", entry.complexity, entry.error, entry.mse, entry.epoch, entry.generation, entry.island
    )
    return numbers + entry.program


def _update(digest: "hashlib._Hash", data: bytes) -> None:
    """Add `data` with its length before it, so that no two lists of parts look alike."""
    digest.update(struct.pack("<q", len(data)))
    digest.update(data)
