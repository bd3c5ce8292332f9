"""What is leased to this worker: its inputs, its process, its result; and batches between workers.

One task runs at a time, its own or that of another worker which it helps. Owned by the worker's loop.
"""

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Literal

from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.task_frames import (
    Ask,
    Batch,
    Begun,
    Computed,
    Ended,
    Failed,
    Failure,
    Finished,
    Give,
    Progressed,
    Run,
    Said,
    Take,
)
from atoll_core.wire.bus.interface import Query
from atoll_core.wire.codec import decode
from atoll_core.wire.messages.epochs import NotYet, PullAnswer
from atoll_core.wire.messages.limits import CHUNK_SIZE, MAX_MESSAGE
from atoll_core.wire.messages.tasks import (
    BatchResult,
    GivenBatch,
    Help,
    Lease,
    NoTask,
    PullBatch,
    Release,
    TaskChunk,
    TaskFailed,
    TaskState,
    TaskStatus,
)
from atoll_island_worker.connection.requests import Request, Requests
from atoll_island_worker.tasks.downloads import ByteCache, Download
from atoll_island_worker.tasks.task_process import TaskProcess

NEXT: Final = {"prepare": "refine"}
"""What a process that has done a task of one function loads then, for the task that most likely follows."""

TaskStep = Literal["fetched", "begun", "finished", "failed", "release"]

TASK_TRANSITIONS: Final[dict[TaskState, dict[TaskStep, TaskState | None]]] = {
    "fetching": {"fetched": "waiting", "failed": "failed", "release": None},
    "waiting": {"begun": "running", "finished": "done", "failed": "failed", "release": None},
    "running": {"finished": "done", "failed": "failed", "release": None},
    "done": {"release": None},
    "failed": {"release": None},
    "helping": {"release": None},
}
"""State of a task on its worker -> what happens -> its next state; None: it is not there any more."""


@dataclass(slots=True)
class _Leased:
    """A task that is leased to this worker; `result` or `failed` once that has come.

    `inputs` are those that have come, until it runs; `life` says which process runs it.
    """

    lease: Lease
    state: TaskState = "fetching"
    downloads: dict[str, Download] = field(default_factory=dict)
    inputs: dict[str, bytes] = field(default_factory=dict)
    life: int = 0
    result: bytes = b""
    failed: TaskFailed | None = None
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
    """A task of another worker; `batch` is the one that is computed here now, by the process of that `life`."""

    help: Help
    batch: int | None = None
    life: int = 0


