"""Many jobs of many users while workers and the coordinator are killed: all must end, with the digests of a plain run.

A coordinator and four workers are programs of this machine. Users are clients with names of their own, each of which
submits several jobs at once and follows them to their ends. Meanwhile workers are killed (SIGKILL) and started again,
and now and then the coordinator. The lag of the loop is read from its metrics, its memory from the system's account.
"""

import re
import socket
import statistics
import sys
import threading
import time
import urllib.request
from argparse import Namespace
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from atoll.client.client import Client, connected
from atoll.client.follower import Subscription
from atoll.terminal.output import note, say
from atoll_core.config import JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import AtollError, UnreachableError
from atoll_core.wire.bus.zenoh_bus import open_client
from atoll_core.wire.messages.views import FINAL_STATES, JobView
from benchmarks.harness.accounts import status
from benchmarks.harness.command_line import OUT, option, positive, program, whole, workers
from benchmarks.harness.jobs import configured, table_of_columns
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import CONNECT_LIMIT_S, COORDINATOR, Machines, running
from benchmarks.harness.tables import Columns
from benchmarks.operations.strikes import Strike, Strikes

GOAL_LAG_S: Final = 0.05
LIMIT_S: Final = 1800.0
RECOVERY_LIMIT_S: Final = 120.0
_LAG: Final = re.compile(r'^atoll_loop_lag_seconds_bucket\{le="([^"]+)"\} (\S+)$', re.MULTILINE)


@dataclass
class Watched:
    """What is seen of the coordinator: probes of its loop by the bound of their lag, and its memory."""

    url: str
    lags: Counter[float] = field(default_factory=Counter)
    resident: list[int] = field(default_factory=list)
    _seen: Counter[float] = field(default_factory=Counter)

    def look(self, pid: int) -> None:
        """Read how it is; it may be away."""
        with suppress(OSError, AtollError):
            self.resident.append(status(pid, "VmRSS"))
            with urllib.request.urlopen(self.url, timeout=10.0) as answer:
                text = answer.read().decode()
            self._seen = Counter({float(bound): int(float(number)) for bound, number in _LAG.findall(text)})

    def bury(self) -> None:
        """Take in that this life of the coordinator has ended: the next one counts from the beginning."""
        self.lags.update(self._seen)
        self._seen = Counter()

    def lag(self, share: float) -> float:
        """Return the bound below which so many of the probes lie; the bounds are those of the histogram, in seconds."""
        total = max(self.lags.values(), default=0)
        return min((bound for bound, number in self.lags.items() if number >= share * total), default=float("nan"))


@dataclass(frozen=True)
class Ended:
    """A job at its end; `seconds` since it was submitted."""

    job: str
    user: str
    state: str
    is_equal: bool
    seconds: float


@dataclass(frozen=True)
class Waited:
    """How long a user waited for half of the jobs, and for all, in seconds."""

    user: str
    median: float
    last: float


class User(threading.Thread):
    """One user, who submits jobs of these seeds at once and follows each to its end."""

    def __init__(self, address: str, name: str, table: bytes, seeds: list[int], digests: dict[int, str]) -> None:
        super().__init__(name=name, daemon=True)
        self.ended: list[Ended] = []
        self.error: Exception | None = None
        self._address, self._table, self._seeds, self._digests = address, table, seeds, digests

    def run(self) -> None:
        """Be a user."""
        try:
            with open_client(self._address, wait_s=CONNECT_LIMIT_S) as bus:
                self._work(Client(bus, self._address, self.name))
        except Exception as error:  # told where the users are waited for
            self.error = error

    def _work(self, client: Client) -> None:
        began = time.monotonic()
        jobs = {f"{self.name}-job-{number}": seed for number, seed in enumerate(self._seeds)}
        for job, seed in jobs.items():
            _patiently(lambda job=job, seed=seed: client.hand_in(job, job, config_of(seed), self._table))
        for job, seed in jobs.items():
            view = followed(client, job)
            digest = _patiently(lambda job=job: client.result(job)).get("digest") if view.state == "done" else None
            seconds = time.monotonic() - began
            self.ended.append(Ended(job, self.name, view.state, digest == self._digests[seed], seconds))


def _patiently(ask, limit_s: float = LIMIT_S):  # type: ignore[no-untyped-def]
    """Ask again while the coordinator is away."""
    end = time.monotonic() + limit_s
    while True:
        try:
            return ask()
        except UnreachableError:
            if time.monotonic() > end:
                raise


def followed(client: Client, job: str) -> JobView:
    """Follow a job to its end, over the coordinator's deaths."""
    subscription, end = Subscription(client, job), time.monotonic() + LIMIT_S
    while time.monotonic() < end:
        with suppress(UnreachableError):
            change = subscription.wait(1.0)
            if change is not None and change.view is not None and change.view.state in FINAL_STATES:
                return change.view
    raise AtollError(f"job {job} has not ended within {LIMIT_S:.0f} s")


def config_of(seed: int) -> JobConfig:
    """Return a small job: y as a function of x, some epochs on four islands."""
    budget = {"max_epochs": 40, "max_time": None}
    return configured(seed, {"target": "y"}, budget, ("+", "-", "*", "/", "sin"), islands=4)


def table() -> Table:
    """Return rows of a function that is found within some epochs; without noise, so that refining takes no time."""
    x = np.linspace(-3.0, 3.0, 120)
    return table_of_columns({"x": x, "y": np.sin(2.0 * x) / (1.0 + x * x) + 0.5 * x}, "curve")


