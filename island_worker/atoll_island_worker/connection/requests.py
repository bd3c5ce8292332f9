"""What a worker says and asks, as puts and questions on the bus; and which question an answer belongs to."""

from dataclasses import dataclass
from typing import Final

from atoll.wire import topics
from atoll.wire.bus.interface import Bus
from atoll.wire.codec import encode
from atoll.wire.messages.workers import Mail, Pull, PullAnswer, PullStates
from atoll_island_worker.session.actions import AskPeer, FetchPlacements, FetchStates, Respond, Send, SendReport

PULL_TIMEOUT_S: Final = 5.0
FETCH_TIMEOUT_S: Final = 20.0

Words = Send | SendReport | AskPeer | Respond | FetchStates | FetchPlacements


@dataclass(frozen=True, slots=True)
class Asked:
    """What a reply will be the answer to: `question` of (`peer` or the coordinator, about `job`), or about `states`."""

    question: str
    subject: str = ""
    index: int = 0
    states: PullStates | None = None


class Voice:
    """One worker's way of saying and asking something."""

    def __init__(self, bus: Bus, name: str) -> None:
        self._bus = bus
        self._name = name
        self._asked: dict[int, Asked] = {}

    @property
    def is_asking(self) -> bool:
        """Whether a question has not come to its end yet."""
        return bool(self._asked)

    def ask(self, key: str, payload: bytes, timeout_s: float, asked: Asked) -> None:
        """Ask for `key`; the reply will be the answer to `asked`."""
        self._asked[self._bus.get(key, payload, timeout_s)] = asked

    def answered(self, token: int) -> Asked | None:
        """Return what a reply is the answer to, once."""
        return self._asked.pop(token, None)

    def say(self, realm: str, words: Words) -> None:
        """Send, answer or ask what the session wants."""
        match words:
            case Send():
                self._bus.put(topics.mail(realm, self._name, words.peer), encode(Mail(body=words.body)))
            case SendReport():
                self._bus.put(topics.worker(realm, self._name, "report"), encode(words.report))
            case AskPeer():
                key = topics.worker(realm, words.peer, "pull")
                self.ask(key, encode(Pull(body=words.body)), PULL_TIMEOUT_S, Asked("pull", words.peer))
            case Respond():
                self._bus.reply(words.handle, encode(PullAnswer(body=words.body)))
            case FetchStates():
                key, asked = topics.state(realm, words.body.job), Asked("states", states=words.body)
                self.ask(key, encode(Pull(body=words.body)), FETCH_TIMEOUT_S, asked)
            case FetchPlacements():
                key, asked = topics.placement(realm, words.job), Asked("placement", words.job)
                self.ask(key, b"", PULL_TIMEOUT_S, asked)
