"""Every message on the bus, as frozen, validated models tagged by `kind`.

An *envelope* names who speaks to whom; its `body` is one of a closed union, told apart by `kind`:

Greeting, GreetingAnswer (hello); Control (coordinator to workers); WorkerStatus, EpochReport (worker to coordinator);
Mail (worker to worker); Pull, PullAnswer (to a worker); Ask, Answer (clients). docs/protocol.md lists their bodies.

Epochs count from 0, islands from 0; a *term* belongs to one (job, variable) and rises with each of its placements.
"""

from typing import Annotated, Final, Literal

from pydantic import ConfigDict, Field

from common.config import JobConfig, Model
from common.slices import Course
from common.wire.views import CoordinatorView, Counters, EventView, JobView, WorkerState, WorkerView

CHUNK_SIZE: Final = 4 * 1024 * 1024
"""Bytes per chunk of an upload or a dataset; the last chunk may be shorter."""

MAX_UPLOAD: Final = 1024 * 1024 * 1024
"""Largest table a client may upload, in bytes."""

MAX_MESSAGE: Final = 16 * 1024 * 1024
"""Largest encoded message; anything larger is refused unread."""

MAX_STATE: Final = 256 * 1024 * 1024
"""Largest state of one island, in bytes; the usual one has about 50,000."""

MAX_RUNNERS_UP: Final = 20_000
"""Most runners-up that an island may report of one epoch; an epoch has room for a few hundred."""

Id = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Variable = Annotated[str, Field(min_length=1, max_length=256)]
Count = Annotated[int, Field(ge=0, lt=2**63)]
IslandIndex = Annotated[int, Field(ge=0, lt=1024)]
Term = Annotated[int, Field(ge=1, lt=2**63)]
Sentence = Annotated[str, Field(max_length=4000)]
Seconds = Annotated[float, Field(ge=0.0, lt=1e12)]
Priority = Annotated[int, Field(ge=-10, le=10)]
"""Each step doubles a job's share of the workers."""


# ---------------------------------------------------------------------------------------------- greeting


class Tolerant(Model):
    """A message whose shape other versions must be able to read: fields they do not know are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class Hello(Tolerant):
    """The first words of a worker or a client. `instance` is drawn anew by each process.

    `fingerprint` names what the bits of a worker's islands depend on ("" while its kernels are not ready, and for a
    client, which computes nothing).
    """

    kind: Literal["hello"] = "hello"
    role: Literal["worker", "client"]
    name: Id
    instance: Id
    protocol: Count
    version: Annotated[str, Field(max_length=64)]
    engine: Count
    fingerprint: Annotated[str, Field(max_length=128)] = ""
    host: Annotated[str, Field(max_length=256)] = ""
    pid: Count = 0


class Welcome(Tolerant):
    """The coordinator accepts; all further keys lie under `realm`. `clock` is its time of day as ISO text, if told."""

    kind: Literal["welcome"] = "welcome"
    realm: Id
    incarnation: Count
    protocol: Count
    version: Annotated[str, Field(max_length=64)]
    engine: Count
    clock: Annotated[str, Field(max_length=64)] = ""


class Refusal(Tolerant):
    """The coordinator does not accept; `sentence` says why and names both sides' versions where they differ."""

    kind: Literal["refusal"] = "refusal"
    protocol: Count
    version: Annotated[str, Field(max_length=64)]
    engine: Count
    sentence: Sentence


class Greeting(Tolerant):
    """Question on the hello key."""

    body: Hello


class GreetingAnswer(Tolerant):
    """Answer on the hello key."""

    body: Annotated[Welcome | Refusal, Field(discriminator="kind")]


# ---------------------------------------------------------------------------------------------- control


class JobAnnouncement(Model):
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


class Schedule(Model):
    """The next two checkpoints of an archipelago: epochs before which islands take a snapshot.

    No island begins an epoch beyond `last`, nor `last` itself when it `holds`: then all of them wait there for another
    placement.
    """

    next: Count
    last: Count
    holds: bool = False

    @property
    def limit(self) -> int:
        """The last epoch that may begin."""
        return self.last - self.holds


