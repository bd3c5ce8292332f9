"""What an island is to compute, under which term: what session and compute thread call each other's work by."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from atoll_core.search.commit_order import CommitOrder


class ShardKey(NamedTuple):
    """One archipelago under one term."""

    job: str
    variable: str
    term: int


@dataclass(frozen=True, slots=True)
class TaskKey:
    """One island's one epoch, under one term."""

    job: str
    variable: str
    term: int
    island: int
    epoch: int

    @property
    def shard(self) -> ShardKey:
        """The archipelago and its term."""
        return ShardKey(self.job, self.variable, self.term)


@dataclass(frozen=True, slots=True)
class Task:
    """Begin epoch `key.epoch` (with the immigrants `blocks` by source island; None at the term's first) and finish it.

    Emigrants are wanted unless the epoch `is_last`; by the `commit_order` its slices count before or after others.
    `state` is what the island goes on from when its term begins at a checkpoint. A snapshot is wanted at a checkpoint;
    an epoch that `is_at_barrier` is begun for the snapshot alone.
    """

    key: TaskKey
    blocks: Mapping[int, bytes] | None
    is_last: bool
    commit_order: CommitOrder
    state: bytes | None = None
    takes_snapshot: bool = False
    is_at_barrier: bool = False
