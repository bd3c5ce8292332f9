"""Dispatches the queries of workers and clients by their key, and answers those for jobs, states and datasets."""

from collections.abc import Callable

from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.jobs import checks
from atoll_coordinator.service.requests.clients import Body, ClientRequests
from atoll_coordinator.service.requests.deferred import NotYetError
from atoll_coordinator.service.requests.handshake import Handshake, refusal
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import RemoteProtocolError, StoreError
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Query
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.clients import Answer, ClientRequest, Failure
from atoll_core.wire.messages.epochs import Pull, PullAnswer, PullStates, States
from atoll_core.wire.messages.handshake import GreetingAnswer
from atoll_core.wire.messages.limits import MAX_MESSAGE
from atoll_core.wire.messages.workers import Control
from atoll_core.wire.rejects import Rejects
from atoll_core.wire.state_pieces import IslandState, split_states


class RequestDispatcher:
    """Hands each query to the one who answers it."""

    def __init__(
        self, controller: JobController, store: Store, handshake: Handshake, clients: ClientRequests, rejects: Rejects,
        now: Callable[[], float],
    ) -> None:  # fmt: skip
        """`rejects` counts questions of clients that are not understood; `now` gives the bus's seconds."""
        self._controller = controller
        self._store = store
        self._handshake = handshake
        self._clients = clients
        self._rejects = rejects
        self._now = now
        self.store_error: StoreError | None = None
        """Why the store failed in the midst of a question, when it did: nothing can go on from there."""

    def answer(self, event: Query) -> bytes | None:
        """Return the answer to a query; None when what it asks for is not there, or something of ours breaks over it.

        A client or a greeting is told what broke.

        Raises:
            RemoteProtocolError: The query cannot be.
            NotYetError: The answer is there when the result of a job is composed.
        """
        key = topics.parse(event.key)
        try:
            return self._answer(key, event)
        except (RemoteProtocolError, StoreError, NotYetError):
            raise
        except Exception as error:
            sentence = self._controller.breakages.add(f"answering a question ({type(key).__name__})", error)
        if isinstance(key, topics.HelloKey):
            return encode(GreetingAnswer(body=refusal(sentence)))
        if isinstance(key, topics.ClientKey):
            return encode(Answer(body=Failure(failure="internal", sentence=sentence)))
        return None

    def _answer(self, key: topics.Key, event: Query) -> bytes | None:
        match key:
            case topics.HelloKey():
                return encode(GreetingAnswer(body=self._handshake.answer(event.payload, key.name)))
            case topics.JobKey() | topics.BlobKey():
                return self._tell_worker(key, event.payload)
            case topics.ClientKey(part="ask"):
                return encode(Answer(body=self._answer_client(event, key.client)))
            case _:
                raise RemoteProtocolError(f"nothing is served on key {event.key}")

    def _tell_worker(self, key: topics.JobKey | topics.BlobKey, payload: bytes) -> bytes | None:
        """Answer what a worker asks until it is told: where that breaks, its job ends, or it would ask for ever."""
        job = self._controller.job_of_dataset(key.digest) if isinstance(key, topics.BlobKey) else key.job
        with self._controller.guarded(job or "", "answering a worker", self._now(), by_peer=True):
            match key:
                case topics.JobKey(part="job"):
                    announcement = self._controller.announcement(key.job)
                    return encode(Control(body=announcement)) if announcement is not None else None
                case topics.JobKey(part="placement"):
                    return encode(Control(body=self._controller.placements(key.job)))
                case topics.JobKey():
                    return self._states(key, payload)
                case topics.BlobKey():
                    return self._chunk(key)
        return None

    def _chunk(self, key: topics.BlobKey) -> bytes | None:
        try:
            return self._store.get_chunk(key.digest, key.index)
        except KeyError:
            return self._controller.tasks.chunk(key.digest, key.index)

    def _states(self, key: topics.JobKey, payload: bytes) -> bytes | None:
        """Return states of a committed checkpoint, as many as one message bears; None when it is not there."""
        pull = decode(payload, Pull, MAX_MESSAGE).body
        if not isinstance(pull, PullStates) or pull.job != key.job:
            raise RemoteProtocolError(f"states of job {key.job} were to be asked for, and {pull.kind!r} came")

        def load(island: int) -> IslandState:
            state = self._store.state(pull.job, pull.variable, pull.epoch, island)
            if not state.is_whole:
                raise KeyError(island)
            return state

        try:
            pieces = split_states(pull.islands, pull.offset, load)
        except KeyError:
            if self._controller.has_lost(pull):  # the worker would ask for ever
                self._controller.fail_job(pull.job, "internal", checks.lost_states_reason(pull.variable), self._now())
            return None
        return encode(PullAnswer(body=States(pieces=pieces)))

    def _answer_client(self, event: Query, client: str) -> Body:
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
