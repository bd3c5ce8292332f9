"""A client of a coordinator: what the command line asks, over any bus.

One owner thread. Every question may be asked again without harm, so a lost one is; every wait has a limit, and the
error at its end says what was waited for.
"""

import hashlib
import json
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final, TypeVar

from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.config import JobConfig
from atoll_core.errors import (
    AtollError,
    DataError,
    RefusedError,
    RemoteProtocolError,
    TableMissingError,
    UnreachableError,
)
from atoll_core.wire import topics
from atoll_core.wire.addresses import Destination
from atoll_core.wire.bus.interface import Bus, Reply
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.clients import (
    Answer,
    Cancel,
    Delete,
    Deleted,
    EventList,
    Failure,
    FailureKind,
    FindJob,
    GetEvents,
    GetResult,
    JobFound,
    JobList,
    Jobs,
    JobStatus,
    Request,
    Result,
    Status,
    Submit,
    Upload,
    Uploaded,
    WorkerList,
    Workers,
)
from atoll_core.wire.messages.handshake import Greeting, GreetingAnswer, Hello, Refusal, Welcome
from atoll_core.wire.messages.limits import CHUNK_LIMIT_S, CHUNK_SIZE, MAX_PAGE_JOBS, chunk_count
from atoll_core.wire.messages.views import FINAL_STATES, CoordinatorView, EventView, JobView, WorkerView

ANSWER_LIMIT_S: Final = 10.0
"""How long any other question may remain without an answer."""

CANCEL_LIMIT_S: Final = 10.0
"""How long a job that was cancelled is waited for."""

_TRIES: Final = 3
_PAUSE_S: Final = 0.1
_ERRORS: Final[dict[FailureKind, type[AtollError]]] = {
    "data": DataError,
    "unknown-job": RefusedError,
    "no-table": TableMissingError,
    "refused": RefusedError,
    "too-early": RefusedError,
    "protocol": RefusedError,
    "internal": AtollError,
}

A = TypeVar("A")
Body = Upload | Submit | Jobs | FindJob | Status | Workers | GetResult | Cancel | Delete | GetEvents


