"""Questions of clients that wait for their answers: parties take turns (`atoll_core.wire.bus.queues`). Pure.

The loop answers one question at a time and takes in between whatever else has come: so nobody's burst of questions
holds up a heartbeat, a report or another party for longer than one answer takes.
"""

from typing import Final, TypeVar

from atoll_core.wire.bus.queues import Bounds, Turns

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


class QuestionQueue(Turns[T]):
    """Lines of questions by party."""

    def __init__(self) -> None:
        super().__init__(Bounds(MAX_OF_CLIENT, MAX_OF_PARTY, MAX_WAITING, MAX_BYTES_OF_PARTY, MAX_BYTES))
