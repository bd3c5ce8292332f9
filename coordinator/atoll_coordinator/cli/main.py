"""The entry of the ``coordinator`` program: parse, dispatch, and turn every error into one sentence and an exit code.

Nothing heavy is imported here; each verb's module is imported when it is called.
"""

import contextlib
import importlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit code; as a program (`argv` None) end the process with it.

    Whatever must be closed is closed by then, so the process does not wait for the interpreter to take itself apart,
    which takes long once the libraries for numbers are loaded. Never raises but SystemExit after ``--help``.
    """
    if argv is None:
        from atoll.machine.garbage import collect_rarely

        open_closed_streams()
        collect_rarely()
    code = _guarded(sys.argv[1:] if argv is None else argv)
    if argv is None:
        _flush()
        os._exit(code)
    return code


def _guarded(argv: Sequence[str]) -> int:
    from atoll.errors import AtollError
    from atoll_coordinator.cli.exit_codes import FAILED, INTERRUPTED

    try:
        return _dispatch(argv)
    except AtollError as error:
        return _complain(str(error), error.exit_code)
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        return _forget_stdout()
    except Exception as error:
        if os.environ.get("ATOLL_DEBUG") == "1":
            raise
        return _complain(_record(error), FAILED)


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()


def open_closed_streams() -> None:
    """Let standard streams that were closed before the start lead nowhere, so that no file takes their numbers."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    sys.stdin = sys.stdin or open(0, encoding="utf-8")  # noqa: SIM115  it is open as long as the process
    sys.stdout = sys.stdout or open(1, "w", encoding="utf-8")  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", encoding="utf-8")  # noqa: SIM115


def _dispatch(argv: Sequence[str]) -> int:
    from atoll_coordinator.cli.options.parser import HANDLERS, parse

    options = parse(argv)
    handler = getattr(importlib.import_module(HANDLERS[options.verb]), options.verb)
    code: int = handler(options)
    sys.stdout.flush()
    return code


def _complain(sentence: str, code: int) -> int:
    _flush()
    sys.stderr.write(f"coordinator: {sentence}\n")
    return code


def _forget_stdout() -> int:
    """The reader of our output has gone: be quiet, also when Python flushes at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _record(error: Exception) -> str:
    """Write the traceback of an unexpected error to a file; return the sentence that names it."""
    import tempfile
    import traceback

    folder = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "atoll"
    text = "".join(traceback.format_exception(error))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(".log", "coordinator-", folder)
    except OSError:
        handle, name = tempfile.mkstemp(".log", "atoll-coordinator-")
    with os.fdopen(handle, "w") as file:
        file.write(text)
    return f"an unexpected error ({type(error).__name__}) stopped this command; the details are in {name}"
