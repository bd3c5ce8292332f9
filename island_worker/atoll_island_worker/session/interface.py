"""What goes into a worker's session and what comes out: names of epochs and tasks, events, actions. Plain data."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from atoll_core.search.commit_order import CommitOrder, Position
from atoll_core.wire.bus.interface import Query
from atoll_core.wire.messages.epochs import (
    EpochReport,
    Finished,
    IslandReport,
    Migrants,
    NewerTerm,
    NotYet,
    PullMigrants,
    PullReports,
    PullStates,
    Reports,
    Sent,
    States,
)
from atoll_core.wire.messages.workers import Close, CloseJob, Commit, Placement


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


@dataclass(frozen=True, slots=True)
class JobReady:
    """The job's configuration and dataset are loaded: its islands can be computed."""

    job: str


@dataclass(frozen=True, slots=True)
class LoadFailed:
    """The dataset of a job cannot be read, although its bytes are those announced."""

    job: str
    sentence: str


@dataclass(frozen=True, slots=True)
class Mailed:
    """Another worker sent migrants, or the statement that none will come."""

    sender: str
    body: Migrants | Finished


@dataclass(frozen=True, slots=True)
class PullAsked:
    """Somebody asks for what we sent; to be answered under `handle`."""

    handle: Query
    body: PullMigrants | PullReports | PullStates


@dataclass(frozen=True, slots=True)
class PullAnswered:
    """Worker `peer` answered our pull."""

    peer: str
    body: Sent | Reports | States | NotYet | NewerTerm


@dataclass(frozen=True, slots=True)
class StatesCame:
    """The coordinator answered a question for states; None: not in time, or it has none."""

    asked: PullStates
    body: States | None


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The state of an island before generation 0 of an epoch; when it `is_at_barrier`, that is all that was wanted."""

    key: TaskKey
    data: bytes
    is_at_barrier: bool


@dataclass(frozen=True, slots=True)
class Computed:
    """An island finished an epoch, or came as far with it as is needed.

    `emigrants`: blocks by destination island, its own included (only after a whole epoch that is not the last);
    `senders`: the other islands whose blocks it needs to begin the next epoch.
    """

    key: TaskKey
    report: IslandReport
    emigrants: Mapping[int, bytes]
    senders: frozenset[int]


@dataclass(frozen=True, slots=True)
class Rejected:
    """An island refused its immigrants' blocks as malformed and is unchanged."""

    key: TaskKey
    sentence: str


@dataclass(frozen=True, slots=True)
class Broken:
    """Something of ours broke while an island computed."""

    key: TaskKey
    sentence: str


@dataclass(frozen=True, slots=True)
class Abandoned:
    """Nothing of a task is needed, because the target was met before."""

    key: TaskKey


Outcome = Computed | Rejected | Broken | Abandoned
"""What can come of a task that is not at a barrier."""


@dataclass(frozen=True, slots=True)
class Tick:
    """Time has passed; `now` is the bus's monotonic seconds."""

    now: float


@dataclass(frozen=True, slots=True)
class Reset:
    """Another coordinator, or another incarnation of ours, is there: what others have placed is void.

    What `incarnation`, of our coordinator, has placed already is kept; 0: nothing is.
    """

    incarnation: int = 0


SessionEvent = (
    Placement
    | Commit
    | Close
    | CloseJob
    | JobReady
    | LoadFailed
    | Mailed
    | PullAsked
    | PullAnswered
    | StatesCame
    | Snapshot
    | Computed
    | Rejected
    | Broken
    | Abandoned
    | Tick
    | Reset
)


@dataclass(frozen=True, slots=True)
class FetchJob:
    """Load the job's configuration and dataset; JobReady follows."""

    job: str


@dataclass(frozen=True, slots=True)
class FetchPlacements:
    """Ask the coordinator for the job's current placements; Placement follows."""

    job: str


@dataclass(frozen=True, slots=True)
class FetchStates:
    """Ask the coordinator for states of a checkpoint; StatesCame follows."""

    body: PullStates


@dataclass(frozen=True, slots=True)
class SendHeartbeat:
    """Tell the coordinator at once what is held."""


@dataclass(frozen=True, slots=True)
class RunTask:
    """Give the task to the compute thread; a Snapshot, Computed, Rejected, Broken or Abandoned follows."""

    task: Task


@dataclass(frozen=True, slots=True)
class StopAt:
    """Compute nothing of the shard that is not needed when the target was met at `hit`."""

    shard: ShardKey
    hit: Position
    commit_order: CommitOrder


@dataclass(frozen=True, slots=True)
class Discard:
    """Forget the islands of one archipelago under one term, also those that are being computed."""

    shard: ShardKey


@dataclass(frozen=True, slots=True)
class DiscardJob:
    """Forget the job's dataset."""

    job: str


@dataclass(frozen=True, slots=True)
class Send:
    """Send mail to worker `peer`."""

    peer: str
    body: Migrants | Finished


@dataclass(frozen=True, slots=True)
class SendReport:
    """Report to the coordinator."""

    report: EpochReport


@dataclass(frozen=True, slots=True)
class AskPeer:
    """Pull from worker `peer`; PullAnswered may follow."""

    peer: str
    body: PullMigrants


@dataclass(frozen=True, slots=True)
class Respond:
    """Answer the pull that came under `handle`."""

    handle: Query
    body: Sent | Reports | States | NotYet | NewerTerm


Outgoing = Send | SendReport | AskPeer | Respond | FetchPlacements | FetchStates
"""What goes out on the bus."""

Action = RunTask | StopAt | Discard | DiscardJob | FetchJob | SendHeartbeat | Outgoing
