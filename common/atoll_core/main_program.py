"""Start and end of both programs: standard streams, exit codes, error messages. Few imports."""

import contextlib
import importlib
import os
import sys
from collections.abc import Callable
from typing import NoReturn

from atoll_core.signals import INTERRUPTED, end_at_interrupts, reap_children


def run_program(module: str) -> NoReturn:
    """Import a module, call its `main` with the words of the command line and end the process with its exit code.

    Until the module calls `signals.raise_interrupts`, Ctrl-C ends the process at once: a KeyboardInterrupt during an
    import may be lost or printed as a traceback. The process ends without the interpreter's shutdown, which takes long
    with numerical libraries loaded, and does not wait for a thread that is compiling: `main` has closed everything.
    """
    end_at_interrupts()
    reap_children()
    open_closed_streams()
    from atoll_core.machine import collect_rarely, use_common_instructions

    use_common_instructions(os.environ)
    collect_rarely()
    code: int = importlib.import_module(module).main(sys.argv[1:])
    flush_streams()
    os._exit(code)


def exit_code_of(work: Callable[[], int], complain: Callable[[str], object]) -> int:
    """Do `work` and return its exit code; for an error, call `complain` with its sentence and return its exit code."""
    from atoll_core.errors import AtollError

    try:
        return work()
    except AtollError as error:
        complain(error.on_command_line)
        return error.exit_code
    except KeyboardInterrupt:
        return INTERRUPTED
    except SystemExit as error:  # after --help
        return error.code if isinstance(error.code, int) else 0


def flush_streams() -> None:
    """Flush the standard streams, if their readers still exist."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()


def open_closed_streams() -> None:
    """Connect standard streams that are closed to the null device, so that no other file gets their descriptors."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    sys.stdin = sys.stdin or open(0, encoding="utf-8")  # noqa: SIM115  it is open as long as the process
    sys.stdout = sys.stdout or open(1, "w", encoding="utf-8")  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", encoding="utf-8")  # noqa: SIM115
