"""A client of a coordinator: all requests of the command line and of Python, over any bus.

How it works: a client greets the coordinator once, to learn its cluster; all requests then go to a key of this cluster
with the client's name. `Client._ask` sends a request, repeats it when no answer comes, and decodes the answer; each
public method is one request or a loop of requests. A repeated request has no further effect, because it names its job,
chunk or worker: the same job id with the same contents is the same job. Every wait has a limit, and the error at its
end names the missing answer. Large data travel in chunks, checked by SHA-256. One thread owns a client and its bus.

Doubtful: a coordinator with another store has another cluster, so after such a change an open client gets no answers;
its owner must open a new client (as `atoll.web.gateway` does). Changes that arrive during another request are kept in a
queue of `MAX_CHANGES`; after an overflow the subscription asks for the lost changes again, which costs one request.
"""

import hashlib
import json
import sys
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final, Protocol, TypeVar

from atoll.client.over_http import HttpBus, WebAddress
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.config import JobConfig
from atoll_core.errors import (
    AtollError,
    DataError,
    RefusedError,
    RemoteProtocolError,
    TableMissingError,
    UnknownJobError,
    UnreachableError,
)
from atoll_core.wire import topics
from atoll_core.wire.addresses import Destination
from atoll_core.wire.bus.interface import Event, Message, Reply
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages import clients as messages
from atoll_core.wire.messages.handshake import Greeting, GreetingAnswer, Hello, Refusal, Welcome
from atoll_core.wire.messages.limits import CHUNK_LIMIT_S, CHUNK_SIZE, MAX_PAGE_JOBS, chunk_count
from atoll_core.wire.messages.tasks import AnalysisFunction
from atoll_core.wire.messages.views import (
    FINAL_STATES,
    CoordinatorView,
    EventView,
    IslandView,
    JobState,
    JobView,
    WorkerService,
    WorkerView,
)

ANSWER_LIMIT_S: Final = 10.0
"""Time limit of a request, in seconds, unless it has its own limit."""

IDLE_LIMIT_S: Final = 3600.0
"""Longest wait for a worker to begin an analysis, in seconds; tasks that were leased earlier have ended by then."""

CANCEL_LIMIT_S: Final = 60.0
"""Longest wait for the end of a cancelled job, in seconds; its result takes seconds, even with a million rows."""

MAX_CHANGES: Final = 256
"""Number of changes kept for `next_change`; older changes are dropped, and requested again later."""

_TRIES: Final = 3
_PAUSE_S: Final = 0.1
_LONGEST_PAUSE_S: Final = 1.0
_ERRORS: Final[dict[messages.FailureKind, type[AtollError]]] = {
    "data": DataError,
    "no-table": TableMissingError,
    "unknown-job": UnknownJobError,
    "internal": AtollError,
}
"""Errors by kind of failure; all other kinds become RefusedError."""

A = TypeVar("A")
_Question = (
    messages.Upload | messages.Submit | messages.ListJobs | messages.FindJob | messages.Status | messages.ListWorkers
    | messages.GetQueueDepth | messages.GetResult | messages.Cancel | messages.Delete | messages.GetEvents
    | messages.Follow | messages.Pause | messages.SetPriority | messages.Share | messages.Retry | messages.SetWorker
    | messages.SetQueue | messages.AskAnalysis | messages.GetIslands | messages.GetTable
)  # fmt: skip


class RequestBus(Protocol):
    """The methods of a bus that a client needs, see `atoll_core.wire.bus.interface.Bus`."""

    def subscribe(self, key_expression: str) -> None: ...

    def get(self, key: str, payload: bytes = b"", timeout_s: float = 5.0) -> int: ...

    def receive(self, timeout_s: float) -> Event | None: ...

    def now(self) -> float: ...


