"""The messages of coordinator and workers, as frozen, validated models tagged by `kind`.

An *envelope* names who speaks to whom; its `body` is one of a closed union, told apart by `kind`:

Control (coordinator to workers); WorkerStatus, EpochReport (worker to coordinator); Mail (worker to worker); Pull,
PullAnswer (to a worker). Greeting and GreetingAnswer (hello) are in `atoll_core.wire.messages.handshake`, Request and
Answer (clients) in `atoll_core.wire.messages.clients`. docs/protocol.md lists the bodies of all.

Epochs count from 0, islands from 0; a *term* belongs to one (job, variable) and rises with each of its placements.
"""

from typing import Annotated, Literal

from pydantic import Field

from atoll_core.config import Frozen, JobConfig
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire.messages.limits import (
    CHUNK_SIZE,
    MAX_ISLANDS,
    MAX_RUNNERS_UP,
    MAX_STATE,
    Count,
    Digest,
    Id,
    IslandCount,
    IslandIndex,
    Priority,
    Seconds,
    Sentence,
    Summand,
    Term,
    Variable,
)
from atoll_core.wire.messages.views import Counters, WorkerState

# ---------------------------------------------------------------------------------------------- control


class JobAnnouncement(Frozen):
    """A job as workers need it: its resolved configuration and where its dataset can be pulled.

    `blob` is the SHA-256 of the encoded dataset of `size` bytes in `chunks` chunks of `CHUNK_SIZE`.
    """

    kind: Literal["job"] = "job"
    job: Id
    config: JobConfig
    variables: tuple[Variable, ...]
    blob: Digest
    size: Count
    chunks: Annotated[int, Field(ge=1)]
    priority: Priority = 0


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


class Commit(Frozen):
    """The checkpoint for `epoch` is durable, and these are the next ones.

    Every island has reported epoch `reported` under this term: what was sent in the epochs below is needed no more.
    """

    kind: Literal["commit"] = "commit"
    job: Id
    variable: Variable
    term: Term
    epoch: Count
    schedule: Schedule
    reported: Count = 0


class Close(Frozen):
    """Stop computing one archipelago, as far as it is placed under `term` or a lower one, and forget it."""

    kind: Literal["close"] = "close"
    job: Id
    variable: Variable
    term: Term


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


ControlBody = JobAnnouncement | Placements | Commit | Close | CloseJob | Reregister | Shutdown


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


class WorkerStatus(Frozen):
    """The heartbeat. `progress` rises while the compute thread gets on; `detail` says what a person should know.

    `jobs` are those whose dataset is here or on its way, also without islands of theirs.
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
    counters: Counters = Counters()


# ---------------------------------------------------------------------------------------------- reports


class HitStatement(Frozen):
    """The target was met at `generation` (1-based within the epoch), the end of a slice."""

    generation: Count
    error: float


class Addition(Frozen):
    """One equation found by an island in this epoch; fields as in `atoll_core.search.pareto.FrontEntry`."""

    complexity: Count
    error: float
    mse: float
    generation: Count
    program: Annotated[bytes, Field(max_length=8192)]


class SliceCounters(Frozen):
    """Point evaluations of an island by part, cumulative since epoch 0, at the end of the slice at `generation`."""

    generation: Count
    evaluations: dict[Annotated[str, Field(max_length=64)], Summand]


class IslandReport(Frozen):
    """What one island says of one epoch, finished or given up (`atoll_island_worker.evolution.island.EpochOutcome`).

    `generations` is how far it got: to the epoch's end, to its own hit, or, when another island met the target, at
    least as far as is needed then. `additions` are those to its front, `runners_up` those to the next best beside it.
    `counters` are those of all slices that it finished; `digest` is that of its state.
    """

    island: IslandIndex
    generations: Count
    hit: HitStatement | None
    additions: tuple[Addition, ...]
    runners_up: Annotated[tuple[Addition, ...], Field(max_length=MAX_RUNNERS_UP)] = ()
    counters: tuple[SliceCounters, ...]
    best_error: float | None
    digest: Annotated[str, Field(pattern=r"^[0-9a-f]{16,128}$")]


class EpochReport(Frozen):
    """One worker's islands of one archipelago, one epoch: all but those that the cut spares the whole epoch."""

    kind: Literal["report"] = "report"
    job: Id
    variable: Variable
    term: Term
    epoch: Count
    islands: Annotated[tuple[IslandReport, ...], Field(min_length=1)]


