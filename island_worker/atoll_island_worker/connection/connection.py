"""A worker's standing with its coordinator, on the bus: greeting, coming back, leaving, and giving it up."""

import logging
from dataclasses import dataclass
from typing import Final

from atoll.errors import AtollError, RefusedError, UnreachableError
from atoll.logs import fields
from atoll.wire import topics
from atoll.wire.bus.interface import Bus
from atoll.wire.messages.workers import Shutdown
from atoll_island_worker.connection.drain import Leaving
from atoll_island_worker.connection.handshake import Joined, Joining
from atoll_island_worker.connection.requests import Asked, Voice

_LOG = logging.getLogger(__name__)

GREET_TIMEOUT_S: Final = 2.0
GREET_PAUSE_S: Final = 0.2
ALONE_S: Final = 3.0
"""A worker that is leaving waits so long for a coordinator that has gone."""

GREET: Final = "greet"
LIFETIME: Final = "lifetime"
GRACE: Final = "grace"
"""Names of timers."""


@dataclass(slots=True)
class Exit:
    """How a worker ends; `code` is None while it does not."""

    code: int | None = None
    error: AtollError | None = None

    def because_of(self, error: AtollError) -> None:
        """End with the error's exit code."""
        self.error, self.code = error, error.exit_code


class Attendance:
    """Greets the coordinator, listens where it says, waits for it when it is away, and leaves."""

    def __init__(self, bus: Bus, voice: Voice, name: str, wait_s: float, leaving: Leaving) -> None:
        """`wait_s`: how long the coordinator may be away."""
        self.exit: Final = Exit()
        self._bus = bus
        self._voice = voice
        self._name = name
        self._wait_s = wait_s
        self._leaving = leaving
        self._joining = Joining(name, bus.now())

    @property
    def realm(self) -> str:
        """The coordinator's realm; empty before the first welcome."""
        return self._joining.realm

    @property
    def incarnation(self) -> int | None:
        """The coordinator's incarnation; None before the first welcome."""
        return self._joining.welcome.incarnation if self._joining.welcome is not None else None

    @property
    def instance(self) -> str:
        """Random name of this process."""
        return self._joining.instance

    @property
    def is_accepted(self) -> bool:
        """Whether the coordinator knows that the kernels here are ready."""
        return self._joining.is_accepted

    @property
    def is_to_leave(self) -> bool:
        """Whether this worker has been told to end."""
        return self._leaving.is_wanted

    @property
    def is_leaving(self) -> bool:
        """Whether the coordinator has been told that this worker wants to end."""
        return self._leaving.has_begun

    def start(self) -> None:
        """Greet the coordinator; begin to count the time that this worker is to live."""
        self.greet()
        if self._leaving.lifetime_s is not None:
            self._bus.call_later(self._leaving.lifetime_s, LIFETIME)

    def greet(self) -> None:
        """Ask whether we are welcome."""
        asked = Asked("hello", self._joining.fingerprint)
        self._voice.ask(topics.hello(self._name), self._joining.hello(), GREET_TIMEOUT_S, asked)

    def greeted(self, fingerprint: str, payload: bytes | None) -> Joined | None:
        """Take in the answer to a greeting that carried `fingerprint` ("": kernels not ready yet).

        Returns what it changed; None: there was none, and we greet again soon, or we are refused.
        """
        if payload is None:
            self._voice.ask(topics.HELLO, self._joining.hello(), GREET_TIMEOUT_S, Asked("enquiry"))
            self._bus.call_later(GREET_PAUSE_S, GREET)
            return None
        try:
            joined = self._joining.take(fingerprint, payload)
        except RefusedError as error:
            self.exit.because_of(error)
            return None
        if joined.is_restart:
            _LOG.info("the coordinator started anew; what was held is dropped")
        if joined.is_new_realm:
            self._listen()
        return joined

    def enquired(self, payload: bytes) -> None:
        """Take in why our greeting may have remained without an answer."""
        try:
            self._joining.enquired(payload)
        except RefusedError as error:
            self.exit.because_of(error)

    def lost(self) -> None:
        """Take notice that the connection went."""
        self._joining.lost(self._bus.now())
        _LOG.warning("connection to the coordinator lost; waiting for it")

    def kernels_ready(self, fingerprint: str) -> None:
        """Greet once more, now with the fingerprint, if we have been welcomed without."""
        self._joining.fingerprint = fingerprint
        if self._joining.welcome is not None:
            self.greet()

    def check_absence(self) -> None:
        """End when the coordinator has been away for too long."""
        absence = self._joining.absence(self._bus.now())
        if self._leaving.has_begun and absence > ALONE_S:
            self.exit.code = 0  # there is nobody to hand over to, and what was committed is not lost
        elif absence > self._wait_s:
            self.exit.because_of(UnreachableError(self._joining.silence(self._wait_s)))

    def ask_to_leave(self) -> None:
        """Leave, soon. Signal handlers may call."""
        self._leaving.is_wanted = True

    def begin_leaving(self) -> bool:
        """Want to end: at once where nobody is to be told or waited for. Returns whether the coordinator is to hear."""
        if self._joining.welcome is None or self._leaving.grace_s <= 0.0:
            self.exit.code = 0
            return False
        if self._leaving.has_begun:
            return False
        self._leaving.has_begun = True
        _LOG.info("leaving: what is computed here is handed over", extra=fields(at_most_s=self._leaving.grace_s))
        self._bus.call_later(self._leaving.grace_s, GRACE)
        return True

    def out_of_grace(self) -> None:
        """End although what is computed here has not been handed over."""
        _LOG.warning(
            "not let go in time; what was not committed is computed again",
            extra=fields(seconds=self._leaving.grace_s),
        )
        self.exit.code = 0

    def shut_down(self, body: Shutdown) -> None:
        """End as the coordinator says."""
        if body.refused:
            self.exit.because_of(RefusedError(body.sentence))
        else:
            _LOG.info("this worker ends", extra=fields(reason=body.sentence or "the coordinator ended"))
            self.exit.code = 0

    def _listen(self) -> None:
        """Declare everything that a worker receives, answers and shows."""
        self._bus.subscribe(topics.control(self.realm))
        self._bus.subscribe(topics.control(self.realm, self._name))
        self._bus.subscribe(topics.inbox(self.realm, self._name))
        self._bus.serve(topics.worker(self.realm, self._name, "pull"))
        self._bus.announce(topics.worker(self.realm, self._name, "alive"))
        _LOG.info("joined", extra=fields(realm=self.realm))