class TaskRunner:
    """The tasks of one worker."""

    def __init__(
        self, requests: Requests, process: TaskProcess, reply: Callable[[Query, PullAnswer], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        """`reply` answers a question of another worker; `clock` gives seconds."""
        self._requests = requests
        self._process = process
        self._reply = reply
        self._clock = clock
        self._leased: dict[str, _Leased] = {}
        self._helped: _Helped | None = None
        self._asked: dict[int, tuple[str, Query]] = {}
        self._tokens = 0
        self._cache = ByteCache()

    @property
    def is_idle(self) -> bool:
        """Whether there is nothing to compute and nothing whose result is still wanted."""
        return not self._leased and self._helped is None

    @property
    def is_loaded(self) -> bool:
        """Whether a process for tasks is there already."""
        return self._process.is_started

    def statuses(self) -> tuple[TaskStatus, ...]:
        """Return what the heartbeat says of tasks."""
        own = (
            TaskStatus(task=task, job=leased.lease.job, state=leased.state, compared=leased.compared)
            for task, leased in self._leased.items()
        )
        if self._helped is None:
            return tuple(own)
        helped = self._helped.help
        return (*own, TaskStatus(task=helped.task, job=helped.job, state="helping"))

    # ------------------------------------------------------------------------------------- the coordinator

    def told(self, body: Lease | Help | Release) -> None:
        """Take in what the coordinator says of a task."""
        match body:
            case Lease():
                self._lease(body)
            case Help():
                self._help(body)
            case Release():
                self._release(body.task)

    def _lease(self, lease: Lease) -> None:
        """Begin a task; of one that is done already push again what came of it.

        One that failed begins anew when the term is another: the coordinator has it tried again.
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
                leased.downloads[given.digest] = Download(given.digest, given.size)
        self.fetch(lease.task)
        self._run_next()

    def _help(self, wanted: Help) -> None:
        """Help another worker with its task, until it is done or released; one task at a time, its own first."""
        if self._helped is not None and self._helped.help.task == wanted.task:
            return
        if any(leased.failed is None and leased.state != "done" for leased in self._leased.values()):
            return
        self._helped = _Helped(wanted)
        self._pull_batch(None)

    def _release(self, task: str) -> None:
        """Have nothing more to do with a task; one that runs is ended with its process."""
        leased = self._leased.pop(task, None)
        if leased is not None and leased.state in ("waiting", "running"):
            self._process.stop()
            self._answer_helpers(task)
        self._run_next()
        if self._helped is not None and self._helped.help.task == task:
            self._stop_helping()

    def reset(self) -> None:
        """Forget what a former coordinator's store had leased."""
        for task in list(self._leased):
            self._release(task)
        self._stop_helping()

    def _stop_helping(self) -> None:
        """Ask for no more batches; what is computed at the moment is done within about a second."""
        self._helped = None

    # ------------------------------------------------------------------------------------------- inputs

    def fetch(self, task: str) -> None:
        """Ask for the next missing chunks of a task's inputs."""
        leased = self._leased.get(task)
        for download in leased.downloads.values() if leased is not None else ():
            for index in download.take():
                self._requests.ask_input(task, download.digest, index)

    def answered(self, request: Request, payload: bytes | None) -> None:
        """Take in the answer to `Requests.ask_input` or `Requests.ask_batch`; None: there was none."""
        if request.question == "input":
            self._chunk_came(request.subject, request.digest, request.index, payload)
        else:
            self._batch_came(request.subject, payload)

    def _chunk_came(self, task: str, digest: str, index: int, payload: bytes | None) -> None:
        leased = self._leased.get(task)
        download = leased.downloads.get(digest) if leased is not None else None
        if leased is None or download is None:
            return
        if payload is None or not download.offer(index, payload):
            download.give_back(index)
            self._requests.ask_inputs_later(task)
            return
        data = download.finish()
        if data is None:
            self.fetch(task)
            return
        self._cache.add(digest, data)
        leased.inputs[digest] = data
        del leased.downloads[digest]
        self._run_next()

    def _run_next(self) -> None:
        """Run the first task whose inputs are here, if none runs."""
        if any(leased.state in ("waiting", "running") for leased in self._leased.values()):
            return
        ready = (one for one in self._leased.values() if one.state == "fetching" and not one.downloads)
        leased = next(ready, None)
        if leased is None:
            return
        leased.step("fetched")
        self._stop_helping()
        leased.began = self._clock()
        lease, inputs = leased.lease, tuple(leased.inputs[given.digest] for given in leased.lease.inputs)
        leased.inputs.clear()
        leased.life = self._process.send(
            Run(lease.task, lease.function, inputs, lease.seconds, lease.threads, lease.job)
        )

    # ------------------------------------------------------------------------------------------- process

    def process_said(self, said: Said) -> bool:
        """Take in what the process says; return whether the coordinator is to be told at once."""
        message = said.message
        match message:
            case Begun() | Progressed() | Finished() | Failed():
                leased = self._leased.get(message.task)
                if leased is not None and leased.life == said.life:  # else a process said it that was stopped since
                    self._advance(leased, message)
                    return not isinstance(message, Progressed)
            case Ended():
                return self._ended(said.life, message)
            case Give():
                self._give(message)
            case Computed():
                self._computed(message)
        return False

    def _advance(self, leased: _Leased, message: Begun | Progressed | Finished | Failed) -> None:
        match message:
            case Begun():
                leased.step("begun")
            case Progressed():
                leased.compared = message.compared
            case Finished():
                self._finish(leased, message)
            case Failed():
                self._fail(leased, message.failure, message.sentence)
                self._run_next()

    def _ended(self, life: int, message: Ended) -> bool:
        """Take in that a process has ended by itself, with what it did; return whether it had a task."""
        if self._helped is not None and self._helped.batch is not None and self._helped.life == life:
            self._stop_helping()
        lost = [one for one in self._leased.values() if one.life == life and one.state in ("waiting", "running")]
        for leased in lost:
            self._fail(leased, message.failure, message.why)
        self._run_next()
        return bool(lost)

    def _finish(self, leased: _Leased, message: Finished) -> None:
        leased.step("finished")
        leased.result, leased.seconds = message.result, self._clock() - leased.began
        self._push(leased)
        self._answer_helpers(message.task)
        self._run_next()
        following = NEXT.get(leased.lease.function)
        if following is not None and all(one.state in ("fetching", "done", "failed") for one in self._leased.values()):
            self._process.load_next(following)

    def _fail(self, leased: _Leased, failure: Failure, sentence: str) -> None:
        leased.step("failed")
        lease = leased.lease
        leased.failed = TaskFailed(task=lease.task, term=lease.term, failure=failure, sentence=sentence[:4000])
        self._push(leased)
        self._answer_helpers(lease.task)

    def _push(self, leased: _Leased) -> None:
        """Send what came of a task, if it is there: the coordinator releases it when it has it all."""
        if leased.failed is not None:
            self._requests.send_task_report(leased.failed)
        elif leased.state == "done":
            digest, size = hashlib.sha256(leased.result).hexdigest(), len(leased.result)
            for offset in range(0, max(size, 1), CHUNK_SIZE):
                data = leased.result[offset : offset + CHUNK_SIZE]
                chunk = TaskChunk(
                    task=leased.lease.task, digest=digest, size=size, offset=offset, data=data, seconds=leased.seconds
                )
                self._requests.send_task_report(chunk)

    # ------------------------------------------------------------------------------- batches, as who helps

    def _pull_batch(self, result: BatchResult | None) -> None:
        assert self._helped is not None
        helped = self._helped.help
        contexts = self._cache.digests[-64:]
        self._requests.ask_batch(helped.worker, PullBatch(task=helped.task, result=result, contexts=contexts))

    def _batch_came(self, task: str, payload: bytes | None) -> None:
        """Take in a batch; without any, or without a task there, helping has ended."""
        helped = self._helped
        if helped is None or helped.help.task != task:
            return
        self._helped = None  # also where what came cannot be read: the coordinator has it help again
        body = decode(payload, PullAnswer, MAX_MESSAGE).body if payload is not None else NoTask()
        match body:
            case GivenBatch():
                if body.context:
                    self._cache.add(hashlib.sha256(body.context).hexdigest(), body.context)
                context = self._cache.get(body.digest)
                if context is None:
                    raise RemoteProtocolError(f"a batch came with the context {body.digest}, which is not here")
                self._helped, helped.batch = helped, body.number
                helped.life = self._process.send(Batch(body.number, body.function, body.digest, context, body.item))
            case NotYet():
                self._helped = helped
                self._pull_batch(None)

    def _computed(self, message: Computed) -> None:
        if self._helped is not None and self._helped.batch == message.number:
            self._helped.batch = None
            self._pull_batch(BatchResult(number=message.number, result=message.result))

    # ----------------------------------------------------------------------- batches, as who has the task

    def batch_asked(self, query: Query, pull: PullBatch) -> None:
        """Take in a helper's question: its result goes to the process, which gives it a batch when there is one."""
        leased = self._leased.get(pull.task)
        if leased is None or leased.state != "running":
            self._reply(query, PullAnswer(body=NoTask()))
            return
        if pull.result is not None:
            self._process.send(Take(pull.result.number, pull.result.result))
        self._tokens += 1
        self._asked[self._tokens] = (pull.task, query)
        self._process.send(Ask(self._tokens, frozenset(pull.contexts)))

    def _give(self, message: Give) -> None:
        asked = self._asked.pop(message.token, None)
        if asked is None:
            return
        batch = message.batch
        if batch is None:
            self._reply(asked[1], PullAnswer(body=NotYet()))
            return
        given = GivenBatch(
            number=batch.number, function=batch.function, digest=batch.digest, context=batch.context, item=batch.item
        )
        self._reply(asked[1], PullAnswer(body=given))

    def _answer_helpers(self, task: str) -> None:
        """Tell helpers who wait for batches of a task that there is no such task any more."""
        for token in [token for token, (asked, _) in self._asked.items() if asked == task]:
            _, query = self._asked.pop(token)
            self._reply(query, PullAnswer(body=NoTask()))

    def close(self) -> None:
        """End the process."""
        self._process.stop()
