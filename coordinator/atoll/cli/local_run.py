"""A local run: read the data, submit the job, follow it, write and print its result."""

import argparse
import sys
import time
from pathlib import Path
from typing import Any, Final

from atoll.cli.exit_codes import FAILED, INTERRUPTED
from atoll.cli.next_step import next_step
from atoll.cli.request import request_of
from atoll.cli.result_files import REPORT, write_report, write_result
from atoll.client.client import Client, connected
from atoll.client.follower import Display, Follower
from atoll.client.local_coordinator import LocalCoordinator
from atoll.client.local_workers import LocalWorkers, NoWorkerLeftError
from atoll.terminal.output import duration, note
from atoll.terminal.progress import open_display
from atoll_coordinator.service.background.process_pool import ProcessPool
from atoll_core.wire.messages.views import JobView

_CONNECT_LIMIT_S: Final = 20.0
_WORTH_SAYING_S: Final = 0.05


class LocalRun:
    """One run, whose workers and pool have been started already and are ended by the caller."""

    def __init__(
        self, options: argparse.Namespace, folder: Path, endpoint: str, workers: LocalWorkers, pool: ProcessPool,
        started: float,
    ) -> None:  # fmt: skip
        """`started` is the monotonic second at which the command began; raises UsageError or DataError."""
        self._request = request_of(options)
        self._has_report: bool = options.report
        self._folder = folder
        self._endpoint = endpoint
        self._workers = workers
        self._started = started
        self._coordinator = LocalCoordinator(endpoint, workers.number, pool)
        self._forced: int | None = None

    def run(self) -> int:
        """Start the coordinator, follow the job, write and print its result; return the exit code."""
        with self._coordinator:
            table = self._request.read()
            self._coordinator.wait()
            with connected(self._endpoint, _CONNECT_LIMIT_S) as client:
                self._request.after(time.monotonic() - self._started).submit(client, table)
                return self._follow_job(client)

    def _follow_job(self, client: Client) -> int:
        with open_display("") as display:
            follower = Follower(client, self._request.job, display, self._check_processes)
            view = self._follow(follower, client, display)
        self._workers.dismiss()
        result = self._request.result(client, view)
        if result is not None:
            path = write_result(self._folder, result)
            self._request.show(result)
            self._print_times(result, follower.timeline.phases, path)
            if self._has_report:
                write_report(path.with_name(REPORT), result)
            proposed = next_step(result, self._folder, sys.argv[1:])
            if proposed is not None:
                note(f"next: {proposed}")
        return self._request.finish(view) if self._forced is None else self._forced

    def _follow(self, follower: Follower, client: Client, display: Display) -> JobView:
        """Follow the job; an interrupt, or the loss of all workers, cancels it and keeps its best equations."""
        try:
            return follower.follow()
        except KeyboardInterrupt:
            display.print_note("interrupted: keeping the best equations so far; Ctrl-C again ends at once")
            self._forced = INTERRUPTED
        except NoWorkerLeftError as error:
            display.print_note(f"coordinator: {error}")
            self._forced = FAILED
        return client.cancel_and_wait(self._request.job)

    def _check_processes(self) -> list[str]:
        self._coordinator.check()
        return self._workers.check()

    def _print_times(self, result: dict[str, Any], phases: dict[str, float], path: Path) -> None:
        total = time.monotonic() - self._started
        parts = {name: phases.get(name, 0.0) for name in ("compiling kernels", "loading kernels")}
        parts["search"] = float(result["search_seconds"] or 0.0)
        refining = phases.get("refining", 0.0)
        parts["refining"] = refining if refining >= _WORTH_SAYING_S else 0.0
        rest = max(0.0, total - sum(parts.values()))
        said = [f"{name} {duration(seconds)}" for name, seconds in parts.items() if seconds]
        note(", ".join([f"start-up {duration(rest)}", *said, f"total {duration(total)}"]))
        note(f"result in {path}")
