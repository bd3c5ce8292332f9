"""What happens to a worker's session, beside the messages of control. Plain data, no behaviour."""

from collections.abc import Mapping
from dataclasses import dataclass

from atoll_core.wire.bus.interface import Query
from atoll_core.wire.messages.epochs import (
    IslandFinished,
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
from atoll_island_worker.session.epoch_tasks import TaskKey


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
    body: Migrants | IslandFinished


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
