"""What processes of one program say of their ends: each sentence once, however many of them say it."""

import os
import sys
from collections.abc import Callable
from types import TracebackType
from typing import Final, Self

AGAIN_S: Final = 60.0
"""After this time a sentence may be said again."""

_MOST_BYTES: Final = 4000
"""Of one sentence; what is written to a pipe at once stays in one piece up to 4096 bytes."""


def say(sentence: str) -> None:
    """Tell people why a process ends."""
    sys.stderr.write(f"island-worker: {sentence}\n")


class Sentences:
    """A pipe from processes to the one that started them; a context manager. `writing_end` is theirs."""

    def __init__(self, say: Callable[[str], None] = say) -> None:
        self._reading_end, self.writing_end = os.pipe()
        os.set_blocking(self._reading_end, False)
        self._say = say
        self._rest = b""
        self._said: dict[str, float] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for end in (self._reading_end, self.writing_end):
            os.close(end)

    def hand_over(self, sentence: str) -> None:
        """Have the first process say a sentence; in a fork of it, which has nothing to read here."""
        os.close(self._reading_end)
        hand_over(self.writing_end, sentence)

    def pass_on(self, now: float) -> None:
        """Say what has come, but not what was said within the last `AGAIN_S`."""
        for sentence in self._come():
            if now - self._said.get(sentence, -AGAIN_S) >= AGAIN_S:
                self._said[sentence] = now
                self._say(sentence)

    def _come(self) -> list[str]:
        """Return the sentences that have come."""
        data = self._rest
        while True:
            try:
                more = os.read(self._reading_end, 1 << 16)
            except BlockingIOError:
                break
            data += more
        *lines, self._rest = data.split(b"\n")
        return [line.decode("utf-8", "replace") for line in lines]


def hand_over(writing_end: int, sentence: str) -> None:
    """Have the process at the other end say a sentence; when that one is gone, say it here."""
    line = " ".join(sentence.split()).encode()[:_MOST_BYTES] + b"\n"
    try:
        os.write(writing_end, line)
    except OSError:
        say(sentence)
