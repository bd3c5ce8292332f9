"""Uploaded files: their temporary folders, and reading them in another process, within limits.

The other process gets a `reading_task.Reading` and runs `reading_process`. If a web process is killed, its folders
remain; the user's next web process removes them.
"""

import asyncio
import contextlib
import fcntl
import json
import multiprocessing
import os
import shutil
import signal
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from multiprocessing import forkserver
from pathlib import Path
from typing import Final, Literal

from starlette.exceptions import HTTPException

from atoll.web.problems import UnreadableError
from atoll.web.reading_task import READERS, REFUSED, Reading, ReadingLimits

PREFIX: Final = "atoll-web-"
_LOCK: Final = "lock"

_NOT_FORKED: Final = 255
"""Exit code of a reader when the fork server has ended."""

_FORKS: Final = multiprocessing.get_context("forkserver")
_FORKS.set_forkserver_preload(["atoll.web.reading_process"])


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a lock on a folder during the block; the system releases it when this process ends for any reason."""
    made = folder / f"{_LOCK}.new"
    descriptor = os.open(made, os.O_CREAT | os.O_RDWR, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        made.rename(folder / _LOCK)  # only from now on `remove_left` finds the folder, so it is never found unlocked
        yield
    finally:
        os.close(descriptor)


def remove_left() -> None:
    """Remove the folders of this user whose lock no process holds.

    A folder without a lock is being created; if its process is killed then, the empty folder stays.
    """
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            if folder.is_symlink() or folder.stat().st_uid != os.getuid():
                continue
            descriptor = os.open(folder / _LOCK, os.O_RDWR)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(descriptor)


def split_files(body: Path, sizes: Mapping[str, int | None]) -> list[Path]:
    """Split a body into its files, in a folder next to it; raises HTTPException."""
    folder, there = body.parent / "sent", body.stat().st_size
    folder.mkdir()
    paths = [folder / name for name in sizes]
    lengths = [there if size is None else size for size in sizes.values()]
    if sum(lengths) != there:
        sentence = f"the body has {there:,} bytes, but `bytes` adds up to {sum(lengths):,}; give the size of each file"
        raise HTTPException(422, sentence)
    if len(paths) == 1:
        return [body.rename(paths[0])]
    with body.open("rb") as file:
        for path, size in zip(paths, lengths, strict=True):
            path.write_bytes(file.read(size))
    return paths


class Readers:
    """Reads a few files at a time, each in a fork of a process that has loaded all modules."""

    def __init__(self, limits: ReadingLimits | None = None) -> None:
        self.limits = limits or ReadingLimits()
        self._slots = asyncio.Semaphore(READERS)

    async def read(
        self, files: Sequence[Path], options: str, media_type: str, wanted: Literal["table", "outline", "preview"]
    ) -> Path:
        """Return a file with the `wanted` view of files in one folder; the file is next to that folder. See `Reading`.

        Raises HTTPException if a file or the options are refused, or reading exceeds its limits.
        """
        answer = files[0].parent.parent / "answer"
        task = Reading(
            files=tuple(map(str, files)), answer=str(answer), wanted=wanted, options=options, media_type=media_type,
            limits=self.limits,
        )  # fmt: skip
        async with self._slots:
            code = await _exit_code_of_fork(task)
        if code == REFUSED:
            raise UnreadableError(**json.loads(answer.read_bytes()))
        if code == _NOT_FORKED:
            raise HTTPException(
                503, "files cannot be read at the moment; send the request again in a second", {"retry-after": "1"}
            )
        if code:
            raise HTTPException(*self.limits.of_code(code, ", ".join(file.name for file in files)))
        return answer

    def start(self) -> None:
        """Start the fork server, unless it is running; it ends with this process. Raises OSError."""
        forkserver.ensure_running()


async def _exit_code_of_fork(task: Reading) -> int:
    """Return the exit code of a reader; if the request is cancelled, kill the reader and its children."""
    process, ended = _FORKS.Process(target=_read, args=(task,), daemon=True), asyncio.Event()
    try:
        process.start()
    except (OSError, EOFError):
        return _NOT_FORKED
    loop = asyncio.get_running_loop()
    loop.add_reader(process.sentinel, ended.set)
    try:
        await ended.wait()
    finally:
        loop.remove_reader(process.sentinel)
        process.kill()  # a fork that has just begun has no group of its own yet
        with contextlib.suppress(OSError):
            os.killpg(process.pid or 0, signal.SIGKILL)
        process.join()
    return _NOT_FORKED if process.exitcode is None else process.exitcode


def _read(task: Reading) -> None:
    """Read in a fork, and exit without the interpreter's cleanup, because a file could disturb it."""
    os.setpgid(0, 0)  # first, so that a cancelled request finds the group of this fork and its children
    from atoll.web.reading_process import answer

    os._exit(answer(task))