class Client:
    """Sends requests to one coordinator; not thread-safe, like its bus."""

    welcome: Welcome
    """The coordinator's answer to the greeting."""

    def __init__(self, bus: RequestBus, address: str, principal: str = "client") -> None:
        """Use a `bus` that the caller closes. `address` is for errors; `principal` is the name in our certificate."""
        self._bus = bus
        self._address = address
        self._name = f"{principal}-{uuid.uuid4().hex[:12]}"
        self._cluster: str | None = None
        self._changes: deque[bytes] | None = None

    def greet(self, limit_s: float = ANSWER_LIMIT_S) -> str:
        """Greet the coordinator and return its cluster; the first request calls this method if needed.

        Raises UnreachableError if no answer comes in time, RefusedError if the coordinator has another version or
        refuses this client.
        """
        hello = Hello(
            role="client",
            name=self._name,
            instance=uuid.uuid4().hex,
            protocol=PROTOCOL_VERSION,
            version=VERSION,
            engine=ENGINE_REVISION,
        )
        advice = "; check that it runs and that the address is right"
        own_key = topics.hello(self._name)
        for key, payload in self._answers(encode(Greeting(body=hello)), limit_s, own_key, topics.HELLO):
            with _decoding():
                answer = decode(payload, GreetingAnswer).body
            if isinstance(answer, Refusal):
                raise RefusedError(answer.sentence)
            if key == own_key:
                self.welcome, self._cluster = answer, answer.realm
                return answer.realm
            advice = (
                ", but it can be reached: access control of the router probably does not know the name "
                f"{self._name!r}; restart the router with the roster of the coordinator"
            )
        silence = f"the coordinator at {self._address} did not answer within {limit_s:.2g} s"
        raise UnreachableError(f"{silence} (waited for its greeting){advice}")

    def upload(self, data: bytes) -> str:
        """Store `data` at the coordinator, chunk by chunk, until no chunk is missing; return its digest.

        Raises RefusedError if the coordinator does not accept or keep the data.
        """
        blob = hashlib.sha256(data).hexdigest()
        body = messages.Upload(blob=blob, size=len(data))
        missing = self._ask(body, messages.Uploaded, "the upload of the data").missing
        for _ in range(_TRIES * chunk_count(len(data))):
            if not missing:
                return blob
            index = missing[0]
            chunk = data[index * CHUNK_SIZE : (index + 1) * CHUNK_SIZE]
            sha256 = hashlib.sha256(chunk).hexdigest()
            body = messages.Upload(blob=blob, size=len(data), index=index, sha256=sha256, data=chunk)
            what = f"the upload of part {index + 1} of the data"
            missing = self._ask(body, messages.Uploaded, what, CHUNK_LIMIT_S).missing
        raise RefusedError(
            f"the coordinator at {self._address} does not keep the uploaded data: {len(missing)} of "
            f"{chunk_count(len(data))} parts are still missing; see its log"
        )

    def hand_in(
        self, job: str, name: str, config: JobConfig, data: bytes, priority: int = 0, *, shared: bool = False
    ) -> JobView:
        """Upload `data` and submit a job on it; repeat both if the table was deleted after the upload."""
        for _ in range(_TRIES - 1):
            with suppress(TableMissingError):
                return self.submit(job, name, config, self.upload(data), priority, shared=shared)
        return self.submit(job, name, config, self.upload(data), priority, shared=shared)

    def submit(
        self, job: str, name: str, config: JobConfig, table: str, priority: int = 0, *, shared: bool = False
    ) -> JobView:
        """Submit a job with the id `job` on the uploaded table with digest `table`; all users see a `shared` job."""
        body = messages.Submit(
            job=job, name=name[:200], config=config, table=table, priority=priority, shared=shared
        )  # fmt: skip
        return self._ask(body, messages.JobStatus, f"the acceptance of job {job}").job

    def jobs(self, prefix: str = "", *, is_open: bool = False, last: int | None = None) -> tuple[JobView, ...]:
        """Return the jobs whose ids begin with `prefix`, newest last.

        `is_open`: only jobs that have not ended; `last`: only this number of jobs, the newest.
        """
        pages: list[tuple[JobView, ...]] = []
        before: int | None = None
        left = sys.maxsize if last is None else last
        while left > 0 and (not prefix or topics.is_id(prefix)):
            page = self.page_of_jobs(prefix, is_open=is_open, before=before, limit=min(left, MAX_PAGE_JOBS))
            pages.append(page.jobs)
            left -= len(page.jobs)
            before = page.before
            if before is None:
                break
        return tuple(view for page in reversed(pages) for view in page)

    def page_of_jobs(
        self, prefix: str = "", *, is_open: bool = False, state: JobState | None = None, before: int | None = None,
        limit: int = MAX_PAGE_JOBS,
    ) -> messages.JobList:  # fmt: skip
        """Return one page of `jobs`: the jobs submitted before the job with the number `before` (None: the newest
        jobs).

        With a `state`, only jobs in that state; the coordinator finds them without reading other jobs.
        """
        question = messages.ListJobs(prefix=prefix, is_open=is_open, state=state, before=before, limit=limit)
        return self._ask(question, messages.JobList, "the list of jobs")

    def status(self, job: str, limit_s: float = ANSWER_LIMIT_S) -> JobView:
        """Return the state and progress of `job`."""
        return self._ask(messages.Status(job=job), messages.JobStatus, f"the status of job {job}", limit_s).job

    def workers(self, prefix: str = "") -> tuple[WorkerView, ...]:
        """Return the workers of the coordinator, sorted by name; `prefix` is the beginning of their names."""
        if prefix and not topics.is_id(prefix):
            return ()
        workers: list[WorkerView] = []
        after: str | None = ""
        while after is not None:
            question = messages.ListWorkers(prefix=prefix, after=after)
            page = self._ask(question, messages.WorkerList, "the list of workers")
            workers += page.workers
            after = page.after
        return tuple(workers)

    def coordinator(self) -> CoordinatorView | None:
        """Return the coordinator's state and counters; None if it does not report them."""
        question = messages.ListWorkers(limit=1)
        return self._ask(question, messages.WorkerList, "the coordinator's counters").coordinator

    def queue_depth(self) -> messages.QueueDepth:
        """Return the number of jobs and islands that wait."""
        return self._ask(messages.GetQueueDepth(), messages.QueueDepth, "the depth of the queue")

    def events(
        self, job: str | None, after: int = 0, limit: int = 200, *, of_workers: bool = False
    ) -> tuple[EventView, ...]:
        """Return the events of `job` (None: of all jobs) after the event number `after`; 0: the last events.

        `of_workers`: only lines of workers' logs.
        """
        body = messages.GetEvents(job=job, after=after, limit=limit, of_workers=of_workers)
        return self._ask(body, messages.EventList, "the log of events").events

    def follow(self, job: str | None, after: int | None, sequence: int) -> messages.Following:
        """Subscribe to changes for the time of a lease, see `atoll.client.follower`; return the missing changes."""
        if self._changes is None:
            self._changes = deque(maxlen=MAX_CHANGES)
            self._bus.subscribe(topics.client(self._cluster or self.greet(), self._name, "changes"))
        body = messages.Follow(job=job, after=after, sequence=sequence)
        return self._ask(body, messages.Following, f"changes of job {job}" if job is not None else "events")

    def next_change(self, limit_s: float) -> messages.JobChange | None:
        """Return the next change of the subscription; None if none comes within `limit_s` seconds."""
        end = self._bus.now() + limit_s
        while not self._changes:
            left = end - self._bus.now()
            if left <= 0.0:
                return None
            self._keep_change(self._bus.receive(left))
        with _decoding():
            return decode(self._changes.popleft(), messages.JobChange)

    def result(self, job: str) -> dict[str, object]:
        """Return the contents of result.json; while the job runs, with the best equations so far."""
        text = self._ask(messages.GetResult(job=job), messages.ResultText, f"the result of job {job}").json_text
        with _decoding():
            contents: dict[str, object] = json.loads(text)
        return contents

    def analyse(
        self, job: str, function: AnalysisFunction, question: bytes, table: bytes | None = None,
        report_wait: Callable[[str], object] = lambda reason: None,
    ) -> bytes:  # fmt: skip
        """Return a worker's answer to a question about the result of `job`; see `atoll.tasks.analyses`.

        The coordinator ends a task that takes too long, so this method always ends.

        Args:
            job: a job that has ended.
            function: the kind of question.
            question: the encoded question.
            table: measurements to use instead of the measurements in the result.
            report_wait: called with the reason for waiting, when the reason changes.

        Raises:
            UnreachableError: no worker has begun the analysis within `IDLE_LIMIT_S` seconds.
            RefusedError: there is no such job, or no result.
            AtollError: the analysis failed.
        """
        digest = None if table is None else self.upload(table)
        waits_for, since, pause, tries = None, self.now(), _PAUSE_S, _TRIES
        while True:
            try:
                reason, made = self.analysis(job, function, question, digest)
            except TableMissingError:  # the coordinator was restarted meanwhile
                tries -= 1
                if table is None or not tries:
                    raise
                self.upload(table)
                continue
            if made is not None:
                return made
            if reason is None:
                since = self.now()
            elif self.now() - since > IDLE_LIMIT_S:
                what = f"the analysis of job {job}"
                raise UnreachableError(f"{what} was not begun within {IDLE_LIMIT_S:.0f} s: it {reason}")
            elif reason != waits_for:
                report_wait(reason)
            waits_for = reason
            self.pause(pause)
            pause = min(2.0 * pause, _LONGEST_PAUSE_S)

    def analysis(
        self, job: str, function: AnalysisFunction, question: bytes, table: str | None = None
    ) -> tuple[str | None, bytes | None]:
        """Ask a question; return the reason for waiting as a clause, and the answer (None until it exists).

        Until the answer exists, the question must be repeated, otherwise the coordinator drops the task. `table` is the
        digest of an uploaded table. Raises the errors of `analyse`.
        """
        parts: list[bytes] = []
        while True:
            body = messages.AskAnalysis(job=job, function=function, question=question, table=table, index=len(parts))
            answer = self._ask(body, messages.AnalysisAnswer, f"the analysis of job {job}")
            if answer.data is None:
                return answer.waits_for, None
            parts.append(answer.data)
            if sum(map(len, parts)) >= answer.size:
                return None, _joined_chunks(parts, answer.digest)

    def table(self, job: str) -> bytes:
        """Return the uploaded table of `job`; raises RefusedError if it was deleted."""
        parts: list[bytes] = []
        while True:
            body = messages.GetTable(job=job, index=len(parts))
            chunk = self._ask(body, messages.TableChunk, f"the table of job {job}", CHUNK_LIMIT_S)
            parts.append(chunk.data)
            if sum(map(len, parts)) >= chunk.size:
                return _joined_chunks(parts, chunk.digest)

    def islands(self, job: str) -> tuple[IslandView, ...]:
        """Return the islands of `job` and their workers; empty unless the job is in its search."""
        return self._ask(messages.GetIslands(job=job), messages.IslandList, f"the islands of job {job}").islands

    def cancel(self, job: str) -> JobView:
        """Cancel `job` and keep its best equations; until its result is built, the returned state is the old one."""
        return self._ask(messages.Cancel(job=job), messages.JobStatus, f"the end of job {job}").job

    def cancel_and_wait(self, job: str) -> JobView:
        """Cancel `job` and wait, within `CANCEL_LIMIT_S`, until it has ended."""
        view, end = self.cancel(job), self.now() + CANCEL_LIMIT_S
        while view.state not in FINAL_STATES and self.now() < end:
            self.pause(_PAUSE_S)
            view = self.cancel(job)  # a restarted coordinator has lost the first request
        return view

    def pause_job(self, job: str, *, paused: bool = True) -> JobView:
        """Stop `job` at a checkpoint until it is resumed (`paused` False)."""
        return self._ask(messages.Pause(job=job, paused=paused), messages.JobStatus, f"the pause of job {job}").job

    def set_priority(self, job: str, priority: int) -> JobView:
        """Change the priority of `job`."""
        body = messages.SetPriority(job=job, priority=priority)
        return self._ask(body, messages.JobStatus, f"the priority of job {job}").job

    def share(self, job: str, *, shared: bool = True) -> JobView:
        """Make `job` visible to all users, or only to its submitter and admins."""
        return self._ask(messages.Share(job=job, shared=shared), messages.JobStatus, f"the sharing of job {job}").job

    def retry(self, job: str, again: str) -> JobView:
        """Submit `job`, which failed or was cancelled, again under the id `again`."""
        return self._ask(messages.Retry(job=job, again=again), messages.JobStatus, f"the retry of job {job}").job

    def set_worker(self, worker: str, service: WorkerService) -> tuple[WorkerView, ...]:
        """Let a worker get islands (open), keep its islands (cordoned) or hand them over (draining); for admins."""
        body = messages.SetWorker(worker=worker, service=service)
        return self._ask(body, messages.WorkerList, f"the change of worker {worker}").workers

    def pause_queue(self, *, paused: bool = True) -> CoordinatorView | None:
        """Pause the queue, so that no further job starts, or resume it (`paused` False); for admins."""
        return self._ask(messages.SetQueue(paused=paused), messages.WorkerList, "the change of the queue").coordinator

    def delete(self, job: str) -> None:
        """Delete `job`, which has ended, with its result and its data; no effect if there is no such job."""
        self._ask(messages.Delete(job=job), messages.Deleted, f"the deletion of job {job}")

    def resolve(self, prefix: str) -> str:
        """Return the id of the one job whose id is `prefix` or begins with it; raises RefusedError."""
        if not topics.is_id(prefix):
            raise RefusedError(
                f"the coordinator at {self._address} has no job {prefix!r}: ids are 1 to 64 letters, digits, _ or -"
            )
        return self._ask(messages.FindJob(prefix=prefix), messages.JobStatus, f"the id of job {prefix}").job.job

    def pause(self, seconds: float) -> None:
        """Wait on the bus; changes that arrive are kept."""
        end = self._bus.now() + seconds
        while (left := end - self._bus.now()) > 0:
            self._keep_change(self._bus.receive(left))

    def now(self) -> float:
        """Return the bus's monotonic seconds."""
        return self._bus.now()

    def exchange(self, request: messages.ClientRequest) -> bytes | None:
        """Pass on a request of another program; return the encoded answer of the coordinator, None after a timeout."""
        key = topics.client(self._cluster or self.greet(), self._name)
        limit_s = CHUNK_LIMIT_S if isinstance(request.body, messages.Upload) else ANSWER_LIMIT_S
        return next(self._answers(encode(request), limit_s, key), (key, None))[1]

    def _ask(self, body: _Question, kind: type[A], what: str, limit_s: float = ANSWER_LIMIT_S) -> A:
        """Return the answer to a request; raises UnreachableError if none comes within `limit_s` seconds."""
        key = topics.client(self._cluster or self.greet(), self._name)
        _, payload = next(self._answers(encode(messages.ClientRequest(body=body)), limit_s, key), (key, None))
        if payload is None:
            raise UnreachableError(
                f"the coordinator at {self._address} did not answer within {limit_s:.0f} s (waited for {what}); "
                "check that it runs and that the address is right"
            )
        with _decoding():
            answer = decode(payload, messages.Answer).body
        if isinstance(answer, messages.Failure):
            raise _ERRORS.get(answer.failure, RefusedError)(answer.sentence)
        if not isinstance(answer, kind):
            raise RefusedError(f"the coordinator answered with {answer.kind!r} when asked for {what}; compare versions")
        return answer

    def _answers(self, payload: bytes, limit_s: float, *keys: str) -> Iterator[tuple[str, bytes]]:
        """Send a request to each key, at least `_TRIES` times in `limit_s` seconds; yield answers with their keys."""
        end = self._bus.now() + limit_s
        while (left := end - self._bus.now()) > 0:
            for key in keys:
                answer = self._receive_reply(self._bus.get(key, payload, min(left, limit_s / _TRIES)), left)
                if answer is not None:
                    yield key, answer
            self.pause(min(_PAUSE_S, max(0.0, end - self._bus.now())))

    def _receive_reply(self, token: int, limit_s: float) -> bytes | None:
        end = self._bus.now() + limit_s + 1.0
        while (left := end - self._bus.now()) > 0:
            event = self._bus.receive(left)
            if isinstance(event, Reply) and event.token == token:
                return event.payload
            self._keep_change(event)
        return None

    def _keep_change(self, event: Event | None) -> None:
        """Keep a change that arrives during the wait for another event."""
        if isinstance(event, Message) and self._changes is not None:
            self._changes.append(event.payload)


