"""Jobs and workers as clients see them: the data behind `status`, `jobs` and `workers`."""

from collections.abc import Iterable
from typing import Annotated, Final, Literal, Self

from pydantic import Field

from atoll_core.config import Frozen
from atoll_core.wire.messages.tasks import TaskFunction

JobState = Literal["queued", "preparing", "running", "refining", "done", "failed", "cancelled"]
FINAL_STATES: frozenset[JobState] = frozenset({"done", "failed", "cancelled"})
WorkerState = Literal["compiling", "ready", "computing", "waiting", "leaving", "hung", "lost"]
WorkerService = Literal["open", "cordoned", "draining"]
"""Whether a worker gets islands, keeps its present islands without getting more, or hands its islands over."""
EventKind = Literal[
    "submitted", "prepared", "placed", "unplaced", "isolated", "pardoned", "commit", "cut", "refining",
    "done", "failed", "cancelled", "stalled", "moving", "worker-joined", "worker-lost", "worker-back",
    "refused", "started", "deleted", "broken", "held", "resumed", "changed", "log",
]  # fmt: skip

WARNINGS: frozenset[EventKind] = frozenset(
    {"failed", "stalled", "isolated", "unplaced", "worker-lost", "refused", "broken"}
)
"""Events that may need attention."""


class Traffic(Frozen):
    """Messages of one kind that a process received and sent, and the bytes of their payloads."""

    kind: Annotated[str, Field(max_length=16)]
    messages_in: Annotated[int, Field(ge=0)] = 0
    bytes_in: Annotated[int, Field(ge=0)] = 0
    messages_out: Annotated[int, Field(ge=0)] = 0
    bytes_out: Annotated[int, Field(ge=0)] = 0


class Counters(Frozen):
    """Counters of a process since its start.

    `dropped`: messages lost because they arrived faster than they were processed; `refused`: malformed or foreign
    messages; `broken`: events that caused an internal error; `duplicates`: repeated messages, which change nothing;
    `waited_s`: seconds that islands waited for migrants, summed over islands; `memory_bytes`: memory in use now;
    `cpu_s`: processor time used.
    """

    traffic: Annotated[tuple[Traffic, ...], Field(max_length=32)] = ()
    dropped: Annotated[int, Field(ge=0)] = 0
    refused: Annotated[int, Field(ge=0)] = 0
    broken: Annotated[int, Field(ge=0)] = 0
    duplicates: Annotated[int, Field(ge=0)] = 0
    waited_s: Annotated[float, Field(ge=0.0)] = 0.0
    memory_bytes: Annotated[int, Field(ge=0)] = 0
    cpu_s: Annotated[float, Field(ge=0.0)] = 0.0


class StoreView(Frozen):
    """Transactions of the coordinator's store since its start, and the seconds they took."""

    transactions: int = 0
    total_s: float = 0.0
    worst_s: float = 0.0


class UserView(Frozen):
    """Numbers of jobs of one user that wait in the queue and that have begun, without ended jobs.

    `user` is the name in the certificate; None: jobs submitted without a certificate.
    """

    user: str | None
    queued: int = 0
    begun: int = 0


class CoordinatorView(Frozen):
    """The coordinator itself as `workers` shows it; `seconds` since its start.

    `queued` jobs wait, `under_way` jobs have places; while the queue is `paused`, no job is started. `lag_s` is the
    largest delay of its event loop in the last minute, in seconds. `users` are the users with the most jobs that have
    not ended, limited to jobs that the client may see.
    """

    version: str
    incarnation: int
    seconds: float
    counters: Counters
    store: StoreView
    queued: int = 0
    under_way: int = 0
    paused: bool = False
    lag_s: float = 0.0
    users: tuple[UserView, ...] = ()


class JobCounters(Frozen):
    """Counters of a job since the coordinator's start, in addition to its point evaluations.

    `placements` counts terms, `deaths` terms that ended by the death of a worker, `stalls` the times without progress;
    the others are as in `Counters`.
    """

    reports: int = 0
    duplicates: int = 0
    commits: int = 0
    placements: int = 0
    deaths: int = 0
    stalls: int = 0
    waited_s: float = 0.0


