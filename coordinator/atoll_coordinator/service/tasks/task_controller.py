"""Task controller: leases tasks to workers, handles their reports, and posts outcomes to the service's loop.

The id of a task is the digest of its job, function and inputs, so the same work always has the same id. Leases are not
stored: a restarted coordinator creates the tasks again, and takes over tasks with these ids that workers still have. At
each heartbeat the tasks of a worker are compared with the table; a difference is corrected by sending the lease again
or by a release. So a lost message delays a task, and cannot stop it.

*Doubts.* Inputs and prepared data of all live jobs are kept in memory, although the store has them too.
"""

import hashlib
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final

from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.service.monitoring.breakages import ask_for_report
from atoll_coordinator.service.tasks.analyses import MAX_KEPT, Analyses, RequestedAnalysis, key_of
from atoll_coordinator.service.tasks.background import (
    JobPrepared,
    PreparationBegun,
    PreparationFailed,
    RefiningFailed,
    ResultRead,
    TaskResult,
)
from atoll_coordinator.service.tasks.task_table import Slot, Task, TaskTable, plan_leases, task_id
from atoll_coordinator.service.workers.channel import WorkerChannel
from atoll_coordinator.service.workers.membership import NO_WORKER, Membership
from atoll_coordinator.tasks.preparing import Prepared
from atoll_coordinator.tasks.refining import Searched
from atoll_core.config import JobConfig
from atoll_core.errors import RemoteProtocolError
from atoll_core.task_frames import Failure
from atoll_core.wire.messages import tasks as messages
from atoll_core.wire.messages.clients import AskAnalysis
from atoll_core.wire.messages.limits import CHUNK_SIZE, MAX_MESSAGE
from atoll_core.wire.messages.views import TaskView
from atoll_core.wire.messages.workers import WorkerStatus
from atoll_core.wire.values import decode_value

INLINE: Final = 64 * 1024
"""Inputs of at most this number of bytes are sent with the lease."""

HELP_AFTER_S: Final = 1.0
"""Seconds after which a running task gets helpers; the process of a helper takes about this time to start."""

SETTLED_S: Final = 2.5
"""This number of seconds after a lease, heartbeats must show the task; otherwise the lease was lost. Heartbeats are
sent once a second."""


@dataclass(slots=True)
class _Blob:
    """An input that is not in the store, and the jobs that use it; jobs with the same data share it."""

    data: bytes
    jobs: set[str]


