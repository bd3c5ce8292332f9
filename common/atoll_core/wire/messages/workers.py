"""What coordinator and workers tell each other of jobs, places and progress: control and heartbeat.

Frozen, validated models tagged by `kind`. An *envelope* names who speaks to whom; its `body` is one of a closed union,
told apart by `kind`: Control (coordinator to workers); WorkerStatus (worker to coordinator). What comes of epochs is in
`atoll_core.wire.messages.epochs`, Greeting and GreetingAnswer (hello) in `atoll_core.wire.messages.handshake`, Request
and Answer (clients) in `atoll_core.wire.messages.clients`. docs/protocol.md lists the bodies of all.

Epochs count from 0, islands from 0; a *term* belongs to one (job, variable) and rises with each of its placements.
"""

from typing import Annotated, Final, Literal

from pydantic import Field

from atoll_core.config import Frozen, JobConfig
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire.messages.epochs import OfTerm
from atoll_core.wire.messages.limits import (
    MAX_ISLANDS,
    Count,
    Digest,
    Id,
    IslandCount,
    IslandIndex,
    Priority,
    Seconds,
    Sentence,
    Term,
    Variable,
)
from atoll_core.wire.messages.tasks import Help, Lease, Release, TaskStatus
from atoll_core.wire.messages.views import Counters, WorkerState

# ---------------------------------------------------------------------------------------------- control


class JobAnnouncement(Frozen):
    """A job as workers need it: its resolved configuration and where its dataset can be pulled.

    `blob` is the SHA-256 of the encoded dataset of `size` bytes in `chunks` chunks of `CHUNK_SIZE`. Between submitters
    workers share their time evenly, within one by `priority`; a later announcement may change that.
    """

    kind: Literal["job"] = "job"
    job: Id
    config: JobConfig
    variables: tuple[Variable, ...]
    blob: Digest
    size: Count
    chunks: Annotated[int, Field(ge=1)]
    priority: Priority = 0
    submitter: Id | None = None


class Schedule(Frozen):
    """The next two checkpoints of an archipelago: epochs before which islands take a snapshot.

    No island begins an epoch beyond `last`, nor `last` itself when it `holds`: then it is a barrier, where all wait for
    another placement.
    """

    next: Count
    last: Count
    holds: bool = False

    @property
    def limit(self) -> int:
        """The last epoch that may begin."""
        return self.last - self.holds


class Placement(Frozen):
    """Who computes which island of one archipelago: `workers[k]` has island k.

    The term begins at `epoch`: 0, or a committed checkpoint, whose states are pulled. No island begins epoch `epochs`
    or later; `interval` epochs lie between the first checkpoints. `commit_order` says what counts when
    the target is met.
    """

    incarnation: Count
    term: Term
    job: Id
    variable: Variable
    workers: Annotated[tuple[Id, ...], Field(min_length=1, max_length=MAX_ISLANDS)]
    epoch: Count = 0
    epochs: Annotated[int, Field(ge=1)]
    interval: Annotated[int, Field(ge=1, lt=2**31)]
    commit_order: CommitOrder

    @property
    def schedule(self) -> Schedule:
        """The first two checkpoints of the term."""
        return Schedule(next=self.epoch + self.interval, last=self.epoch + 2 * self.interval)

    def islands_of(self, worker: str) -> tuple[int, ...]:
        """Return the islands that `worker` computes."""
        return tuple(island for island, name in enumerate(self.workers) if name == worker)


class Placements(Frozen):
    """Current placements of archipelagos that are still searched."""

    kind: Literal["placements"] = "placements"
    placements: tuple[Placement, ...]


class Commit(OfTerm):
    """The checkpoint for `epoch` is durable, and these are the next ones.

    Every island has reported epoch `reported` under this term: what was sent in the epochs below is needed no more.
    """

    kind: Literal["commit"] = "commit"
    epoch: Count
    schedule: Schedule
    reported: Count = 0