class Placement(Model):
    """Who computes which island of one archipelago: `workers[k]` has island k.

    The term begins at `epoch`: 0, or a committed checkpoint, whose states are pulled. No island begins epoch `epochs`
    or later; `interval` epochs lie between the first checkpoints. `course` says what counts when the target is met.
    """

    incarnation: Count
    term: Term
    job: Id
    variable: Variable
    workers: Annotated[tuple[Id, ...], Field(min_length=1, max_length=1024)]
    epoch: Count = 0
    epochs: Annotated[int, Field(ge=1)]
    interval: Annotated[int, Field(ge=1, lt=2**31)]
    course: Course

    @property
    def schedule(self) -> Schedule:
        """The first two checkpoints of the term."""
        return Schedule(next=self.epoch + self.interval, last=self.epoch + 2 * self.interval)

    def islands_of(self, worker: str) -> tuple[int, ...]:
        """Return the islands that `worker` computes."""
        return tuple(island for island, name in enumerate(self.workers) if name == worker)


class Placements(Model):
    """Current placements of archipelagos that are still searched."""

    kind: Literal["placements"] = "placements"
    placements: tuple[Placement, ...]


class Commit(Model):
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


class Close(Model):
    """A hint to cease work and forget: on one archipelago, or on all of the job (`variable` None)."""

    kind: Literal["close"] = "close"
    job: Id
    variable: Variable | None = None


class Shutdown(Model):
    """The coordinator ends and its workers may end too; `refused` tells one worker to leave with an error."""

    kind: Literal["shutdown"] = "shutdown"
    sentence: Sentence = ""
    refused: bool = False


class Introduce(Model):
    """The coordinator does not know this worker (it started anew, perhaps): greet again."""

    kind: Literal["introduce"] = "introduce"


class Control(Model):
    """From the coordinator to workers."""

    body: Annotated[JobAnnouncement | Placements | Commit | Close | Shutdown | Introduce, Field(discriminator="kind")]


# ---------------------------------------------------------------------------------------------- heartbeat


class Holding(Model):
    """What a worker holds of one archipelago.

    All epochs below `reported` have been finished and reported by all of its islands there; `commit` is the last
    commit it knows of; `snapshots` are the epochs after it of which there is a snapshot of every island there.
    `waited_s` are the seconds that its islands there have waited for migrants, summed over them.
    """

    job: Id
    variable: Variable
    term: Term
    islands: Count
    reported: Count
    commit: Count
    snapshots: Annotated[tuple[Count, ...], Field(max_length=8)] = ()
    waited_s: Seconds = 0.0


class Doing(Model):
    """What a worker's compute thread is at."""

    job: Id
    variable: Variable
    island: IslandIndex
    epoch: Count


class Trouble(Model):
    """Something of ours broke while this island computed; repeated until its archipelago is closed."""

    job: Id
    variable: Variable
    term: Term
    island: IslandIndex
    sentence: Sentence


class WorkerStatus(Model):
    """The heartbeat. `progress` rises while the compute thread gets on; `detail` says what a person should know.

    `jobs` are those whose dataset is here or on its way, also without islands of theirs.
    """

    kind: Literal["status"] = "status"
    instance: Id
    incarnation: Count
    state: WorkerState
    progress: Count
    holdings: tuple[Holding, ...] = ()
    troubles: tuple[Trouble, ...] = ()
    jobs: tuple[Id, ...] = ()
    detail: Sentence = ""
    doing: Doing | None = None
    counters: Counters = Counters()


# ---------------------------------------------------------------------------------------------- reports


class HitStatement(Model):
    """The target was met at `generation` (1-based within the epoch), the end of a slice."""

    generation: Count
    error: float


class Addition(Model):
    """One equation found by an island in this epoch; fields as in `common.pareto.FrontEntry`."""

    complexity: Count
    error: float
    mse: float
    generation: Count
    program: Annotated[bytes, Field(max_length=8192)]


class Tally(Model):
    """Point evaluations of an island by part, cumulative since epoch 0, at the end of the slice at `generation`."""

    generation: Count
    evaluations: dict[Annotated[str, Field(max_length=64)], Count]


