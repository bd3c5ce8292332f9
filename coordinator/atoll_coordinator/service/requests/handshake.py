"""The handshake: a greeting is answered with a welcome, or with a sentence on why a program cannot take part."""

import logging
from collections.abc import Callable

from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.requests.authorization import Authorization
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.workers.membership import version_refusal
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.errors import RemoteProtocolError
from atoll_core.logs import fields
from atoll_core.wire import topics
from atoll_core.wire.codec import decode
from atoll_core.wire.messages.handshake import Greeting, Hello, Refusal, Welcome
from atoll_core.wire.messages.limits import MAX_MESSAGE
from atoll_core.wire.rejects import Rejects

_LOG = logging.getLogger(__name__)


class Handshake:
    """Answers the greetings of workers and clients."""

    def __init__(
        self, controller: JobController, store: Store, authorization: Authorization, rejects: Rejects,
        now: Callable[[], float], clock: Callable[[], str],
    ) -> None:  # fmt: skip
        """`now` gives the bus's seconds, `clock` the time of day as ISO text. What is not understood is counted."""
        self._controller = controller
        self._store = store
        self._authorization = authorization
        self._rejects = rejects
        self._now = now
        self._clock = clock

    def answer(self, payload: bytes, name: str | None) -> Welcome | Refusal:
        """Answer a greeting on the key of `name`, or (None) only say how it would be answered there."""
        try:
            hello = decode(payload, Greeting, MAX_MESSAGE).body
        except RemoteProtocolError as error:
            self._rejects.count(topics.HELLO, error)
            return refusal(
                f"the coordinator is Atoll {VERSION} (protocol {PROTOCOL_VERSION}) and did not understand the "
                "greeting; install the same version on both sides"
            )
        sentence = self._refuse(hello, name)
        if sentence is not None:
            if hello.role == "client":
                _LOG.warning("client refused", extra=fields(client=hello.name, reason=sentence))
            return refusal(sentence)
        return Welcome(
            realm=self._store.cluster,
            incarnation=self._store.incarnation,
            protocol=PROTOCOL_VERSION,
            version=VERSION,
            engine=ENGINE_REVISION,
            clock=self._clock(),
        )

    def _refuse(self, hello: Hello, name: str | None) -> str | None:
        if name not in (None, hello.name):
            return f"{hello.name!r} greeted under the name {name!r}; install the same version on both sides"
        refusal = version_refusal(hello) or self._authorization.refuse_role(hello)
        if refusal is not None or hello.role == "client" or name is None:
            return refusal
        return self._controller.workers.register(hello, self._now())


def refusal(sentence: str) -> Refusal:
    """Return the answer to a greeting that is refused for this reason."""
    return Refusal(protocol=PROTOCOL_VERSION, version=VERSION, engine=ENGINE_REVISION, sentence=sentence[:4000])
