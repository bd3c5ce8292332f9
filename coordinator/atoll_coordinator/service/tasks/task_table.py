"""The tasks of all jobs: their states, their assignment to workers, and retries. Pure; the time is an argument.

A worker has one task at a time: its own task, or a task of another worker with which it helps. Waiting tasks are leased
first, in the given order; idle workers then help with running tasks. A task that ran out of memory gets a host without
other tasks: `plan_leases` keeps a host free of other tasks and helpers for it.
"""

import hashlib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, get_args

from atoll_core.errors import LocalProtocolError
from atoll_core.task_frames import Failure
from atoll_core.wire.messages.tasks import AnalysisFunction, Lease, TaskFunction, TaskInput

MAX_LOSSES: Final = 5
"""Number of lost workers after which a task fails, as an archipelago does (`workers.crash_loops`)."""

ANALYSES: Final[frozenset[TaskFunction]] = frozenset(get_args(AnalysisFunction))
"""Functions that answer questions about ended jobs."""

LIMIT_S: Final = 3_600.0
"""Seconds after which a task is treated as hung and ended, unless its job has more time. Preparing and refining take
far less."""

MOST_THREADS: Final = 16
"""Largest number of threads of a task. Threads integrate parts of a fit; the rest of a fit, about a tenth of its time,
is Python, which one thread runs at a time. So more threads would mostly wait."""

_BY_HELPERS: Final[frozenset[TaskFunction]] = frozenset({"prepare"})
"""Functions that get helpers in place of threads: their batches are mostly Python, so that threads would wait for each
other."""

State = Literal["waiting", "leased", "running", "ended"]
Step = Literal["lease", "begin", "lose", "retry", "end"]

TASK_TRANSITIONS: Final[Mapping[State, Mapping[Step, State]]] = {
    "waiting": {"lease": "leased", "end": "ended"},
    "leased": {"begin": "running", "lose": "waiting", "retry": "waiting", "end": "ended"},
    "running": {"begin": "running", "lose": "waiting", "retry": "waiting", "end": "ended"},
    "ended": {"end": "ended"},
}
"""State of a task -> event -> next state. `lose`: its worker is lost; `retry`: it failed on its worker."""


def task_id(job: str, function: TaskFunction, inputs: Sequence[TaskInput]) -> str:
    """Return the id of a task: the SHA-256 of its job, function and digests of inputs.

    The time limit is not part of the id, because it differs after a restart of the coordinator, which must still
    recognise the tasks of workers.
    """
    words = [job, function, *(given.digest for given in inputs)]
    return hashlib.sha256("\n".join(words).encode()).hexdigest()


@dataclass(slots=True)
class Task:
    """One task.

    `worker` has the task while it is leased or running; `helpers` has the time since which each helper helps. `term`
    counts the leases of the task; its worker may use `threads` threads. `is_alone`: it ran out of memory and is tried
    once more on a host without other tasks. `waiting_since`, `leased_at`, `sent_at` (the last message to its worker or
    chunk from it) and `began_at` are in seconds of the bus. `compared` is the number of candidates that its worker has
    compared. `charged` seconds since `began_at` have been charged to its user. `parts` are the parts of its result that
    have arrived, with `received` bytes. When all have arrived, the result is read in the background (`is_read`).
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
    sent_at: float = 0.0
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
        """Whether it answers a question about an ended job."""
        return self.function in ANALYSES

    @property
    def turn(self) -> str:
        """The id by which the task takes turns: the id of its job, or for an analysis its own id."""
        return self.id if self.is_analysis else self.job

    def lease(self) -> Lease:
        """Return the message to its worker."""
        return Lease(
            task=self.id, term=self.term, job=self.job, function=self.function, inputs=self.inputs,
            seconds=self.seconds, threads=self.threads,
        )  # fmt: skip

    def drop_result(self) -> None:
        """Forget the parts of its result that have arrived."""
        self.parts, self.received, self.is_read = [], 0, False

    @property
    def limit_s(self) -> float:
        """The task is treated as hung this number of seconds after its lease."""
        return max(LIMIT_S, self.seconds or 0.0)

    def step(self, step: Step) -> None:
        """Go to the next state by the table."""
        following = TASK_TRANSITIONS[self.state].get(step)
        if following is None:
            raise LocalProtocolError(f"a task that is {self.state} cannot {step}")
        self.state = following


class TaskTable:
    """All tasks that have not ended, by id, in the order of their creation."""

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
        """Lease a task to a worker."""
        task.step("lease")
        task.worker, task.leased_at, task.sent_at, task.began_at = worker, now, now, None
        task.charged, task.compared = 0.0, 0
        task.term, task.threads = task.term + 1, threads

    def begin(self, task: Task, now: float) -> bool:
        """Record that a task runs; return whether this is new."""
        is_new = task.state == "leased"
        if is_new:
            task.began_at = now
        task.step("begin")
        return is_new

    def lose(self, worker: str, now: float, *, had_left: bool = False) -> list[tuple[Task, str | None]]:
        """Record that a worker is lost; return its tasks, each with the reason of its failure (None: it waits again).

        A worker that `had_left` had announced its end. So no task caused the loss, and the loss does not count.
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
        """Record that a task failed; return why it is not tried again, None: it is tried again.

        After an error or the death of its process a task is tried once more. After a lack of memory it is tried once
        more, alone on a host. After a timeout it is not tried again.
        """
        task.failures.append(failure)
        if failure == "time" or len(task.failures) > 1:
            self.end(task)
            again = ", twice" if len(set(task.failures)) < len(task.failures) else ""
            return sentence + again
        task.is_alone = failure == "memory"
        self._wait_again(task, "retry", now)
        return None

    def timed_out(self, now: float) -> list[Task]:
        """Return the tasks that have taken too long."""
        held = (task for task in self._tasks.values() if task.worker is not None and not task.is_read)
        return [task for task in held if now - task.leased_at > task.limit_s]

    def end(self, task: Task) -> None:
        """Remove a task that is done, has failed, or is no longer needed."""
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