class IslandReport(Model):
    """What one island says of one epoch, finished or given up (`island_worker.evolution.island.EpochOutcome`).

    `generations` is how far it got: to the epoch's end, to its own hit, or, when another island met the target, at
    least as far as is needed then. `additions` are those to its front, `runners_up` those to the next best beside it.
    `tallies` are those of all slices that it finished; `digest` is that of its state.
    """

    island: IslandIndex
    generations: Count
    hit: HitStatement | None
    additions: tuple[Addition, ...]
    runners_up: Annotated[tuple[Addition, ...], Field(max_length=MAX_RUNNERS_UP)] = ()
    tallies: tuple[Tally, ...]
    best_error: float | None
    digest: Annotated[str, Field(pattern=r"^[0-9a-f]{16,128}$")]


class EpochReport(Model):
    """One worker's islands of one archipelago, one epoch: all but those that the cut spares the whole epoch."""

    kind: Literal["report"] = "report"
    job: Id
    variable: Variable
    term: Term
    epoch: Count
    islands: Annotated[tuple[IslandReport, ...], Field(min_length=1)]


# ---------------------------------------------------------------------------------------------- migrants


class Block(Model):
    """Solutions of island `source` for island `destination`, with their slots; opaque to all but the island."""

    source: IslandIndex
    destination: IslandIndex
    data: bytes


class Migrants(Model):
    """Emigrants of one finished epoch for islands of one worker."""

    kind: Literal["migrants"] = "migrants"
    job: Id
    variable: Variable
    term: Term
    epoch: Count
    blocks: Annotated[tuple[Block, ...], Field(min_length=1)]


class Finished(Model):
    """In place of emigrants: `island` met the target at `generation` of `epoch`; nothing after that is needed."""

    kind: Literal["finished"] = "finished"
    job: Id
    variable: Variable
    term: Term
    epoch: Count
    generation: Count
    island: IslandIndex


class Mail(Model):
    """From worker to worker."""

    body: Annotated[Migrants | Finished, Field(discriminator="kind")]


# ---------------------------------------------------------------------------------------------- pulls


class PullMigrants(Model):
    """What did the `sources` of yours send in `epoch` to island `destination`?"""

    kind: Literal["pull-migrants"] = "pull-migrants"
    job: Id
    variable: Variable
    term: Term
    epoch: Count
    destination: IslandIndex
    sources: Annotated[tuple[IslandIndex, ...], Field(min_length=1)]


class PullReports(Model):
    """What did you report of these epochs (first included, last excluded)?"""

    kind: Literal["pull-reports"] = "pull-reports"
    job: Id
    variable: Variable
    term: Term
    first: Count
    last: Count


class PullStates(Model):
    """What are the states of these islands at checkpoint `epoch`, of the first one from byte `offset` on?"""

    kind: Literal["pull-states"] = "pull-states"
    job: Id
    variable: Variable
    term: Term
    epoch: Count
    islands: Annotated[tuple[IslandIndex, ...], Field(min_length=1, max_length=1024)]
    offset: Count = 0


class Pull(Model):
    """Question to a worker; that for states also to the coordinator."""

    body: Annotated[PullMigrants | PullReports | PullStates, Field(discriminator="kind")]


class Sent(Model):
    """The migrants asked for, as far as they exist already, and those sources that finished instead."""

    kind: Literal["sent"] = "sent"
    migrants: Migrants | None
    finished: tuple[Finished, ...] = ()


class Reports(Model):
    """The reports asked for, as far as they exist already."""

    kind: Literal["reports"] = "reports"
    reports: tuple[EpochReport, ...]


class Piece(Model):
    """Bytes from `offset` on of the state of one island; the whole has `size` bytes and the SHA-256 `digest`."""

    island: IslandIndex
    size: Annotated[int, Field(ge=1, le=MAX_STATE)]
    digest: Digest
    offset: Count
    data: Annotated[bytes, Field(max_length=CHUNK_SIZE)]


class States(Model):
    """As many of the states asked for as one message bears, in their order; the last one may be a part of it."""

    kind: Literal["states"] = "states"
    pieces: Annotated[tuple[Piece, ...], Field(min_length=1, max_length=1024)]


class NotYet(Model):
    """Nothing of what was asked for exists yet; ask later."""

    kind: Literal["not-yet"] = "not-yet"