class EventView(Frozen):
    """One event, as `logs` shows it; `number` rises. Fields that do not apply are None.

    `details` are further numbers and words by name.
    """

    number: int
    time: str
    event: EventKind
    text: str
    job: str | None = None
    variable: str | None = None
    island: int | None = None
    epoch: int | None = None
    term: int | None = None
    worker: str | None = None
    details: dict[str, str | int | float] = Field(default_factory=dict)


class VariableView(Frozen):
    """Progress of one equation. `epoch` counts completely reported epochs; `why` says how its search ended.

    A known equation is not searched: its `why` is always "known". `verdict` is known when the job has ended.
    """

    variable: str
    lhs: str
    epoch: int
    error: float | None = None
    normalized_error: float | None = None
    complexity: int | None = None
    expression: str | None = None
    point_evaluations: int = 0
    converged: bool = False
    finished: bool = False
    why: Literal["target", "law", "stagnation", "max-epochs", "max-time", "cancelled", "known"] | None = None
    verdict: Literal["exact", "good", "doubtful", "no model"] | None = None


class TaskView(Frozen):
    """A task that has not ended; `compared` counts candidates, `helpers` the workers that help `worker`."""

    function: TaskFunction
    worker: str | None = None
    helpers: int = 0
    compared: int = 0


class JobView(Frozen):
    """One job as `jobs` and `status` show it. Times are in seconds; `reason` says why the job failed or why it waits.

    `fault` is why the job failed: unusable data, two workers that diverged, islands that killed their workers (poison),
    or an internal error. `stalls` says where it makes no progress, and why; `ahead` counts jobs before it in the queue.
    `submitter` is the name in the certificate; other users see the job when it is `shared`. A `paused` job waits to be
    resumed; a job that is `held` has begun and has no place now. `tasks` have not ended. `notes` are the `warnings`
    that only report steps taken by rule.
    """

    job: str
    name: str
    state: JobState
    seed: int
    preset: str
    reason: str | None = None
    fault: Literal["data", "diverged", "poison", "internal"] | None = None
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    submitted: str
    elapsed: float
    workers: int
    point_evaluations: int
    point_evaluations_per_second: float | None = None
    variables: tuple[VariableView, ...] = ()
    priority: int = 0
    ahead: int | None = None
    stalls: tuple[str, ...] = ()
    target_error: float | None = None
    counters: JobCounters = JobCounters()
    submitter: str | None = None
    shared: bool = False
    paused: bool = False
    held: bool = False
    tasks: tuple[TaskView, ...] = ()


class IslandView(Frozen):
    """One island of an equation that is searched: its worker, if it has one, and its last reported epoch."""

    variable: str
    island: int
    worker: str | None
    epoch: int


class WorkerView(Frozen):
    """One worker as `workers` shows it; `silent` is seconds since its last message, `detail` a note for users.

    `doing` is its current computation by its last message, the job first; `standing` is seconds without progress in
    this computation. `joined` is seconds since it joined; `cores` are available to all processes of its host together.
    """

    worker: str
    host: str
    pid: int
    state: WorkerState
    islands: int
    silent: float
    version: str
    detail: str = ""
    doing: str = ""
    standing: float = 0.0
    counters: Counters = Counters()
    service: WorkerService = "open"
    joined: float = 0.0
    cores: int = 1


MAX_DETAILS: Final = 8
"""Largest number of notes of compiling workers."""


class Workforce(Frozen):
    """Numbers of workers that are alive and that are compiling, and the first notes of compiling workers, sorted."""

    alive: Annotated[int, Field(ge=0)] = 0
    compiling: Annotated[int, Field(ge=0)] = 0
    details: Annotated[tuple[str, ...], Field(max_length=MAX_DETAILS)] = ()

    @classmethod
    def of(cls, workers: Iterable[WorkerView]) -> Self:
        """Return the workforce of these workers; lost workers do not count."""
        alive = [worker for worker in workers if worker.state != "lost"]
        compiling = [worker for worker in alive if worker.state == "compiling"]
        details = sorted(worker.detail for worker in compiling if worker.detail)  # "compiling …" before "waiting …"
        return cls(alive=len(alive), compiling=len(compiling), details=tuple(details[:MAX_DETAILS]))
