"""Questions that wait for their answers: parties take turns, and within each its clients do. Pure.

A party is a user, and without certificates a session on the bus, of which each may use thousands of names of clients.
The loop answers one question at a time and takes in between whatever else has come: so nobody's burst of questions
holds up a heartbeat, a report or another party for longer than one answer takes.
"""

from collections import OrderedDict, deque
from typing import Final, Generic, TypeVar

MAX_OF_CLIENT: Final = 32
"""Questions of one client that may wait. The programs of ours ask one after the other; more are refused, and a client
asks again after a pause by itself."""

MAX_OF_PARTY: Final = 512
"""Questions of one party that may wait, an eighth of all."""

MAX_WAITING: Final = 4096
"""Questions of all parties that may wait: at 5 ms each, twice what the patience of a client (10 s) would bear."""

MAX_BYTES_OF_PARTY: Final = 64 * 1024**2
"""Of the questions of one party: sixteen chunks of tables."""

MAX_BYTES: Final = 256 * 1024**2
"""Of all questions that wait: sixty-four chunks of tables."""

T = TypeVar("T")


class _Line(Generic[T]):
    """The questions of one party, by client, with their sizes."""

    def __init__(self) -> None:
        self.waiting = self.bytes = 0
        self._clients: OrderedDict[str, deque[tuple[T, int]]] = OrderedDict()

    def has_room(self, client: str, size: int) -> bool:
        is_full = self.waiting >= MAX_OF_PARTY or self.bytes + size > MAX_BYTES_OF_PARTY
        return not is_full and len(self._clients.get(client, ())) < MAX_OF_CLIENT

    def add(self, client: str, question: T, size: int) -> None:
        self._clients.setdefault(client, deque()).append((question, size))
        self.waiting += 1
        self.bytes += size

    def take(self) -> tuple[T, int]:
        """Return the question of the client whose turn it is; the client goes to the end."""
        client, questions = self._clients.popitem(last=False)
        question, size = questions.popleft()
        if questions:
            self._clients[client] = questions
        self.waiting -= 1
        self.bytes -= size
        return question, size


class QuestionQueue(Generic[T]):
    """Lines of questions by party."""

    def __init__(self) -> None:
        self.refused = 0
        """How many were refused, since too many waited already."""
        self._lines: OrderedDict[str, _Line[T]] = OrderedDict()
        self._waiting = self._bytes = 0

    def __len__(self) -> int:
        return self._waiting

    def add(self, party: str, client: str, question: T, size: int = 0) -> bool:
        """Let a question of `size` bytes wait; return False when too many do."""
        line = self._lines.get(party) or _Line[T]()
        is_full = self._waiting >= MAX_WAITING or self._bytes + size > MAX_BYTES
        if is_full or not line.has_room(client, size):
            self.refused += 1
            return False
        line.add(client, question, size)
        self._lines[party] = line
        self._waiting += 1
        self._bytes += size
        return True

    def take(self) -> T | None:
        """Return the question whose turn it is; its party goes to the end."""
        if not self._lines:
            return None
        party, line = self._lines.popitem(last=False)
        question, size = line.take()
        self._waiting -= 1
        self._bytes -= size
        if line.waiting:
            self._lines[party] = line
        return question
