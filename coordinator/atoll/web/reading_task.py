"""The task of a process that reads uploaded files, and its limits."""

import signal
from typing import Final, Literal

from pydantic import BaseModel

from atoll_core.machine import total_memory_bytes

TABLE: Final = "application/vnd.atoll.table"
"""Media type of an encoded table, as clients of the bus upload it."""

MAX_BODY: Final = 256 * 1024**2
"""Maximum bytes of the files of a request; larger files must be submitted on the command line."""

READERS: Final = 2
"""Maximum number of files that are read at the same time."""

REFUSED: Final = 3
"""Exit code of a reader whose answer is JSON: status, sentence and columns of an `UnreadableError`."""

LATE: Final = -int(signal.SIGALRM)
"""Exit code of a reader that exceeded the limit `total_s`."""


class ReadingLimits(BaseModel):
    """Limits on reading one file.

    `memory` is in bytes: reading CSV takes 16 times its size (measured: 4.3 GB for 262 MB), and all readers together
    may take half of the machine's memory. `processor_s` is in processor seconds: the largest CSV takes 80. `total_s` is
    in seconds of the clock, for a busy machine or a reader that waits.
    """

    memory: int = min(20 * MAX_BODY, total_memory_bytes() // (2 * READERS) or 20 * MAX_BODY)
    processor_s: int = 120
    total_s: float = 300.0

    def too_much_memory(self, name: str) -> tuple[int, str]:
        """Return the HTTP status and the sentence for a file that takes too much memory."""
        return 413, f"reading {name} takes more than {self.memory // 10**6:,} MB; send fewer rows or columns"

    def of_code(self, code: int, name: str) -> tuple[int, str]:
        """Return HTTP status and sentence for the exit code of a reader; C and Rust libraries abort without memory."""
        if code in (-signal.SIGKILL, -signal.SIGABRT):
            return self.too_much_memory(name)
        if code in (-signal.SIGXCPU, LATE):
            return 422, (
                f"{name} takes more than {self.processor_s} processor seconds, or {self.total_s:.0f} s in total; "
                "send fewer rows, or use coordinator submit"
            )
        return 422, f"reading {name} crashed; save the file again, or as CSV"


class Reading(BaseModel):
    """The task of a reader: write the `wanted` view of files into the file `answer`.

    `options` is JSON; `media_type` says whether the file is an encoded table.
    """

    files: tuple[str, ...]
    answer: str
    wanted: Literal["table", "outline", "preview"]
    options: str
    media_type: str
    limits: ReadingLimits
