"""The tasks of all jobs: who has each, how often it was lost, and whether it is tried again. Pure; time comes in."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, get_args

from atoll_core.errors import LocalProtocolError
from atoll_core.task_frames import Failure
from atoll_core.wire.messages.tasks import AnalysisFunction, Lease, TaskFunction, TaskInput

MAX_LOSSES: Final = 5
"""So many workers may be lost with a task; as many deaths fail an archipelago (`workers.crash_loops`)."""

ANALYSES: Final[frozenset[TaskFunction]] = frozenset(get_args(AnalysisFunction))
"""Functions that answer questions about jobs that have ended."""

LIMIT_S: Final = 3_600.0
"""Far above what preparing or refining takes: a task that takes longer hangs, and is ended, unless its job was given
more time."""

State = Literal["waiting", "leased", "running", "ended"]
Step = Literal["lease", "begin", "lose", "retry", "end"]

TASK_TRANSITIONS: Final[Mapping[State, Mapping[Step, State]]] = {
    "waiting": {"lease": "leased", "end": "ended"},
    "leased": {"begin": "running", "lose": "waiting", "retry": "waiting", "end": "ended"},
    "running": {"begin": "running", "lose": "waiting", "retry": "waiting", "end": "ended"},
    "ended": {"end": "ended"},
}
"""State of a task -> what happens -> its next state. `lose`: its worker is lost; `retry`: it failed there."""


def task_id(job: str, function: TaskFunction, inputs: Sequence[TaskInput]) -> str:
    """Return the SHA-256 that names a task: of its job, function and digests of inputs.

    The time that it may take is left out: what is left of `--max-time` is another after a restart of the coordinator,
    which takes over what workers have of the task all the same.
    """
    words = [job, function, *(given.digest for given in inputs)]
    return hashlib.sha256("\n".join(words).encode()).hexdigest()


@dataclass(slots=True)
class Task:
    """One task. `worker` has it while it is leased or running; `helpers` are the workers that
    help with it, and since when.

    `is_alone`: memory ran out with it, so that it is tried once more where nothing else runs. `term` counts its
    leases, `threads` is how many it may use there. `waiting_since`, `leased_at` and `said_at`, when its worker was last
    told, are the bus's seconds. `compared` counts the candidates that its worker has compared. `charged` is for how
    many seconds since `began_at` its user has been charged. `parts` of its result have come, `received` bytes; when all
    have, the result `is_read` in the background.
    """

    id: str
    job: str
    function: TaskFunction
    inputs: tuple[TaskInput, ...]
    seconds: float | None
    waiting_since: float
    state: State = "waiting"
    worker: str | None = None
    term: int = 0
    threads: int = 1
    leased_at: float = 0.0
    said_at: float = 0.0
    began_at: float | None = None
    charged: float = 0.0
    compared: int = 0
    helpers: dict[str, float] = field(default_factory=dict)
    losses: int = 0
    failures: list[Failure] = field(default_factory=list)
    is_alone: bool = False
    parts: list[bytes] = field(default_factory=list)
    received: int = 0
    is_read: bool = False

    @property
    def is_analysis(self) -> bool:
        """Whether it answers a question about a job that has ended."""
        return self.function in ANALYSES

    @property
    def turn(self) -> str:
        """Whose turn it waits for: its job's or, of an analysis, its own."""
        return self.id if self.is_analysis else self.job

    def lease(self) -> Lease:
        """Return what the worker is told."""
        return Lease(
            task=self.id, term=self.term, job=self.job, function=self.function, inputs=self.inputs,
            seconds=self.seconds, threads=self.threads,
        )  # fmt: skip

    def drop_result(self) -> None:
        """Forget what has come of its result."""
        self.parts, self.received, self.is_read = [], 0, False

    @property
    def limit_s(self) -> float:
        """How many seconds after its lease it is taken for hung."""
        return max(LIMIT_S, self.seconds or 0.0)

    def step(self, step: Step) -> None:
        """Go to the next state by the table."""
        following = TASK_TRANSITIONS[self.state].get(step)
        if following is None:
            raise LocalProtocolError(f"a task that is {self.state} has no {step}")
        self.state = following


