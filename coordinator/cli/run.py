"""``coordinator run``: everything on this machine, through a real router, as on any number of machines."""

import argparse
import contextlib
import logging
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from common.errors import AtollError, UsageError
from common.wire.views import FINAL_STATES, JobView
from coordinator.cli.follow import FAILED, INTERRUPTED, Follower
from coordinator.cli.local import Coordinator, NoWorkerLeftError, Workers, cores, free_endpoint
from coordinator.cli.output import duration, note, refuse_existing_result, write_result
from coordinator.cli.progress import Display, open_display
from coordinator.cli.request import Request, request_of
from coordinator.cli.signals import raising_interrupts
from coordinator.client import Client, connected

_CONNECT_LIMIT_S: Final = 20.0
_CANCEL_LIMIT_S: Final = 10.0
_WORKER_LOG: Final = "workers.log"
_COORDINATOR_LOG: Final = "coordinator.log"


def run(options: argparse.Namespace) -> int:
    """Search the equations behind ``options.data``; return the exit code."""
    started = time.monotonic()
    request = request_of(options)
    folder = Path(options.out) if options.out is not None else Path("runs") / request.job
    refuse_existing_result(folder)
    with raising_interrupts(), _folder_of_a_run(folder):
        return _Run(request, folder, options.workers or cores(), started).conduct()


class _Run:
    """One local run from start to end."""

    def __init__(self, request: Request, folder: Path, number: int, started: float) -> None:
        self._request = request
        self._folder = folder
        self._started = started
        endpoint = free_endpoint()
        self._endpoint = endpoint
        self._coordinator = Coordinator(endpoint, number)
        self._workers = Workers(endpoint, number, folder / _WORKER_LOG)
        self._forced: int | None = None

    def conduct(self) -> int:
        """Start everything, follow the job, write and print its result, end everything; return the exit code."""
        with self._coordinator, self._workers:
            table = self._request.read()
            self._coordinator.wait()
            with connected(self._endpoint, _CONNECT_LIMIT_S) as client:
                self._request.submit(client, table)
                return self._see_through(client)

    def _see_through(self, client: Client) -> int:
        with open_display("") as display:
            follower = Follower(client, self._request.job, display, self._watch)
            view = self._follow(follower, client, display)
        self._workers.dismiss()
        result = self._request.result(client, view)
        if result is not None:
            path = write_result(self._folder, result)
            self._request.show(result)
            self._sum_up(result, follower.timeline.phases, path)
        code = self._request.finish(view)
        return code if self._forced is None else self._forced

    def _follow(self, follower: Follower, client: Client, display: Display) -> JobView:
        """Follow the job; an interrupt, or the loss of all workers, cancels it and keeps its best equations."""
        try:
            return follower.to_the_end()
        except KeyboardInterrupt:
            display.say("interrupted: keeping the best equations so far; Ctrl-C again ends at once")
            self._forced = INTERRUPTED
        except NoWorkerLeftError as error:
            display.say(f"coordinator: {error}")
            self._forced = FAILED
        return _cancelled(client, self._request.job)

    def _watch(self) -> list[str]:
        self._coordinator.check()
        return self._workers.check()

    def _sum_up(self, result: dict[str, Any], phases: dict[str, float], path: Path) -> None:
        total = time.monotonic() - self._started
        parts = {name: phases.get(name, 0.0) for name in ("compiling kernels", "loading kernels")}
        parts["search"] = float(result["search_seconds"] or 0.0)
        rest = max(0.0, total - sum(parts.values()))
        said = [f"{name} {duration(seconds)}" for name, seconds in parts.items() if seconds]
        note(", ".join([f"start-up {duration(rest)}", *said, f"total {duration(total)}"]))
        note(f"result in {path}")


def _cancelled(client: Client, job: str) -> JobView:
    """Cancel the job and wait, within limits, until it has ended."""
    view = client.cancel(job)
    end = client.now() + _CANCEL_LIMIT_S
    while view.state not in FINAL_STATES and client.now() < end:
        client.pause(0.1)
        view = client.status(job)
    return view


@contextlib.contextmanager
def _folder_of_a_run(folder: Path) -> Iterator[None]:
    """Make the folder and write the coordinator's log there; leave no trace of a run that had nothing to keep."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        log = logging.FileHandler(folder / _COORDINATOR_LOG, encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"the folder {folder} cannot be written ({error.strerror}); name another with --out"
        ) from error
    logging.basicConfig(
        level=logging.INFO, handlers=[log], format="%(asctime)s %(levelname)s %(name)s %(message)s", force=True
    )
    try:
        yield
    except AtollError as error:
        log.close()
        if error.exit_code == UsageError.exit_code:
            _remove_logs(folder)
        raise


def _remove_logs(folder: Path) -> None:
    for name in (_WORKER_LOG, _COORDINATOR_LOG):
        (folder / name).unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # something else is in there
        folder.rmdir()
