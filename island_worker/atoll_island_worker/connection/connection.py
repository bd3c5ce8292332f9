"""The connection of a worker to its coordinator: handshake, absence, drain, and how the worker ends."""

import logging
import os
import socket
from typing import Final
from uuid import uuid4

from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.errors import AtollError, RefusedError, RemoteProtocolError, UnreachableError
from atoll_core.logs import fields
from atoll_core.machine import total_memory_bytes, usable_cores
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Bus
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.handshake import Greeting, GreetingAnswer, Hello, Refusal, Welcome
from atoll_core.wire.messages.limits import MAX_MESSAGE
from atoll_core.wire.messages.workers import Shutdown
from atoll_island_worker.connection.requests import Request, Requests
from atoll_island_worker.session.events import Reset

_LOG = logging.getLogger(__name__)

START_S: Final = 10.0
RETURN_S: Final = 3600.0
"""How long a worker waits for a coordinator, unless told otherwise: at the start, where the address may be wrong, and
for the return of one that it has worked for, which is restarted, upgraded, or waits for room on its disk."""

GREET_TIMEOUT_S: Final = 2.0
GREET_PAUSE_S: Final = 0.2
STALE_PAUSE_S: Final = 2.0
"""Between greetings while a former coordinator answers: it ends within a tick of its own, once it goes on."""

GRACE_S: Final = 30.0
"""How long handing over may take, unless another time was given."""
ALONE_S: Final = 3.0
"""A worker that drains waits so long for a coordinator that has gone."""

QUIET_S: Final = 15.0
"""After so long a silence of the coordinator it is asked whether it is there: of one behind a router, no link tells.
As long as the coordinator bears a worker's silence."""

GREET: Final = "greet"
LIFETIME: Final = "lifetime"
GRACE: Final = "grace"
"""Names of timers."""