def _joined_chunks(parts: list[bytes], digest: str) -> bytes:
    whole = b"".join(parts)
    if hashlib.sha256(whole).hexdigest() != digest:
        raise RefusedError("the answer was damaged on the network; try again")
    return whole


@contextmanager
def connected(address: str | Destination | WebAddress, wait_s: float = 5.0) -> Iterator[Client]:
    """Open a client of the coordinator at `address`, such as ``tcp/host:7447``; close it at the end.

    Raises the errors of `Client.greet` if no answer comes within `wait_s` seconds.
    """
    if isinstance(address, WebAddress):
        client = Client(HttpBus(address), str(address))
        client.greet(wait_s)
        yield client
        return
    from atoll_core.wire.bus.zenoh_bus import open_client

    credentials = address.credentials if isinstance(address, Destination) else None
    began = time.monotonic()
    with open_client(address, wait_s=wait_s) as bus:
        client = Client(bus, str(address), credentials.name if credentials is not None else "client")
        client.greet(max(wait_s - (time.monotonic() - began), _PAUSE_S))
        yield client


@contextmanager
def _decoding() -> Iterator[None]:
    """Raise RefusedError if an answer that is decoded in the block is malformed."""
    try:
        yield
    except (RemoteProtocolError, ValueError) as error:
        raise RefusedError(f"the coordinator's answer was not understood ({error}); compare the versions") from error
