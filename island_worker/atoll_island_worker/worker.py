"""A worker at work: the only loop. Bus events go to the session, its actions to the bus and the compute thread.

`Worker.step` takes one event and never blocks; `Worker.run` is the thin loop around `Bus.receive`; `run_worker` is what
the command line calls.
"""

import logging
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import singledispatchmethod
from typing import Final

from atoll.errors import AtollError, RemoteProtocolError
from atoll.logs import fields
from atoll.wire import topics
from atoll.wire.addresses import Destination
from atoll.wire.bus.interface import Bus, Event, Link, Message, Posted, Presence, Query, Reply, Timer
from atoll.wire.bus.metered_bus import MeteredBus
from atoll.wire.codec import decode, encode
from atoll.wire.messages.limits import MAX_MESSAGE
from atoll.wire.messages.views import WorkerState
from atoll.wire.messages.workers import (
    Close,
    CloseJob,
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
from atoll.wire.rejects import Rejects
from atoll_island_worker.compute.compute import Compute, ComputeFailed, IslandCompute, WarmedUp, WarmUpNote
from atoll_island_worker.connection.connection import GRACE, GREET, LIFETIME, Attendance
from atoll_island_worker.connection.drain import Leaving
from atoll_island_worker.connection.heartbeat import counters, doing
from atoll_island_worker.connection.requests import FETCH_TIMEOUT_S, PULL_TIMEOUT_S, Asked, Voice
from atoll_island_worker.datasets import Datasets
from atoll_island_worker.session.actions import Action, Beat, Discard, DiscardJob, FetchJob, StopAt
from atoll_island_worker.session.actions import Compute as ComputeTask
from atoll_island_worker.session.events import (
    Abandoned,
    Broken,
    Closed,
    Committed,
    Computed,
    JobClosed,
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
from atoll_island_worker.session.session import Session

_LOG = logging.getLogger(__name__)

HEARTBEAT_S: Final = 1.0
TICK_S: Final = 0.5
FETCH_PAUSE_S: Final = 0.5

_BEAT: Final = "heartbeat"
_TICK: Final = "tick"
_FETCH: Final = "fetch/"


class Worker:
    """One worker process on one bus. Owned by the bus's owner thread."""

    def __init__(self, bus: Bus, compute: Compute, name: str, wait_s: float, leaving: Leaving | None = None) -> None:
        """Set up a worker whose `compute` warms up elsewhere; `wait_s`: how long the coordinator may be away."""
        self.name: Final = name
        self.session = Session(name)
        self.rejects = Rejects(_LOG)
        self._bus = MeteredBus(bus)
        self._told_at = bus.now()
        self._compute = compute
        self._datasets = Datasets(self)
        self._detail = "loading kernels"
        self._voice = Voice(self._bus, name)
        self._attendance = Attendance(self._bus, self._voice, name, wait_s, leaving or Leaving())

    @property
    def exit_code(self) -> int | None:
        """How this worker ends; None while it does not."""
        return self._attendance.exit.code

    @property
    def error(self) -> AtollError | None:
        """Why it ends, when that is an error."""
        return self._attendance.exit.error

    # ------------------------------------------------------------------------------------------- life

    def start(self) -> None:
        """Begin: greet the coordinator, start the timers."""
        self._compute.attach(self._bus.post)
        self._attendance.start()
        self._bus.call_later(HEARTBEAT_S, _BEAT)
        self._bus.call_later(TICK_S, _TICK)

    def leave(self) -> None:
        """Ask, at the next tick, to be let go: what is computed here is handed over first. Signal handlers may call."""
        self._attendance.ask_to_leave()

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
            case ComputeFailed():
                self._attendance.exit.because_of(AtollError(item.sentence))
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
            self._attendance.check_absence()
            if self._attendance.is_to_leave:
                self._begin_leaving()
            self._tell(Tick(self._bus.now()))
            self._bus.call_later(TICK_S, _TICK)
        elif event.name == LIFETIME:
            self._begin_leaving()
        elif event.name == GRACE:
            self._attendance.out_of_grace()
        elif event.name == GREET:
            self._attendance.greet()
        elif event.name.startswith(_FETCH):
            self._datasets.fetch(event.name.removeprefix(_FETCH))

    @_on.register
    def _on_link(self, event: Link) -> None:
        if event.up:
            self._attendance.greet()
        else:
            self._attendance.lost()

    @_on.register
    def _on_presence(self, event: Presence) -> None:
        del event  # a worker watches nobody

    # ------------------------------------------------------------------------------------ coordinator

    def _greeted(self, fingerprint: str, payload: bytes | None) -> None:
        """Take in the answer to a greeting: what a former coordinator had placed here is void."""
        joined = self._attendance.greeted(fingerprint, payload)
        if joined is None:
            return
        if joined.is_restart:
            self._tell(Reset(joined.incarnation))
            for job in self._datasets.jobs():
                if not self.session.wants(job):
                    self._forget_job(job)
        self._beat()
        if joined.greets_again:
            self._attendance.greet()

    def _begin_leaving(self) -> None:
        """Say that this worker wants to end; it ends when it is told that nothing is left here, or after a while."""
        if self._attendance.begin_leaving():
            self._beat()

    def _state(self) -> WorkerState:
        if self._attendance.is_leaving:
            return "leaving"
        return self.session.state() if self._attendance.is_accepted else "compiling"

    def _beat(self) -> None:
        incarnation = self._attendance.incarnation
        if incarnation is None:
            return
        state = self._state()
        status = WorkerStatus(
            instance=self._attendance.instance,
            incarnation=incarnation,
            state=state,
            progress=self._compute.progress,
            holdings=self.session.holdings(),
            troubles=self.session.troubles(),
            jobs=tuple(dict.fromkeys((*self.session.jobs(), *self._datasets.jobs()))),
            detail=self._detail,
            doing=doing(self._compute.doing) if state == "computing" else None,
            counters=counters(self._bus, self.session, self.rejects),
        )
        self._bus.put(topics.worker(self._attendance.realm, self.name, "status"), encode(status))

    def _warmed_up(self, item: WarmedUp) -> None:
        """Say that islands can be computed here."""
        self._detail = ""
        _LOG.info("kernels ready", extra=fields(seconds=item.seconds, fingerprint=item.fingerprint))
        self._attendance.kernels_ready(item.fingerprint)

    def _on_control(
        self, body: JobAnnouncement | Placements | Commit | Close | CloseJob | Shutdown | Introduce
    ) -> None:
        match body:
            case JobAnnouncement():
                self._datasets.announced(body)
            case Placements():
                for placement in body.placements:
                    self._tell(Placed(placement))
            case Commit():
                self._tell(Committed(body))
            case Close():
                self._tell(Closed(body))
            case CloseJob():
                self._tell(JobClosed(body.job))  # first the islands, then what they are computed from
                self._forget_job(body.job)
            case Shutdown():
                self._attendance.shut_down(body)
            case Introduce():
                self._attendance.greet()

    # ---------------------------------------------------------------------------------------- datasets

    def ask_announcement(self, job: str) -> None:
        """See `Asker.ask_announcement`."""
        self._voice.ask(topics.job(self._attendance.realm, job), b"", PULL_TIMEOUT_S, Asked("job", job))

    def ask_chunk(self, job: str, blob: str, index: int) -> None:
        """See `Asker.ask_chunk`."""
        self._voice.ask(
            topics.blob(self._attendance.realm, blob, index), b"", FETCH_TIMEOUT_S, Asked("chunk", job, index)
        )

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
                self._attendance.enquired(event.payload)
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
        if realm != self._attendance.realm:
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
                self._voice.say(self._attendance.realm, action)


OnSignal = Callable[[Callable[[], None]], AbstractContextManager[None]]


def run_worker(connect: str | Destination, name: str, wait_s: float, leaving: Leaving, on_signal: OnSignal) -> int:
    """Join the coordinator at `connect` as worker `name` and work until it ends or lets us go; return the exit code.

    Kernels are made ready while the connection is still being sought. `wait_s` limits both the first connection and
    any later absence of the coordinator. `on_signal` has a function called when this process is told to end.

    Raises:
        UnreachableError: The coordinator was not there, or stayed away.
        RefusedError: It refused this worker, for instance because of its version or its certificate.
    """
    from atoll.wire.bus.zenoh_bus import open_client

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
