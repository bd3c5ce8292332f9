"""Dispatches queries: answers greetings and workers, and passes requests of clients to `clients`."""

import logging
from collections.abc import Callable
from typing import Final

from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.jobs import checks
from atoll_coordinator.service.requests.authorization import Authorization
from atoll_coordinator.service.requests.clients import ClientRequests
from atoll_coordinator.service.requests.waiting import NotYetError
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.workers.membership import version_refusal
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.errors import RemoteProtocolError, StoreError
from atoll_core.logs import fields
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Query
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.clients import Answer, AnswerBody, ClientRequest, Failure
from atoll_core.wire.messages.epochs import Pull, PullAnswer, PullStates, States
from atoll_core.wire.messages.handshake import Greeting, GreetingAnswer, Hello, Refusal, Welcome
from atoll_core.wire.messages.limits import MAX_MESSAGE
from atoll_core.wire.rejects import Rejects
from atoll_core.wire.state_pieces import IslandState, split_states

_LOG: Final = logging.getLogger(__name__)


class RequestDispatcher:
    """Answers queries by their keys."""

    def __init__(  # noqa: PLR0913  # the sources of answers
        self, controller: JobController, store: Store, authorization: Authorization, clients: ClientRequests,
        rejects: Rejects, now: Callable[[], float], clock: Callable[[], str],
    ) -> None:  # fmt: skip
        """`rejects` counts malformed questions, `now` is in seconds of the bus, `clock` is the time of day (ISO)."""
        self._controller = controller
        self._store = store
        self._authorization = authorization
        self._clients = clients
        self._rejects = rejects
        self._now = now
        self._clock = clock
        self.store_error: StoreError | None = None
        """The error of the store during a request, after which the coordinator must end; None: no error."""

    def answer(self, event: Query) -> bytes | None:
        """Return the answer to a query; None: there is none. After an error, clients and greetings get a sentence.

        Raises:
            RemoteProtocolError: The query is malformed.
            NotYetError: The query can be answered when the result of a job, or its equations, have been written.
        """
        key = topics.parse(event.key)
        try:
            return self._answer(key, event)
        except (RemoteProtocolError, StoreError, NotYetError):
            raise
        except Exception as error:
            sentence = self._controller.breakages.add(f"answering a question ({type(key).__name__})", error)
        if isinstance(key, topics.HelloKey):
            return encode(GreetingAnswer(body=_refusal(sentence)))
        if isinstance(key, topics.ClientKey):
            return encode(Answer(body=Failure(failure="internal", sentence=sentence)))
        return None

    def _answer(self, key: topics.Key, event: Query) -> bytes | None:
        match key:
            case topics.HelloKey():
                return encode(GreetingAnswer(body=self._greet(event.payload, key.name)))
            case topics.StatesKey() | topics.BlobKey():
                return self._tell_worker(key, event.payload)
            case topics.ClientKey(part="ask"):
                return encode(Answer(body=self._answer_client(event, key.client)))
            case _:
                raise RemoteProtocolError(f"nothing is served on key {event.key}")

    def _tell_worker(self, key: topics.StatesKey | topics.BlobKey, payload: bytes) -> bytes | None:
        """Answer a worker. A worker repeats its query until it has an answer, so an error must end the job."""
        job = self._controller.job_of_dataset(key.digest) if isinstance(key, topics.BlobKey) else key.job
        with self._controller.guarded(job or "", "answering a worker", self._now(), by_peer=True):
            match key:
                case topics.StatesKey():
                    return self._states(key, payload)
                case topics.BlobKey():
                    try:
                        return self._store.get_chunk(key.digest, key.index)
                    except KeyError:
                        return self._controller.tasks.chunk(key.digest, key.index)
        return None

    def _states(self, key: topics.StatesKey, payload: bytes) -> bytes | None:
        """Return states of a committed checkpoint, as many as fit into one message; None: states are missing."""
        pull = decode(payload, Pull, MAX_MESSAGE).body
        if not isinstance(pull, PullStates) or pull.job != key.job:
            raise RemoteProtocolError(f"a pull of states of job {key.job} was expected, but {pull.kind!r} came")

        def load(island: int) -> IslandState:
            state = self._store.state(pull.job, pull.variable, pull.epoch, island)
            if not state.is_whole:
                raise KeyError(island)
            return state

        try:
            pieces = split_states(pull.islands, pull.offset, load)
        except KeyError:
            if self._controller.has_lost(pull):  # the worker would ask for these states for ever
                self._controller.fail_job(pull.job, "internal", checks.lost_states_reason(pull.variable), self._now())
            return None
        return encode(PullAnswer(body=States(pieces=pieces)))

    def _answer_client(self, event: Query, client: str) -> AnswerBody:
        try:
            request = decode(event.payload, ClientRequest, MAX_MESSAGE)
        except RemoteProtocolError as error:
            self._rejects.count(event.key, error)
            return Failure(failure="protocol", sentence=f"the coordinator did not understand the question: {error}")
        try:
            return self._clients.answer(client, request)
        except StoreError as error:
            self.store_error = error
            return Failure(failure="internal", sentence=str(error)[:4000])

    def _greet(self, payload: bytes, name: str | None) -> Welcome | Refusal:
        """Answer a greeting on the key of `name`; None: the greeting is a test, which changes nothing."""
        try:
            hello = decode(payload, Greeting, MAX_MESSAGE).body
        except RemoteProtocolError as error:
            self._rejects.count(topics.HELLO, error)
            return _refusal(
                f"the coordinator is Atoll {VERSION} (protocol {PROTOCOL_VERSION}) and did not understand the "
                "greeting; install the same version on both sides"
            )
        sentence = self._refuse(hello, name)
        if sentence is not None:
            if hello.role == "client":
                _LOG.warning("client refused", extra=fields(client=hello.name, reason=sentence))
            return _refusal(sentence)
        return Welcome(
            realm=self._store.cluster, incarnation=self._store.incarnation, protocol=PROTOCOL_VERSION, version=VERSION,
            engine=ENGINE_REVISION, clock=self._clock(),
        )  # fmt: skip

    def _refuse(self, hello: Hello, name: str | None) -> str | None:
        if name not in (None, hello.name):
            return f"{hello.name!r} greeted under the name {name!r}; install the same version on both sides"
        refusal = version_refusal(hello) or self._authorization.refuse_role(hello)
        if refusal is not None or hello.role == "client" or name is None:
            return refusal
        return self._controller.workers.register(hello, self._now())


def _refusal(sentence: str) -> Refusal:
    return Refusal(protocol=PROTOCOL_VERSION, version=VERSION, engine=ENGINE_REVISION, sentence=sentence[:4000])
