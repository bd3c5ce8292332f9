"""The loop of a worker: passes events from the bus to the session, and its actions to bus and compute thread.

`Worker.step` handles one event and never blocks; `Worker.run` is the loop around `Bus.receive`; the command line calls
`run_worker`. All decisions are made in `session`, `connection`, `tasks` and `downloads`. Each of them owns its state;
this module is the only one that imports all of them and connects them.
"""

import logging
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Final

from atoll_core.compilation.progress import count_of
from atoll_core.errors import AtollError, RemoteProtocolError
from atoll_core.logs import fields
from atoll_core.machine import available_bytes, memory_bytes
from atoll_core.task_frames import ProcessMessage
from atoll_core.wire import topics
from atoll_core.wire.addresses import Destination
from atoll_core.wire.bus.interface import Bus, Event, Link, Message, Posted, Query, Reply, Timer
from atoll_core.wire.bus.metered_bus import MeteredBus
from atoll_core.wire.codec import decode
from atoll_core.wire.messages import epochs
from atoll_core.wire.messages import tasks as task_messages
from atoll_core.wire.messages import workers as messages
from atoll_core.wire.messages.limits import MAX_MESSAGE
from atoll_core.wire.messages.views import Counters, WorkerState
from atoll_core.wire.rejects import Rejects
from atoll_island_worker import connection as timers
from atoll_island_worker.compute.compute_thread import ComputeFailed, ComputeThread, WarmedUp, WarmUpNote
from atoll_island_worker.connection import GRACE_S, START_S, CoordinatorConnection, PendingRequest, Requests
from atoll_island_worker.downloads import Datasets, Downloads
from atoll_island_worker.job_logs import JobLogs
from atoll_island_worker.session import interface as io
from atoll_island_worker.session.worker_session import Session
from atoll_island_worker.tasks.task_process import Starter, TaskProcess
from atoll_island_worker.tasks.task_runner import TaskRunner

_LOG = logging.getLogger(__name__)

HEARTBEAT_S: Final = 1.0
TICK_S: Final = 0.5

_HEARTBEAT: Final = "heartbeat"
_TICK: Final = "tick"


