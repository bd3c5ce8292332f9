"""The ``coordinator`` program: parses the options, calls the verb, turns every error into a sentence and an exit code.

This module imports nothing heavy: the module of a verb is imported when the verb is called.
"""

import contextlib
import importlib
import os
import sys
from collections.abc import Sequence
from typing import Final

from atoll_core.main_program import exit_code_of, flush_streams
from atoll_core.signals import raise_interrupts

_READERS: Final = frozenset({"result", "simulate", "analyse", "report", "suggest", "compare", "export"})
_MAY_BE_EDITED: Final = "; if the result file was edited, use the original file"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line (None: `sys.argv`) and return its exit code."""
    words = sys.argv[1:] if argv is None else argv
    try:
        return exit_code_of(lambda: _dispatch(words), _print_error)
    except BrokenPipeError:  # the program that reads our output has ended
        # Python flushes stdout at exit; without a reader this would print a message
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if os.environ.get("ATOLL_DEBUG") == "1":
            raise
        from atoll.cli.exit_codes import FAILED

        _print_error(_record(error) + (_MAY_BE_EDITED if words[0] in _READERS else ""))
        return FAILED


def _dispatch(argv: Sequence[str]) -> int:
    from atoll.cli.parser import VERBS, parse

    options = parse(argv)
    handler = getattr(importlib.import_module(f"atoll.cli.{VERBS[options.verb][0]}"), options.verb)
    raise_interrupts()
    code: int = handler(options)
    sys.stdout.flush()
    return code


def _print_error(sentence: str) -> None:
    from atoll_core.quoting import visible

    flush_streams()
    with contextlib.suppress(OSError):  # a full disk: the exit code still shows the error
        sys.stderr.write(f"coordinator: {visible(sentence)}\n")
        sys.stderr.flush()


def _record(error: Exception) -> str:
    """Write the traceback of an unexpected error to a file; return the sentence that names it."""
    import tempfile
    import traceback

    from atoll_core.errors import UsageError
    from atoll_core.machine import user_folder
    from atoll_core.redaction import without_secrets

    text = without_secrets("".join(traceback.format_exception(error)))
    try:
        folder = user_folder("XDG_STATE_HOME", ".local/state") / "atoll"
        folder.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(".log", "coordinator-", folder)
    except (OSError, UsageError):
        handle, name = tempfile.mkstemp(".log", "atoll-coordinator-")
    with os.fdopen(handle, "w") as file:
        file.write(text)
    message = f"an unexpected error ({type(error).__name__}) stopped this command"
    return f"{message}; please report it, with the details in {name}"
