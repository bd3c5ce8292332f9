"""The process that reads and smooths files for the web process, each file in a separate fork, within limits.

``python -m atoll.web.reading_process SOCKET`` loads everything once, so that a fork costs milliseconds. Through SOCKET
it receives one descriptor for each file: a socket with a line of JSON, on which it answers with the exit code.
Memory, time and crashes of one file's fork affect nothing else.
"""

import importlib
import json
import os
import resource
import select
import signal
import socket
import sys
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Final, TypeVar

from atoll.web.problems import status_of
from atoll.web.reading import LATE, REFUSED, Limits, Reading
from atoll.web.submission import Submission
from atoll_core.errors import AtollError
from atoll_core.wire.messages.limits import MAX_UPLOAD

T = TypeVar("T")

MAX_ANSWER: Final = 4 * 1024**2
"""Bytes of an outline or preview: enough for `submission.VALUES` values in ten thousand columns."""

MAX_COLUMNS: Final = 1_000
"""Columns named in the refusal of a table, for a page on which one of them can be chosen."""


class TooLargeError(AtollError):
    """Raised when an answer is too large for a page."""


def _json(content: Mapping[str, object]) -> bytes:
    packed = json.dumps(content).encode()
    if len(packed) > MAX_ANSWER:
        raise TooLargeError("the table has too many columns to be shown; submit it, or send fewer columns")
    return packed


ANSWERS: Final[Mapping[str, Callable[[Submission], bytes]]] = {
    "table": lambda submission: submission.table.to_bytes(),
    "outline": lambda submission: _json(submission.outline()),
    "preview": lambda submission: _json(submission.preview()),
}
"""Kinds of answers."""


def main() -> None:
    """Fork for each received socket, until the web process has ended."""
    control = socket.socket(fileno=int(sys.argv[1]))
    _load_ahead()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the system removes ended processes
    while True:
        sent, descriptors, _, _ = socket.recv_fds(control, 1, 1)
        if not sent:
            return
        with (
            socket.socket(fileno=descriptors[0]) as connection,
            suppress(OSError),
        ):  # without a fork it is closed
            _fork(_watch_over, connection)


def _load_ahead() -> None:
    """Load the modules and kernels of reading and smoothing; an error here occurs again where it is answered.

    Not polars: its threads would be missing after a fork.
    """
    for name in ("openpyxl", "h5py"):
        with suppress(Exception):
            importlib.import_module(name)
    with suppress(Exception):
        path = files("atoll.web").joinpath("static/predator_prey.csv")
        Submission.of([Path(str(path))], "{}").preview()


def _fork(work: Callable[[T], int], given: T) -> int:
    """Return the process id of a fork that does `work` and then exits, without returning into its parent's code."""
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        code = work(given)
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def _watch_over(connection: socket.socket) -> int:
    """Fork again, and report the exit code of that fork; kill it when it is late or no longer waited for."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    task = Reading.model_validate_json(connection.makefile("rb").readline())
    ended, held = os.pipe()
    pid = _fork(_answer, task)
    os.close(held)
    with suppress(OSError):
        os.setpgid(pid, pid)
    is_late = not select.select([ended, connection.fileno()], [], [], task.limits.total_s)[0]
    for kill in (os.killpg, os.kill):  # also its own children
        with suppress(OSError):
            kill(pid, signal.SIGKILL)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    with suppress(OSError):  # the web process no longer waits
        connection.sendall(b"%d\n" % (LATE if is_late else code))
    return 0


def _answer(task: Reading) -> int:
    """Write the answer and, next to it, the name of the data; return the exit code."""
    with suppress(OSError):
        os.setpgid(0, 0)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (task.limits.processor_s, task.limits.processor_s + 1))
    resource.setrlimit(resource.RLIMIT_FSIZE, (MAX_UPLOAD, MAX_UPLOAD))
    if sys.platform == "linux":  # elsewhere address space cannot be limited
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
        most = pages * os.sysconf("SC_PAGE_SIZE") + task.limits.memory
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        Path("/proc/self/oom_score_adj").write_text("1000", "ascii")
    paths, answer, code = [Path(file) for file in task.files], Path(task.answer), 0
    submission = None
    try:
        submission = Submission.of(paths, task.options, task.media_type)
        answer.with_name("name").write_text(submission.filenames[0], "utf-8")
        content = ANSWERS[task.wanted](submission)
    except BaseException as error:  # also panics of polars
        status, sentence = _refusal(error, ", ".join(path.name for path in paths), task.limits)
        columns = [] if submission is None else submission.columns()[:MAX_COLUMNS]
        refusal = {"status_code": status, "detail": sentence, "columns": columns}
        content, code = json.dumps(refusal).encode(), REFUSED
    answer.write_bytes(content)
    return code


def _refusal(error: BaseException, name: str, limits: Limits) -> tuple[int, str]:
    causes, cause = [error], error
    while (cause := cause.__cause__ or cause.__context__) is not None and len(causes) < 10:  # type: ignore[assignment]
        causes.append(cause)
    if any(isinstance(cause, MemoryError) for cause in causes):
        return limits.too_much_memory(name)
    if isinstance(error, TooLargeError):
        return 413, str(error)
    if isinstance(error, AtollError):
        return status_of(error), str(error)
    print(f"reading {name!r} broke: {type(error).__name__}: {str(error)[:500]!r}", file=sys.stderr)  # noqa: T201
    return 422, f"reading {name} crashed; save the file again, or as CSV"


if __name__ == "__main__":
    main()