class Worker:
    """One worker process on one bus. Only the thread that owns the bus may call its methods."""

    def __init__(  # noqa: PLR0913  # one caller, which hands on the options of the command line
        self,
        bus: Bus,
        compute: ComputeThread,
        name: str,
        wait_s: float | None = None,
        lifetime_s: float | None = None,
        grace_s: float = GRACE_S,
        task_process: TaskProcess | None = None,
        logs: JobLogs | None = None,
    ) -> None:
        """Set up a worker; its caller warms up `compute`. The times are as in `CoordinatorConnection`.

        `task_process` runs tasks; by default it starts a new interpreter. `logs` has the log lines for the coordinator.
        """
        self.name: Final = name
        self.session = Session(name)
        self.rejects = Rejects(_LOG)
        self._bus = MeteredBus(bus)
        self._last_event_at = bus.now()
        self._compute = compute
        self._requests = Requests(self._bus, name)
        self._datasets = Datasets(compute)
        self._downloads = Downloads(self._requests.ask_chunk, self._bytes_came)
        self._task_process = task_process or TaskProcess()
        self._tasks = TaskRunner(self._requests, self._task_process, self._bus.reply, bus.now)
        self._connection = CoordinatorConnection(self._bus, self._requests, name, wait_s, lifetime_s, grace_s)
        self._is_drain_requested = False
        self._detail = "loading kernels"
        self._logs = logs

    @property
    def exit_code(self) -> int | None:
        """The exit code when this worker ends; None while it runs."""
        return self._connection.exit_code

    @property
    def error(self) -> AtollError | None:
        """The error with which this worker ends, if any."""
        return self._connection.error

    # ------------------------------------------------------------------------------------------- loop

    def start(self) -> None:
        """Greet the coordinator; start the timers."""
        self._compute.attach(self._bus.post)
        self._task_process.attach(self._bus.post)
        self._connection.start()
        self._bus.call_later(HEARTBEAT_S, _HEARTBEAT)
        self._bus.call_later(TICK_S, _TICK)

    def leave(self) -> None:
        """Drain from the next tick on: hand over the islands computed here, then end. Signal handlers may call this."""
        self._is_drain_requested = True

    def run(self) -> int:
        """Work until the coordinator ends, refuses this worker or is away too long; return the exit code."""
        self.start()
        try:
            while self.exit_code is None:
                event = self._bus.receive(1.0)
                if event is not None:
                    self.step(event)
        finally:
            self._tasks.close()
        return self.exit_code

    def step(self, event: Event) -> None:
        """Handle one event. An invalid message of a peer is counted, logged once, and has no other effect."""
        if self.exit_code is not None:
            return
        self._bus.count_received(event)
        try:
            match event:
                case Posted():
                    self._on_posted(event.item)
                case Timer():
                    self._on_timer(event.name)
                case Link():
                    if event.up:
                        self._connection.greet()
                    else:
                        self._connection.link_lost()
                case Message():
                    self._on_message(event)
                case Query():
                    self._on_query(event)
                case Reply():
                    self._on_reply(event)
                case _:
                    raise RemoteProtocolError(f"events of kind {type(event).__name__} are not expected here")
        except RemoteProtocolError as error:
            self.rejects.count(event.key if isinstance(event, Message | Query) else "answer", error)

    def _on_posted(self, item: object) -> None:  # noqa: C901  # a table of messages of threads
        match item:
            case WarmUpNote():
                done, kernels = count_of(item.sentence) or (0, 0)
                is_new = (done, kernels) != count_of(self._detail)  # otherwise only the remaining time has changed
                self._detail = item.sentence
                level = logging.INFO if is_new and done in (0, kernels) else logging.DEBUG
                _LOG.log(level, "warm-up", extra=fields(detail=item.sentence))
                self._send_heartbeat()
            case WarmedUp():
                self._detail = ""
                _LOG.info("kernels ready", extra=fields(seconds=item.seconds, fingerprint=item.fingerprint))
                self._connection.kernels_ready(item.fingerprint)
            case ComputeFailed():
                self._connection.fail(AtollError(item.sentence))
            case ProcessMessage():
                if self._tasks.handle_process_message(item):
                    self._send_heartbeat()
            case io.AnnounceHit():
                if not self.session.has_reported(item.shard, item.epoch):
                    self._send_heartbeat()
            case io.JobReady() | io.LoadFailed():
                if self._datasets.finish_loading(item.job):
                    if isinstance(item, io.JobReady):
                        _LOG.info("data are loaded", extra=fields(job=item.job))
                    else:
                        _LOG.error("data cannot be read", extra=fields(job=item.job, reason=item.sentence))
                    self._handle(item)
            case io.Snapshot() | io.EpochComputed() | io.Rejected() | io.Broken() | io.Abandoned():
                if isinstance(item, io.Broken):
                    key = item.key
                    where = {"variable": key.variable, "island": key.island, "epoch": key.epoch, "term": key.term}
                    _LOG.error("an island failed", extra=fields(job=key.job, **where, reason=item.sentence))
                self._handle(item)

    def _on_timer(self, name: str) -> None:
        if name == _HEARTBEAT:
            self._send_heartbeat()
            self._bus.call_later(HEARTBEAT_S, _HEARTBEAT)
        elif name == _TICK:
            self._connection.check_absence()
            if self._is_drain_requested:
                self._drain()
            if self._tasks.is_idle:
                self._task_process.stop_if_idle()
            self._handle(io.Tick())
            self._fetch()
            self._bus.call_later(TICK_S, _TICK)
        elif name == timers.LIFETIME:
            self._drain()
        elif name == timers.GRACE:
            self._connection.grace_over()
        elif name == timers.GREET:
            self._connection.greet()

    def _on_message(self, event: Message) -> None:
        key = topics.parse(event.key)
        if not isinstance(key, topics.ControlKey):
            raise RemoteProtocolError(f"nothing is expected on key {event.key}")
        if key.cluster != self._requests.cluster:
            raise RemoteProtocolError(f"a message of cluster {key.cluster} came, but this worker is not in it")
        self._on_control(decode(event.payload, messages.Control, MAX_MESSAGE).body)

    def _on_query(self, event: Query) -> None:
        try:
            body = decode(event.payload, epochs.Pull, MAX_MESSAGE).body
        except RemoteProtocolError:
            self._bus.reply(event, None)
            raise
        if isinstance(body, task_messages.PullBatch):
            self._tasks.batch_asked(event, body)
        else:
            self._handle(io.PullAsked(event, body))

    def _on_reply(self, event: Reply) -> None:  # a table of requests
        request, payload = self._requests.pop(event.token), event.payload
        is_of_peer = request is None or request.question == "batch" or (request.pull and request.pull.peer)
        if payload is not None and not is_of_peer:
            self._connection.coordinator_heard()
        match request:
            case PendingRequest("hello"):
                self._on_greeting_answer(request, payload)
            case PendingRequest("enquiry"):
                self._connection.handle_enquiry(payload)
            case PendingRequest("chunk"):
                if self._downloads.chunk_came(request.subject, request.index, payload):
                    self._fetch()
            case PendingRequest("batch"):
                self._tasks.batch_came(request.subject, payload)
            case PendingRequest("pull", pull=io.SendPull() as asked):
                body: object = None  # without an answer the request is repeated
                try:
                    body = decode(payload, epochs.PullAnswer, MAX_MESSAGE).body if payload is not None else None
                finally:
                    answer = body if isinstance(body, epochs.Migrants | epochs.States) else None
                    has_timed_out = payload is None and self._bus.now() >= request.deadline
                    self._handle(io.PullEnded(asked, answer, has_timed_out))

    def _fetch(self) -> None:
        """Request missing chunks of datasets and of inputs of tasks."""
        self._downloads.fetch({**self._datasets.wanted(), **self._tasks.wanted()})

    def _bytes_came(self, digest: str, data: bytes) -> None:
        self._datasets.arrived(digest, data)
        self._tasks.arrived(digest, data)

    # -------------------------------------------------------------------------------------- coordinator

    def _on_control(self, body: messages.ControlBody) -> None:
        self._connection.coordinator_heard()
        match body:
            case messages.JobAnnouncement():
                self._datasets.announced(body)
                self._fetch()
            case messages.Placements():
                for placement in body.placements:
                    self._connection.incarnation_heard(placement.incarnation)
                    if islands := len(placement.islands_of(self.name)):
                        where = {"variable": placement.variable, "term": placement.term, "islands": islands}
                        _LOG.info("islands are placed here", extra=fields(job=placement.job, **where))
                    self._handle(placement)
            case messages.Commit() | messages.Close():
                self._handle(body)
            case messages.CloseJob():
                self._handle(body)  # first the islands, then their dataset
                self._datasets.forget(body.job)
            case task_messages.Lease() | task_messages.Help() | task_messages.Release():
                self._tasks.handle(body)
                self._fetch()
                self._send_heartbeat()
            case messages.Shutdown():
                self._connection.shut_down(body)
            case messages.Reregister():
                self._connection.greet()

    def _on_greeting_answer(self, request: PendingRequest, payload: bytes | None) -> None:
        """Handle the answer to a greeting: placements of a former coordinator are void."""
        reset = self._connection.handle_answer(request.subject, payload, request.index)
        if reset is not None:
            self._handle(reset)
            if not reset.incarnation:
                self._tasks.reset()  # with another store, the leases are also void
            for job in self._datasets.jobs():
                if not self.session.wants(job):
                    self._datasets.forget(job)
        if payload is not None and self.exit_code is None:
            self._send_heartbeat()

    def _drain(self) -> None:
        """End this worker as soon as the coordinator confirms that no work remains here, or after the grace period."""
        if self._connection.drain():
            self._send_heartbeat()

    # ---------------------------------------------------------------------------------------- session

    def _send_heartbeat(self) -> None:
        """Report holdings, computations, failures and costs to the coordinator, once it has welcomed this worker."""
        connection, session, task = self._connection, self.session, self._compute.current
        if connection.welcome is None:
            return
        state: WorkerState = session.state() if connection.is_accepted else "compiling"
        if connection.is_draining:
            state = "leaving"
        doing = None
        if task is not None and state == "computing":
            doing = messages.Doing(job=task.job, variable=task.variable, island=task.island, epoch=task.epoch)
        counters = Counters(
            traffic=self._bus.traffic(),
            dropped=self._bus.dropped,
            refused=self.rejects.total,
            duplicates=session.duplicates,
            waited_s=session.waited_s,
            memory_bytes=memory_bytes(),
            cpu_s=time.process_time(),
        )
        status = messages.WorkerStatus(
            instance=connection.instance,
            incarnation=connection.welcome.incarnation,
            state=state,
            progress=self._compute.progress,
            holdings=session.assignment_statuses(),
            failures=session.failures(),
            jobs=self._datasets.jobs(),
            detail=self._detail,
            doing=doing,
            tasks=self._tasks.statuses(),
            is_loaded=self._tasks.is_loaded,
            computed=tuple(
                messages.ComputedTime(submitter=user or None, seconds=seconds)
                for user, seconds in self._compute.seconds.items()
            ),
            available_bytes=available_bytes(),
            counters=counters,
        )
        self._requests.publish("status", status)
        log = self._logs.take() if self._logs is not None else None
        if log is not None:
            self._requests.publish("log", log)

    def _handle(self, event: io.SessionEvent) -> None:
        """Pass an event to the session, and carry out the session's actions."""
        now = self._bus.now()
        self.session.elapse(now - self._last_event_at)
        self._last_event_at = now
        for action in self.session.handle(event):
            match action:
                case io.RunTask():
                    self._compute.run(action.task)
                case io.StopAt():
                    self._compute.stop_at(action.shard, action.hit, action.commit_order)
                case io.Discard():
                    self._compute.discard(action.shard)
                case io.SendHeartbeat():
                    self._send_heartbeat()
                case io.AnnounceHit():
                    self._bus.post(action)  # outcomes that are waiting already are handled first
                case _:
                    self._requests.send(action)