class NewerTerm(Model):
    """The question's term is over; `term` is the one that the answerer knows (0: it holds nothing there)."""

    kind: Literal["newer-term"] = "newer-term"
    job: Id
    variable: Variable
    term: Count


class PullAnswer(Model):
    """Answer of a worker."""

    body: Annotated[Sent | Reports | States | NotYet | NewerTerm, Field(discriminator="kind")]


# ---------------------------------------------------------------------------------------------- clients


class Upload(Model):
    """One chunk of a table, or, with `data` None, the question which chunks are missing.

    `blob` is the SHA-256 of all `size` bytes; chunk `index` holds bytes from ``index * CHUNK_SIZE``; `sha256` is the
    chunk's own. Idempotent.
    """

    kind: Literal["upload"] = "upload"
    blob: Digest
    size: Annotated[int, Field(ge=1, le=MAX_UPLOAD)]
    index: Count = 0
    sha256: Digest | None = None
    data: Annotated[bytes, Field(max_length=CHUNK_SIZE)] | None = None


class Submit(Model):
    """A job under an id that the client made. The same id with the same contents again is the same job."""

    kind: Literal["submit"] = "submit"
    job: Id
    name: Annotated[str, Field(max_length=200)]
    config: JobConfig
    table: Digest
    priority: Priority = 0


class Jobs(Model):
    """List all jobs."""

    kind: Literal["jobs"] = "jobs"


class Status(Model):
    """Tell how a job is getting on."""

    kind: Literal["job-status"] = "job-status"
    job: Id


class Workers(Model):
    """List all workers."""

    kind: Literal["workers"] = "workers"


class GetResult(Model):
    """Give a job's result; while it runs, the best so far."""

    kind: Literal["get-result"] = "get-result"
    job: Id


class Cancel(Model):
    """End a job and keep the best models; without effect on a job that has ended."""

    kind: Literal["cancel"] = "cancel"
    job: Id


class GetEvents(Model):
    """Tell what happened to a job, or at all (`job` None), after the event of number `after`: `limit` of it at most.

    With `after` 0 these are the last ones.
    """

    kind: Literal["get-events"] = "get-events"
    job: Id | None = None
    after: Count = 0
    limit: Annotated[int, Field(ge=1, le=1000)] = 200


class Ask(Model):
    """Question of a client."""

    body: Annotated[
        Upload | Submit | Jobs | Status | Workers | GetResult | Cancel | GetEvents, Field(discriminator="kind")
    ]


class Uploaded(Model):
    """Chunks of an upload that are still missing; none: the table is stored."""

    kind: Literal["uploaded"] = "uploaded"
    blob: Digest
    missing: tuple[Count, ...]


class JobList(Model):
    """All jobs, newest last."""

    kind: Literal["job-list"] = "job-list"
    jobs: tuple[JobView, ...]


class JobStatus(Model):
    """One job; the answer to Submit, Status and Cancel."""

    kind: Literal["job-view"] = "job-view"
    job: JobView


class WorkerList(Model):
    """All workers seen since the coordinator started, and the coordinator itself."""

    kind: Literal["worker-list"] = "worker-list"
    workers: tuple[WorkerView, ...]
    coordinator: CoordinatorView | None = None


class EventList(Model):
    """What happened, in order."""

    kind: Literal["event-list"] = "event-list"
    events: tuple[EventView, ...]


class Result(Model):
    """The contents of result.json, as JSON text."""

    kind: Literal["result"] = "result"
    json_text: str


FailureKind = Literal["unknown-job", "refused", "data", "too-early", "protocol", "internal"]


class Failure(Model):
    """The question cannot be answered; `sentence` is for the person who asked."""

    kind: Literal["failure"] = "failure"
    failure: FailureKind
    sentence: Sentence


class Answer(Model):
    """Answer to a client."""

    body: Annotated[
        Uploaded | JobList | JobStatus | WorkerList | Result | EventList | Failure, Field(discriminator="kind")
    ]


def chunk_count(size: int) -> int:
    """Return the number of chunks of `size` bytes (at least 1)."""
    return max(1, -(-size // CHUNK_SIZE))