# ---------------------------------------------------------------------------------------------- migrants


class Block(Frozen):
    """Solutions of island `source` for island `destination`, with their slots; opaque to all but the island."""

    source: IslandIndex
    destination: IslandIndex
    data: bytes


class Migrants(Frozen):
    """Emigrants of one finished epoch for islands of one worker."""

    kind: Literal["migrants"] = "migrants"
    job: Id
    variable: Variable
    term: Term
    epoch: Count
    blocks: Annotated[tuple[Block, ...], Field(min_length=1)]


class Finished(Frozen):
    """In place of emigrants: `island` met the target at `generation` of `epoch`; nothing after that is needed."""

    kind: Literal["finished"] = "finished"
    job: Id
    variable: Variable
    term: Term
    epoch: Count
    generation: Count
    island: IslandIndex


class Mail(Frozen):
    """From worker to worker."""

    body: Annotated[Migrants | Finished, Field(discriminator="kind")]


# ---------------------------------------------------------------------------------------------- pulls


class PullMigrants(Frozen):
    """What did the `sources` of yours send in `epoch` to island `destination`?"""

    kind: Literal["pull-migrants"] = "pull-migrants"
    job: Id
    variable: Variable
    term: Term
    epoch: Count
    destination: IslandIndex
    sources: Annotated[tuple[IslandIndex, ...], Field(min_length=1)]


class PullReports(Frozen):
    """What did you report of these epochs (first included, last excluded)?"""

    kind: Literal["pull-reports"] = "pull-reports"
    job: Id
    variable: Variable
    term: Term
    first: Count
    last: Count


class PullStates(Frozen):
    """What are the states of these islands at checkpoint `epoch`, of the first one from byte `offset` on?"""

    kind: Literal["pull-states"] = "pull-states"
    job: Id
    variable: Variable
    term: Term
    epoch: Count
    islands: Annotated[tuple[IslandIndex, ...], Field(min_length=1, max_length=1024)]
    offset: Count = 0


class Pull(Frozen):
    """Question to a worker; that for states also to the coordinator."""

    body: Annotated[PullMigrants | PullReports | PullStates, Field(discriminator="kind")]


class Sent(Frozen):
    """The migrants asked for, as far as they exist already, and those sources that finished instead."""

    kind: Literal["sent"] = "sent"
    migrants: Migrants | None
    finished: tuple[Finished, ...] = ()


class Reports(Frozen):
    """The reports asked for, as far as they exist already."""

    kind: Literal["reports"] = "reports"
    reports: tuple[EpochReport, ...]


class Piece(Frozen):
    """Bytes from `offset` on of the state of one island; the whole has `size` bytes and the SHA-256 `digest`."""

    island: IslandIndex
    size: Annotated[int, Field(ge=1, le=MAX_STATE)]
    digest: Digest
    offset: Count
    data: Annotated[bytes, Field(max_length=CHUNK_SIZE)]


class States(Frozen):
    """As many of the states asked for as one message bears, in their order; the last one may be a part of it."""

    kind: Literal["states"] = "states"
    pieces: Annotated[tuple[Piece, ...], Field(min_length=1, max_length=1024)]


class NotYet(Frozen):
    """Nothing of what was asked for exists yet; ask later."""

    kind: Literal["not-yet"] = "not-yet"


class NewerTerm(Frozen):
    """The question's term is over; `term` is the one that the answerer knows (0: it holds nothing there)."""

    kind: Literal["newer-term"] = "newer-term"
    job: Id
    variable: Variable
    term: Count


class PullAnswer(Frozen):
    """Answer of a worker."""

    body: Annotated[Sent | Reports | States | NotYet | NewerTerm, Field(discriminator="kind")]
