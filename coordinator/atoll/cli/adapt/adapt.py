"""The verb that keeps as many jobs of a batch system with workers as the coordinator's queue has work for."""

import argparse
import logging
import shlex
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from atoll.cli.adapt.adapt_policy import AdaptPolicy, Decision, Limits, Need
from atoll.cli.adapt.batch import Batch
from atoll.cli.adapt.batch_systems import SYSTEMS, BatchError
from atoll.cli.exit_codes import DONE
from atoll.cli.request import CONNECT_LIMIT_S, bus_address_of
from atoll.client.client import Client, connected
from atoll.terminal.output import note, say
from atoll_core.errors import UnreachableError, UsageError
from atoll_core.logs import configure, fields
from atoll_core.machine import job_of
from atoll_core.signals import stopping
from atoll_core.wire.addresses import Destination
from atoll_core.wire.messages.views import WorkerView

_LOG = logging.getLogger(__name__)


def adapt(options: argparse.Namespace) -> int:
    """Keep jobs of a batch system until SIGTERM or Ctrl-C; return 0. The jobs stay."""
    if options.minimum > options.maximum:
        raise UsageError(f"--minimum {options.minimum} is more than --maximum {options.maximum}")
    configure(options.log_format, options.log_level)
    address, stop = bus_address_of(options), threading.Event()
    with stopping(stop):
        with connected(address, CONNECT_LIMIT_S) as client:
            name = f"atoll-{client.welcome.realm}"
        given = [*_words(options.sbatch, "--sbatch"), *_words(options.batch_options, "--batch-options")]
        batch = Batch(SYSTEMS[options.batch], name, worker_command(options, address), options.cores, given)
        limits = Limits(options.minimum, options.maximum, options.cores, options.idle)
        batch.jobs()
        say(
            f"adapt keeps {limits.minimum} to {limits.maximum} jobs of {batch.title} called {name}, {limits.workers} "
            f"workers each, for the coordinator at {address}"
        )
        Adapting(address, batch, AdaptPolicy(limits), options.wait).run(stop, options.interval)
    note(f"coordinator adapt: stopped; its jobs of {batch.title} stay, and end by: {batch.how_to_end}")
    return DONE


def worker_command(options: argparse.Namespace, address: Destination) -> list[str]:
    """Return the command of a job's workers; the program is the one beside ours unless another was given."""
    program = _words(options.worker, "--worker") or [str(Path(sys.executable).with_name("island-worker"))]
    return [*program, "--connect", str(address), "--processes", str(options.cores), "--wait", f"{options.wait:g}"]


def _words(text: str | None, option: str) -> list[str]:
    try:
        return shlex.split(text or "")
    except ValueError as error:
        raise UsageError(f"{option} {text!r} cannot be split into words ({error}); see to its quotes") from error


class Adapting:
    """Looks at the coordinator and at the batch system, and does what the policy says.

    Either may be away for `patience_s` seconds; meanwhile nothing is changed.
    """

    def __init__(self, address: Destination, batch: Batch, policy: AdaptPolicy, patience_s: float) -> None:
        self._address = address
        self._batch = batch
        self._policy = policy
        self._patience_s = patience_s
        self._has_submitted = False
        self._failed_since: float | None = None

    def run(self, stop: threading.Event, interval_s: float) -> None:
        """Look every so many seconds until `stop` is set.

        Raises:
            UnreachableError, BatchError: the coordinator or the batch system has been away for too long.
            AtollError: job after job ends without that a worker has joined.
        """
        while not stop.is_set():
            try:
                self._look(time.monotonic())
                self._failed_since = None
            except (UnreachableError, BatchError) as error:
                self._tolerate(error, time.monotonic())
            stop.wait(interval_s)

    def _look(self, now: float) -> None:
        with connected(self._address, CONNECT_LIMIT_S) as client:
            jobs = self._batch.jobs()
            need = need_of(client, {job.id for job in jobs})
        self._do(self._policy.decide(now, need, jobs), need)

    def _do(self, decision: Decision, need: Need) -> None:
        for _ in range(decision.submit):
            job = self._batch.submit()
            self._has_submitted = True
            _LOG.info("submitted", extra=fields(batch_job=job, workers_wanted=need.workers))
        self._end(decision.take_back, self._batch.take_back, "taken back", need)
        self._end(decision.drain, self._batch.drain, "told to drain", need)

    def _end(self, jobs: Sequence[str], end: Callable[[str], None], done: str, need: Need) -> None:
        """End each of these jobs. One that fails has usually just ended by itself; if not, it is decided on again."""
        for job in jobs:
            try:
                end(job)
                _LOG.info(done, extra=fields(batch_job=job, workers_wanted=need.workers))
            except BatchError as error:
                self._policy.forget(job)
                _LOG.warning("not ended", extra=fields(batch_job=job, reason=str(error)))

    def _tolerate(self, error: UnreachableError | BatchError, now: float) -> None:
        """Take in a failure; raise it when it lasts, or when the system has never accepted a job with these options."""
        if isinstance(error, BatchError) and not self._has_submitted:
            raise error
        if self._failed_since is None:
            self._failed_since = now
            _LOG.warning("nothing is changed for now", extra=fields(reason=str(error)))
        elif now - self._failed_since > self._patience_s:
            raise error


def need_of(client: Client, jobs: set[str]) -> Need:
    """Return what the coordinator says, where `jobs` are the ids of ours."""
    depth, workers = client.queue_depth(), [view for view in client.workers() if view.state not in ("lost", "leaving")]
    ours = {job: _islands(workers, job) for job in {job_of(view.worker) for view in workers} & jobs if job is not None}
    others = sum(job_of(view.worker) not in jobs for view in workers)
    return Need(depth.workers_wanted, others, ours)


def _islands(workers: Sequence[WorkerView], job: str) -> int:
    return sum(view.islands for view in workers if job_of(view.worker) == job)