def plain_digests(client: Client, data: bytes, seeds: int) -> dict[int, str]:
    """Search each seed once in peace; return the digests."""
    digests = {}
    for seed in range(seeds):
        client.hand_in(f"plain-{seed}", f"plain-{seed}", config_of(seed), data)
        view = followed(client, f"plain-{seed}")
        if view.state != "done":
            raise AtollError(f"the plain run of seed {seed} is {view.state}: {view.reason}")
        digests[seed] = str(client.result(f"plain-{seed}")["digest"])
    return digests


def kill_until(
    over: threading.Event, machines: Machines, watched: Watched, period_s: float, rarely: int, seed: int
) -> Counter[str]:
    """Kill a program `period_s` seconds after all were well, each `rarely`-th time the coordinator.

    Return how many of which were killed.
    """
    killed: Counter[str] = Counter()
    strikes, number = Strikes(seed, ("kill-worker",), machines.workers), 0
    while not over.wait(period_s):
        number += 1
        watched.look(machines.pid(COORDINATOR))
        is_coordinator = number % rarely == 0
        who = COORDINATOR if is_coordinator else machines.workers[number % len(machines.workers)]
        strike = Strike("kill-coordinator" if is_coordinator else "kill-worker", who, strikes.between(0.0, 2.0))
        strike.carry_out(machines)
        if is_coordinator:
            watched.bury()
        over.wait(strike.for_s)
        strike.undo(machines)
        killed["coordinator" if is_coordinator else "workers"] += 1
        await_workers(over, machines)
    return killed


def await_workers(over: threading.Event, machines: Machines) -> None:
    """Wait until all workers are ready again: on a busy machine one takes long to load its kernels."""
    end = time.monotonic() + RECOVERY_LIMIT_S
    with suppress(AtollError), connected(machines.address, CONNECT_LIMIT_S) as client:
        while not over.wait(0.5) and time.monotonic() < end:
            with suppress(UnreachableError):
                ready = [view for view in client.workers() if view.state not in ("compiling", "lost")]
                if len(ready) >= len(machines.workers):
                    return


def free_port() -> int:
    """Return a port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@program(
    "benchmarks.operations.many_users",
    __doc__,
    option("--users", type=whole, default=10, help="how many users (%(default)s)"),
    option("--jobs", type=whole, default=5, help="jobs of each (%(default)s)"),
    option("--seeds", type=whole, default=10, help="jobs that differ (%(default)s)"),
    workers(4),
    option("--period", type=positive, default=2.0, help="seconds from recovery to the next kill (%(default)g)"),
    option("--coordinator-each", type=whole, default=5, help="every so many kills it is the coordinator (%(default)s)"),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print; return 1 where a job did not end as in peace, or the loop was late, else 0."""
    record = Record("many_users", options.words, options.out)
    place = f"127.0.0.1:{free_port()}"
    data, over = table().to_bytes(), threading.Event()
    with (
        TemporaryDirectory(prefix="atoll-benchmark-") as made,
        running(options.workers, Path(made), serve_options=("--metrics", place)) as (machines, client),
    ):
        digests = plain_digests(client, data, options.seeds)
        note(f"{options.seeds} plain runs are done")
        watched = Watched(f"http://{place}/metrics")
        resident = status(machines.pid(COORDINATOR), "VmRSS")
        users = [
            User(
                machines.address, f"user{number}", data,
                [(number * options.jobs + job) % options.seeds for job in range(options.jobs)], digests,
            )
            for number in range(options.users)
        ]  # fmt: skip
        began = time.monotonic()
        killed: Counter[str] = Counter()
        killer = threading.Thread(
            target=lambda: killed.update(
                kill_until(over, machines, watched, options.period, options.coordinator_each, 1)
            ),
            daemon=True,
        )
        for user in users:
            user.start()
        killer.start()
        for user in users:
            user.join(LIMIT_S)
        seconds = time.monotonic() - began
        over.set()
        killer.join(30.0)
        watched.look(machines.pid(COORDINATOR))
        watched.bury()
    ended = [job for user in users for job in user.ended]
    errors = [str(user.error) for user in users if user.error is not None]
    return told(ended, errors, watched, killed, seconds, resident, options, record)


def told(  # noqa: PLR0913  # all figures
    ended: list[Ended], errors: list[str], watched: Watched, killed: Counter[str], seconds: float, resident: int,
    options: Namespace, record: Record,
) -> int:  # fmt: skip
    """Print what came of it; return the exit code."""
    wanted = options.users * options.jobs
    right = sum(job.is_equal for job in ended)
    by_user = {user: [job.seconds for job in ended if job.user == user] for user in {job.user: None for job in ended}}
    rows = [Waited(user, statistics.median(times), max(times)) for user, times in by_user.items()]
    say(Columns("user={user} | median s={median:.1f} | last s={last:.1f}").table(rows))
    most = max(watched.resident, default=0)
    say(
        f"\n{len(ended)} of {wanted} jobs ended, {right} with the digest of a plain run, in {seconds:.0f} s; killed: "
        f"{killed['workers']} workers, {killed['coordinator']} coordinators; lag of the loop: half of the probes at "
        f"most {1e3 * watched.lag(0.5):g} ms, 99 % at most {1e3 * watched.lag(0.99):g} ms (goal {1e3 * GOAL_LAG_S:g}); "
        f"the coordinator had {resident / 1e6:.0f} MB before, {most / 1e6:.0f} MB at most; load {load():.1f}"
    )
    for error in errors:
        say(f"a user ended: {error}")
    record.write(
        jobs=[vars(job) for job in ended], killed=dict(killed), all_s=seconds, resident=most, lag_99=watched.lag(0.99)
    )
    return 0 if right == wanted and watched.lag(0.99) <= GOAL_LAG_S else 1


if __name__ == "__main__":
    sys.exit(main())
