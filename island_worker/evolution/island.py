"""An island: one population and all that coevolves with it. Its epoch is a pure function.

(state at epoch e, problem, configuration, seed) -> (state after the generations, additions to the front, counters).
No clock, no I/O, no global random state, no thread order in it (DESIGN section 1, promise 1).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from common.config import JobConfig
from common.dataset import Problem
from common.pareto import FrontEntry


@dataclass(frozen=True)
class Hit:
    """The target error was met: at this generation (1-based within the epoch; 0 = in the initial population)."""

    generation: int
    error: float


@dataclass(frozen=True)
class EpochOutcome:
    """What one island has to say of one finished epoch.

    `additions` are the entries that improved the island's own front in this epoch, in the order found; `evaluations`
    are *cumulative* point evaluations by part since epoch 0; `best_error` is the smallest normalized error on all rows
    so far (None: none finite yet); `digest` is the hex digest of the state.
    """

    epoch: int
    generations: int
    hit: Hit | None
    additions: tuple[FrontEntry, ...]
    evaluations: Mapping[str, int]
    best_error: float | None
    digest: str


class Island:
    """One island of one variable between epochs. Mutable, but only through `advance` and `immigrate`, in turn.

    The life of an island: ``Island(...)`` (epoch 0, random population), then for every epoch: `advance` until it returns
    True, `outcome`, and, unless the archipelago ended, `emigrants` to send and `immigrate` with all that is due here
    (own ones included), which begins the next epoch.
    """

    def __init__(self, problem: Problem, config: JobConfig, island: int) -> None: ...

    epoch: int

    def advance(self, generations: int = 10) -> bool:
        """Advance at most `generations` generations; return True when the epoch is finished or the target was hit."""
        raise NotImplementedError

    def outcome(self) -> EpochOutcome:
        """Return the report of the finished epoch."""
        raise NotImplementedError

    def emigrants(self) -> dict[int, bytes]:
        """Return, by destination island (this one included), a block of solutions with their destination slots."""
        raise NotImplementedError

    def immigrate(self, blocks: Mapping[int, bytes]) -> None:
        """Rebuild the population by slot from the blocks of exactly `senders(...)`, keyed by source island.

        Raises RemoteProtocolError when a block is malformed or the slots do not add up; the island is then unchanged.
        """
        raise NotImplementedError

    def to_bytes(self) -> bytes:
        """Return everything that can influence later bits or counters (PROTOCOL rule 14)."""
        raise NotImplementedError

    @classmethod
    def from_bytes(cls, data: bytes, problem: Problem, config: JobConfig, island: int) -> Self:
        """Rebuild an island from `to_bytes`; raises RemoteProtocolError."""
        raise NotImplementedError


def senders(config: JobConfig, variable: str, epoch: int, island: int) -> frozenset[int]:
    """Return the islands (never `island` itself) whose solutions the reshuffle of `epoch` sends to `island`."""
    raise NotImplementedError


def receivers(config: JobConfig, variable: str, epoch: int, island: int) -> frozenset[int]:
    """Return the islands (never `island` itself) to which the reshuffle of `epoch` sends solutions of `island`."""
    raise NotImplementedError