@dataclass(frozen=True, slots=True)
class Slot:
    """A worker that can get a task.

    `is_loaded`: its task process runs already; `near` are the jobs whose tasks it has done; `islands` is the number of
    islands that it computes; `helps` is the task of another worker that it helps with now.
    """

    worker: str
    host: str
    is_loaded: bool = False
    near: frozenset[str] = frozenset()
    islands: int = 0
    helps: str | None = None


@dataclass(slots=True)
class TaskPlan:
    """The plan: `leases` (task, worker, threads), `helps` (task, worker), and `recalled` helpers, which must stop."""

    leases: list[tuple[Task, str, int]] = field(default_factory=list)
    helps: list[tuple[Task, str]] = field(default_factory=list)
    recalled: list[str] = field(default_factory=list)


def plan_leases(
    waiting: Sequence[Task], running: Sequence[Task], slots: Sequence[Slot], busy_hosts: Counter[str],
    closed_hosts: Collection[str] = (),
) -> TaskPlan:  # fmt: skip
    """Return which tasks to lease to which workers, and which workers help with which tasks.

    Args:
        waiting: tasks without a worker, the next one first.
        running: running tasks that may get helpers.
        slots: workers that have no task, or only help with one.
        busy_hosts: number of tasks on each host.
        closed_hosts: hosts with a task that must be alone there.
    """
    made = TaskPlan()
    left = [slot for slot in slots if slot.host not in closed_hosts]
    busy = Counter(busy_hosts)
    for task in waiting:
        slot = _best(task, left, busy)
        if slot is not None:
            left.remove(slot)
            made.recalled += [slot.worker] if slot.helps is not None else []
            idle = sum(other.host == slot.host and other.helps is None for other in left)
            has_threads = not task.is_alone and task.function not in _BY_HELPERS
            made.leases.append((task, slot.worker, min(1 + idle, MOST_THREADS) if has_threads else 1))
            busy[slot.host] += 1
        if task.is_alone and left:
            free = slot or min(left, key=lambda one: (busy[one.host], one.host))
            host = free.host  # it gets no other task, so that it becomes free
            made.recalled += [one.worker for one in left if one.host == host and one.helps is not None]
            left = [one for one in left if one.host != host]
    helped = [task for task in running if not task.is_alone]
    helped.sort(key=lambda task: (len(task.helpers), task.waiting_since))
    idle_slots = [slot for slot in left if slot.helps is None]
    if len(idle_slots) == 1 and len(helped) == 1 and helped[0].threads > 1 and busy_hosts[idle_slots[0].host]:
        return made  # a second thread uses this core: unlike a helper, it needs no messages
    while idle_slots and helped:
        for task in helped:
            if idle_slots:
                made.helps.append((task, idle_slots.pop(0).worker))
    return made


def _best(task: Task, slots: Sequence[Slot], busy: Counter[str]) -> Slot | None:
    """Return the best worker for a task (near its data, loaded, few islands); None: the task must wait."""
    fit = [slot for slot in slots if not (task.is_alone and busy[slot.host])]

    def cost(slot: Slot) -> tuple[bool, bool, bool, int, str]:
        return slot.helps is not None, task.job not in slot.near, not slot.is_loaded, slot.islands, slot.worker

    return min(fit, key=cost, default=None)
