"""``coordinator run``: a search on this machine, through a real router, in the same way as on many machines.

Workers are started before this process loads its own modules: both steps take about half a second and overlap.
"""

import argparse
import contextlib
import logging
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from atoll.cli.exit_codes import BAD_INPUT, INTERRUPTED
from atoll.cli.parser import job_id
from atoll.cli.result_files import refuse_existing_result
from atoll.client.local_processes import local_processes
from atoll_core.errors import DataError, UsageError
from atoll_core.logs import configure
from atoll_core.machine import usable_cores
from atoll_core.signals import raising_interrupts

_WORKER_LOG: Final = "workers.log"
_COORDINATOR_LOG: Final = "coordinator.log"


def run(options: argparse.Namespace) -> int:
    """Search equations for the files ``options.data``; return the exit code."""
    started = time.monotonic()
    if options.dry_run:
        from atoll.cli.request import request_of

        return request_of(options).rehearse()
    options.id = job_id(options.id)
    folder = Path(options.out) if options.out is not None else Path("runs") / options.id
    refuse_existing_result(folder)
    number = options.workers or usable_cores(os.environ)[0]
    with (
        _log_in(folder),
        raising_interrupts(),
        local_processes(number, folder / _WORKER_LOG) as (endpoint, workers),
        _web_process(endpoint, options.web),
    ):
        from atoll.cli.verbs.submit import run_locally

        code = run_locally(options, folder, endpoint, workers, started)
    if code in (BAD_INPUT, INTERRUPTED):
        _remove_logs(folder)
    return code


def _web_process(endpoint: str, listen: tuple[str, int] | None) -> contextlib.AbstractContextManager[None]:
    """Run ``coordinator web`` during the block if `listen` is given. Its modules are loaded only then."""
    if listen is None:
        return contextlib.nullcontext()
    from atoll.cli.verbs.web import web_process

    return web_process(endpoint, listen)


@contextlib.contextmanager
def _log_in(folder: Path) -> Iterator[None]:
    """Create the folder and write the coordinator's log into it during the block; raises UsageError.

    If bad input or an interrupt ends the block, the logs are removed.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        log = logging.FileHandler(folder / _COORDINATOR_LOG, encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"the folder {folder} cannot be written ({error.strerror}); name another with --out"
        ) from error
    configure(handler=log)
    try:
        yield
    except (UsageError, DataError, KeyboardInterrupt):
        _remove_logs(folder)
        raise
    finally:
        configure(handler=logging.NullHandler())  # the file may be gone


def _remove_logs(folder: Path) -> None:
    """Remove the logs, and the empty folder, of a run without a result."""
    if (folder / "result.json").exists():
        return
    for name in (_WORKER_LOG, _COORDINATOR_LOG):
        (folder / name).unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # the folder has other files
        folder.rmdir()
