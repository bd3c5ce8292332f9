"""Files that are read for pages, outside of this process and within limits: see `reading_process`."""

import asyncio
import json
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from starlette.exceptions import HTTPException

from atoll.client.local_processes import start_apart
from atoll.client.over_http import TOKEN
from atoll.web.problems import UnreadableError
from atoll_core.machine import total_memory_bytes

TABLE: Final = "application/vnd.atoll.table"
"""Content of a table that was read already, as clients of the bus upload it."""

MAX_BODY: Final = 256 * 1024**2
"""Bytes of a file that is sent; larger ones are submitted on the command line."""

READERS: Final = 2
"""Files that are read at the same time; others wait."""

REFUSED: Final = 3
"""Exit code of a reader whose answer is JSON: status, sentence and columns of an `UnreadableError`."""

LATE: Final = -int(signal.SIGALRM)
"""What is told in place of the exit code of a reader that took too long in all."""


@dataclass(frozen=True)
class Limits:
    """What reading one file may take.

    `memory` is in bytes: CSV takes 16 times its size (measured: 4.3 GB for 262 MB), and all that are read shall not
    take more than half of the machine. `processor_s` are seconds of a processor: the largest CSV takes 80. `total_s`
    are seconds in all, where the machine is busy or a reader waits for something.
    """

    memory: int = min(20 * MAX_BODY, total_memory_bytes() // (2 * READERS) or 20 * MAX_BODY)
    processor_s: int = 120
    total_s: float = 300.0

    def too_much_memory(self, name: str) -> tuple[int, str]:
        """Return status and sentence for a file that takes too much memory."""
        return 413, f"{name} takes more than {self.memory // 10**6:,} MB when it is read; send fewer rows or columns"

    def of_code(self, code: int, name: str) -> tuple[int, str]:
        """Return status and sentence for a reader that ended so; libraries in C and Rust abort without memory."""
        if code in (-signal.SIGKILL, -signal.SIGABRT):
            return self.too_much_memory(name)
        if code in (-signal.SIGXCPU, LATE):
            return 422, (
                f"{name} takes more than {self.processor_s} s of a processor, or {self.total_s:.0f} s in all; "
                "send fewer rows, or use coordinator submit"
            )
        return 422, f"{name} broke the program that reads it; save it anew, or as CSV"


@dataclass(frozen=True)
class Asked:
    """What is asked of a reader: what is `made` ("table", "outline" or "preview") of files, and written to `answer`.

    `options` are JSON, `media_type` says whether the file is a table already.
    """

    files: tuple[str, ...]
    answer: str
    made: str
    options: str
    media_type: str
    limits: Limits

    @classmethod
    def of(cls, line: bytes) -> "Asked":
        """Return what `to_line` wrote."""
        values = json.loads(line)
        return cls(**values | {"limits": Limits(**values["limits"])})

    def to_line(self) -> bytes:
        """Return it as a line of JSON."""
        return json.dumps(asdict(self)).encode() + b"\n"


def split_files(body: Path, sizes: Mapping[str, int | None]) -> list[Path]:
    """Return files by name that are one after the other in a body, in a folder beside it; raises HTTPException."""
    folder, there = body.parent / "sent", body.stat().st_size
    folder.mkdir()
    paths = [folder / name for name in sizes]
    lengths = [there if size is None else size for size in sizes.values()]
    if sum(lengths) != there:
        sentence = f"the body has {there:,} bytes, but bytes says {sum(lengths):,}; give those of each file"
        raise HTTPException(422, sentence)
    if len(paths) == 1:
        return [body.rename(paths[0])]
    with body.open("rb") as file:
        for path, size in zip(paths, lengths, strict=True):
            path.write_bytes(file.read(size))
    return paths


class Readers:
    """Has files read, a few at a time, by a process that is started anew where it has died."""

    def __init__(self, limits: Limits | None = None) -> None:
        self.limits = limits or Limits()
        self._slots = asyncio.Semaphore(READERS)
        self._process: subprocess.Popen[bytes] | None = None
        self._control: socket.socket | None = None

    @property
    def pid(self) -> int | None:
        """The number of the process, if there is one."""
        return None if self._process is None else self._process.pid

    async def read(self, files: Sequence[Path], options: str, media_type: str, made: str) -> Path:
        """Return the file in which is what is made of files in one folder, beside that folder; see `Asked`.

        Raises HTTPException: a file or the options are refused, or reading takes more than it may.
        """
        answer = files[0].parent.parent / "answer"
        asked = Asked(tuple(map(str, files)), str(answer), made, options, media_type, self.limits)
        async with self._slots:
            code = await self._ask_reader(asked.to_line())
        if code == REFUSED:
            raise UnreadableError(**json.loads(answer.read_bytes()))
        if code is None:
            raise HTTPException(503, "files cannot be read at the moment; ask again", {"retry-after": "1"})
        if code:
            raise HTTPException(*self.limits.of_code(code, ", ".join(file.name for file in files)))
        return answer

    async def _ask_reader(self, line: bytes) -> int | None:
        """Return the exit code of a reader; None where there was none, and no process to start it."""
        ours, theirs = socket.socketpair()
        with theirs:
            is_sent = self._send(theirs) or self._send(theirs)
        reader, writer = await asyncio.open_connection(sock=ours)
        try:
            writer.write(line)
            said = await reader.readline() if is_sent else b""
        except OSError:
            return None
        finally:
            writer.close()
        return int(said) if said else None

    def _send(self, theirs: socket.socket) -> bool:
        try:
            self.start()
            assert self._control is not None
            socket.send_fds(self._control, [b"r"], [theirs.fileno()])
        except OSError:
            self.close()
            return False
        return True

    def start(self) -> None:
        """Start the process, if there is none; raises OSError."""
        if self._control is not None:
            return
        self._control, theirs = socket.socketpair()
        with theirs:
            command = [sys.executable, "-P", "-m", "atoll.web.reading_process", str(theirs.fileno())]
            given = {TOKEN: "", "OPENBLAS_NUM_THREADS": "1"}  # no thread may be there when it forks
            self._process = start_apart(
                command, given, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, pass_fds=[theirs.fileno()]
            )

    def close(self) -> None:
        """End the process; what is being read ends, too, since nobody waits for it."""
        if self._control is not None:
            self._control.close()
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._control = self._process = None
