"""A worker at work: the only loop. Bus events go to the session, its actions to the bus and the compute thread.

`Worker.step` takes one event and never blocks; `Worker.run` is the thin loop around `Bus.receive`; `run_worker` is what
the command line calls.
"""

import logging
import os
import socket
from dataclasses import dataclass
from functools import singledispatchmethod
from typing import Final
from uuid import uuid4

from common import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from common.errors import AtollError, RefusedError, RemoteProtocolError, UnreachableError
from common.wire import topics
from common.wire.bus import Bus, Event, Link, Message, Posted, Presence, Query, Reply, Timer
from common.wire.codec import decode, encode
from common.wire.messages import (
    MAX_MESSAGE,
    Close,
    Commit,
    Control,
    Greeting,
    GreetingAnswer,
    Hello,
    Introduce,
    JobAnnouncement,
    Mail,
    Placements,
    Pull,
    PullAnswer,
    Refusal,
    Shutdown,
    Welcome,
    WorkerStatus,
)
from common.wire.rejects import Rejects
from common.wire.views import WorkerState
from island_worker.compute import Compute, IslandCompute, WarmedUp, WarmUpFailed, WarmUpNote
from island_worker.download import Download
from island_worker.events import (
    Abandoned,
    Action,
    AskPeer,
    Broken,
    Closed,
    Committed,
    Computed,
    Discard,
    DiscardJob,
    FetchJob,
    FetchPlacements,
    JobReady,
    Mailed,
    Placed,
    PullAnswered,
    PullAsked,
    Rejected,
    Reset,
    Respond,
    Send,
    SendReport,
    SessionEvent,
    Tick,
    Unloadable,
)
from island_worker.events import Compute as ComputeTask
from island_worker.session import Session

_LOG = logging.getLogger(__name__)

HEARTBEAT_S: Final = 1.0
TICK_S: Final = 0.5
GREET_TIMEOUT_S: Final = 2.0
GREET_PAUSE_S: Final = 0.2
PULL_TIMEOUT_S: Final = 5.0
FETCH_TIMEOUT_S: Final = 20.0
FETCH_PAUSE_S: Final = 0.5

_BEAT: Final = "heartbeat"
_TICK: Final = "tick"
_GREET: Final = "greet"
_FETCH: Final = "fetch/"


@dataclass(frozen=True, slots=True)
class _Asked:
    """What a reply will be the answer to: `question` of (`peer` or the coordinator, about `job`)."""

    question: str
    subject: str = ""
    index: int = 0


