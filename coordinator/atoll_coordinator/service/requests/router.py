"""What the coordinator answers to queries of workers and clients, by the key that they ask for."""

from atoll.errors import RemoteProtocolError, StoreError
from atoll.wire import topics
from atoll.wire.bus.interface import Query
from atoll.wire.codec import decode, encode
from atoll.wire.messages.clients import Answer, Ask, Failure
from atoll.wire.messages.handshake import GreetingAnswer
from atoll.wire.messages.limits import MAX_MESSAGE
from atoll.wire.messages.workers import Control, Pull, PullAnswer, PullStates, States
from atoll.wire.rejects import Rejects
from atoll.wire.state_transfer import cut
from atoll_coordinator.service.controller import Controller
from atoll_coordinator.service.ports import StorePort
from atoll_coordinator.service.requests.authorization import Admission
from atoll_coordinator.service.requests.clients import Body, Desk
from atoll_coordinator.service.requests.handshake import Greeter


class Answers:
    """Hands each query to whom it concerns."""

    def __init__(
        self, controller: Controller, store: StorePort, greeter: Greeter, desk: Desk, admission: Admission,
        rejects: Rejects,
    ) -> None:  # fmt: skip
        """`rejects` counts questions of clients that are not understood."""
        self._controller = controller
        self._store = store
        self._greeter = greeter
        self._desk = desk
        self._admission = admission
        self._rejects = rejects
        self.broken: StoreError | None = None
        """Why the store failed in the midst of a question, when it did: nothing can go on from there."""

    def answer(self, event: Query) -> bytes | None:
        """Return the answer to a query; None when what it asks for is not there.

        Raises:
            RemoteProtocolError: The query cannot be.
        """
        key = topics.parse(event.key)
        match key:
            case topics.HelloKey():
                return encode(GreetingAnswer(body=self._greeter.answer(event.payload, key.name)))
            case topics.JobKey():
                announcement = self._controller.announcement(key.job)
                return encode(Control(body=announcement)) if announcement is not None else None
            case topics.PlacementKey():
                return encode(Control(body=self._controller.placements(key.job)))
            case topics.StateKey():
                return self._states(key, event.payload)
            case topics.BlobKey():
                return self._chunk(key)
            case topics.ClientKey():
                return encode(Answer(body=self._serve_client(event, key.client)))
            case _:
                raise RemoteProtocolError(f"nothing is served on key {event.key}")

    def _chunk(self, key: topics.BlobKey) -> bytes | None:
        try:
            return self._store.get_chunk(key.digest, key.index)
        except KeyError:
            return None

    def _states(self, key: topics.StateKey, payload: bytes) -> bytes | None:
        """Return states of a committed checkpoint, as many as one message bears; None when it is not there."""
        pull = decode(payload, Pull, MAX_MESSAGE).body
        if not isinstance(pull, PullStates) or pull.job != key.job:
            raise RemoteProtocolError(f"states of job {key.job} were to be asked for, and {pull.kind!r} came")
        try:
            pieces = cut(
                pull.islands,
                pull.offset,
                lambda island: self._store.state(pull.job, pull.variable, pull.epoch, island),
            )
        except KeyError:
            return None
        return encode(PullAnswer(body=States(pieces=pieces)))

    def _serve_client(self, event: Query, client: str) -> Body:
        try:
            ask = decode(event.payload, Ask, MAX_MESSAGE)
        except RemoteProtocolError as error:
            self._rejects.note(event.key, error)
            return Failure(failure="protocol", sentence=f"the coordinator did not understand the question: {error}")
        refusal = self._admission.refuse_ask(client, ask)
        if refusal is not None:
            return Failure(failure="refused", sentence=refusal)
        try:
            return self._desk.answer(ask, self._admission.submitter(client))
        except StoreError as error:
            self.broken = error
            return Failure(failure="internal", sentence=str(error)[:4000])