class CoordinatorConnection:
    """Greets the coordinator, subscribes in its cluster, waits while it is away, and drains the worker before it ends.

    `welcome`: the coordinator's last answer to a greeting; None before the first. `is_accepted`: the coordinator knows
    that the kernels here are ready. `is_draining`: it has been told that this worker wants to end. `exit_code`: None
    while the worker goes on; `error`: why it ends, when that is an error.
    """

    def __init__(
        self, bus: Bus, requests: Requests, name: str, wait_s: float | None, lifetime_s: float | None, grace_s: float
    ) -> None:
        """Set up, without a greeting yet.

        Args:
            wait_s: how long the coordinator may be away, at the start or later; None: `START_S`, then `RETURN_S`.
            lifetime_s: after so many seconds the worker drains; None: never.
            grace_s: how long a drain may take; 0: the worker ends at once.
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
        self._is_reachable = False  # an enquiry was answered although no greeting was
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
        """Greet the coordinator; begin to count the worker's lifetime."""
        self.greet()
        if self._lifetime_s is not None:
            self._bus.call_later(self._lifetime_s, LIFETIME)

    def greet(self) -> None:
        """Ask to be accepted."""
        request = Request("hello", self._fingerprint, self._welcomes)
        self._requests.ask(topics.hello(self._name), self._hello(), GREET_TIMEOUT_S, request)

    def handle_answer(self, fingerprint: str, payload: bytes | None, welcomes: int | None = None) -> Reset | None:
        """Handle the answer (None: there was none) to a greeting that carried `fingerprint` ("": kernels not ready).

        Returns what the session is to drop when the coordinator, or its store, is another one than before. Without an
        answer another greeting follows, and after a late one of a former coordinator; a refusal ends the worker.
        `welcomes`: how many, and later incarnations, there had been when the greeting was sent; None: as now.
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
        is_late = welcomes not in (None, self._welcomes)  # and may be of a former coordinator
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
            self.greet()  # the kernels became ready while the greeting was under way
        if former is None or (former.realm, former.incarnation) == (welcome.realm, welcome.incarnation):
            return None
        _LOG.info("the coordinator started anew; what was held is dropped")
        return Reset(welcome.incarnation if former.realm == welcome.realm else 0)

    def _refuse_stale(self, incarnation: int) -> None:
        """Join no coordinator of which a later incarnation has been heard: it hung, or its store was copied back."""
        if self._stale != incarnation:
            self._stale = incarnation
            _LOG.warning(
                "a former coordinator answers, and is not joined; was its store copied back without `restore`?",
                extra=fields(incarnation=incarnation, newest=self._newest),
            )
        if self._away_since is None:
            self._away_since = self._bus.now()
        self._bus.call_later(STALE_PAUSE_S, GREET)

    def incarnation_heard(self, incarnation: int) -> None:
        """Take in what a placement says: an answer of a former coordinator may still come, to an older greeting.

        Raises:
            RemoteProtocolError: The placement is one of a former coordinator itself.
        """
        if incarnation < self._newest:
            raise RemoteProtocolError(
                f"a placement by incarnation {incarnation} of the coordinator came, and incarnation {self._newest} "
                "has taken over"
            )
        if incarnation > self._newest:
            self._welcomes, self._newest = self._welcomes + 1, incarnation

    def _enquire(self) -> None:
        """Ask whether we would be accepted, which changes nothing."""
        self._asked_at = self._bus.now()
        self._requests.ask(topics.HELLO, self._hello(), GREET_TIMEOUT_S, Request("enquiry"))

    def handle_enquiry(self, payload: bytes | None) -> None:
        """Handle the answer to the question whether we would be accepted; None: nobody answered.

        It is asked when no greeting is answered, and when the coordinator has been silent for long.
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
        """Greet once more, now with the fingerprint of the kernels, after a welcome without."""
        self._fingerprint = fingerprint
        if self.welcome is not None:
            self.greet()

    # ---------------------------------------------------------------------------------------- absence

    @property
    def _wait_s(self) -> float:
        """How long the coordinator may be away now."""
        if self._given_wait_s is not None:
            return self._given_wait_s
        return START_S if self.welcome is None else RETURN_S

    def coordinator_heard(self) -> None:
        """Take in that the coordinator has said something."""
        self._heard_at = self._bus.now()

    def link_lost(self) -> None:
        """Begin to count the coordinator's absence."""
        self._away_since = self._bus.now()
        _LOG.warning("connection to the coordinator lost; waiting for it")

    def check_absence(self) -> None:
        """End the worker when the coordinator has been away for too long; ask for it when it has long been silent."""
        now = self._bus.now()
        pause_s = QUIET_S if self._away_since is None else GREET_TIMEOUT_S
        if self.welcome is not None and now - max(self._heard_at, self._asked_at) >= pause_s:
            self._enquire()
        absence = now - self._away_since if self._away_since is not None else 0.0
        if self.is_draining and absence > ALONE_S:
            self.exit_code = 0  # there is nobody to hand over to, and what was committed is not lost
        elif absence > self._wait_s:
            self.fail(UnreachableError(self._absence_sentence()))

    # ------------------------------------------------------------------------------------------ drain

    def drain(self) -> bool:
        """Begin to drain; end at once where nobody is to be told or waited for.

        Returns whether the coordinator is to be told.
        """
        if self.welcome is None or self._grace_s <= 0.0:
            self.exit_code = 0
            return False
        if self.is_draining:
            return False
        self.is_draining = True
        _LOG.info("leaving: what is computed here is handed over", extra=fields(at_most_s=self._grace_s))
        self._bus.call_later(self._grace_s, GRACE)
        return True

    def grace_over(self) -> None:
        """End although what is computed here has not been handed over."""
        _LOG.warning(
            "not let go in time; what was not committed is computed again", extra=fields(seconds=self._grace_s)
        )
        self.exit_code = 0

    def shut_down(self, body: Shutdown) -> None:
        """End as the coordinator demands."""
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
        """Declare everything that a worker receives, answers and shows in a cluster."""
        self._clusters.add(cluster)
        self._bus.subscribe(topics.control(cluster))
        self._bus.subscribe(topics.control(cluster, self._name))
        self._bus.subscribe(topics.inbox(cluster, self._name))
        self._bus.serve(topics.worker(cluster, self._name, "pull"))
        self._bus.announce(topics.worker(cluster, self._name, "alive"))
        _LOG.info("joined", extra=fields(realm=cluster))

    def _absence_sentence(self) -> str:
        if self._is_reachable and self.welcome is None:
            return (
                f"the coordinator did not answer the greeting of {self._name!r} within {self._wait_s:.0f} s, though it "
                "can be reached: access control on the way does probably not know this name; have the router started "
                "again with the roster that the coordinator has"
            )
        if self._stale is not None:
            return (
                f"for {self._wait_s:.0f} s only a coordinator of incarnation {self._stale} has answered, though "
                f"incarnation {self._newest} has taken over; if its store was copied back, put the copy in place by "
                "`coordinator restore`"
            )
        return f"the coordinator has not answered for {self._wait_s:.0f} s; start it again"


def _welcome(payload: bytes) -> Welcome:
    """Return the welcome in an answer to a greeting; raises RefusedError with the reason when it is none."""
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
