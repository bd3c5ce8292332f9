"""A worker at work: the only loop. Bus events go to the session, its actions to the bus and the compute thread.

`Worker.step` takes one event and never blocks; `Worker.run` is the thin loop around `Bus.receive`; `run_worker` is what
the command line calls.
"""

import logging
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import singledispatchmethod
from typing import Final

from common.errors import AtollError, RefusedError, RemoteProtocolError, UnreachableError
from common.logs import fields
from common.wire import topics
from common.wire.addresses import Destination
from common.wire.bus import Bus, Event, Link, Message, Posted, Presence, Query, Reply, Timer
from common.wire.codec import decode, encode
from common.wire.limits import MAX_MESSAGE
from common.wire.messages import (
    Close,
    Commit,
    Control,
    Introduce,
    JobAnnouncement,
    Mail,
    Placements,
    Pull,
    PullAnswer,
    PullStates,
    Shutdown,
    States,
    WorkerStatus,
)
from common.wire.metered_bus import MeteredBus
from common.wire.rejects import Rejects
from common.wire.views import WorkerState
from island_worker.actions import Action, Beat, Discard, DiscardJob, FetchJob, StopAt
from island_worker.actions import Compute as ComputeTask
from island_worker.compute import Compute, IslandCompute, WarmedUp, WarmUpFailed, WarmUpNote
from island_worker.download import Datasets
from island_worker.events import (
    Abandoned,
    Broken,
    Closed,
    Committed,
    Computed,
    JobReady,
    Mailed,
    Placed,
    PullAnswered,
    PullAsked,
    Rejected,
    Reset,
    SessionEvent,
    Snapshot,
    StatesCame,
    Tick,
    Unloadable,
)
from island_worker.heartbeat import counters, doing
from island_worker.joining import Joining
from island_worker.leaving import Leaving
from island_worker.session import Session
from island_worker.speaking import FETCH_TIMEOUT_S, PULL_TIMEOUT_S, Asked, Voice

_LOG = logging.getLogger(__name__)

HEARTBEAT_S: Final = 1.0
TICK_S: Final = 0.5
GREET_TIMEOUT_S: Final = 2.0
GREET_PAUSE_S: Final = 0.2
FETCH_PAUSE_S: Final = 0.5
ALONE_S: Final = 3.0
"""A worker that is leaving waits so long for a coordinator that has gone."""


_BEAT: Final = "heartbeat"
_TICK: Final = "tick"
_GREET: Final = "greet"
_LIFETIME: Final = "lifetime"
_GRACE: Final = "grace"
_FETCH: Final = "fetch/"


