"""Questions that wait for their answers: each client has its own line, and clients take turns. Pure.

The loop answers one question at a time and takes in between whatever else has come: so nobody's burst of questions
holds up a heartbeat, a report or another client for longer than one answer takes.
"""

from collections import OrderedDict, deque
from typing import Final, Generic, TypeVar

MAX_OF_CLIENT: Final = 32
"""Questions of one client that may wait. The programs of ours ask one after the other; more are refused, and a client
asks again after a pause by itself."""

MAX_WAITING: Final = 4096
"""Questions of all clients that may wait: at 5 ms each, twice what the patience of a client (10 s) would bear."""

MAX_BYTES: Final = 256 * 1024**2
"""Of all questions that wait: sixty-four chunks of tables."""

T = TypeVar("T")


class QuestionQueue(Generic[T]):
    """Lines of questions by client."""

    def __init__(self) -> None:
        self.refused = 0
        """How many were refused, since too many waited already."""
        self._lines: OrderedDict[str, deque[tuple[T, int]]] = OrderedDict()
        self._waiting = self._bytes = 0

    def __len__(self) -> int:
        return self._waiting

    def add(self, client: str, question: T, size: int = 0) -> bool:
        """Let a question of `size` bytes wait; return False when too many do."""
        line = self._lines.get(client, deque())
        is_full = self._waiting >= MAX_WAITING or self._bytes + size > MAX_BYTES
        if is_full or len(line) >= MAX_OF_CLIENT:
            self.refused += 1
            return False
        line.append((question, size))
        self._lines[client] = line
        self._waiting += 1
        self._bytes += size
        return True

    def take(self) -> T | None:
        """Return the question whose turn it is; its client goes to the end."""
        if not self._lines:
            return None
        client, line = self._lines.popitem(last=False)
        question, size = line.popleft()
        self._waiting -= 1
        self._bytes -= size
        if line:
            self._lines[client] = line
        return question
