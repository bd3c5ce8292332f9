"""Inputs and outputs of a worker's session: keys of shards and epochs, events, actions. Plain data."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from atoll_core.search.commit_order import CommitOrder, Position
from atoll_core.wire.bus.interface import Query
from atoll_core.wire.messages import epochs
from atoll_core.wire.messages.workers import Close, CloseJob, Commit, Placement


class ShardKey(NamedTuple):
    """One archipelago under one term."""

    job: str
    variable: str
    term: int


@dataclass(frozen=True, slots=True)
class TaskKey:
    """One epoch of one island under one term."""

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
class EpochTask:
    """Begin epoch `key.epoch` with the immigrants `blocks`, and finish it.

    `blocks` are by source island; None in the first epoch of a term. The task returns emigrants unless the epoch
    `is_last`. The `commit_order` ranks its slices. `state` is the island's state if its term begins at a checkpoint;
    together with `blocks` it is the state at the end of the epoch before. At a checkpoint the task returns a snapshot;
    an epoch that `is_at_barrier` is begun only for the snapshot.
    """

    key: TaskKey
    blocks: Mapping[int, bytes] | None
    is_last: bool
    commit_order: CommitOrder
    state: bytes | None = None
    takes_snapshot: bool = False
    is_at_barrier: bool = False


# ---------------------------------------------------------------------------------------------- events


@dataclass(frozen=True, slots=True)
class JobReady:
    """The configuration and dataset of the job are loaded: its islands can be computed."""

    job: str


@dataclass(frozen=True, slots=True)
class LoadFailed:
    """The dataset of a job cannot be read, although its bytes have the announced digest."""

    job: str
    sentence: str


@dataclass(frozen=True, slots=True)
class PullAsked:
    """Another worker or the coordinator requests migrants, reports or states; the answer refers to `handle`."""

    handle: Query
    body: epochs.PullMigrants | epochs.PullReports | epochs.PullStates


@dataclass(frozen=True, slots=True)
class PullEnded:
    """A pull of this worker, `asked`, has ended with an answer, or without an answer (None).

    `has_timed_out`: no answer came within the timeout, perhaps because the migrants did not exist yet.
    """

    asked: "SendPull"
    body: epochs.Migrants | epochs.States | None
    has_timed_out: bool = False


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The state of an island before generation 0 of an epoch; at a barrier it is the only result."""

    key: TaskKey
    data: bytes
    is_at_barrier: bool


@dataclass(frozen=True, slots=True)
class EpochComputed:
    """An island finished an epoch, or the needed part of it.

    `emigrants`: blocks by destination island, including this island (only after a whole epoch that is not the last);
    `senders`: the other islands whose blocks it needs to begin the next epoch.
    """

    key: TaskKey
    report: epochs.IslandReport
    emigrants: Mapping[int, bytes]
    senders: frozenset[int]


@dataclass(frozen=True, slots=True)
class Rejected:
    """An island rejected the blocks of its immigrants as malformed, and is unchanged."""

    key: TaskKey
    sentence: str


@dataclass(frozen=True, slots=True)
class Broken:
    """An island raised an unexpected error."""

    key: TaskKey
    sentence: str


@dataclass(frozen=True, slots=True)
class Abandoned:
    """No part of a task is needed, because the target was met before."""

    key: TaskKey


Outcome = EpochComputed | Rejected | Broken | Abandoned
"""The possible ends of a task that is not at a barrier."""


@dataclass(frozen=True, slots=True)
class Tick:
    """Time has passed: missing messages that are not under way are requested again."""


@dataclass(frozen=True, slots=True)
class Reset:
    """Another coordinator, or another incarnation of this one, has taken over: placements by others are void.

    Placements by `incarnation` of the present coordinator are kept; 0: none are kept.
    """

    incarnation: int = 0


SessionEvent = (
    Placement | Commit | Close | CloseJob | JobReady | LoadFailed | PullAsked | PullEnded | Snapshot | Outcome | Tick
    | Reset
)  # fmt: skip


# --------------------------------------------------------------------------------------------- actions


@dataclass(frozen=True, slots=True)
class SendHeartbeat:
    """Send the coordinator a heartbeat at once."""


@dataclass(frozen=True, slots=True)
class AnnounceHit:
    """Send the coordinator a heartbeat with a hit, unless a report with it is sent first.

    The other islands of the shard may have outcomes that wait to be handled; the report of `epoch` is then complete.
    """

    shard: ShardKey
    epoch: int


@dataclass(frozen=True, slots=True)
class RunTask:
    """Give the task to the compute thread; a Snapshot or an Outcome follows."""

    task: EpochTask


@dataclass(frozen=True, slots=True)
class StopAt:
    """Stop computing the parts of the shard that are not needed after the target was met at `hit`."""

    shard: ShardKey
    hit: Position
    commit_order: CommitOrder


@dataclass(frozen=True, slots=True)
class Discard:
    """Forget the islands of one archipelago under one term, also while they are computed."""

    shard: ShardKey


@dataclass(frozen=True, slots=True)
class SendReport:
    """Report to the coordinator."""

    report: epochs.EpochReport


@dataclass(frozen=True, slots=True)
class SendPull:
    """Pull migrants from worker `peer`, or states of a checkpoint from the coordinator (None). A PullEnded follows."""

    peer: str | None
    body: epochs.PullMigrants | epochs.PullStates


@dataclass(frozen=True, slots=True)
class Respond:
    """Answer the pull that came under `handle`."""

    handle: Query
    body: epochs.Migrants | epochs.Reports | epochs.States | epochs.NotYet


Outgoing = SendReport | SendPull | Respond
"""The messages that are sent on the bus."""

Action = RunTask | StopAt | Discard | SendHeartbeat | AnnounceHit | Outgoing
