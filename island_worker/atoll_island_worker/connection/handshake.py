"""Joining a coordinator: who we are, whether we are welcome, and for how long it has been away. No I/O but names."""

import os
import socket
from dataclasses import dataclass
from uuid import uuid4

from atoll import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll.errors import RefusedError, RemoteProtocolError
from atoll.wire.codec import decode, encode
from atoll.wire.messages.handshake import Greeting, GreetingAnswer, Hello, Refusal, Welcome
from atoll.wire.messages.limits import MAX_MESSAGE


@dataclass(frozen=True, slots=True)
class Joined:
    """What an accepted greeting changed.

    `is_new_realm`: nothing has been subscribed there yet; `is_restart`: the coordinator, or its store, is another one
    than before, and what is held is void, but for what this `incarnation` of the same store (0: of another one) has
    placed; `greets_again`: the kernels became ready while the greeting was under way.
    """

    is_new_realm: bool
    is_restart: bool
    greets_again: bool
    incarnation: int = 0


class Joining:
    """One worker's standing with its coordinator."""

    def __init__(self, name: str, now: float) -> None:
        self.fingerprint = ""
        self.welcome: Welcome | None = None
        self.is_accepted = False
        self.instance = uuid4().hex
        self._name = name
        self._is_heard = False  # an enquiry was answered although no greeting was
        self._away_since: float | None = now
        self._realms: set[str] = set()

    @property
    def realm(self) -> str:
        """The coordinator's realm; empty before the first welcome."""
        return self.welcome.realm if self.welcome is not None else ""

    def hello(self) -> bytes:
        """Return the greeting. It carries the kernels' fingerprint once they are ready."""
        hello = Hello(
            role="worker",
            name=self._name,
            instance=self.instance,
            protocol=PROTOCOL_VERSION,
            version=VERSION,
            engine=ENGINE_REVISION,
            fingerprint=self.fingerprint,
            host=socket.gethostname()[:256],
            pid=os.getpid(),
        )
        return encode(Greeting(body=hello))

    def take(self, fingerprint: str, payload: bytes) -> Joined:
        """Take in the answer to a greeting that carried `fingerprint`.

        Raises:
            RefusedError: We are refused, or do not understand each other.
        """
        return self._join(_welcome(payload), fingerprint)

    def enquired(self, payload: bytes) -> None:
        """Take in the answer to the question whether we would be welcome, asked because no greeting was answered.

        Raises:
            RefusedError: We would not, or do not understand each other.
        """
        _welcome(payload)
        self._is_heard = True

    def silence(self, limit_s: float) -> str:
        """Return a sentence on a coordinator that has not answered for `limit_s` seconds."""
        if self._is_heard and self.welcome is None:
            return (
                f"the coordinator did not answer the greeting of {self._name!r} within {limit_s:.0f} s, though it can "
                "be reached: access control on the way does probably not know this name; have the router started again "
                "with the roster that the coordinator has"
            )
        return f"the coordinator has not answered for {limit_s:.0f} s; start it again"

    def lost(self, now: float) -> None:
        """Note that the connection went."""
        self._away_since = now

    def absence(self, now: float) -> float:
        """Return for how many seconds the coordinator has been away."""
        return now - self._away_since if self._away_since is not None else 0.0

    def _join(self, welcome: Welcome, fingerprint: str) -> Joined:
        former, self.welcome, self._away_since = self.welcome, welcome, None
        self.is_accepted = self.is_accepted or bool(fingerprint)
        is_same_store = former is not None and former.realm == welcome.realm
        is_same = is_same_store and former is not None and former.incarnation == welcome.incarnation
        joined = Joined(
            is_new_realm=welcome.realm not in self._realms,
            is_restart=former is not None and not is_same,
            greets_again=bool(self.fingerprint) and not self.is_accepted,
            incarnation=welcome.incarnation if is_same_store and not is_same else 0,
        )
        self._realms.add(welcome.realm)
        return joined


def _welcome(payload: bytes) -> Welcome:
    """Return the welcome in an answer to a greeting; raises RefusedError with what it says instead."""
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