class Close(OfTerm):
    """Stop computing one archipelago, as far as it is placed under `term` or a lower one, and forget it."""

    kind: Literal["close"] = "close"


class CloseJob(Frozen):
    """Stop computing a job, which has ended, and forget it."""

    kind: Literal["close-job"] = "close-job"
    job: Id


class Shutdown(Frozen):
    """The coordinator ends and its workers may end too; `refused` tells one worker to leave with an error."""

    kind: Literal["shutdown"] = "shutdown"
    sentence: Sentence = ""
    refused: bool = False


class Reregister(Frozen):
    """The coordinator does not know this worker (it started anew, perhaps): greet again."""

    kind: Literal["introduce"] = "introduce"


ControlBody = JobAnnouncement | Placements | Commit | Close | CloseJob | Reregister | Shutdown | Lease | Help | Release


class Control(Frozen):
    """From the coordinator to workers."""

    body: Annotated[ControlBody, Field(discriminator="kind")]


# ---------------------------------------------------------------------------------------------- heartbeat


class AssignmentStatus(Frozen):
    """What a worker has of one archipelago, and how far that is.

    All epochs below `reported` have been finished and reported by all of its islands there; `commit` is the last
    commit it knows of; `snapshots` are the epochs after it of which there is a snapshot of every island there.
    `waited_s` are the seconds that its islands there have waited for migrants, summed over them.
    """

    job: Id
    variable: Variable
    term: Term
    islands: IslandCount
    reported: Count
    commit: Count
    snapshots: Annotated[tuple[Count, ...], Field(max_length=8)] = ()
    waited_s: Seconds = 0.0


class Doing(Frozen):
    """What a worker's compute thread is at."""

    job: Id
    variable: Variable
    island: IslandIndex
    epoch: Count


class IslandFailure(Frozen):
    """Something of ours broke while this island computed; repeated until its archipelago is closed."""

    job: Id
    variable: Variable
    term: Term
    island: IslandIndex
    sentence: Sentence


class Computed(Frozen):
    """For how many seconds a worker process has computed islands of a submitter's jobs; it only grows."""

    submitter: Id | None = None
    seconds: Seconds


class WorkerStatus(Frozen):
    """The heartbeat. `progress` rises while the compute thread gets on; `detail` says what a person should know.

    `jobs` are those whose dataset is here or on its way, also without islands of theirs. `tasks` are those leased to it
    or helped with; `is_loaded`: its process for tasks need not be started; `computed` has the time that this process
    has spent, by submitter; `available_bytes` is the memory that more data can take (None: not told).
    """

    kind: Literal["status"] = "status"
    instance: Id
    incarnation: Count
    state: WorkerState
    progress: Count
    holdings: tuple[AssignmentStatus, ...] = ()
    failures: tuple[IslandFailure, ...] = ()
    jobs: tuple[Id, ...] = ()
    detail: Sentence = ""
    doing: Doing | None = None
    tasks: Annotated[tuple[TaskStatus, ...], Field(max_length=64)] = ()
    is_loaded: bool = False
    computed: Annotated[tuple[Computed, ...], Field(max_length=10_000)] = ()
    available_bytes: Count | None = None
    counters: Counters = Counters()


# ---------------------------------------------------------------------------------------------- log

MAX_LINES: Final = 100
"""Lines in one message."""


class LogLine(Frozen):
    """One line of a worker's log: a warning, or what it says of a job; `time` is ISO, by the worker's clock."""

    time: Annotated[str, Field(max_length=40)]
    level: Literal["info", "warning", "error"]
    text: Annotated[str, Field(max_length=1000)]
    job: Id | None = None
    variable: Variable | None = None
    island: IslandIndex | None = None
    epoch: Count | None = None
    term: Count | None = None


class WorkerLog(Frozen):
    """Lines of a worker's log since the last such message; `dropped` were too many."""

    kind: Literal["log"] = "log"
    lines: Annotated[tuple[LogLine, ...], Field(max_length=MAX_LINES)]
    dropped: Count = 0