class TaskController:
    """The tasks of all jobs."""

    def __init__(  # noqa: PLR0913  # the rules for turns
        self, channel: WorkerChannel, membership: Membership, post: Callable[[object], None],
        read: Callable[[TaskResult], object],
        order: Callable[[Collection[str], Collection[str]], Sequence[str]] = lambda waiting, _: tuple(waiting),
        may_follow: Callable[[str], bool] = lambda job: False,
        charge: Callable[[str, float], object] = lambda turn, seconds: None,
        forget: Callable[[str], object] = lambda turn: None,
    ) -> None:  # fmt: skip
        """Set up.

        Args:
            channel: sends messages to the workers in `membership`.
            post: posts outcomes to the loop.
            read: reads a result in the background; `take_result` is then called with it.
            order: takes the turns (`Task.turn`) of waiting tasks, in the order of their creation, and of running tasks;
                returns the turns that may get a lease, the next one first.
            may_follow: returns whether a job may soon create a task that a worker already has; then the worker keeps
            it. charge: charges a turn for the seconds for which workers have run its tasks, or helped with them.
            forget: forgets the turn of a question.
        """
        self.table: Final = TaskTable()
        self.analyses: Final = Analyses()
        self.help_after_s = HELP_AFTER_S
        self._channel = channel
        self._membership = membership
        self.post: Final = post
        self._read = read
        self._order = order
        self._may_follow = may_follow
        self._charge = charge
        self._forget = forget
        self._configs: dict[str, JobConfig] = {}
        self._blobs: dict[str, _Blob] = {}
        self._prepared: dict[str, tuple[str, bytes]] = {}
        self._near: dict[str, str] = {}
        self._keeping: set[str] = set()

    # ------------------------------------------------------------------------------------------------ jobs

    def prepare(self, job: str, table: str, size: int, config: JobConfig, now: float) -> None:
        """Create the task that prepares a table. `PreparationBegun`, then `JobPrepared` or `PreparationFailed` is
        posted."""
        specification = self._input(job, config.model_dump_json().encode())
        inputs = (messages.TaskInput(digest=table, size=size), specification)
        self._add(job, "prepare", inputs, config.budget.max_time, now, config)

    def refine(self, searched: Searched, config: JobConfig, seconds: float | None, now: float) -> None:
        """Create the task that refines the equations of a search within `seconds` (None: no limit).

        `JobRefined` or `RefiningFailed` is posted.
        """
        job = searched.job
        inputs = (self._keep_input(job, *self._prepared[job]), self._input(job, searched.to_bytes()))
        self._add(job, "refine", inputs, seconds, now, config)

    def analyse(
        self, asked: AskAnalysis, result: bytes, table_size: int, user: str | None, now: float
    ) -> RequestedAnalysis:
        """Create the task that answers a question of a `user` about the `result` (JSON) of a job.

        Raises:
            RefusedError: The user has too many open questions.
        """
        self.analyses.check(user)
        tables = () if asked.table is None else (messages.TaskInput(digest=asked.table, size=table_size),)
        inputs = (self._input(asked.job, result), self._input(asked.job, asked.question), *tables)
        analysis = RequestedAnalysis(
            task_id(asked.job, asked.function, inputs), key_of(asked), asked.job, user, now, now
        )
        self.analyses.add(analysis)
        self._add(asked.job, asked.function, inputs, None, now)
        return analysis

    def _expire_analyses(self, now: float) -> None:
        """End the tasks of questions that no client repeats."""
        for expired in self.analyses.expire(now):
            task = self.table.get(expired)
            if task is not None:
                self._end(task)
            self._forget(expired)

    def encoded(self, job: str) -> bytes:
        """Return the prepared data of a job as bytes; empty if the job is not prepared."""
        return self._prepared.get(job, ("", b""))[1]

    def take_prepared(self, job: str, digest: str, encoded: bytes) -> Prepared:
        """Keep and return data that were prepared before a restart; raises RemoteProtocolError if they are
        unreadable."""
        prepared = decode_value(encoded, Prepared)
        self._prepared[job] = digest, encoded
        return prepared

    def cancel(self, job: str) -> None:
        """End all tasks of a job, also running ones, without an outcome."""
        for task in self.table.of_job(job):
            self._end(task)
        for analysis in self.analyses.forget_job(job):
            self._forget(analysis)
        self._forget_inputs(job)
        self._prepared.pop(job, None)
        self._near.pop(job, None)

    def _forget_inputs(self, job: str) -> None:
        for held in self._blobs.values():
            held.jobs.discard(job)
        self._blobs = {digest: held for digest, held in self._blobs.items() if held.jobs}

    def views(self, job: str) -> tuple[TaskView, ...]:
        """Return the views of the tasks of a job, without questions about its result."""
        return tuple(
            TaskView(function=task.function, worker=task.worker, helpers=len(task.helpers), compared=task.compared)
            for task in self.table.of_job(job)
            if not task.is_analysis
        )

    def waits(self, job: str) -> bool:
        """Return whether a job has a task without a worker."""
        return any(task.worker is None for task in self.table.of_job(job))

    def waiting_reason(self, job: str) -> str | None:
        """Return a sentence on why the tasks of a job wait; None: they do not wait."""
        if not self.waits(job):
            return None
        if self._keeping or any(task.worker is not None for task in self.table):
            return "waits for a worker that has no other task"
        return NO_WORKER

    def chunk(self, digest: str, index: int) -> bytes | None:
        """Return a chunk of an input that is kept here and not in the store; None: the input is unknown."""
        held = self._blobs.get(digest)
        return held.data[index * CHUNK_SIZE : (index + 1) * CHUNK_SIZE] if held is not None else None

    def _input(self, job: str, data: bytes) -> messages.TaskInput:
        return self._keep_input(job, hashlib.sha256(data).hexdigest(), data)

    def _keep_input(self, job: str, digest: str, data: bytes) -> messages.TaskInput:
        """Keep an input for workers to fetch, unless it is sent with the lease."""
        size = len(data)
        if size <= INLINE:
            return messages.TaskInput(digest=digest, size=size, data=data)
        self._blobs.setdefault(digest, _Blob(data, set())).jobs.add(job)
        return messages.TaskInput(digest=digest, size=size)

    def _add(
        self, job: str, function: messages.TaskFunction, inputs: tuple[messages.TaskInput, ...],
        seconds: float | None, now: float, config: JobConfig | None = None,
    ) -> None:  # fmt: skip
        """Add a task; the `config` of its job is needed for a sentence about an error."""
        task = Task(task_id(job, function, inputs), job, function, inputs, seconds, now)
        if config is not None:
            self._configs[task.id] = config
        self.table.add(task)
        for worker, member in self._membership.attending():  # a worker may have it from before a restart
            status = member.status
            has_task = status is not None and any(
                held.task == task.id and held.state != "helping" for held in status.tasks
            )
            if status is not None and has_task and self._can_adopt(task, worker, status):
                self._adopt(task, worker, now)
        self.dispatch(now)

    # --------------------------------------------------------------------------------------------- leases

    def dispatch(self, now: float) -> None:
        """Lease waiting tasks to workers, and have idle workers help."""
        waiting = [task for task in self.table if task.state == "waiting"]
        running = [task for task in self.table if task.state == "running"]
        if not waiting and not running:
            return
        turns = dict.fromkeys(task.turn for task in waiting), dict.fromkeys(task.turn for task in running)
        ranks = {turn: rank for rank, turn in enumerate(self._order(*turns))} if waiting else {}
        waiting = sorted(
            (task for task in waiting if task.turn in ranks), key=lambda task: (ranks[task.turn], task.waiting_since)
        )
        lasting = [task for task in running if task.began_at is not None and now - task.began_at >= self.help_after_s]
        planned = plan_leases(waiting, lasting, self._slots(), self._hosts(), self._hosts(is_alone=True))
        for worker in planned.recalled:
            self._recall(worker)
        for task, worker, threads in planned.leases:
            self._lease(task, worker, now, threads)
        for task, worker in planned.helps:
            task.helpers[worker] = now
            if task.worker is not None:
                self._channel.send(worker, messages.Help(task=task.id, job=task.job, worker=task.worker))

    def _lease(self, task: Task, worker: str, now: float, threads: int = 1) -> None:
        self.table.lease(task, worker, now, threads)
        if not task.is_analysis:
            self._near[task.job] = worker
        self._channel.send(worker, task.lease())

    def _slots(self) -> list[Slot]:
        owners = {task.worker for task in self.table}
        helped = {helper: task.id for task in self.table for helper in task.helpers}
        near: dict[str, set[str]] = {}
        for job, worker in self._near.items():
            near.setdefault(worker, set()).add(job)
        return [
            Slot(
                name, member.hello.host, bool(member.status and member.status.is_loaded), frozenset(near.get(name, ())),
                sum(held.islands for held in member.status.holdings) if member.status else 0, helped.get(name),
            )
            for name, member in self._membership.attending()
            if name not in owners and name not in self._keeping and self._membership.service(name) == "open"
        ]  # fmt: skip

    def _hosts(self, *, is_alone: bool = False) -> Counter[str]:
        """Return the number of tasks on each host; `is_alone`: only count tasks that must be alone on their host."""
        owners = (task.worker for task in self.table if task.worker is not None and (task.is_alone or not is_alone))
        members = (self._membership.member(owner) for owner in owners)
        return Counter(member.hello.host for member in members if member is not None)

    def _recall(self, worker: str) -> None:
        """Tell a worker to stop helping after its present batch."""
        for task in self.table:
            if task.helpers.pop(worker, None) is not None:
                self._channel.send(worker, messages.Release(task=task.id))

    def tick(self, now: float) -> None:
        """Charge users, end tasks that take too long or that no client wants, and lease waiting tasks."""
        self._expire_analyses(now)
        for task in self.table:
            self._charge_user(task, now)
            for worker in [*task.helpers]:
                if self._membership.service(worker) == "draining":
                    self._recall(worker)
        for task in self.table.timed_out(now):
            self._fail(task, "time", f"it took longer than {task.limit_s:,.0f} s and was ended", now)
        self.dispatch(now)

    def _charge_user(self, task: Task, now: float) -> None:
        """Charge the user of a task for the time since the last charge, including the time of helpers."""
        if task.began_at is not None:
            seconds = now - task.began_at - task.charged
            task.charged += seconds
            self._charge(task.turn, seconds * (1 + len(task.helpers)))

    # -------------------------------------------------------------------------------------------- workers

    def add_heartbeat(self, worker: str, status: WorkerStatus, now: float) -> None:
        """Compare the tasks that a worker has with the table, and correct differences by messages."""
        self._keeping.discard(worker)
        for held in status.tasks:
            self._compare(worker, held, status, now)
        shown = {held.task for held in status.tasks}
        for task in self.table:  # messages that the worker has missed
            if task.worker == worker and task.id not in shown and not task.is_read and now - task.sent_at > SETTLED_S:
                self._send_again(task, worker, now)
            if task.id not in shown and now - task.helpers.get(worker, now) > SETTLED_S:
                del task.helpers[worker]
        self.dispatch(now)

    def _compare(self, worker: str, held: messages.TaskStatus, status: WorkerStatus, now: float) -> None:
        """Record a worker's progress with a task; release tasks that are not its own."""
        task = self.table.get(held.task)
        if task is None:
            self._keep_or_release(worker, held)
        elif held.state == "helping":
            if worker not in task.helpers:
                self._channel.send(worker, messages.Release(task=held.task))
        elif self._can_adopt(task, worker, status):
            self._adopt(task, worker, now)  # leased by an earlier coordinator, or its worker is back
        elif task.worker != worker:
            self._channel.send(worker, messages.Release(task=held.task))
        elif held.state == "running":
            task.compared = held.compared
            if self.table.begin(task, now) and task.function == "prepare":
                self.post(PreparationBegun(task.job))
        elif held.state in ("done", "failed") and not task.is_read and now - task.sent_at > SETTLED_S:
            self._send_again(task, worker, now)  # the report, or a later lease, was lost

    def _keep_or_release(self, worker: str, held: messages.TaskStatus) -> None:
        """Let a worker keep an unknown task that may be needed soon, as after a restart; release any other task."""
        if held.state == "helping" or not self._may_follow(held.job):
            self._channel.send(worker, messages.Release(task=held.task))
        elif held.state in ("waiting", "running"):
            self._keeping.add(worker)  # another task on this worker would have to wait

    def _can_adopt(self, task: Task, worker: str, status: WorkerStatus) -> bool:
        """Return whether a worker may continue a task. A task that has failed needs a new lease, perhaps elsewhere."""
        is_free = task.worker is None and not task.failures
        return is_free and status.state != "leaving" and self.table.on(worker) is None

    def _adopt(self, task: Task, worker: str, now: float) -> None:
        self._recall(worker)
        self._keeping.discard(worker)
        self._lease(task, worker, now)

    def _send_again(self, task: Task, worker: str, now: float) -> None:
        task.sent_at = now
        self._channel.send(worker, task.lease())

    def lose(self, worker: str, now: float, *, had_left: bool = False) -> tuple[str, ...]:
        """Lease the tasks of a lost worker to other workers; it `had_left` if it had announced its end.

        Return the jobs of the tasks that it had or helped with.
        """
        self._keeping.discard(worker)
        had = [task for task in self.table if task.worker == worker or worker in task.helpers]
        for task in self.table:
            if task.worker == worker:
                self._charge_user(task, now)
        for task, why in self.table.lose(worker, now, had_left=had_left):
            if why is not None:
                self._conclude_failed(task, "crash", why)
        self.dispatch(now)
        return tuple(dict.fromkeys(task.job for task in had if not task.is_analysis))

    def add_report(self, worker: str, report: messages.TaskReport, now: float) -> None:
        """Handle a worker's report on a task; raises RemoteProtocolError when it is impossible."""
        body = report.body
        task = self.table.get(body.task)
        if task is None:
            return  # the next heartbeat, which has the job of the task, decides about it
        if task.worker != worker:
            self._channel.send(worker, messages.Release(task=body.task))
            return
        match body:
            case messages.TaskFailed() if body.term == task.term:  # a repeated message has an earlier term
                self._fail(task, body.failure, body.sentence, now)
            case messages.TaskChunk() if body.size > (most := _most_bytes(task)):
                size, most_mb = body.size / 1024**2, most / 1024**2
                self._fail(task, "error", f"its result has {size:,.0f} MB; at most {most_mb:,.0f} MB are accepted", now)
            case messages.TaskChunk() if not task.is_read:
                self._add_chunk(task, body, now)

    def _add_chunk(self, task: Task, body: messages.TaskChunk, now: float) -> None:
        """Add a part of a result; when all parts have arrived, the result is read in the background."""
        task.sent_at = now
        if body.offset == 0:
            task.drop_result()
        if body.offset != task.received or body.offset + len(body.data) > body.size:
            raise RemoteProtocolError(f"part of a task's result from byte {body.offset} arrived out of order")
        task.parts.append(body.data)
        task.received += len(body.data)
        if task.received == body.size:
            parts, task.parts, task.is_read = tuple(task.parts), [], True
            self._read(TaskResult(task.id, task.term, task.job, task.function, parts, body.digest, body.seconds))

    def take_result(self, read: ResultRead, now: float) -> None:
        """Handle the result of a task; without effect if the task has ended or was lost meanwhile.

        Raises:
            RemoteProtocolError: The result was damaged in transit; its worker sends it again.
        """
        result = read.result
        task = self.table.get(result.task)
        if task is None or not task.is_read or task.term != result.term:
            return
        task.drop_result()
        if read.error is not None:
            raise read.error
        if read.is_damaged:
            raise RemoteProtocolError("the result of a task was damaged in transit")
        if read.unreadable is not None:
            self._fail(task, "error", read.unreadable, now)
            return
        # Charge the time that no heartbeat has shown. Time before the lease was charged by an earlier coordinator.
        self._charge(task.turn, max(0.0, min(result.seconds, now - task.leased_at) - task.charged))
        self._end(task)
        if isinstance(read.outcome, JobPrepared):
            self._prepared[task.job] = read.outcome.digest, read.outcome.encoded
        if isinstance(read.outcome, bytes):
            self.analyses.finish(task.id, read.outcome, result.digest)
        else:
            self.post(read.outcome)
        self.dispatch(now)

    def _fail(self, task: Task, failure: Failure, sentence: str, now: float) -> None:
        """Handle a task that failed on its worker: try it again, or post why it is not tried again."""
        self._charge_user(task, now)
        self._release(task)
        why = self.table.fail(task, failure, sentence, now)
        if why is not None:
            self._conclude_failed(task, failure, why)
        self.dispatch(now)

    def _conclude_failed(self, task: Task, failure: Failure, why: str) -> None:
        if task.is_analysis:
            self.analyses.fail(
                task.id,
                f"the analysis failed ({why}); repeat it on the saved result, and report the error with this file",
            )
            self._forget_unused_inputs(task.job)
            return
        to_send = ask_for_report(self._configs.pop(task.id), is_certain=failure == "error")
        if task.function == "prepare":
            self.post(PreparationFailed(task.job, "internal", f"preparing the data failed ({why}){to_send}"))
            return
        warning = f"Refining failed ({why}); equations are as the search found them{to_send}."
        self.post(RefiningFailed(task.job, Refinement(warnings=(warning,), end="not refined")))

    def _end(self, task: Task) -> None:
        self._release(task)
        self._configs.pop(task.id, None)
        self.table.end(task)
        if task.is_analysis:
            self._forget_unused_inputs(task.job)

    def _forget_unused_inputs(self, job: str) -> None:
        if not self.table.of_job(job):
            self._forget_inputs(job)

    def _release(self, task: Task) -> None:
        """Tell the worker and the helpers of a task to drop it."""
        holders: Sequence[str] = [*([task.worker] if task.worker is not None else []), *task.helpers]
        for worker in holders:
            self._channel.send(worker, messages.Release(task=task.id))
        task.helpers.clear()


def _most_bytes(task: Task) -> int:
    """Return the largest size of the result of a task, in bytes."""
    return MAX_KEPT if task.is_analysis else messages.MAX_RESULT if task.function == "prepare" else MAX_MESSAGE
