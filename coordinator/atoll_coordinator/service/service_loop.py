"""The only loop of the coordinator: passes events of the bus to the job controller and the request dispatcher.

`Service.step` handles one event and never blocks for long; `Service.work` is the loop around `Bus.receive`.
"""

import gc
import logging
import threading
import time
from collections import Counter as Tally
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import singledispatchmethod
from typing import Final, cast

from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.monitoring.event_log import WorkerLogs
from atoll_coordinator.service.monitoring.followers import Followers
from atoll_coordinator.service.monitoring.metrics import LAG_S, MAX_USERS, UPDATE_S, Metrics
from atoll_coordinator.service.monitoring.view_equations import FrontWritten
from atoll_coordinator.service.requests.authorization import Authorization
from atoll_coordinator.service.requests.clients import ClientRequests
from atoll_coordinator.service.requests.deletion import JobDeletion
from atoll_coordinator.service.requests.dispatch import RequestDispatcher
from atoll_coordinator.service.requests.waiting import (
    QUESTIONS,
    Deferred,
    DeferredQuestions,
    FrontOf,
    NotYetError,
    ResultOf,
)
from atoll_coordinator.service.scheduling.limits import Limits
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.tasks.background import Background, Dependencies, Outcome, ResultComposed, ResultRead
from atoll_coordinator.service.workers.channel import WorkerChannel
from atoll_coordinator.service.workers.membership import ABSENCE_S
from atoll_core import VERSION
from atoll_core.errors import RemoteProtocolError, StoreError
from atoll_core.logs import fields
from atoll_core.machine import memory_bytes
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Bus, Event, Link, Message, Posted, Presence, Query, Reply, Timer
from atoll_core.wire.bus.metered_bus import MeteredBus
from atoll_core.wire.bus.queues import Turns
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.clients import Answer, Failure, ResultText
from atoll_core.wire.messages.epochs import (
    EpochReport,
    PullAnswer,
    PullReports,
    PullStates,
    Reports,
    States,
)
from atoll_core.wire.messages.limits import MAX_MESSAGE
from atoll_core.wire.messages.tasks import TaskReport
from atoll_core.wire.messages.views import CoordinatorView, Counters, EventKind, JobState, UserView, Workforce
from atoll_core.wire.messages.workers import Shutdown, WorkerLog, WorkerStatus
from atoll_core.wire.rejects import Rejects
from atoll_core.wire.security.roles import RoleBindings

_LOG = logging.getLogger(__name__)

TICK_S: Final = 0.5
_TICK: Final = "tick"

LAG_WINDOW_S: Final = 60.0
"""The view of the coordinator shows the longest lag of the loop within this number of seconds."""

_ABSENCE: Final = "absence"
_CHANGES: Final = "changes"
_PROBE: Final = "probe"


@dataclass(frozen=True, slots=True)
class _TimeCheck:
    """Posted by the timer. The loop first handles all earlier events, and then checks the silence of workers."""


@dataclass(frozen=True, slots=True)
class _Turn:
    """Posted while questions of clients wait: the loop then answers one question."""


@dataclass(frozen=True, slots=True)
class _Probe:
    """Posted by a timer to measure the lag of the loop."""


