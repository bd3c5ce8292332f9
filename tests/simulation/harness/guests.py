"""Other users of the coordinator: who stall, vanish, cancel, ask for everything, hold old versions, say what is wrong.

Each is a participant of its own with a script: a generator that yields questions, and pauses in seconds. What comes
back is checked: once all faults are over every question has an answer, and a job that somebody submitted ends as it
would have alone.
"""

import hashlib
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from typing import Any, Final

from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Event, Reply, Timer
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages import clients
from atoll_core.wire.messages.handshake import Greeting, GreetingAnswer, Hello, Welcome
from atoll_core.wire.messages.limits import CHUNK_SIZE
from atoll_core.wire.messages.views import FINAL_STATES
from atoll_core.wire.messages.workers import WorkerStatus
from tests.simulation.harness.fault_schedule import GuestKind, GuestPlan
from tests.simulation.harness.participants import Participants

TABLE_BYTES: Final = 3_000_000
PATIENCE: Final = 3
"""So many questions in a row may remain without an answer on a network without faults: none is lost there."""

TIMEOUT_S: Final = 5.0
PAUSE_S: Final = 0.7

Question = tuple[str, bytes]
Script = Generator[Question | float, bytes | None, None]
Answered = Generator[Question | float, bytes | None, clients.Answer]


class GaveUpError(Exception):
    """Raised in a script whose question has remained without an answer for too long."""


