"""The tasks leased to this worker: inputs, process and results; also batches between workers.

The worker does one thing at a time: it runs a leased task, or it helps another worker and computes batches of that
worker's task. A result is pushed until the coordinator releases the task, so a lost message costs only time. A helper
requests batches from the worker that runs the task, and sends its last result with the request. The request goes to the
process of the task, which answers when it has a batch. Only the worker's loop may call this module.
"""

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Literal

from atoll_core import task_frames as frames
from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.wire.bus.interface import Query
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages import tasks as messages
from atoll_core.wire.messages.epochs import NotYet, PullAnswer
from atoll_core.wire.messages.limits import CHUNK_SIZE, MAX_MESSAGE
from atoll_island_worker.connection import Requests
from atoll_island_worker.downloads import ByteCache
from atoll_island_worker.tasks.task_process import TaskProcess

NEXT: Final = {"prepare": "refine"}
"""Function of a task -> function of the most likely next task; the process loads its modules in advance."""

TaskStep = Literal["fetched", "begun", "finished", "failed", "release"]

TASK_TRANSITIONS: Final[dict[messages.TaskState, dict[TaskStep, messages.TaskState | None]]] = {
    "fetching": {"fetched": "waiting", "failed": "failed", "release": None},
    "waiting": {"begun": "running", "finished": "done", "failed": "failed", "release": None},
    "running": {"finished": "done", "failed": "failed", "release": None},
    "done": {"release": None},
    "failed": {"release": None},
    "helping": {"release": None},
}
"""State of a task on its worker -> event -> next state; None: the task is removed."""


@dataclass(slots=True)
class _Leased:
    """A task that is leased to this worker; it has a `result`, or `failed`, once it has ended.

    `inputs` are the arrived inputs, until the task runs; `missing` has the sizes of the missing inputs, by digest.
    `life` is the number of the process that runs it.
    """

    lease: messages.Lease
    state: messages.TaskState = "fetching"
    missing: dict[str, int] = field(default_factory=dict)
    inputs: dict[str, bytes] = field(default_factory=dict)
    life: int = 0
    result: bytes = b""
    failed: messages.TaskFailed | None = None
    began: float = 0.0
    seconds: float = 0.0
    compared: int = 0

    def step(self, step: TaskStep) -> None:
        """Go to the next state by the table."""
        following = TASK_TRANSITIONS[self.state].get(step)
        if following is None:
            raise LocalProtocolError(f"a task that is {self.state} cannot be {step}")
        self.state = following


@dataclass(slots=True)
class _Helped:
    """A task of another worker; `batch` is the batch that the process with the number `life` computes here now."""

    help: messages.Help
    batch: int | None = None
    life: int = 0