class Worker:
    """One worker process on one bus. Owned by the bus's owner thread."""

    def __init__(self, bus: Bus, compute: Compute, name: str, wait_s: float, leaving: Leaving | None = None) -> None:
        """Set up a worker whose `compute` warms up elsewhere; `wait_s`: how long the coordinator may be away."""
        self.exit_code: int | None = None
        self.error: AtollError | None = None
        self.name: Final = name
        self.session = Session(name)
        self.rejects = Rejects(_LOG)
        self._bus = MeteredBus(bus)
        self._told_at = bus.now()
        self._compute = compute
        self._wait_s = wait_s
        self._leaving = leaving or Leaving()
        self._joining = Joining(name, bus.now())
        self._datasets = Datasets(self)
        self._detail = "loading kernels"
        self._voice = Voice(self._bus, name)

    # ------------------------------------------------------------------------------------------- life

    def start(self) -> None:
        """Begin: greet the coordinator, start the timers."""
        self._compute.attach(self._bus.post)
        self._greet()
        self._bus.call_later(HEARTBEAT_S, _BEAT)
        self._bus.call_later(TICK_S, _TICK)
        if self._leaving.lifetime_s is not None:
            self._bus.call_later(self._leaving.lifetime_s, _LIFETIME)

    def leave(self) -> None:
        """Ask, at the next tick, to be let go: what is computed here is handed over first. Signal handlers may call."""
        self._leaving.is_wanted = True

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
        self._bus.note(event)
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
                _LOG.info("warm-up", extra=fields(detail=item.sentence))
                self._beat()
            case WarmedUp():
                self._warmed_up(item)
            case WarmUpFailed():
                self._leave(AtollError(item.sentence))
            case JobReady() | Unloadable():
                if self._datasets.loaded(item.job):
                    self._tell(item)
            case Snapshot() | Computed() | Rejected() | Broken() | Abandoned():
                self._tell(item)

    @_on.register
    def _on_timer(self, event: Timer) -> None:
        if event.name == _BEAT:
            self._beat()
            self._bus.call_later(HEARTBEAT_S, _BEAT)
        elif event.name == _TICK:
            self._check_absence()
            if self._leaving.is_wanted:
                self._begin_leaving()
            self._tell(Tick(self._bus.now()))
            self._bus.call_later(TICK_S, _TICK)
        elif event.name == _LIFETIME:
            self._begin_leaving()
        elif event.name == _GRACE:
            _LOG.warning(
                "not let go in time; what was not committed is computed again",
                extra=fields(seconds=self._leaving.grace_s),
            )
            self.exit_code = 0
        elif event.name == _GREET:
            self._greet()
        elif event.name.startswith(_FETCH):
            self._datasets.fetch(event.name.removeprefix(_FETCH))

    @_on.register
    def _on_link(self, event: Link) -> None:
        if not event.up:
            self._joining.lost(self._bus.now())
            _LOG.warning("connection to the coordinator lost; waiting for it")
        else:
            self._greet()

    @_on.register
    def _on_presence(self, event: Presence) -> None:
        del event  # a worker watches nobody

    # ------------------------------------------------------------------------------------ coordinator

    def _greet(self) -> None:
        asked = Asked("hello", self._joining.fingerprint)
        self._voice.ask(topics.hello(self.name), self._joining.hello(), GREET_TIMEOUT_S, asked)

    def _greeted(self, fingerprint: str, payload: bytes | None) -> None:
        """Take in the answer to a greeting that carried `fingerprint` ("": kernels not ready yet)."""
        if payload is None:
            self._voice.ask(topics.HELLO, self._joining.hello(), GREET_TIMEOUT_S, Asked("enquiry"))
            self._bus.call_later(GREET_PAUSE_S, _GREET)
            return
        try:
            joined = self._joining.take(fingerprint, payload)
        except RefusedError as error:
            self._leave(error)
            return
        if joined.is_restart:
            _LOG.info("the coordinator started anew; what was held is dropped")
            self._tell(Reset(joined.incarnation))
            for job in self._datasets.jobs():
                if not self.session.wants(job):
                    self._forget_job(job)
        if joined.is_new_realm:
            self._listen()
        self._beat()
        if joined.greets_again:
            self._greet()

    def _listen(self) -> None:
        """Declare everything that a worker receives, answers and shows."""
        realm = self._joining.realm
        self._bus.subscribe(topics.control(realm))
        self._bus.subscribe(topics.control(realm, self.name))
        self._bus.subscribe(topics.inbox(realm, self.name))
        self._bus.serve(topics.worker(realm, self.name, "pull"))
        self._bus.announce(topics.worker(realm, self.name, "alive"))
        _LOG.info("joined", extra=fields(realm=realm))

    def _begin_leaving(self) -> None:
        """Say that this worker wants to end; it ends when it is told that nothing is left here, or after a while."""
        if self._joining.welcome is None or self._leaving.grace_s <= 0.0:
            self.exit_code = 0
        elif not self._leaving.has_begun:
            self._leaving.has_begun = True
            _LOG.info("leaving: what is computed here is handed over", extra=fields(at_most_s=self._leaving.grace_s))
            self._bus.call_later(self._leaving.grace_s, _GRACE)
            self._beat()

    def _state(self) -> WorkerState:
        if self._leaving.has_begun:
            return "leaving"
        return self.session.state() if self._joining.is_accepted else "compiling"

    def _beat(self) -> None:
        welcome = self._joining.welcome
        if welcome is None:
            return
        status = WorkerStatus(
            instance=self._joining.instance,
            incarnation=welcome.incarnation,
            state=self._state(),
            progress=self._compute.progress,
            holdings=self.session.holdings(),
            troubles=self.session.troubles(),
            jobs=tuple(dict.fromkeys((*self.session.jobs(), *self._datasets.jobs()))),
            detail=self._detail,
            doing=doing(self._compute.doing) if self._state() == "computing" else None,
            counters=counters(self._bus, self.session, self.rejects),
        )
        self._bus.put(topics.worker(welcome.realm, self.name, "status"), encode(status))

    def _enquired(self, payload: bytes) -> None:
        """Take in why our greeting may have remained without an answer."""
        try:
            self._joining.enquired(payload)
        except RefusedError as error:
            self._leave(error)

    def _warmed_up(self, item: WarmedUp) -> None:
        """Greet once more, now with the fingerprint; then say that islands can be computed here."""
        self._detail, self._joining.fingerprint = "", item.fingerprint
        _LOG.info("kernels ready", extra=fields(seconds=item.seconds, fingerprint=item.fingerprint))
        if self._joining.welcome is not None:
            self._greet()

    def _check_absence(self) -> None:
        """Leave when the coordinator has been away for longer than allowed."""
        absence = self._joining.absence(self._bus.now())
        if self._leaving.has_begun and absence > ALONE_S:
            self.exit_code = 0  # there is nobody to hand over to, and what was committed is not lost
        elif absence > self._wait_s:
            self._leave(UnreachableError(self._joining.silence(self._wait_s)))

    def _leave(self, error: AtollError) -> None:
        self.error, self.exit_code = error, error.exit_code

    def _on_control(self, body: JobAnnouncement | Placements | Commit | Close | Shutdown | Introduce) -> None:
        match body:
            case JobAnnouncement():
                self._datasets.announced(body)
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
            _LOG.info("this worker ends", extra=fields(reason=body.sentence or "the coordinator ended"))
            self.exit_code = 0

    # ---------------------------------------------------------------------------------------- datasets

    def ask_announcement(self, job: str) -> None:
        """See `Asker.ask_announcement`."""
        self._voice.ask(topics.job(self._joining.realm, job), b"", PULL_TIMEOUT_S, Asked("job", job))

    def ask_chunk(self, job: str, blob: str, index: int) -> None:
        """See `Asker.ask_chunk`."""
        self._voice.ask(topics.blob(self._joining.realm, blob, index), b"", FETCH_TIMEOUT_S, Asked("chunk", job, index))

    def ask_later(self, job: str) -> None:
        """See `Asker.ask_later`."""
        self._bus.call_later(FETCH_PAUSE_S, _FETCH + job)

    def wants(self, job: str) -> bool:
        """See `Asker.wants`."""
        return self.session.wants(job)

    def load(self, announcement: JobAnnouncement, data: bytes) -> None:
        """See `Asker.load`."""
        weight = 2.0**announcement.priority
        self._compute.load(announcement.job, announcement.config, data, weight)

    def _forget_job(self, job: str) -> None:
        if self._datasets.forget(job):
            self._compute.discard_job(job)

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
        asked = self._voice.answered(event.token)
        match asked:
            case Asked("hello"):
                self._greeted(asked.subject, event.payload)
            case Asked("enquiry") if event.payload is not None:
                self._enquired(event.payload)
            case Asked("job"):
                self._datasets.announcement_came(asked.subject, event.payload)
            case Asked("chunk"):
                self._datasets.chunk_came(asked.subject, asked.index, event.payload)
            case Asked("placement"):
                if event.payload is not None:
                    self._on_control(decode(event.payload, Control, MAX_MESSAGE).body)
                self.session.forget_early(asked.subject)
            case Asked("states", states=PullStates() as pull):
                self._states_came(pull, event.payload)
            case Asked("pull") if event.payload is not None:
                self._tell(PullAnswered(asked.subject, decode(event.payload, PullAnswer, MAX_MESSAGE).body))

    def _states_came(self, pull: PullStates, payload: bytes | None) -> None:
        """Hand on what came, also that nothing came: it is asked for again."""
        try:
            body = decode(payload, PullAnswer, MAX_MESSAGE).body if payload is not None else None
        except RemoteProtocolError:
            self._tell(StatesCame(pull, None))
            raise
        self._tell(StatesCame(pull, body if isinstance(body, States) else None))

    def _check_realm(self, realm: str) -> None:
        if realm != self._joining.realm:
            raise RemoteProtocolError(f"a message of realm {realm} came, which is not ours")

    # ------------------------------------------------------------------------------------------ actions

    def _tell(self, event: SessionEvent) -> None:
        now = self._bus.now()
        self.session.elapse(now - self._told_at)
        self._told_at = now
        for action in self.session.handle(event):
            self._act(action)

    def _act(self, action: Action) -> None:
        match action:
            case ComputeTask():
                self._compute.advance(action.task)
            case StopAt():
                self._compute.stop_at(action.share, action.hit, action.course)
            case Discard():
                self._compute.discard(action.share)
            case DiscardJob():
                self._forget_job(action.job)
            case FetchJob():
                self._datasets.fetch(action.job)
            case Beat():
                self._beat()
            case _:
                self._voice.say(self._joining.realm, action)


OnSignal = Callable[[Callable[[], None]], AbstractContextManager[None]]


def run_worker(connect: str | Destination, name: str, wait_s: float, leaving: Leaving, on_signal: OnSignal) -> int:
    """Join the coordinator at `connect` as worker `name` and work until it ends or lets us go; return the exit code.

    Kernels are made ready while the connection is still being sought. `wait_s` limits both the first connection and
    any later absence of the coordinator. `on_signal` has a function called when this process is told to end.

    Raises:
        UnreachableError: The coordinator was not there, or stayed away.
        RefusedError: It refused this worker, for instance because of its version or its certificate.
    """
    from common.wire.zenoh_bus import open_client

    compute = IslandCompute()
    compute.warm_up()
    try:
        with open_client(connect, wait_s=wait_s) as bus:
            worker = Worker(bus, compute, name, wait_s, leaving)
            with on_signal(worker.leave):
                code = worker.run()
            if worker.error is not None:
                raise worker.error
            return code
    finally:
        compute.close()
