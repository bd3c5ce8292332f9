"""Reads and smooths files for the web process, each file in a separate fork, within limits.

The fork server of `multiprocessing` loads this module once, with all modules for reading, so that a fork takes
milliseconds. A fork that needs too much memory or time, or crashes, affects no other process.
"""

import importlib
import json
import os
import resource
import signal
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Final

from atoll.web.problems import status_of
from atoll.web.reading_task import REFUSED, Reading, ReadingLimits
from atoll.web.submission import Submission
from atoll_core.errors import AtollError
from atoll_core.wire.messages.limits import MAX_UPLOAD

MAX_ANSWER: Final = 4 * 1024**2
"""Maximum bytes of an outline or preview: enough for `submission.VALUES` values in ten thousand columns."""

MAX_COLUMNS: Final = 1_000
"""Maximum number of columns named in the refusal of a table; the page lets the user choose one of them."""


class TooLargeError(AtollError):
    """Raised when an answer is too large for a page."""


def _json(content: Mapping[str, object]) -> bytes:
    packed = json.dumps(content).encode()
    if len(packed) > MAX_ANSWER:
        raise TooLargeError(
            "the table has too many columns to be shown; submit it without a preview, or send fewer columns"
        )
    return packed


ANSWERS: Final[Mapping[str, Callable[[Submission], bytes]]] = {
    "table": lambda submission: submission.table.to_bytes(),
    "outline": lambda submission: _json(submission.outline()),
    "preview": lambda submission: _json(submission.preview()),
}
"""Kinds of answers."""


def _load_ahead() -> None:
    """Load the modules and kernels for reading and smoothing; an error here occurs again in a fork, which reports it.

    Polars is not loaded, because its threads would be missing after a fork.
    """
    for name in ("openpyxl", "h5py"):
        with suppress(Exception):
            importlib.import_module(name)
    with suppress(Exception):
        path = files("atoll.web").joinpath("static/predator_prey.csv")
        Submission.of([Path(str(path))], "{}").preview()


def answer(task: Reading) -> int:
    """Write the answer of a fork and, next to it, a file with the name of the data; return the exit code."""
    signal.setitimer(signal.ITIMER_REAL, max(task.limits.total_s, 1e-3))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (task.limits.processor_s, task.limits.processor_s + 1))
    resource.setrlimit(resource.RLIMIT_FSIZE, (MAX_UPLOAD, MAX_UPLOAD))
    if sys.platform == "linux":  # other systems cannot limit the address space
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
        most = pages * os.sysconf("SC_PAGE_SIZE") + task.limits.memory
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        Path("/proc/self/oom_score_adj").write_text("1000", "ascii")
    paths, place, code = [Path(file) for file in task.files], Path(task.answer), 0
    submission = None
    try:
        submission = Submission.of(paths, task.options, task.media_type)
        place.with_name("name").write_text(submission.filenames[0], "utf-8")
        content = ANSWERS[task.wanted](submission)
    except BaseException as error:  # also panics of polars
        status, sentence = _refusal(error, ", ".join(path.name for path in paths), task.limits)
        columns = [] if submission is None else submission.columns()[:MAX_COLUMNS]
        refusal = {"status_code": status, "detail": sentence, "columns": columns}
        content, code = json.dumps(refusal).encode(), REFUSED
    place.write_bytes(content)
    return code


def _refusal(error: BaseException, name: str, limits: ReadingLimits) -> tuple[int, str]:
    causes, cause = [error], error
    while (cause := cause.__cause__ or cause.__context__) is not None and len(causes) < 10:  # type: ignore[assignment]
        causes.append(cause)
    if any(isinstance(cause, MemoryError) for cause in causes):
        return limits.too_much_memory(name)
    if isinstance(error, TooLargeError):
        return 413, str(error)
    if isinstance(error, AtollError):
        return status_of(error), str(error)
    print(f"reading {name!r} failed: {type(error).__name__}: {str(error)[:500]!r}", file=sys.stderr)  # noqa: T201
    return 422, f"reading {name} crashed; save the file again, or as CSV"


_load_ahead()
