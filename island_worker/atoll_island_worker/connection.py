"""The connection of a worker to its coordinator: requests, handshake, absence, drain, and how the worker ends.

A worker greets twice: once as soon as it is connected, so that the coordinator knows it, and again with the fingerprint
of its kernels when they are ready. The coordinator places islands here only after the second greeting. If the
coordinator is silent, the worker sends an enquiry: whether the coordinator would accept this worker. An enquiry changes
nothing. If the coordinator is away too long, the worker ends. Each time a coordinator opens the store, the coordinator
gets a later incarnation number. A worker never returns to an earlier incarnation, such as a process that hung and
answers late.

A worker that is asked to end (by SIGTERM or its lifetime) drains: its heartbeats say ``leaving``, the coordinator
places its islands elsewhere and answers ``shutdown``. Without this answer the worker ends after its grace period, or
earlier if the coordinator is away.
"""

import logging
import os
import socket
from dataclasses import dataclass
from typing import Final
from uuid import uuid4

from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.errors import AtollError, RefusedError, RemoteProtocolError, UnreachableError
from atoll_core.logs import fields
from atoll_core.machine import total_memory_bytes, usable_cores
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Bus
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.epochs import EpochReport, Pull, PullAnswer
from atoll_core.wire.messages.handshake import Greeting, GreetingAnswer, Hello, Refusal, Welcome
from atoll_core.wire.messages.limits import MAX_MESSAGE
from atoll_core.wire.messages.tasks import PullBatch, TaskReport
from atoll_core.wire.messages.workers import Shutdown, WorkerLog, WorkerStatus
from atoll_island_worker.session import interface as io

PULL_TIMEOUT_S: Final = 5.0
"""Timeout of a pull from another worker. Migrants are requested before they exist: a lost answer costs this time, and
for an epoch that takes longer the pull is repeated."""

FETCH_TIMEOUT_S: Final = 20.0


@dataclass(frozen=True, slots=True)
class PendingRequest:
    """A request without a reply yet: a `question` about `subject` (a digest, task or fingerprint), or a `pull`.

    `index` is the number of a chunk; for a greeting it is the number of welcomes before it. A pull without an answer
    times out at `deadline` (seconds of the bus).
    """

    question: str
    subject: str = ""
    index: int = 0
    pull: io.SendPull | None = None
    deadline: float = 0.0


class Requests:
    """The messages and queries of one worker. `cluster` is the id of the coordinator's cluster, "" before a welcome."""

    def __init__(self, bus: Bus, name: str) -> None:
        self.cluster = ""
        self._bus = bus
        self._name = name
        self._open: dict[int, PendingRequest] = {}

    def ask(self, key: str, payload: bytes, timeout_s: float, request: PendingRequest) -> None:
        """Send a query; its reply belongs to `request`."""
        self._open[self._bus.get(key, payload, timeout_s)] = request

    def pop(self, token: int) -> PendingRequest | None:
        """Remove and return the request that a reply answers."""
        return self._open.pop(token, None)

    def ask_chunk(self, digest: str, index: int) -> None:
        """Ask the coordinator for one chunk of a dataset, or of an input of a task."""
        self.ask(topics.blob(self.cluster, digest, index), b"", FETCH_TIMEOUT_S, PendingRequest("chunk", digest, index))

    def ask_batch(self, peer: str, pull: PullBatch) -> None:
        """Ask another worker for a batch of its task."""
        key = topics.worker(self.cluster, peer, "pull")
        self.ask(key, encode(Pull(body=pull)), PULL_TIMEOUT_S, PendingRequest("batch", pull.task))

    def publish(self, part: topics.WorkerPart, message: EpochReport | TaskReport | WorkerStatus | WorkerLog) -> None:
        """Send the coordinator a report, a part of a task's result, a heartbeat or log lines."""
        self._bus.put(topics.worker(self.cluster, self._name, part), encode(message))

    def send(self, action: io.Outgoing) -> None:
        """Carry out an action of the session: a message, an answer or a request."""
        match action:
            case io.SendReport():
                self.publish("report", action.report)
            case io.SendPull():
                key, timeout_s = topics.states(self.cluster, action.body.job), FETCH_TIMEOUT_S
                if action.peer is not None:
                    key, timeout_s = topics.worker(self.cluster, action.peer, "pull"), PULL_TIMEOUT_S
                request = PendingRequest("pull", pull=action, deadline=self._bus.now() + timeout_s)
                self.ask(key, encode(Pull(body=action.body)), timeout_s, request)
            case io.Respond():
                self._bus.reply(action.handle, encode(PullAnswer(body=action.body)))


