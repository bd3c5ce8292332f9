"""Why the processes of one program end: each sentence is printed once, however many processes report it."""

import os
import sys
from collections.abc import Callable
from types import TracebackType
from typing import Final, Self

REPEAT_S: Final = 60.0
"""After this time a sentence may be printed again."""

_MOST_BYTES: Final = 4000
"""Of one sentence; what is written to a pipe at once stays in one piece up to 4096 bytes."""


def complain(sentence: str) -> None:
    """Print why a process ends."""
    sys.stderr.write(f"island-worker: {sentence}\n")


class ExitReasons:
    """A pipe from processes to the one that started them; a context manager. `writing_end` is theirs."""

    def __init__(self, complain: Callable[[str], None] = complain) -> None:
        self._reading_end, self.writing_end = os.pipe()
        os.set_blocking(self._reading_end, False)
        self._complain = complain
        self._rest = b""
        self._printed_at: dict[str, float] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for end in (self._reading_end, self.writing_end):
            os.close(end)

    def report(self, sentence: str) -> None:
        """Have the first process print a sentence; in a fork of it, which has nothing to read here."""
        os.close(self._reading_end)
        report_to(self.writing_end, sentence)

    def print_new(self, now: float) -> None:
        """Print the sentences that were reported, but for those printed within the last `REPEAT_S`."""
        for sentence in self._read():
            if now - self._printed_at.get(sentence, -REPEAT_S) >= REPEAT_S:
                self._printed_at[sentence] = now
                self._complain(sentence)

    def _read(self) -> list[str]:
        """Return the sentences that were reported since the last call."""
        data = self._rest
        while True:
            try:
                more = os.read(self._reading_end, 1 << 16)
            except BlockingIOError:
                break
            data += more
        *lines, self._rest = data.split(b"\n")
        return [line.decode("utf-8", "replace") for line in lines]


def report_to(writing_end: int, sentence: str) -> None:
    """Have the process at the other end print a sentence; when that one is gone, print it here."""
    line = " ".join(sentence.split()).encode()[:_MOST_BYTES] + b"\n"
    try:
        os.write(writing_end, line)
    except OSError:
        complain(sentence)
