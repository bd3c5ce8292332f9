"""A local run: read the data, submit the job, follow it, write and print its result."""

import argparse
import contextlib
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from atoll.cli.exit_codes import FAILED, INTERRUPTED, finish
from atoll.cli.next_step import next_step
from atoll.cli.request import request_of
from atoll.cli.result_files import REPORT, write_report, write_result
from atoll.client.client import Client, connected
from atoll.client.follower import Display, Follower
from atoll.client.local_coordinator import LocalCoordinator
from atoll.client.local_workers import LocalWorkers, NoWorkerLeftError
from atoll.terminal.output import duration, note
from atoll.terminal.progress import is_screen, open_display
from atoll_coordinator.result.result import Result
from atoll_core.wire.messages.views import JobView

_CONNECT_LIMIT_S: Final = 20.0
_WORTH_SAYING_S: Final = 0.05


def run_locally(options: argparse.Namespace, folder: Path, endpoint: str, workers: LocalWorkers, started: float) -> int:
    """Start the coordinator, follow the job, write and print its result; return the exit code.

    `workers` have been started and are ended by the caller; `started` is the monotonic second at which the
    command began. Raises UsageError or DataError.
    """
    request = request_of(options)
    with LocalCoordinator(endpoint, workers.number) as coordinator:
        table = request.read()
        coordinator.wait()

        def check_processes() -> list[str]:
            coordinator.check()
            return workers.check()

        with connected(endpoint, _CONNECT_LIMIT_S) as client:
            request.after(time.monotonic() - started).submit(client, table)
            with open_display("") as display:
                follower = Follower(client, request.job, display, check_processes)
                view, forced = _follow(follower, client, display)
            stays = options.web is not None and forced is None and is_screen()
            if not stays:
                workers.dismiss()
            result = request.result(client, view)
            if result is not None:
                path = write_result(folder, result)
                request.show(result)
                note(_times(result, follower.phases, time.monotonic() - started))
                note(f"result in {path}")
                if options.report:
                    write_report(folder / REPORT, result)
                proposed = next_step(result, folder, sys.argv[1:], program_of(Path(sys.argv[0]), Path.cwd()))
                if proposed is not None:
                    note(f"next: {proposed}")
            if stays:
                _stay(client, check_processes)
            return finish(view) if forced is None else forced


def _follow(follower: Follower, client: Client, display: Display) -> tuple[JobView, int | None]:
    """Follow the job; return its last state, and the exit code of an early end.

    An interrupt, or the loss of all workers, cancels it and keeps its best equations.
    """
    try:
        return follower.follow(), None
    except KeyboardInterrupt:
        display.print_note("interrupted: keeping the best equations so far; Ctrl-C again ends at once")
        forced = INTERRUPTED
    except NoWorkerLeftError as error:
        display.print_note(f"coordinator: {error}")
        forced = FAILED
    return client.cancel_and_wait(follower.job), forced


def program_of(path: Path, here: Path) -> str:
    """Return how the program at `path` is called from `here`: by its path where the shell does not find it."""
    if path.name != "coordinator" or shutil.which("coordinator") is not None:
        return "coordinator"
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


def _stay(client: Client, check_processes: Callable[[], object]) -> None:
    """Let somebody at a terminal look at the page until an interrupt; workers make its report."""
    note("the page stays until Ctrl-C")
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            check_processes()
            client.pause(1.0)


def _times(result: Result, phases: dict[str, float], total: float) -> str:
    """Return what the seconds of a run went into."""
    parts = {name: phases.get(name, 0.0) for name in ("compiling kernels", "loading kernels")}
    parts["search"] = result.search_seconds or 0.0
    refining = phases.get("refining", 0.0)
    parts["refining"] = refining if refining >= _WORTH_SAYING_S else 0.0
    rest = max(0.0, total - sum(parts.values()))
    said = [f"{name} {duration(seconds)}" for name, seconds in parts.items() if seconds]
    return ", ".join([f"start-up {duration(rest)}", *said, f"total {duration(total)}"])