_LOG = logging.getLogger(__name__)

START_S: Final = 10.0
RETURN_S: Final = 3600.0
"""Default waiting times for a coordinator: at the start, when the address may be wrong, and later, when the coordinator
may be restarting, upgrading, or waiting for disk space."""

GREET_TIMEOUT_S: Final = 2.0
GREET_PAUSE_S: Final = 0.2
STALE_PAUSE_S: Final = 2.0
"""Pause between greetings while a former coordinator answers: a former coordinator that runs again ends within a
tick."""

GRACE_S: Final = 30.0
"""Default time limit of a drain."""
ALONE_S: Final = 3.0
"""Time that a draining worker waits for an absent coordinator."""

QUIET_S: Final = 15.0
"""After this silence the worker sends an enquiry: behind a router, a lost link cannot be noticed otherwise. The
coordinator tolerates the same silence of a worker."""

GREET: Final = "greet"
LIFETIME: Final = "lifetime"
GRACE: Final = "grace"
"""Names of timers."""


class CoordinatorConnection:
    """Greets the coordinator, subscribes in its cluster, waits while it is away, and drains the worker before it ends.

    `welcome`: the coordinator's last answer to a greeting; None before the first. `is_accepted`: the coordinator knows
    that the kernels here are ready. `is_draining`: heartbeats say that this worker wants to end. `exit_code`: None
    while the worker runs; `error`: the error with which it ends, if any.
    """

    def __init__(
        self, bus: Bus, requests: Requests, name: str, wait_s: float | None, lifetime_s: float | None, grace_s: float
    ) -> None:
        """Set up the connection; no greeting is sent yet.

        Args:
            wait_s: longest absence of the coordinator, at the start or later; None: `START_S`, then `RETURN_S`.
            lifetime_s: seconds after which the worker drains; None: never.
            grace_s: time limit of a drain; 0: the worker ends at once.
        """
        self.instance: Final = uuid4().hex
        self.welcome: Welcome | None = None
        self.is_accepted = False
        self.is_draining = False
        self.exit_code: int | None = None
        self.error: AtollError | None = None
        self._bus = bus
        self._requests = requests
        self._name = name
        self._given_wait_s = wait_s
        self._lifetime_s = lifetime_s
        self._grace_s = grace_s
        self._fingerprint = ""
        self._is_reachable = False  # an enquiry was answered, but the greeting was not
        self._away_since: float | None = bus.now()
        self._heard_at = self._asked_at = bus.now()
        self._clusters: set[str] = set()
        self._welcomes = 0
        self._newest = 0
        self._stale: int | None = None

    def fail(self, error: AtollError) -> None:
        """End the worker with an error and its exit code."""
        self.error, self.exit_code = error, error.exit_code

    # -------------------------------------------------------------------------------------- handshake

    def start(self) -> None:
        """Greet the coordinator; start the timer of the worker's lifetime."""
        self.greet()
        if self._lifetime_s is not None:
            self._bus.call_later(self._lifetime_s, LIFETIME)

    def greet(self) -> None:
        """Send a greeting, which asks the coordinator to accept this worker."""
        request = PendingRequest("hello", self._fingerprint, self._welcomes)
        self._requests.ask(topics.hello(self._name), self._hello(), GREET_TIMEOUT_S, request)

    def handle_answer(self, fingerprint: str, payload: bytes | None, welcomes: int | None = None) -> io.Reset | None:
        """Handle the answer (None: none came) to a greeting that carried `fingerprint` ("": kernels not ready).

        Returns a Reset if the coordinator, or its store, has changed. Without an answer, or after a late answer of a
        former coordinator, another greeting follows; a refusal ends the worker. `welcomes`: the count of welcomes and
        later incarnations when the greeting was sent; None: the present count.
        """
        if payload is None:
            self._enquire()
            self._bus.call_later(GREET_PAUSE_S, GREET)
            return None
        try:
            welcome = _welcome(payload)
        except RefusedError as error:
            self.fail(error)
            return None
        former = self.welcome
        is_late = welcomes not in (None, self._welcomes)  # the answer may come from a former coordinator
        is_stale = former is not None and former.realm == welcome.realm and welcome.incarnation < self._newest
        if former and is_late and (former.realm != welcome.realm or is_stale):
            self.greet()
            return None
        if is_stale:
            self._refuse_stale(welcome.incarnation)
            return None
        self.welcome, self._away_since, self._stale = welcome, None, None
        self._welcomes, self._newest = self._welcomes + 1, welcome.incarnation
        self._requests.cluster = welcome.realm
        self.is_accepted = self.is_accepted or bool(fingerprint)
        if welcome.realm not in self._clusters:
            self._subscribe(welcome.realm)
        if self._fingerprint and not self.is_accepted:
            self.greet()  # the kernels became ready after the greeting was sent
        if former is None or (former.realm, former.incarnation) == (welcome.realm, welcome.incarnation):
            return None
        _LOG.info("the coordinator was restarted; islands and tasks of the former one are dropped")
        return io.Reset(welcome.incarnation if former.realm == welcome.realm else 0)

    def _refuse_stale(self, incarnation: int) -> None:
        """Refuse a former incarnation of the coordinator: its process hung, or its store was copied back."""
        if self._stale != incarnation:
            self._stale = incarnation
            _LOG.warning(
                "a former coordinator answers and is not joined; was its store copied back without `restore`?",
                extra=fields(incarnation=incarnation, newest=self._newest),
            )
        if self._away_since is None:
            self._away_since = self._bus.now()
        self._bus.call_later(STALE_PAUSE_S, GREET)

    def incarnation_heard(self, incarnation: int) -> None:
        """Record the incarnation of a placement: a former coordinator may still answer older greetings.

        Raises:
            RemoteProtocolError: A former coordinator sent the placement.
        """
        if incarnation < self._newest:
            raise RemoteProtocolError(
                f"a placement by incarnation {incarnation} of the coordinator came, and incarnation {self._newest} "
                "has taken over"
            )
        if incarnation > self._newest:
            self._welcomes, self._newest = self._welcomes + 1, incarnation

    def _enquire(self) -> None:
        """Ask whether the coordinator would accept this worker, which changes nothing."""
        self._asked_at = self._bus.now()
        self._requests.ask(topics.HELLO, self._hello(), GREET_TIMEOUT_S, PendingRequest("enquiry"))

    def handle_enquiry(self, payload: bytes | None) -> None:
        """Handle the answer to an enquiry; None: none came.

        An enquiry is sent if a greeting is not answered, or if the coordinator was silent for a long time.
        """
        if payload is None:
            self._away_since = self._away_since if self._away_since is not None else self._asked_at
            return
        if self.welcome is not None and self._stale is None:
            self._away_since = None
        try:
            _welcome(payload)
        except RefusedError as error:
            self.fail(error)
        self._is_reachable = True

    def kernels_ready(self, fingerprint: str) -> None:
        """Greet again, now with the fingerprint of the kernels."""
        self._fingerprint = fingerprint
        if self.welcome is not None:
            self.greet()

    # ---------------------------------------------------------------------------------------- absence

    @property
    def _wait_s(self) -> float:
        """The longest permitted absence of the coordinator now."""
        if self._given_wait_s is not None:
            return self._given_wait_s
        return START_S if self.welcome is None else RETURN_S

    def coordinator_heard(self) -> None:
        """Record that a message of the coordinator came."""
        self._heard_at = self._bus.now()

    def link_lost(self) -> None:
        """Start measuring the coordinator's absence."""
        self._away_since = self._bus.now()
        _LOG.warning("connection to the coordinator lost; waiting for it")

    def check_absence(self) -> None:
        """End the worker if the coordinator was away too long; send an enquiry if it was silent for a long time."""
        now = self._bus.now()
        pause_s = QUIET_S if self._away_since is None else GREET_TIMEOUT_S
        if self.welcome is not None and now - max(self._heard_at, self._asked_at) >= pause_s:
            self._enquire()
        absence = now - self._away_since if self._away_since is not None else 0.0
        if self.is_draining and absence > ALONE_S:
            self.exit_code = 0  # no coordinator can take the islands, and committed epochs are not lost
        elif absence > self._wait_s:
            self.fail(UnreachableError(self._absence_sentence()))

    # ------------------------------------------------------------------------------------------ drain

    def drain(self) -> bool:
        """Start to drain; end at once before a welcome or without a grace period.

        Returns whether the coordinator should get a heartbeat.
        """
        if self.welcome is None or self._grace_s <= 0.0:
            self.exit_code = 0
            return False
        if self.is_draining:
            return False
        self.is_draining = True
        _LOG.info("leaving: islands are handed over", extra=fields(at_most_s=self._grace_s))
        self._bus.call_later(self._grace_s, GRACE)
        return True

    def grace_over(self) -> None:
        """End although the islands have not been handed over."""
        _LOG.warning(
            "not released in time; uncommitted epochs will be computed again",
            extra=fields(seconds=self._grace_s),
        )
        self.exit_code = 0

    def shut_down(self, body: Shutdown) -> None:
        """End because the coordinator ordered it."""
        if body.refused:
            self.fail(RefusedError(body.sentence))
        else:
            _LOG.info("this worker ends", extra=fields(reason=body.sentence or "the coordinator ended"))
            self.exit_code = 0

    # ---------------------------------------------------------------------------------------- private

    def _hello(self) -> bytes:
        hello = Hello(
            role="worker",
            name=self._name,
            instance=self.instance,
            protocol=PROTOCOL_VERSION,
            version=VERSION,
            engine=ENGINE_REVISION,
            fingerprint=self._fingerprint,
            host=socket.gethostname()[:256],
            pid=os.getpid(),
            cores=usable_cores(os.environ)[0],
            memory_bytes=total_memory_bytes(),
        )
        return encode(Greeting(body=hello))

    def _subscribe(self, cluster: str) -> None:
        """Subscribe to, serve and announce all keys of this worker in a cluster."""
        self._clusters.add(cluster)
        self._bus.subscribe(topics.control(cluster))
        self._bus.subscribe(topics.control(cluster, self._name))
        self._bus.serve(topics.worker(cluster, self._name, "pull"))
        self._bus.announce(topics.worker(cluster, self._name, "alive"))
        _LOG.info("joined", extra=fields(realm=cluster))

    def _absence_sentence(self) -> str:
        if self._is_reachable and self.welcome is None:
            return (
                f"the coordinator did not answer the greeting of {self._name!r} within {self._wait_s:.0f} s, but it "
                "can be reached: access control of the router probably does not know this name; restart the router "
                "with the roster of the coordinator"
            )
        if self._stale is not None:
            return (
                f"for {self._wait_s:.0f} s only a coordinator of incarnation {self._stale} has answered, though "
                f"incarnation {self._newest} has taken over; if its store was copied back, install the copy with "
                "`coordinator restore`"
            )
        return f"the coordinator has not answered for {self._wait_s:.0f} s; start it again"


def _welcome(payload: bytes) -> Welcome:
    """Return the welcome from an answer to a greeting; raises RefusedError with the reason of a refusal."""
    try:
        answer = decode(payload, GreetingAnswer, MAX_MESSAGE).body
    except RemoteProtocolError as error:
        raise RefusedError(
            f"the coordinator's answer was not understood ({error}); this worker is Atoll {VERSION} (protocol "
            f"{PROTOCOL_VERSION}), install the same version on both sides"
        ) from error
    if isinstance(answer, Refusal):
        raise RefusedError(answer.sentence)
    return answer