class Service:
    """One coordinator on one bus, with one store. Only the thread that owns the bus may call it."""

    def __init__(  # noqa: PLR0913  # the outside world
        self,
        bus: Bus,
        store: Store,
        *,
        expected_workers: int = 1,
        dismisses_workers: bool = False,
        dependencies: Dependencies | None = None,
        role_bindings: RoleBindings | None = None,
        metrics: Metrics | None = None,
    ) -> None:
        """Set up a coordinator.

        Args:
            bus: An open bus, with a router that workers and clients can reach.
            store: An open store; its file determines cluster and incarnation.
            expected_workers: Number of workers for which the first placement waits, for a limited time.
            dismisses_workers: Whether workers are shut down at the end; otherwise they wait for another coordinator.
            dependencies: Clock, retention, background thread; None: the real ones.
            role_bindings: Names and roles, if certificates are used; None: every client has all permissions.
            metrics: The metrics for Prometheus; None: no metrics are recorded.
        """
        self.rejects: Final = Rejects(_LOG)
        self._bus = MeteredBus(bus)
        self._began_at = bus.now()
        self._dropped = 0
        self._store = store
        self._dismisses_workers = dismisses_workers
        dependencies = dependencies or Dependencies()
        self._questions = Turns[tuple[Query, str]](QUESTIONS)
        self._is_turn_posted = False
        self._deferred = DeferredQuestions[tuple[Query, str]]()
        self._is_linked = True
        self._workers = WorkerChannel(self._bus, store.cluster)
        background = Background(dependencies.background, store, self._bus.post)
        self.controller: Final = JobController(
            store, self._workers, background, self._bus.post, dependencies.clock, expected_workers
        )
        self._authorization = authorization = Authorization(role_bindings, store)
        self._worker_logs = WorkerLogs(self.controller.events)
        self._deletion = JobDeletion(self.controller, store, dependencies.retention)
        self._followers = Followers(
            store.incarnation, self.controller.shown, self.controller.events, self._workforce,
            lambda client, payload: self._bus.put(topics.client(store.cluster, client, "changes"), payload),
        )  # fmt: skip
        self.controller.changed, self.controller.events.on_event = self._note_change, self._note_event
        self._metrics = metrics
        self._probe_due = self._metrics_due = self._tick_due = bus.now()
        self._lags: deque[float] = deque(maxlen=round(LAG_WINDOW_S / TICK_S))
        self._clients = clients = ClientRequests(
            self.controller, store, authorization, self._deletion, bus.now, self.view, self._followers
        )
        self._uploads = clients.uploads
        self._requests = RequestDispatcher(
            self.controller, store, authorization, clients, self.rejects, bus.now, dependencies.clock
        )

    # ------------------------------------------------------------------------------------------- life

    def start(self) -> None:
        """Continue the stored jobs, then listen."""
        cluster = self._store.cluster
        self.controller.recover(self._bus.now())
        self._uploads.delete_all()
        self._bus.subscribe(topics.all_workers(cluster, "status"))
        self._bus.subscribe(topics.all_workers(cluster, "report"))
        self._bus.subscribe(topics.all_workers(cluster, "result"))
        self._bus.subscribe(topics.all_workers(cluster, "log"))
        self._bus.watch(topics.all_workers(cluster, "alive"))
        for expression in (topics.all_states(cluster), topics.all_blobs(cluster), topics.all_clients(cluster)):
            self._bus.serve(expression)
        for expression in (topics.HELLO, topics.ALL_GREETINGS):
            self._bus.serve(expression)
        self._bus.post(_TimeCheck())  # stored jobs are prepared at once
        self._tick_later()
        if self._metrics is not None:
            self._probe_later()
        self.controller.events.record(
            "started", "the coordinator is ready", realm=cluster, incarnation=self._store.incarnation
        )

    def run(self, stop: threading.Event) -> None:
        """Start, and work until `stop` is set."""
        self.start()
        self.work(stop)

    def wake(self) -> None:
        """Let a loop that waits for events check at once whether it should stop. From any thread."""
        self._bus.post(_TimeCheck())

    def set_policy(self, limits: Limits, role_bindings: RoleBindings | None) -> None:
        """Apply new limits and roles; workers that may no longer take part are shut down and treated as lost.

        A router keeps its access rules until it is restarted, so new names are admitted only after that.
        """
        self.controller.queue.limits = limits
        self._authorization.role_bindings = role_bindings
        for view in self.controller.workers.membership.views(self._bus.now()):
            refusal = self._authorization.refuse_worker(view.worker)
            if refusal is not None:
                self._workers.send(view.worker, Shutdown(sentence=refusal, refused=True))
                self.controller.workers.send_away(view.worker, refusal, self._bus.now())
        self._clients.check_followers()
        self._bus.post(_TimeCheck())

    def work(self, stop: threading.Event, between: Callable[[], object] = lambda: None) -> None:
        """Work until `stop` is set; `between` is called between events, several times a second.

        The garbage collector leaves out the objects that exist now, mostly modules: to visit them all takes 0.1 s, in
        which no event is handled.
        """
        gc.freeze()
        while not stop.is_set():
            between()
            event = self._bus.receive(0.1)
            if event is not None:
                self.step(event)
        self.controller.events.flush()
        if self._dismisses_workers:
            self._workers.publish(Shutdown(sentence="the coordinator ended"))

    def step(self, event: Event) -> None:
        """Handle one event. Only a StoreError ends the loop.

        A wrong message of a peer is counted, logged once and changes nothing. An internal error is counted, logged once
        and ends the job that it concerns; a client that asked gets an answer.
        """
        began = time.perf_counter()
        with self.controller.breakages.tolerated("counting an event"):
            self._bus.count_received(event)
        with self.controller.breakages.tolerated(f"handling an event ({type(event).__name__})"):
            try:
                self._on(event)
            except RemoteProtocolError as error:
                if isinstance(event, Timer | Posted | Link):  # these do not come from a peer
                    raise
                self.rejects.count(event.key if isinstance(event, Message | Query | Presence) else "answer", error)
        with self.controller.breakages.tolerated("notifying followers"):
            next_s = self._followers.notify(self._bus.now())
            if next_s is not None:  # some changes are due later
                self._bus.call_later(next_s, _CHANGES)
        if self._metrics is not None:
            self._metrics.observe_step(time.perf_counter() - began)

    def _note_change(self, job_id: str) -> None:
        self._followers.touch(job_id)
        if self._metrics is not None:
            job = self.controller.jobs.get(job_id)
            state, submitted_at = (job.state, job.submitted_at) if job is not None else (None, 0.0)
            self._metrics.note_state(job_id, state, submitted_at, self._bus.now())

    def _note_event(self, kind: EventKind, job_id: str | None) -> None:
        self._followers.touch(job_id)
        if self._metrics is not None:
            self._metrics.note_event(kind)

    def _tick_later(self) -> None:
        self._tick_due = self._bus.now() + TICK_S
        self._bus.call_later(TICK_S, _TICK)

    def _probe_later(self) -> None:
        """Measure the loop's lag: a probe waits in the queue like all other events."""
        self._probe_due = self._bus.now() + LAG_S
        self._bus.call_later(LAG_S, _PROBE)

    def _update_metrics(self, now: float) -> None:
        if self._metrics is None or now < self._metrics_due:
            return
        self._metrics_due = now + UPDATE_S
        members = self.controller.workers.membership.views(now)
        self._metrics.set_process(self.view(), self._store.size_bytes(), len(self._followers), self._questions.refused)
        self._metrics.set_dropped_lines(self._worker_logs.dropped)
        self._metrics.set_workers(member.state for member in members)
        depth = self.controller.queue_depth()
        self._metrics.set_jobs(self._jobs_by_user())
        tasks = tuple(self.controller.tasks.table)
        states: Tally[tuple[str, ...]] = Tally((task.function, task.state) for task in tasks)
        self._metrics.set_tasks(depth.tasks_ready, states, sum(len(task.helpers) for task in tasks))

    def _jobs_by_user(self) -> Tally[tuple[str | None, JobState]]:
        """Return the numbers of jobs that have not ended, by submitter and state."""
        counts: Tally[tuple[str | None, JobState]] = Tally(
            (job.submitter, job.state) for job in self.controller.begun.values()
        )
        counts.update({(user, "queued"): number for user, number in self.controller.queue.queued_by_user().items()})
        return counts

    def _user_views(self) -> tuple[UserView, ...]:
        """Return the users with the most unfinished jobs, the user with the most first."""
        queued, begun = Tally[str | None](), Tally[str | None]()
        for (user, state), number in self._jobs_by_user().items():
            (queued if state == "queued" else begun)[user] += number
        users = sorted({*queued, *begun}, key=lambda user: (-queued[user] - begun[user], user or ""))
        views = (UserView(user=user, queued=queued[user], begun=begun[user]) for user in users[:MAX_USERS])
        return tuple(view for view in views if view.queued or view.begun)

    def _workforce(self, now: float) -> Workforce:
        return Workforce.of(self.controller.workers.membership.views(now))

    def view(self) -> CoordinatorView:
        """Return the view of the coordinator itself."""
        counters = Counters(
            traffic=self._bus.traffic(),
            dropped=self._bus.dropped,
            refused=self.rejects.total,
            broken=self.controller.breakages.total,
            memory_bytes=memory_bytes(),
            cpu_s=time.process_time(),
        )
        return CoordinatorView(
            version=VERSION,
            incarnation=self._store.incarnation,
            seconds=self._bus.now() - self._began_at,
            counters=counters,
            store=self._store.timing(),
            queued=self.controller.queue.queued,
            under_way=self.controller.queue.under_way,
            paused=self.controller.queue.is_paused,
            lag_s=max(self._lags, default=0.0),
            users=self._user_views(),
        )

    # ----------------------------------------------------------------------------------------- events

    @singledispatchmethod
    def _on(self, event: Event) -> None:
        raise RemoteProtocolError(f"events of kind {type(event).__name__} are not expected")

    @_on.register
    def _on_timer(self, event: Timer) -> None:
        if event.name == _TICK:
            self._lags.append(max(0.0, self._bus.now() - self._tick_due))
            self._tick_later()
            self._bus.post(_TimeCheck())
        elif event.name == _ABSENCE:
            self._bus.post(_TimeCheck())
        elif event.name == _PROBE:
            self._bus.post(_Probe())

    @_on.register
    def _on_posted(self, event: Posted) -> None:
        item, now = event.item, self._bus.now()
        match item:
            case _TimeCheck():
                self._check_time(now)
            case _Turn():
                self._is_turn_posted = False  # if the turn fails, the next question posts another one
                self._take_turn()
            case _Probe() if self._metrics is not None:
                self._metrics.observe_lag(now - self._probe_due)
                self._probe_later()
            case _Probe():
                return
            case ResultRead():
                try:
                    self.controller.take_result(item, now)
                except RemoteProtocolError as error:
                    self.rejects.count("result", error)
            case ResultComposed() if item.draft.is_final:
                self._finish_ending(item, now)
            case ResultComposed():
                self._send_result(item, now)
            case FrontWritten():
                self.controller.take_outcome(item, now)
                self._reply_meanwhile(self._deferred.take(FrontOf(item.front.number)))
            case _:
                self.controller.take_outcome(cast(Outcome, item), now)

    def _finish_ending(self, item: ResultComposed, now: float) -> None:
        """Complete the end of a job, and answer the questions that waited for it."""
        job = item.draft.job
        try:
            self.controller.finish_ending(item, now)
        except StoreError as error:
            self._reply_deferred(job, Failure(failure="internal", sentence=str(error)[:4000]), is_final=True)
            raise
        if job not in self.controller.ending:
            for one in self._deferred.take(ResultOf(job, is_final=True)):
                self._answer(*one.question)

    def _send_result(self, item: ResultComposed, now: float) -> None:
        """Answer the questions that wait for the best result so far of a job."""
        body: ResultText | Failure
        try:
            body = ResultText(json_text=self.controller.finish_composing(item, now))
        except Exception as error:
            sentence = self.controller.breakages.add("composing a result", error)
            body = Failure(failure="internal", sentence=sentence)
        self._reply_deferred(item.draft.job, body, is_final=False)

    def _reply_deferred(self, job: str, body: ResultText | Failure, *, is_final: bool) -> None:
        answer = encode(Answer(body=body))
        for one in self._deferred.take(ResultOf(job, is_final)):
            question, party = one.question
            self._bus.reply(question, answer, party)

    def _reply_meanwhile(self, questions: list[Deferred[tuple[Query, str]]]) -> None:
        """Answer questions as the jobs are now."""
        for one in questions:
            body = one.meanwhile() if one.meanwhile is not None else None
            answer = encode(Answer(body=body)) if body is not None else None
            question, party = one.question
            self._bus.reply(question, answer, party)

    def _check_time(self, now: float) -> None:
        """Check all timeouts; all earlier events have been handled."""
        self._store.beat()
        if self._bus.dropped > self._dropped:
            self._dropped = self._bus.dropped
            _LOG.warning("messages were dropped because they came too fast", extra=fields(dropped=self._dropped))
            self.controller.workers.membership.renew_leases(now)
        if self._is_linked:  # otherwise no message of a worker can arrive, and silence does not mean a loss
            self.controller.tick(now)
        with self.controller.breakages.tolerated("updating followers"):
            self._followers.expire(now)
            self._followers.look(now)
        with self.controller.breakages.tolerated("setting metrics"):
            self._update_metrics(now)
        with self.controller.breakages.tolerated("answering questions that waited too long"):
            self._reply_meanwhile(self._deferred.take_overdue(now))
        with self.controller.breakages.tolerated("deleting abandoned uploads"):
            self._uploads.expire()
        with self.controller.breakages.tolerated("deleting expired jobs"):
            self._deletion.delete_expired(now)

    @_on.register
    def _on_link(self, event: Link) -> None:
        """Handle the loss or return of the link to the router; a router in this process is never lost."""
        _LOG.warning("router link", extra=fields(up=event.up))
        self._is_linked = event.up
        if event.up:
            self.controller.workers.membership.renew_leases(self._bus.now())

    @_on.register
    def _on_presence(self, event: Presence) -> None:
        key = topics.parse(event.key)
        if isinstance(key, topics.WorkerKey):
            self.controller.workers.membership.record_presence(key.worker, event.present, self._bus.now())
            if not event.present:
                self._bus.call_later(ABSENCE_S, _ABSENCE)

    @_on.register
    def _on_message(self, event: Message) -> None:
        key = topics.parse(event.key)
        match key:
            case topics.WorkerKey(part="status"):
                status = decode(event.payload, WorkerStatus, MAX_MESSAGE)
                self.controller.add_heartbeat(key.worker, status, self._bus.now())
            case topics.WorkerKey(part="log"):
                self._add_lines(key.worker, decode(event.payload, WorkerLog, MAX_MESSAGE))
            case topics.WorkerKey(part="report"):
                report = decode(event.payload, EpochReport, MAX_MESSAGE)
                # An error must end the job: without this report the job would wait for ever.
                with self.controller.guarded(report.job, "adding a report", self._bus.now(), by_peer=True):
                    self.controller.add_report(key.worker, report, self._bus.now())
            case topics.WorkerKey(part="result"):
                result = decode(event.payload, TaskReport, MAX_MESSAGE)
                self.controller.add_task_report(key.worker, result, self._bus.now())
            case _:
                raise RemoteProtocolError(f"no messages are expected on key {event.key}")

    @_on.register
    def _on_reply(self, event: Reply) -> None:
        asked = self._workers.take_pull(event.token)
        match asked:
            case (worker, PullStates() as pull):
                with self.controller.guarded(pull.job, "adding states", self._bus.now(), by_peer=True):
                    self._add_states(worker, pull, event.payload)
            case (worker, PullReports()) if event.payload is not None:
                body = decode(event.payload, PullAnswer, MAX_MESSAGE).body
                for report in body.reports if isinstance(body, Reports) else ():
                    with self.controller.guarded(report.job, "adding a report", self._bus.now(), by_peer=True):
                        self.controller.add_report(worker, report, self._bus.now())

    def _add_lines(self, worker: str, message: WorkerLog) -> None:
        """Record a worker's log lines with the jobs that they are about."""
        if self.controller.workers.membership.member(worker) is None:
            raise RemoteProtocolError(f"log lines came from the worker {worker}, which has not greeted")
        jobs = {line.job for line in message.lines if line.job is not None}
        known = {job for job in jobs if job in self.controller.jobs or self._store.job(job) is not None}
        self._worker_logs.take(worker, message, known, self._bus.now())

    def _add_states(self, worker: str, pull: PullStates, payload: bytes | None) -> None:
        """Pass an answer to the controller; without an answer the states are pulled again."""
        try:
            body = decode(payload, PullAnswer, MAX_MESSAGE).body if payload is not None else None
        except Exception:
            self.controller.add_states(worker, pull, None, self._bus.now())
            raise
        self.controller.add_states(worker, pull, body if isinstance(body, States) else None, self._bus.now())

    # ---------------------------------------------------------------------------------------- queries

    @_on.register
    def _on_query(self, event: Query) -> None:
        """Answer workers and greetings at once. Questions of clients wait for their turn; other events come between."""
        try:
            key = topics.parse(event.key)
        except RemoteProtocolError:
            self._bus.reply(event, None)
            raise
        if not isinstance(key, topics.ClientKey):
            self._answer(event, event.session)
            return
        party = self._party(key.client, event)
        if not self._questions.add(party, key.client, (event, party), len(event.payload)):
            self._bus.reply(event, None)
        else:
            self._post_turn()

    def _party(self, client: str, event: Query) -> str:
        """Return the party that takes turns with other parties: a user; if there are no certificates, a session."""
        return self._authorization.submitter(client) or f"/{event.session}"

    def _post_turn(self) -> None:
        """Let a question be answered after the events that have arrived; a turn that is posted already is enough."""
        if not self._is_turn_posted:
            self._is_turn_posted = True
            self._bus.post(_Turn())

    def _take_turn(self) -> None:
        """Answer one question. The next question comes after the events that have arrived meanwhile."""
        question = self._questions.take()
        if len(self._questions):
            self._post_turn()
        if question is not None:
            try:
                self._answer(*question)
            except RemoteProtocolError as error:
                self.rejects.count(question[0].key, error)

    def _answer(self, event: Query, party: str) -> None:
        try:
            answer = self._requests.answer(event)
        except RemoteProtocolError:
            self._bus.reply(event, None)
            raise
        except NotYetError as reason:
            if self._deferred.add((event, party), reason, self._bus.now()):
                return
            answer = encode(Answer(body=reason.meanwhile())) if reason.meanwhile is not None else None
        self._bus.reply(event, answer, party)
        if self._requests.store_error is not None:  # the client has its answer, and the coordinator ends
            raise self._requests.store_error