class TaskRunner:
    """The tasks of one worker."""

    def __init__(
        self, requests: Requests, process: TaskProcess, reply: Callable[[Query, bytes | None], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        """`reply` answers a request of another worker, or refuses it (None); `clock` returns seconds."""
        self._requests = requests
        self._process = process
        self._reply = reply
        self._clock = clock
        self._leased: dict[str, _Leased] = {}
        self._helped: _Helped | None = None
        self._questions: dict[int, tuple[str, Query]] = {}
        self._tokens = 0
        self._cache = ByteCache()

    @property
    def is_idle(self) -> bool:
        """Whether there is no task, and no result that the coordinator still needs."""
        return not self._leased and self._helped is None

    @property
    def is_loaded(self) -> bool:
        """Whether a process for tasks is running already."""
        return self._process.is_started

    def statuses(self) -> tuple[messages.TaskStatus, ...]:
        """Return the status of tasks for heartbeats."""
        statuses = [
            messages.TaskStatus(task=task, job=leased.lease.job, state=leased.state, compared=leased.compared)
            for task, leased in self._leased.items()
        ]
        if self._helped is not None:
            helped = self._helped.help
            statuses.append(messages.TaskStatus(task=helped.task, job=helped.job, state="helping"))
        return tuple(statuses)

    # ------------------------------------------------------------------------------------- the coordinator

    def handle(self, body: messages.Lease | messages.Help | messages.Release) -> None:
        """Handle a message of the coordinator about a task."""
        match body:
            case messages.Lease():
                self._lease(body)
            case messages.Release():
                self._release(body.task)
            case messages.Help():
                # Helping lasts until the task is done or released. Leased tasks come first.
                is_known = self._helped is not None and self._helped.help.task == body.task
                has_work = any(own.failed is None and own.state != "done" for own in self._leased.values())
                if not is_known and not has_work:
                    self._helped = _Helped(body)
                    self._pull_batch(None)

    def _lease(self, lease: messages.Lease) -> None:
        """Begin a task; if it has already ended, push its result again.

        A failed task begins again if the term is new: then the coordinator retries it.
        """
        known = self._leased.get(lease.task)
        if known is not None and (known.failed is None or known.failed.term == lease.term):
            known.lease = lease
            self._push(known)
            return
        leased = self._leased[lease.task] = _Leased(lease)
        for given in lease.inputs:
            data = given.data if given.data is not None else self._cache.get(given.digest)
            if data is not None:
                leased.inputs[given.digest] = data
            else:
                leased.missing[given.digest] = given.size
        self._run_next()

    def _release(self, task: str) -> None:
        """Forget a task; if it is running, end its process."""
        leased = self._leased.pop(task, None)
        if leased is not None and leased.state in ("waiting", "running"):
            self._process.stop()
            self._answer_helpers(task)
        self._run_next()
        if self._helped is not None and self._helped.help.task == task:
            self._helped = None

    def reset(self) -> None:
        """Forget the leases of another coordinator's store."""
        for task in list(self._leased):
            self._release(task)
        self._helped = None

    # ------------------------------------------------------------------------------------------- inputs

    def wanted(self) -> dict[str, int]:
        """Return digests and sizes of the missing inputs."""
        return {digest: size for leased in self._leased.values() for digest, size in leased.missing.items()}

    def arrived(self, digest: str, data: bytes) -> None:
        """Store an input that has arrived."""
        waiting = [leased for leased in self._leased.values() if leased.missing.pop(digest, None) is not None]
        if waiting:
            self._cache.add(digest, data)
        for leased in waiting:
            leased.inputs[digest] = data
        self._run_next()

    def _run_next(self) -> None:
        """Run the first task whose inputs are complete, if none is running."""
        if any(leased.state in ("waiting", "running") for leased in self._leased.values()):
            return
        ready = (one for one in self._leased.values() if one.state == "fetching" and not one.missing)
        leased = next(ready, None)
        if leased is None:
            return
        leased.step("fetched")
        self._helped = None  # the batch that is computed now ends within about a second
        leased.began = self._clock()
        lease, inputs = leased.lease, tuple(leased.inputs[given.digest] for given in leased.lease.inputs)
        leased.inputs.clear()
        leased.life = self._process.send(
            frames.Run(lease.task, lease.function, inputs, lease.seconds, lease.threads, lease.job)
        )

    # ------------------------------------------------------------------------------------------- process

    def handle_process_message(self, report: frames.ProcessMessage) -> bool:
        """Handle a message of the process; return whether the coordinator should get a heartbeat at once."""
        message = report.message
        match message:
            case frames.Begun() | frames.Progressed() | frames.TaskFinished() | frames.Failed():
                leased = self._leased.get(message.task)
                if leased is not None and leased.life == report.life:  # else the message is from a stopped process
                    self._advance(leased, message)
                    return not isinstance(message, frames.Progressed)
            case frames.Ended():
                return self._ended(report.life, message)
            case frames.Give():
                self._give(message)
            case frames.BatchComputed():
                if self._helped is not None and self._helped.batch == message.number:
                    self._helped.batch = None
                    self._pull_batch(messages.BatchResult(number=message.number, result=message.result))
        return False

    def _advance(
        self, leased: _Leased, message: frames.Begun | frames.Progressed | frames.TaskFinished | frames.Failed
    ) -> None:
        match message:
            case frames.Begun():
                leased.step("begun")
            case frames.Progressed():
                leased.compared = message.compared
            case frames.Failed():
                self._fail(leased, message.failure, message.sentence)
                self._run_next()
            case frames.TaskFinished():
                leased.step("finished")
                leased.result, leased.seconds = message.result, self._clock() - leased.began
                self._push(leased)
                self._answer_helpers(message.task)
                self._run_next()
                following = NEXT.get(leased.lease.function)
                is_free = all(one.state in ("fetching", "done", "failed") for one in self._leased.values())
                if following is not None and is_free:
                    self._process.load_next(following)

    def _ended(self, life: int, message: frames.Ended) -> bool:
        """Handle the end of a process that this worker did not stop; return whether the process had a task."""
        if self._helped is not None and self._helped.batch is not None and self._helped.life == life:
            self._helped = None
        lost = [one for one in self._leased.values() if one.life == life and one.state in ("waiting", "running")]
        for leased in lost:
            self._fail(leased, message.failure, message.why)
        self._run_next()
        return bool(lost)

    def _fail(self, leased: _Leased, failure: frames.Failure, sentence: str) -> None:
        leased.step("failed")
        lease = leased.lease
        leased.failed = messages.TaskFailed(task=lease.task, term=lease.term, failure=failure, sentence=sentence[:4000])
        self._push(leased)
        self._answer_helpers(lease.task)

    def _push(self, leased: _Leased) -> None:
        """Send the result of a task that has ended; the coordinator releases the task when it has the whole result."""
        if leased.failed is not None:
            self._requests.publish("result", messages.TaskReport(body=leased.failed))
        elif leased.state == "done":
            digest, size = hashlib.sha256(leased.result).hexdigest(), len(leased.result)
            for offset in range(0, max(size, 1), CHUNK_SIZE):
                data = leased.result[offset : offset + CHUNK_SIZE]
                chunk = messages.TaskChunk(
                    task=leased.lease.task, digest=digest, size=size, offset=offset, data=data, seconds=leased.seconds
                )
                self._requests.publish("result", messages.TaskReport(body=chunk))

    # ------------------------------------------------------------------------------ batches, as the helper

    def _pull_batch(self, result: messages.BatchResult | None) -> None:
        assert self._helped is not None
        helped = self._helped.help
        contexts = self._cache.digests[-64:]
        self._requests.ask_batch(helped.worker, messages.PullBatch(task=helped.task, result=result, contexts=contexts))

    def batch_came(self, task: str, payload: bytes | None) -> None:
        """Handle the answer of the worker that has the task; if it has no batch or no such task, helping ends."""
        helped = self._helped
        if helped is None or helped.help.task != task:
            return
        self._helped = None  # also if the answer cannot be read: the coordinator will send another Help
        body = decode(payload, PullAnswer, MAX_MESSAGE).body if payload is not None else None
        match body:
            case messages.GivenBatch():
                if body.context:
                    self._cache.add(hashlib.sha256(body.context).hexdigest(), body.context)
                context = self._cache.get(body.digest)
                if context is None:
                    raise RemoteProtocolError(f"a batch came with the unknown context {body.digest}")
                self._helped, helped.batch = helped, body.number
                batch = frames.TaskBatch(body.number, body.function, body.digest, context, body.item)
                helped.life = self._process.send(batch)
            case NotYet():
                self._helped = helped
                self._pull_batch(None)

    # ------------------------------------------------------------------ batches, as the owner of the task

    def batch_asked(self, query: Query, pull: messages.PullBatch) -> None:
        """Handle a helper's request: pass its result on to the process, which answers when it has a batch."""
        leased = self._leased.get(pull.task)
        if leased is None or leased.state != "running":
            self._reply(query, None)
            return
        if pull.result is not None:
            self._process.send(frames.Take(pull.result.number, pull.result.result))
        self._tokens += 1
        self._questions[self._tokens] = (pull.task, query)
        self._process.send(frames.Ask(self._tokens, frozenset(pull.contexts)))

    def _give(self, message: frames.Give) -> None:
        if message.token not in self._questions:
            return
        _, query = self._questions.pop(message.token)
        batch = message.batch
        if batch is None:
            self._reply(query, encode(PullAnswer(body=NotYet())))
            return
        given = messages.GivenBatch(
            number=batch.number, function=batch.function, digest=batch.digest, context=batch.context, item=batch.item
        )
        self._reply(query, encode(PullAnswer(body=given)))

    def _answer_helpers(self, task: str) -> None:
        """If helpers wait for batches of a task that has ended, tell them that it has ended."""
        for token in [token for token, (asked, _) in self._questions.items() if asked == task]:
            _, query = self._questions.pop(token)
            self._reply(query, None)

    def close(self) -> None:
        """End the process."""
        self._process.stop()
