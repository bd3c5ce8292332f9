"""What a worker sends and asks, as puts and queries on the bus; and which request a reply belongs to."""

from dataclasses import dataclass
from typing import Final

from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Bus
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.epochs import Mail, Pull, PullAnswer, PullStates
from atoll_core.wire.messages.tasks import PullBatch, TaskChunk, TaskFailed, TaskReport
from atoll_core.wire.messages.workers import WorkerLog, WorkerStatus
from atoll_island_worker.session.actions import (
    AskPeer,
    FetchPlacements,
    FetchStates,
    Outgoing,
    Respond,
    Send,
    SendReport,
)

PULL_TIMEOUT_S: Final = 5.0
FETCH_TIMEOUT_S: Final = 20.0
FETCH_PAUSE_S: Final = 0.5
FETCH: Final = "fetch/"
FETCH_INPUTS: Final = "inputs/"
"""What the names of the timers begin with after which a dataset, or the inputs of a task, are asked for again; the job
or the task follows."""


@dataclass(frozen=True, slots=True)
class Request:
    """What a reply answers: a `question` about `subject` (a job, a task, a peer or a fingerprint), or about `states`.

    `index` is the number of a chunk, of the blob `digest` where the subject is a task, or, of a greeting, how many
    welcomes had come before it.
    """

    question: str
    subject: str = ""
    index: int = 0
    digest: str = ""
    states: PullStates | None = None


class Requests:
    """The messages and queries of one worker. `cluster` is the coordinator's; empty before the first welcome."""

    def __init__(self, bus: Bus, name: str) -> None:
        self.cluster = ""
        self._bus = bus
        self._name = name
        self._open: dict[int, Request] = {}

    def ask(self, key: str, payload: bytes, timeout_s: float, request: Request) -> None:
        """Send a query; the reply will answer `request`."""
        self._open[self._bus.get(key, payload, timeout_s)] = request

    def pop(self, token: int) -> Request | None:
        """Return the request that a reply answers, once."""
        return self._open.pop(token, None)

    def ask_announcement(self, job: str) -> None:
        """Ask the coordinator for a job's announcement."""
        self.ask(topics.job(self.cluster, job), b"", PULL_TIMEOUT_S, Request("job", job))

    def ask_chunk(self, job: str, blob: str, index: int) -> None:
        """Ask the coordinator for one chunk of a job's dataset."""
        self.ask(topics.blob(self.cluster, blob, index), b"", FETCH_TIMEOUT_S, Request("chunk", job, index))

    def ask_later(self, job: str) -> None:
        """Set the timer after which a job's dataset is asked for again."""
        self._bus.call_later(FETCH_PAUSE_S, FETCH + job)

    def ask_input(self, task: str, digest: str, index: int) -> None:
        """Ask the coordinator for one chunk of an input of a task."""
        key = topics.blob(self.cluster, digest, index)
        self.ask(key, b"", FETCH_TIMEOUT_S, Request("input", task, index, digest))

    def ask_inputs_later(self, task: str) -> None:
        """Set the timer after which the inputs of a task are asked for again."""
        self._bus.call_later(FETCH_PAUSE_S, FETCH_INPUTS + task)

    def ask_batch(self, peer: str, pull: PullBatch) -> None:
        """Ask another worker for a batch of its task."""
        key = topics.worker(self.cluster, peer, "pull")
        self.ask(key, encode(Pull(body=pull)), PULL_TIMEOUT_S, Request("batch", pull.task))

    def send_task_report(self, body: TaskChunk | TaskFailed) -> None:
        """Tell the coordinator what came of a task."""
        self._bus.put(topics.worker(self.cluster, self._name, "result"), encode(TaskReport(body=body)))

    def send_status(self, status: WorkerStatus) -> None:
        """Send a heartbeat."""
        self._bus.put(topics.worker(self.cluster, self._name, "status"), encode(status))

    def send_log(self, log: WorkerLog) -> None:
        """Send lines of our log."""
        self._bus.put(topics.worker(self.cluster, self._name, "log"), encode(log))

    def send(self, action: Outgoing) -> None:
        """Send, answer or ask what the session wants."""
        match action:
            case Send():
                self._bus.put(topics.mail(self.cluster, self._name, action.peer), encode(Mail(body=action.body)))
            case SendReport():
                self._bus.put(topics.worker(self.cluster, self._name, "report"), encode(action.report))
            case AskPeer():
                key = topics.worker(self.cluster, action.peer, "pull")
                self.ask(key, encode(Pull(body=action.body)), PULL_TIMEOUT_S, Request("pull", action.peer))
            case Respond():
                self._bus.reply(action.handle, encode(PullAnswer(body=action.body)))
            case FetchStates():
                key, request = topics.job(self.cluster, action.body.job, "state"), Request("states", states=action.body)
                self.ask(key, encode(Pull(body=action.body)), FETCH_TIMEOUT_S, request)
            case FetchPlacements():
                key = topics.job(self.cluster, action.job, "placement")
                self.ask(key, b"", PULL_TIMEOUT_S, Request("placement", action.job))