class TaskTable:
    """All tasks that have not ended, by id, in the order in which they came."""

    def __init__(self) -> None:
        self._tasks: dict[str, Task] = {}

    def __iter__(self) -> Iterator[Task]:
        return iter(tuple(self._tasks.values()))

    def __len__(self) -> int:
        return len(self._tasks)

    def get(self, task: str) -> Task | None:
        """Return a task that has not ended."""
        return self._tasks.get(task)

    def of_job(self, job: str) -> list[Task]:
        """Return the tasks of a job that have not ended."""
        return [task for task in self._tasks.values() if task.job == job]

    def on(self, worker: str) -> Task | None:
        """Return the task that a worker has."""
        return next((task for task in self._tasks.values() if task.worker == worker), None)

    def add(self, task: Task) -> None:
        """Add a task."""
        if task.id in self._tasks:
            raise LocalProtocolError(f"task {task.id} is there already")
        self._tasks[task.id] = task

    def lease(self, task: Task, worker: str, now: float, threads: int = 1) -> None:
        """Give a task to a worker, which may use so many threads."""
        task.step("lease")
        task.worker, task.leased_at, task.said_at, task.began_at = worker, now, now, None
        task.charged, task.compared = 0.0, 0
        task.term, task.threads = task.term + 1, threads

    def begin(self, task: Task, now: float) -> bool:
        """Take in that a task runs; return whether that is news."""
        is_new = task.state == "leased"
        if is_new:
            task.began_at = now
        task.step("begin")
        return is_new

    def lose(self, worker: str, now: float, *, had_left: bool = False) -> list[tuple[Task, str | None]]:
        """Take in that a worker is lost; return the tasks that it had, and why one of them is not tried again.

        One that `had_left` said before that it would end, so that no task has ended it, and counts for none.
        """
        lost: list[tuple[Task, str | None]] = []
        for task in tuple(self._tasks.values()):
            task.helpers.pop(worker, None)
            if task.worker != worker:
                continue
            task.losses += not had_left
            if task.losses >= MAX_LOSSES:
                lost.append((task, f"its worker was lost, {task.losses} times"))
                self.end(task)
            else:
                self._wait_again(task, "lose", now)
                lost.append((task, None))
        return lost

    def fail(self, task: Task, failure: Failure, sentence: str, now: float) -> str | None:
        """Take in that a task failed; return why it is not tried again, None when it is.

        What breaks, or a process that dies, is tried once more; where memory ran out, alone; what took too long, never.
        """
        task.failures.append(failure)
        if failure == "time" or len(task.failures) > 1:
            self.end(task)
            again = ", twice" if len(set(task.failures)) < len(task.failures) else ""
            return sentence + again
        task.is_alone = failure == "memory"
        self._wait_again(task, "retry", now)
        return None

    def overdue(self, now: float) -> list[Task]:
        """Return the tasks that have taken too long."""
        held = (task for task in self._tasks.values() if task.worker is not None and not task.is_read)
        return [task for task in held if now - task.leased_at > task.limit_s]

    def end(self, task: Task) -> None:
        """Take in that a task has ended: done, failed for good, or needed by nobody."""
        task.step("end")
        del self._tasks[task.id]

    def validate(self) -> None:
        """Check the invariants; raises AssertionError."""
        owners = [task.worker for task in self._tasks.values() if task.worker is not None]
        helpers = [helper for task in self._tasks.values() for helper in task.helpers]
        assert len(set(owners)) == len(owners), "a worker has two tasks"
        assert len(set(helpers)) == len(helpers), "a worker helps with two tasks"
        assert not set(owners) & set(helpers), "a worker helps while it has a task"
        for task in self._tasks.values():
            assert (task.worker is None) == (task.state == "waiting"), f"a task is {task.state} on {task.worker}"

    def _wait_again(self, task: Task, step: Step, now: float) -> None:
        task.step(step)
        task.worker, task.began_at, task.waiting_since = None, None, now
        task.helpers.clear()
        task.drop_result()