OnSignal = Callable[[Callable[[], None]], AbstractContextManager[None]]


def run_worker(  # noqa: PLR0913  # one caller, which hands on the options of the command line
    connect: str | Destination, name: str, wait_s: float | None, lifetime_s: float | None, grace_s: float,
    on_signal: OnSignal, show: Callable[[str], None] | None = None, tasks: Starter | None = None,
) -> int:  # fmt: skip
    """Connect to the coordinator at `connect` as worker `name`, and work until it ends or releases this worker.

    Kernels are made ready while the connection is being opened. `wait_s` limits both the first connection and any later
    absence of the coordinator (None: `START_S`, then `RETURN_S`). `on_signal` registers a function that is called when
    this process gets a signal to end; `show` is called with each sentence of the warm-up. `tasks` starts processes for
    tasks, by default new interpreters.

    Returns:
        The exit code.

    Raises:
        UnreachableError: The coordinator could not be reached, or was away too long.
        RefusedError: the coordinator refused this worker, for instance because of its version or its certificate.
        AtollError: The kernels cannot be made ready, or the compute thread failed.
    """
    from atoll_core.wire.bus.zenoh_bus import open_client

    compute = ComputeThread(show)
    compute.warm_up()
    try:
        with open_client(connect, wait_s=START_S if wait_s is None else wait_s) as bus:
            logs = JobLogs(time.monotonic)
            logging.getLogger().addHandler(logs)
            worker = Worker(bus, compute, name, wait_s, lifetime_s, grace_s, TaskProcess(tasks), logs)
            with on_signal(worker.leave):
                code = worker.run()
            if worker.error is not None:
                raise worker.error
            return code
    finally:
        compute.close()