@dataclass
class Guest:
    """One guest. `submitted` names its job once that has been accepted, and `deleted` whether it was deleted."""

    plan: GuestPlan
    participants: Participants
    submitted: str | None = None
    deleted: bool = False
    is_here: bool = True
    _cluster: str | None = None
    _token: int | None = None
    _script: Script = field(init=False)

    def __post_init__(self) -> None:
        self._bus = self.participants.network.bus(self.plan.name)
        self._bus.handle_with(self._step)
        self._script = _SCRIPTS[self.plan.kind](self)
        self._go_on(None)

    def _step(self, event: Event) -> None:
        if isinstance(event, Timer):
            self._go_on(None)
        elif isinstance(event, Reply) and event.token == self._token:
            self._go_on(event.payload)

    def _go_on(self, answer: bytes | None) -> None:
        self._token = None
        try:
            wanted = self._script.send(answer)
        except (StopIteration, GaveUpError):
            self.leave()
            return
        if isinstance(wanted, float):
            self._bus.call_later(wanted, "go on")
        else:
            self._token = self._bus.get(*wanted, TIMEOUT_S)

    def leave(self) -> None:
        """Be gone, in order or, if it is to vanish, without a word."""
        if not self.is_here:
            return
        self.is_here = False
        if self.plan.kind in ("half-uploads", "vanishes"):
            self.participants.network.crash(self.plan.name)
        else:
            self._bus.close()

    # ----------------------------------------------------------------------------------- parts of scripts

    def ask(self, body: Any) -> Answered:
        """Ask until there is an answer; what is lost is asked again."""
        unheard = 0
        while True:
            if self._cluster is None:
                yield from self.greet()
            was_over = self.participants.is_over
            payload = yield topics.client(self._cluster or "", self.plan.name), encode(clients.ClientRequest(body=body))
            if payload is not None:
                answer = decode(payload, clients.Answer)
                its_fault = isinstance(answer.body, clients.Failure) and answer.body.failure == "internal"
                if was_over or not its_fault:  # a full disk, until then
                    return answer
            unheard += was_over
            if unheard >= PATIENCE:
                self.participants.wrong.append(f"{self.plan.name} got no answer to {type(body).__name__}")
                raise GaveUpError
            yield PAUSE_S

    def greet(self) -> Generator[Question | float, bytes | None, None]:
        """Learn the cluster."""
        unheard = 0
        while self._cluster is None:
            was_over = self.participants.is_over
            payload = yield topics.hello(self.plan.name), self.hello("client")
            answer = decode(payload, GreetingAnswer).body if payload is not None else None
            if isinstance(answer, Welcome):
                self._cluster = answer.realm
                return
            unheard += was_over
            if unheard >= PATIENCE:
                self.participants.wrong.append(f"{self.plan.name} was not welcomed: {answer}")
                raise GaveUpError
            yield PAUSE_S

    def hello(self, role: str, protocol: int = PROTOCOL_VERSION) -> bytes:
        hello = Hello.model_validate({
            "role": role, "name": self.plan.name, "instance": "i", "protocol": protocol, "version": VERSION,
            "engine": ENGINE_REVISION, "fingerprint": "of another version" if role == "worker" else "",
        })  # fmt: skip
        return encode(Greeting(body=hello))

    def submit(self) -> Script:
        """Upload a table and submit a job on it; the table is uploaded again where it was deleted meanwhile."""
        config, variables = self.participants.cast.job(self.plan.seed)
        table = variables.encode()
        blob, job = hashlib.sha256(table).hexdigest(), f"of-{self.plan.name}"
        chunk = clients.Upload(blob=blob, size=len(table), index=0, sha256=blob, data=table)
        for _ in range(5):
            yield from self.ask(chunk)
            submitted = yield from self.ask(clients.Submit(job=job, name="a guest's", config=config, table=blob))
            if isinstance(submitted.body, clients.JobStatus):
                self.submitted = job
                return
        self.participants.wrong.append(f"{self.plan.name} cannot submit: {submitted.body}")

    def upload(self, number: int, is_whole: bool) -> Script:
        """Upload a table that nobody needs, or its second part only."""
        data = f"{self.plan.name} {number}".encode() * (TABLE_BYTES // 10)
        size = len(data) if is_whole else CHUNK_SIZE + len(data)
        digest = hashlib.sha256(data).hexdigest()
        blob = digest if is_whole else hashlib.sha256(digest.encode()).hexdigest()
        yield from self.ask(clients.Upload(blob=blob, size=size))
        yield from self.ask(clients.Upload(blob=blob, size=size, index=0 if is_whole else 1, sha256=digest, data=data))

    def end_of_job(self) -> Script:
        """Wait until the job has ended."""
        while self.submitted is not None:
            answer = yield from self.ask(clients.Status(job=self.submitted))
            if not isinstance(answer.body, clients.JobStatus):
                self.participants.wrong.append(f"{self.submitted} is gone: {answer.body}")
                raise GaveUpError
            if answer.body.job.state in FINAL_STATES:
                return
            yield PAUSE_S


def _half_uploads(guest: Guest) -> Script:
    for number in range(guest.plan.times):
        yield from guest.upload(number, is_whole=False)


def _uploads(guest: Guest) -> Script:
    for number in range(guest.plan.times):
        yield from guest.upload(number, is_whole=True)
        yield PAUSE_S


def _vanishes(guest: Guest) -> Script:
    yield from guest.submit()


def _stalls(guest: Guest) -> Script:
    network, name = guest.participants.network, guest.plan.name
    yield from guest.submit()
    network.hang(name)
    network.at(network.now + guest.plan.for_s, lambda: network.resume(name))
    yield from guest.end_of_job()
    yield from guest.ask(clients.GetResult(job=f"of-{name}"))


def _cancels(guest: Guest) -> Script:
    yield from guest.submit()
    yield guest.plan.for_s
    yield from guest.ask(clients.Cancel(job=f"of-{guest.plan.name}"))
    yield from guest.end_of_job()


def _deletes(guest: Guest) -> Script:
    yield from guest.submit()
    delete = clients.Delete(job=f"of-{guest.plan.name}")
    early = yield from guest.ask(delete)
    if isinstance(early.body, clients.Failure):
        yield from guest.end_of_job()
        guest.deleted = True  # also where the answer is lost
        yield from guest.ask(delete)
    guest.deleted = True


def _asks_everything(guest: Guest) -> Script:
    for _ in range(guest.plan.times):
        jobs = ["job-0", "job-1", "nobodys"]
        for body in (
            clients.ListJobs(), clients.ListWorkers(), *(clients.Status(job=job) for job in jobs),
            *(clients.GetResult(job=job) for job in jobs), clients.GetEvents(limit=1000),
            *(clients.GetEvents(job=job, limit=1000) for job in jobs),
        ):  # fmt: skip
            yield from guest.ask(body)
        yield PAUSE_S


def _old_client(guest: Guest) -> Script:
    yield from guest.greet()
    key = topics.client(guest._cluster or "", guest.plan.name)
    for number in range(guest.plan.times):
        yield topics.hello(guest.plan.name), guest.hello("client", PROTOCOL_VERSION - 1 - number)
        for words in (b"", b"\xc1", b"\x81\xa4body\x81\xa4kind\xa5ping?", b"\x81\xa4body\x80", b"\x93" * 40):
            yield key, words
        yield PAUSE_S


def _old_worker(guest: Guest) -> Script:
    yield from guest.greet()
    cluster, name = guest._cluster or "", guest.plan.name
    guest._bus.announce(topics.worker(cluster, name, "alive"))
    for number in range(guest.plan.times):
        yield topics.hello(name), guest.hello("worker")
        status = WorkerStatus(instance="i", incarnation=0, state="ready", progress=number)
        guest._bus.put(topics.worker(cluster, name, "status"), encode(status))
        guest._bus.put(topics.worker(cluster, name, "report"), b"\x81\xa4body\x80")
        yield PAUSE_S


_SCRIPTS: Final[dict[GuestKind, Callable[[Guest], Script]]] = {
    "half-uploads": _half_uploads,
    "uploads": _uploads,
    "vanishes": _vanishes,
    "stalls": _stalls,
    "cancels": _cancels,
    "deletes": _deletes,
    "asks-everything": _asks_everything,
    "old-client": _old_client,
    "old-worker": _old_worker,
}
