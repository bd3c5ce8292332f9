"""Control messages from the coordinator to workers, heartbeats and log lines from workers to the coordinator.

Epochs and islands count from 0; a *term* belongs to one (job, variable) and rises with each of its placements. An
*archipelago* is all islands of one (job, variable). docs/protocol.md has the rules by which these messages are sent.
"""

from typing import Annotated, Final, Literal

from pydantic import Field

from atoll_core.config import Frozen, JobConfig
from atoll_core.search.commit_order import CommitOrder, Position
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
    """A job as workers need it: its resolved configuration, and the digest by which its dataset can be pulled.

    `blob` is the SHA-256 of the encoded dataset of `size` bytes in `chunks` chunks of `CHUNK_SIZE`. Workers share their
    time evenly between submitters, and by `priority` between the jobs of one submitter. A later announcement may change
    the priority.
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

    No island begins an epoch after `last`. If the schedule `holds`, no island begins epoch `last` either: `last` is
    then a barrier, at which all islands wait for another placement.
    """

    next: Count
    last: Count
    holds: bool = False

    @property
    def limit(self) -> int:
        """The last epoch that may begin."""
        return self.last - self.holds


class Placement(Frozen):
    """Which worker computes which island of one archipelago: `workers[k]` has island k.

    The term begins at `epoch`: 0, or a committed checkpoint, whose states are pulled. No island begins epoch `epochs`
    or later; `interval` epochs lie between the first checkpoints. `commit_order` decides what counts after a hit.
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
    """Current placements of archipelagos whose search has not ended."""

    kind: Literal["placements"] = "placements"
    placements: tuple[Placement, ...]


class Commit(OfTerm):
    """The checkpoint for `epoch` is durable, and `schedule` has the next checkpoints.

    Every island has reported epoch `reported` under this term: messages of earlier epochs are no longer needed. `hit`
    is the first position at which the target was met, as far as is known; messages about later slices are not needed
    either.
    """

    kind: Literal["commit"] = "commit"
    epoch: Count
    schedule: Schedule
    reported: Count = 0
    hit: Position | None = None


class Close(OfTerm):
    """Stop computing one archipelago and forget it, if it is placed under `term` or a lower one."""

    kind: Literal["close"] = "close"


class CloseJob(Frozen):
    """Stop computing a job, which has ended, and forget it."""

    kind: Literal["close-job"] = "close-job"
    job: Id


class Shutdown(Frozen):
    """The coordinator ends and its workers may end, too; `refused` tells one worker to end with an error."""

    kind: Literal["shutdown"] = "shutdown"
    sentence: Sentence = ""
    refused: bool = False


class Reregister(Frozen):
    """The coordinator does not know this worker, for example after a restart: greet again."""

    kind: Literal["introduce"] = "introduce"


ControlBody = JobAnnouncement | Placements | Commit | Close | CloseJob | Reregister | Shutdown | Lease | Help | Release


class Control(Frozen):
    """From the coordinator to workers."""

    body: Annotated[ControlBody, Field(discriminator="kind")]


# ---------------------------------------------------------------------------------------------- heartbeat


class AssignmentStatus(Frozen):
    """The islands of one archipelago on a worker, and their progress.

    All of these islands have finished and reported all epochs before `reported`; `commit` is the last commit that the
    worker knows of; `snapshots` are later epochs for which the worker has a snapshot of each of these islands.
    `waited_s` are the seconds that the islands have waited for migrants, summed over islands. `hit` is the first
    position at which the target was met, as far as the worker knows.
    """

    job: Id
    variable: Variable
    term: Term
    islands: IslandCount
    reported: Count
    commit: Count
    snapshots: Annotated[tuple[Count, ...], Field(max_length=8)] = ()
    waited_s: Seconds = 0.0
    hit: Position | None = None


class Doing(Frozen):
    """The epoch that a worker's compute thread is computing."""

    job: Id
    variable: Variable
    island: IslandIndex
    epoch: Count


class IslandFailure(Frozen):
    """An internal error while this island computed; repeated until its archipelago is closed."""

    job: Id
    variable: Variable
    term: Term
    island: IslandIndex
    sentence: Sentence


class ComputedTime(Frozen):
    """Seconds for which a worker process has computed islands of a submitter's jobs since its start."""

    submitter: Id | None = None
    seconds: Seconds


class WorkerStatus(Frozen):
    """The heartbeat. `progress` rises while the compute thread advances; `detail` is a note for users.

    `jobs` are the jobs whose dataset is on this worker or is being fetched, even if the worker has no islands of these
    jobs. `tasks` are leased to this worker or helped by it; `is_loaded`: its process for tasks is ready; `computed` is
    the computing time of this process by submitter; `available_bytes` is the memory available for more data (None:
    unknown).
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
    computed: Annotated[tuple[ComputedTime, ...], Field(max_length=10_000)] = ()
    available_bytes: Count | None = None
    counters: Counters = Counters()


# ---------------------------------------------------------------------------------------------- log

MAX_LINES: Final = 100
"""Largest number of lines in one message."""


class LogLine(Frozen):
    """One line of a worker's log, a warning or about a job; `time` is ISO, by the worker's clock."""

    time: Annotated[str, Field(max_length=40)]
    level: Literal["info", "warning", "error"]
    text: Annotated[str, Field(max_length=1000)]
    job: Id | None = None
    variable: Variable | None = None
    island: IslandIndex | None = None
    epoch: Count | None = None
    term: Count | None = None


class WorkerLog(Frozen):
    """Lines of a worker's log since the last such message; `dropped` is the number of lines that were not sent."""

    kind: Literal["log"] = "log"
    lines: Annotated[tuple[LogLine, ...], Field(max_length=MAX_LINES)]
    dropped: Count = 0