class Client:
    """Asks one coordinator; not thread-safe, like its bus."""

    def __init__(self, bus: Bus, address: str, principal: str = "client") -> None:
        """Use `bus`, which the caller opened and will close; `address` is for messages to people.

        `principal` is the name in our certificate, if we have one.
        """
        self._bus = bus
        self._address = address
        self._name = f"{principal}-{uuid.uuid4().hex[:12]}"
        self._cluster: str | None = None
        self.welcome: Welcome | None = None
        """What the coordinator said of itself when it was greeted."""

    def greet(self, limit_s: float = ANSWER_LIMIT_S) -> str:
        """Learn and return the coordinator's cluster; the first question calls this by itself.

        Raises:
            UnreachableError: nobody answered in time.
            RefusedError: the coordinator is of another version, or does not let us in.
        """
        hello = Hello(
            role="client",
            name=self._name,
            instance=uuid.uuid4().hex,
            protocol=PROTOCOL_VERSION,
            version=VERSION,
            engine=ENGINE_REVISION,
        )
        self.welcome = self._greet(encode(Greeting(body=hello)), limit_s)
        self._cluster = self.welcome.realm
        return self._cluster

    def _greet(self, greeting: bytes, limit_s: float) -> Welcome:
        """Greet under our name; when nothing comes back, ask whether access control may be the reason."""
        end = self._bus.now() + limit_s
        is_heard = False
        while (left := end - self._bus.now()) > 0:
            for key in (topics.hello(self._name), topics.HELLO):
                payload = self._await(self._bus.get(key, greeting, min(left, limit_s / _TRIES)), left)
                if payload is None:
                    continue
                answer = _understood(lambda payload=payload: decode(payload, GreetingAnswer)).body  # type: ignore[misc]
                if isinstance(answer, Refusal):
                    raise RefusedError(answer.sentence)
                if key != topics.HELLO:
                    return answer
                is_heard = True
            self.pause(min(_PAUSE_S, max(0.0, end - self._bus.now())))
        raise UnreachableError(self._no_greeting(limit_s, is_heard))

    def _no_greeting(self, limit_s: float, is_heard: bool) -> str:
        silence = f"the coordinator at {self._address} did not answer within {limit_s:.2g} s (waited for its greeting)"
        if is_heard:
            return (
                f"{silence}, though it can be reached: access control on the way does probably not know the name "
                f"{self._name!r}; have the router started again with the roster that the coordinator has"
            )
        return f"{silence}; check that it runs and that the address is right"

    def upload(self, data: bytes) -> str:
        """Store `data` at the coordinator, chunk by chunk, until it says that none is missing; return its digest.

        Raises:
            RefusedError: it does not take them, or does not keep them.
        """
        blob = hashlib.sha256(data).hexdigest()
        missing = self._ask(Upload(blob=blob, size=len(data)), Uploaded, "the upload of the data").missing
        for _ in range(_TRIES * chunk_count(len(data))):
            if not missing:
                return blob
            missing = self._upload_chunk(blob, data, missing[0])
        raise RefusedError(
            f"the coordinator at {self._address} does not keep what is uploaded: {len(missing)} of "
            f"{chunk_count(len(data))} parts are still missing; see its log"
        )

    def hand_in(self, job: str, name: str, config: JobConfig, data: bytes, priority: int = 0) -> JobView:
        """Upload `data` and submit a job on it, again where the table was deleted in between."""
        for _ in range(_TRIES - 1):
            with suppress(TableMissingError):
                return self.submit(job, name, config, self.upload(data), priority)
        return self.submit(job, name, config, self.upload(data), priority)

    def submit(self, job: str, name: str, config: JobConfig, table: str, priority: int = 0) -> JobView:
        """Submit a job under the id `job` on the uploaded table of that digest."""
        body = Submit(job=job, name=name[:200], config=config, table=table, priority=priority)
        return self._ask(body, JobStatus, f"the acceptance of job {job}").job

    def jobs(self, prefix: str = "", *, is_open: bool = False, last: int | None = None) -> tuple[JobView, ...]:
        """Return the jobs whose ids begin with `prefix`, newest last.

        Args:
            prefix: of the ids; all jobs have an empty one.
            is_open: whether only those are wanted that have not ended.
            last: how many, those that came last; None: all of them.
        """
        pages: list[tuple[JobView, ...]] = []
        before, left = None, last
        while left != 0 and (not prefix or topics.is_id(prefix)):
            limit = MAX_PAGE_JOBS if left is None else min(left, MAX_PAGE_JOBS)
            question = Jobs(prefix=prefix, is_open=is_open, before=before, limit=limit)
            page = self._ask(question, JobList, "the list of jobs")
            pages.append(page.jobs)
            left = None if left is None else left - len(page.jobs)
            if page.before is None:
                break
            before = page.before
        return tuple(view for page in reversed(pages) for view in page)

    def status(self, job: str, limit_s: float = ANSWER_LIMIT_S) -> JobView:
        """Return how `job` is getting on."""
        return self._ask(Status(job=job), JobStatus, f"the status of job {job}", limit_s).job

    def workers(self) -> tuple[WorkerView, ...]:
        """Return the workers that the coordinator knows."""
        return self._ask(Workers(), WorkerList, "the list of workers").workers

    def coordinator(self) -> CoordinatorView | None:
        """Return the coordinator's view of itself."""
        return self._ask(Workers(), WorkerList, "the coordinator's counters").coordinator

    def events(self, job: str | None, after: int = 0, limit: int = 200) -> tuple[EventView, ...]:
        """Return what happened to `job`, or at all (None), after that event; the last events when `after` is 0."""
        body = GetEvents(job=job, after=after, limit=limit)
        return self._ask(body, EventList, "the log of events").events

    def result(self, job: str) -> dict[str, object]:
        """Return the contents of result.json; while the job runs, the best so far."""
        text = self._ask(GetResult(job=job), Result, f"the result of job {job}").json_text
        contents: dict[str, object] = _understood(lambda: json.loads(text))
        return contents

    def cancel(self, job: str) -> JobView:
        """End `job`, keeping its best equations."""
        return self._ask(Cancel(job=job), JobStatus, f"the end of job {job}").job

    def cancel_and_wait(self, job: str) -> JobView:
        """End `job` and wait, within `CANCEL_LIMIT_S`, until it has ended."""
        view, end = self.cancel(job), self.now() + CANCEL_LIMIT_S
        while view.state not in FINAL_STATES and self.now() < end:
            self.pause(_PAUSE_S)
            view = self.status(job)
        return view

    def delete(self, job: str) -> None:
        """Delete `job`, which has ended, with its result and its data; without effect when there is none."""
        self._ask(Delete(job=job), Deleted, f"the deletion of job {job}")

    def resolve(self, prefix: str) -> str:
        """Return the id of the one job whose id is `prefix` or begins with it; raises RefusedError."""
        if not topics.is_id(prefix):
            raise RefusedError(
                f"the coordinator at {self._address} has no job {prefix!r}: ids are 1 to 64 letters, digits, _ or -"
            )
        return self._ask(FindJob(prefix=prefix), JobFound, f"the id of job {prefix}").job

    def pause(self, seconds: float) -> None:
        """Let time pass on the bus."""
        end = self._bus.now() + seconds
        while (left := end - self._bus.now()) > 0:
            self._bus.receive(left)

    def now(self) -> float:
        """Return the bus's monotonic seconds."""
        return self._bus.now()

    def _upload_chunk(self, blob: str, data: bytes, index: int) -> tuple[int, ...]:
        """Upload one chunk; return which are missing then."""
        chunk = data[index * CHUNK_SIZE : (index + 1) * CHUNK_SIZE]
        sha256 = hashlib.sha256(chunk).hexdigest()
        body = Upload(blob=blob, size=len(data), index=index, sha256=sha256, data=chunk)
        return self._ask(body, Uploaded, f"the upload of part {index + 1} of the data", CHUNK_LIMIT_S).missing

    def _ask(self, body: Body, kind: type[A], what: str, limit_s: float = ANSWER_LIMIT_S) -> A:
        cluster = self._cluster or self.greet()
        payload = self._exchange(topics.client(cluster, self._name), encode(Request(body=body)), what, limit_s)
        answer = _understood(lambda: decode(payload, Answer)).body
        if isinstance(answer, Failure):
            raise _ERRORS[answer.failure](answer.sentence)
        if not isinstance(answer, kind):
            raise RefusedError(f"the coordinator answered with {answer.kind!r} when asked for {what}; compare versions")
        return answer

    def _exchange(self, key: str, payload: bytes, what: str, limit_s: float) -> bytes:
        """Ask until there is an answer or `limit_s` seconds have passed; a question that is lost, `_TRIES` times."""
        end = self._bus.now() + limit_s
        while (left := end - self._bus.now()) > 0:
            answer = self._await(self._bus.get(key, payload, min(left, limit_s / _TRIES)), left)
            if answer is not None:
                return answer
            self.pause(min(_PAUSE_S, max(0.0, end - self._bus.now())))
        raise UnreachableError(
            f"the coordinator at {self._address} did not answer within {limit_s:.0f} s (waited for {what}); "
            "check that it runs and that the address is right"
        )

    def _await(self, token: int, limit_s: float) -> bytes | None:
        end = self._bus.now() + limit_s + 1.0
        while (left := end - self._bus.now()) > 0:
            event = self._bus.receive(left)
            if isinstance(event, Reply) and event.token == token:
                return event.payload
        return None


@contextmanager
def connected(address: str | Destination, wait_s: float = 5.0) -> Iterator[Client]:
    """Open a client of the coordinator at `address`, such as ``tcp/host:7447``; close it at the end.

    Raises:
        UnreachableError: no coordinator answered within `wait_s` seconds.
        RefusedError: it is of another version, or does not let us in.
    """
    from atoll_core.wire.bus.zenoh_bus import open_client

    credentials = address.credentials if isinstance(address, Destination) else None
    began = time.monotonic()
    with open_client(address, wait_s=wait_s) as bus:
        client = Client(bus, str(address), credentials.name if credentials is not None else "client")
        client.greet(max(wait_s - (time.monotonic() - began), _PAUSE_S))
        yield client


def _understood(read: Callable[[], A]) -> A:
    """Return what `read` makes of an answer; raise RefusedError when it is not in our words."""
    try:
        return read()
    except (RemoteProtocolError, ValueError) as error:
        raise RefusedError(f"the coordinator's answer was not understood ({error}); compare the versions") from error