class Worker:
    """One worker process on one bus. Owned by the bus's owner thread."""

    def __init__(self, bus: Bus, compute: Compute, name: str, wait_s: float) -> None:
        """`wait_s`: how long the coordinator may be away; `compute` begins to warm up elsewhere."""
        self.exit_code: int | None = None
        self.error: AtollError | None = None
        self.name: Final = name
        self.session = Session(name)
        self.rejects = Rejects(_LOG)
        self._bus = bus
        self._compute = compute
        self._wait_s = wait_s
        self._fingerprint = ""
        self._instance = uuid4().hex
        self._welcome: Welcome | None = None
        self._realms: set[str] = set()
        self._away_since: float | None = None
        self._is_accepted = False
        self._detail = "loading kernels"
        self._asked: dict[int, _Asked] = {}
        self._downloads: dict[str, Download] = {}
        self._loaded: set[str] = set()

    # ------------------------------------------------------------------------------------------- life

    def start(self) -> None:
        """Begin: greet the coordinator, start the timers."""
        self._away_since = self._bus.now()
        self._compute.attach(self._bus.post)
        self._greet()
        self._bus.call_later(HEARTBEAT_S, _BEAT)
        self._bus.call_later(TICK_S, _TICK)

    def run(self) -> int:
        """Work until the coordinator ends, refuses us or stays away; return the exit code."""
        self.start()
        while self.exit_code is None:
            event = self._bus.receive(1.0)
            if event is not None:
                self.step(event)
        return self.exit_code

    def step(self, event: Event) -> None:
        """Take in one event. What a peer did wrong is counted, logged once and changes nothing."""
        if self.exit_code is not None:
            return
        try:
            self._on(event)
        except RemoteProtocolError as error:
            self.rejects.note(event.key if isinstance(event, Message | Query) else "answer", error)

    @singledispatchmethod
    def _on(self, event: Event) -> None:
        raise RemoteProtocolError(f"events of kind {type(event).__name__} are not expected here")

    @_on.register
    def _on_posted(self, event: Posted) -> None:
        item = event.item
        match item:
            case WarmUpNote():
                self._detail = item.sentence
                _LOG.info("%s", item.sentence)
                self._beat()
            case WarmedUp():
                self._warmed_up(item)
            case WarmUpFailed():
                self._leave(AtollError(item.sentence))
            case JobReady() | Unloadable() | Computed() | Rejected() | Broken() | Abandoned():
                self._tell(item)

    @_on.register
    def _on_timer(self, event: Timer) -> None:
        if event.name == _BEAT:
            self._beat()
            self._bus.call_later(HEARTBEAT_S, _BEAT)
        elif event.name == _TICK:
            self._check_absence()
            self._tell(Tick(self._bus.now()))
            self._bus.call_later(TICK_S, _TICK)
        elif event.name == _GREET:
            self._greet()
        elif event.name.startswith(_FETCH):
            self._fetch(event.name.removeprefix(_FETCH))

    @_on.register
    def _on_link(self, event: Link) -> None:
        if not event.up:
            self._away_since = self._bus.now()
            _LOG.warning("connection to the coordinator lost; waiting for it")
        else:
            self._greet()

    @_on.register
    def _on_presence(self, event: Presence) -> None:
        del event  # a worker watches nobody

    # ------------------------------------------------------------------------------------ coordinator

    def _greet(self) -> None:
        hello = Hello(
            role="worker",
            name=self.name,
            instance=self._instance,
            protocol=PROTOCOL_VERSION,
            version=VERSION,
            engine=ENGINE_REVISION,
            fingerprint=self._fingerprint,
            host=socket.gethostname()[:256],
            pid=os.getpid(),
        )
        self._get(topics.HELLO, encode(Greeting(body=hello)), GREET_TIMEOUT_S, _Asked("hello", self._fingerprint))

    def _greeted(self, fingerprint: str, payload: bytes | None) -> None:
        """Take in the answer to a greeting that carried `fingerprint` ("": kernels not ready yet)."""
        if payload is None:
            self._bus.call_later(GREET_PAUSE_S, _GREET)
            return
        answer = decode(payload, GreetingAnswer, MAX_MESSAGE).body
        if isinstance(answer, Refusal):
            self._leave(RefusedError(answer.sentence))
            return
        self._is_accepted = self._is_accepted or bool(fingerprint)
        self._join(answer)
        if self._fingerprint and not self._is_accepted:  # the kernels became ready while the greeting was under way
            self._greet()

    def _join(self, welcome: Welcome) -> None:
        former, self._welcome, self._away_since = self._welcome, welcome, None
        if former is not None and (former.realm, former.incarnation) != (welcome.realm, welcome.incarnation):
            _LOG.info("the coordinator started anew; what was held is dropped")
            self._tell(Reset())
            self._forget_all_jobs()
        if welcome.realm not in self._realms:
            self._realms.add(welcome.realm)
            self._bus.subscribe(topics.control(welcome.realm))
            self._bus.subscribe(topics.control(welcome.realm, self.name))
            self._bus.subscribe(topics.inbox(welcome.realm, self.name))
            self._bus.serve(topics.worker(welcome.realm, self.name, "pull"))
            self._bus.announce(topics.worker(welcome.realm, self.name, "alive"))
            _LOG.info("joined realm=%s worker=%s", welcome.realm, self.name)
        self._beat()

    def _state(self) -> WorkerState:
        return self.session.state() if self._is_accepted else "compiling"

    def _beat(self) -> None:
        if self._welcome is None:
            return
        status = WorkerStatus(
            instance=self._instance,
            incarnation=self._welcome.incarnation,
            state=self._state(),
            progress=self._compute.progress,
            holdings=self.session.holdings(),
            troubles=self.session.troubles(),
            detail=self._detail,
        )
        self._bus.put(topics.worker(self._welcome.realm, self.name, "status"), encode(status))

    def _warmed_up(self, item: WarmedUp) -> None:
        """Greet once more, now with the fingerprint; then say that islands can be computed here."""
        self._detail, self._fingerprint = "", item.fingerprint
        _LOG.info("kernels ready seconds=%.2f fingerprint=%s", item.seconds, item.fingerprint)
        if self._welcome is not None:
            self._greet()

    def _check_absence(self) -> None:
        """Leave when the coordinator has been away for longer than allowed."""
        if self._away_since is not None and self._bus.now() - self._away_since > self._wait_s:
            self._leave(UnreachableError(f"the coordinator has not answered for {self._wait_s:.0f} s; start it again"))

    def _leave(self, error: AtollError) -> None:
        self.error, self.exit_code = error, error.exit_code

    def _on_control(self, body: JobAnnouncement | Placements | Commit | Close | Shutdown | Introduce) -> None:
        match body:
            case JobAnnouncement():
                self._announced(body)
            case Placements():
                for placement in body.placements:
                    self._tell(Placed(placement))
            case Commit():
                self._tell(Committed(body))
            case Close():
                if body.variable is None:
                    self._forget_job(body.job)
                self._tell(Closed(body))
            case Shutdown():
                self._shut_down(body)
            case Introduce():
                self._greet()

    def _shut_down(self, body: Shutdown) -> None:
        if body.refused:
            self._leave(RefusedError(body.sentence))
        else:
            _LOG.info("the coordinator ended; so does this worker")
            self.exit_code = 0

    # ---------------------------------------------------------------------------------------- datasets

    def _announced(self, announcement: JobAnnouncement) -> None:
        job = announcement.job
        if job not in self._downloads and job not in self._loaded:
            self._downloads[job] = Download(announcement)
            self._fetch(job)

    def _fetch(self, job: str) -> None:
        """Ask for the next missing chunks of a job's dataset, or for its announcement."""
        if self._welcome is None:
            return
        download = self._downloads.get(job)
        if download is None:
            if self.session.wants(job) and job not in self._loaded:
                self._get(topics.job(self._welcome.realm, job), b"", PULL_TIMEOUT_S, _Asked("job", job))
            return
        for index in download.take():
            key = topics.blob(self._welcome.realm, download.announcement.blob, index)
            self._get(key, b"", FETCH_TIMEOUT_S, _Asked("chunk", job, index))

    def _job_came(self, job: str, payload: bytes | None) -> None:
        if payload is None:
            if self.session.wants(job):
                self._bus.call_later(FETCH_PAUSE_S, _FETCH + job)
            return
        body = decode(payload, Control, MAX_MESSAGE).body
        if not isinstance(body, JobAnnouncement) or body.job != job:
            raise RemoteProtocolError(f"an announcement of job {job} was asked for, {body.kind} came")
        self._announced(body)

    def _chunk_came(self, asked: _Asked, payload: bytes | None) -> None:
        download = self._downloads.get(asked.subject)
        if download is None:
            return
        if payload is None or not download.offer(asked.index, payload):
            download.give_back(asked.index)
            self._bus.call_later(FETCH_PAUSE_S, _FETCH + asked.subject)
            return
        data = download.finish()
        if data is not None:
            self._load(download.announcement, data)
        else:
            self._fetch(asked.subject)

    def _load(self, announcement: JobAnnouncement, data: bytes) -> None:
        del self._downloads[announcement.job]
        self._loaded.add(announcement.job)
        self._compute.load(announcement.job, announcement.config, data)

    def _forget_job(self, job: str) -> None:
        self._downloads.pop(job, None)
        if job in self._loaded:
            self._loaded.discard(job)
            self._compute.discard_job(job)

    def _forget_all_jobs(self) -> None:
        for job in [*self._downloads, *self._loaded]:
            self._forget_job(job)

    # -------------------------------------------------------------------------------- messages, replies

    @_on.register
    def _on_message(self, event: Message) -> None:
        key = topics.parse(event.key)
        match key:
            case topics.ControlKey():
                self._check_realm(key.realm)
                self._on_control(decode(event.payload, Control, MAX_MESSAGE).body)
            case topics.MailKey():
                self._check_realm(key.realm)
                self._tell(Mailed(key.worker, decode(event.payload, Mail, MAX_MESSAGE).body))
            case _:
                raise RemoteProtocolError(f"nothing is expected on key {event.key}")

    @_on.register
    def _on_query(self, event: Query) -> None:
        try:
            body = decode(event.payload, Pull, MAX_MESSAGE).body
        except RemoteProtocolError:
            self._bus.reply(event, None)
            raise
        self._tell(PullAsked(event, body))

    @_on.register
    def _on_reply(self, event: Reply) -> None:
        asked = self._asked.pop(event.token, None)
        match asked:
            case _Asked("hello"):
                self._greeted(asked.subject, event.payload)
            case _Asked("job"):
                self._job_came(asked.subject, event.payload)
            case _Asked("chunk"):
                self._chunk_came(asked, event.payload)
            case _Asked("placement") if event.payload is not None:
                self._on_control(decode(event.payload, Control, MAX_MESSAGE).body)
            case _Asked("pull") if event.payload is not None:
                self._tell(PullAnswered(asked.subject, decode(event.payload, PullAnswer, MAX_MESSAGE).body))

    def _get(self, key: str, payload: bytes, timeout_s: float, asked: _Asked) -> None:
        self._asked[self._bus.get(key, payload, timeout_s)] = asked

    def _check_realm(self, realm: str) -> None:
        if self._welcome is None or realm != self._welcome.realm:
            raise RemoteProtocolError(f"a message of realm {realm} came, which is not ours")

    # ------------------------------------------------------------------------------------------ actions

    def _tell(self, event: SessionEvent) -> None:
        for action in self.session.handle(event):
            self._act(action)

    def _act(self, action: Action) -> None:
        realm = self._welcome.realm if self._welcome is not None else ""
        match action:
            case ComputeTask():
                self._compute.advance(action.task)
            case Send():
                self._bus.put(topics.mail(realm, self.name, action.peer), encode(Mail(body=action.body)))
            case SendReport():
                self._bus.put(topics.worker(realm, self.name, "report"), encode(action.report))
            case AskPeer():
                key = topics.worker(realm, action.peer, "pull")
                self._get(key, encode(Pull(body=action.body)), PULL_TIMEOUT_S, _Asked("pull", action.peer))
            case Respond():
                self._bus.reply(action.handle, encode(PullAnswer(body=action.body)))
            case FetchJob():
                self._fetch(action.job)
            case FetchPlacements():
                self._get(topics.placement(realm, action.job), b"", PULL_TIMEOUT_S, _Asked("placement", action.job))
            case Discard():
                self._compute.discard(action.job, action.variable, action.term)
            case DiscardJob():
                self._forget_job(action.job)


def run_worker(connect: str, name: str, wait_s: float) -> int:
    """Join the coordinator at `connect` as worker `name` and work until it ends; return the exit code.

    Kernels are made ready while the connection is still being sought. `wait_s` limits both the first connection and
    any later absence of the coordinator.

    Raises:
        UnreachableError: The coordinator was not there, or stayed away.
        RefusedError: It refused this worker, for instance because of its version.
    """
    from common.wire.zenoh_bus import open_client

    compute = IslandCompute()
    compute.warm_up()
    try:
        with open_client(connect, wait_s=wait_s) as bus:
            worker = Worker(bus, compute, name, wait_s)
            code = worker.run()
            if worker.error is not None:
                raise worker.error
            return code
    finally:
        compute.close()
