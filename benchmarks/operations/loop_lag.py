"""How late the coordinator's loop is while many users submit jobs at once and a page watches.

A coordinator and workers are real programs. A thread in the coordinator's process posts a probe into the loop's queue a
hundred times a second. Its lag is the time until the loop takes it. On a machine that other programs use, most of
this time passes before the loop gets a core. So the lag is also given in processor time of the loop's own thread. This
time has no waiting for the disk, for other threads of the coordinator, or for a core.

All users submit in the same moment, each over a connection of its own. A page asks what the web process asks for an
open page: changes of all jobs, the list of jobs, and the status and best result of a job that is searched.

Returns 1 if 1 % of the probes were later than the goal, by processor time.
"""

import json
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from atoll.client.client import Client, connected
from atoll.client.follower import Subscription
from atoll.terminal.output import note, say
from atoll_core.config import JobConfig
from atoll_core.errors import AtollError
from atoll_core.wire.bus.zenoh_bus import open_client
from benchmarks.harness.accounts import processor_seconds
from benchmarks.harness.command_line import OUT, option, positive, program, whole, workers
from benchmarks.harness.jobs import configured
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import CONNECT_LIMIT_S, COORDINATOR, TIED_COORDINATOR, running
from benchmarks.harness.systems import table_of, trajectories
from benchmarks.harness.tables import Columns

GOAL_MS: Final = 50.0
BEGIN_S: Final = 0.1
"""Seconds until the coordinator has noticed that the measurement begins."""

PAGE_S: Final = 1.0
"""Seconds between two rounds of questions of a page."""

PROBED_COORDINATOR: Final = (
    """
import gc, json, os, threading, time
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Message, Posted, Query
from atoll_core.wire.codec import unpack
from atoll_coordinator.service.requests.dispatch import RequestDispatcher
from atoll_coordinator.service.service_loop import Service
_step, _start, _answer, _lags, _steps = Service.step, Service.start, RequestDispatcher.answer, [], []
class Probe:
    def __init__(self, clock):
        self.wall, self.processor = time.monotonic(), time.clock_gettime(clock)
def name_of(event):
    if isinstance(event, Posted):
        return type(event.item).__name__
    return event.key.split("/")[-1] if isinstance(event, (Query, Message)) else type(event).__name__
def answer(self, event):
    if "/ask" in event.key:
        self.asked = unpack(event.payload, 2**24)["body"]["kind"]
    return _answer(self, event)
def step(self, event):
    self._requests.asked = None
    if isinstance(event, Posted) and isinstance(event.item, Probe):
        _lags.append((time.monotonic() - event.item.wall, time.thread_time() - event.item.processor))
        return
    began, processor = time.monotonic(), time.thread_time()
    try:
        _step(self, event)
    finally:
        name = self._requests.asked or name_of(event)
        _steps.append((name, time.monotonic() - began, time.thread_time() - processor))
def collecting(phase, _):
    if phase == "start":
        collecting.began = time.monotonic(), time.thread_time()
    elif threading.get_ident() == collecting.loop:
        wall, processor = collecting.began
        _steps.append(("garbage collection", time.monotonic() - wall, time.thread_time() - processor))
def write():
    with open(FILE + "-", "w") as file:
        json.dump({"lags": _lags, "steps": _steps}, file)
    os.replace(FILE + "-", FILE)
def probe(bus, clock):
    while True:
        time.sleep(0.01)
        if os.path.exists(FILE + ".begin"):
            os.remove(FILE + ".begin")
            _lags.clear(), _steps.clear()
        if os.path.exists(FILE + ".end"):
            os.remove(FILE + ".end")
            write()
        bus.post(Probe(clock))
def start(self):
    collecting.loop = threading.get_ident()
    gc.callbacks.append(collecting)
    clock = time.pthread_getcpuclockid(collecting.loop)
    _start(self)
    threading.Thread(target=probe, args=(self._bus, clock), daemon=True).start()
Service.step, Service.start, RequestDispatcher.answer = step, start, answer
"""
    + TIED_COORDINATOR
)
"""The coordinator's program. It writes the lags of probes and the duration of each event into FILE, from the moment
when FILE.begin exists to the moment when FILE.end exists; in seconds of the clock and of the loop's processor time."""


@dataclass(frozen=True)
class Kind:
    """Events of one kind: their number, and milliseconds of all and of the longest.

    `wall` is by the clock, the other times are processor time of the loop.
    """

    kind: str
    number: int
    total_ms: float
    longest_ms: float
    total_wall_ms: float
    longest_wall_ms: float


@dataclass(frozen=True)
class Lags:
    """Milliseconds by which probes were late: median, 99 %, longest; by the clock and in the loop's processor time."""

    probes: int
    wall: tuple[float, float, float]
    processor: tuple[float, float, float]

    @classmethod
    def of(cls, lags: Sequence[tuple[float, float]]) -> "Lags":
        """Return the quantiles of measured lags, in seconds."""
        wall, processor = (1e3 * np.array(column) for column in zip(*lags, strict=True))
        return cls(len(lags), _quantiles(wall), _quantiles(processor))


def _quantiles(values: Any) -> tuple[float, float, float]:
    return float(np.median(values)), float(np.percentile(values, 99)), float(values.max())


def kinds_of(steps: Sequence[tuple[str, float, float]]) -> list[Kind]:
    """Return the kinds of events, the kind with the longest event first."""
    by_kind: dict[str, list[tuple[float, float]]] = {}
    for kind, wall, processor in steps:
        by_kind.setdefault(kind, []).append((1e3 * wall, 1e3 * processor))
    kinds = []
    for kind, times in by_kind.items():
        walls, processors = zip(*times, strict=True)
        kinds.append(Kind(kind, len(times), sum(processors), max(processors), sum(walls), max(walls)))
    return sorted(kinds, key=lambda one: -one.longest_ms)


class Page(threading.Thread):
    """Asks what the web process asks while one page is open."""

    def __init__(self, address: str, over: threading.Event) -> None:
        super().__init__(name="page", daemon=True)
        self._address, self._over = address, over

    def run(self) -> None:
        """Ask until the measurement is over; a question without an answer is asked again in the next round."""
        with connected(self._address, CONNECT_LIMIT_S) as client, connected(self._address, CONNECT_LIMIT_S) as other:
            events = Subscription(other, None)
            while not self._over.is_set():
                with suppress(AtollError):
                    events.wait(0.0)
                    views = client.jobs(last=50)
                    client.workers()
                    for view in views:
                        if view.state == "running":
                            client.status(view.job)
                            client.result(view.job)
                self._over.wait(PAGE_S)


def submit_at_once(address: str, number: int, begin: Callable[[], None]) -> float:
    """Submit jobs on different tables in the same moment, each over its own connection.

    `begin` is called when all are connected. Return the seconds until the last was accepted; raises the first error.
    """
    tables = [table_of(trajectories("lotka_volterra", 0.1, seed, 0.03)).to_bytes() for seed in range(number)]
    together, errors = threading.Barrier(number), list[Exception]()

    def submit(client: Client, index: int) -> None:
        try:
            together.wait()
            client.hand_in(f"job-{index}", f"job {index}", config_of(index), tables[index])
        except Exception as error:  # raised below
            errors.append(error)

    with ExitStack() as stack:
        buses = [stack.enter_context(open_client(address, CONNECT_LIMIT_S)) for _ in range(number)]
        clients = [Client(bus, address) for bus in buses]
        for client in clients:
            client.greet()
        threads = [threading.Thread(target=submit, args=one[::-1]) for one in enumerate(clients)]
        begin()
        time.sleep(BEGIN_S)
        began = time.monotonic()
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        seconds = time.monotonic() - began
    if errors:
        raise errors[0]
    return seconds


def config_of(seed: int) -> JobConfig:
    """Return a search that nothing ends before the measurement is over, so that equations are shown all the time."""
    return configured(seed, budget={"max_epochs": 10_000, "stagnation": 10_000})


def measured(options: Namespace, folder: Path) -> tuple[Lags, list[Kind], float]:
    """Return lags and kinds of events while jobs are submitted, and the coordinator's processor time in seconds."""
    file = folder / "lags.json"
    text = PROBED_COORDINATOR.replace("FILE", repr(str(file)))
    with running(options.workers, folder / "service", coordinator=text) as (machines, client):
        over = threading.Event()
        page = Page(machines.address, over)
        page.start()
        client.pause(2.0)
        note(f"{options.jobs} jobs are submitted at once")
        before = processor_seconds(machines.pid(COORDINATOR))
        accepted_s = submit_at_once(machines.address, options.jobs, (folder / "lags.json.begin").touch)
        note(f"all were accepted after {accepted_s:.1f} s")
        client.pause(options.seconds)
        for index in range(options.jobs):
            client.cancel(f"job-{index}")
        (folder / "lags.json.end").touch()
        while not file.exists():
            client.pause(0.1)
        taken = processor_seconds(machines.pid(COORDINATOR)) - before
        over.set()
        page.join()
    found: Mapping[str, Any] = json.loads(file.read_text("utf-8"))
    return Lags.of(found["lags"]), kinds_of(found["steps"]), taken


@program(
    "benchmarks.operations.loop_lag",
    __doc__,
    option("--jobs", type=whole, default=50, help="jobs that are submitted at once (%(default)s)"),
    workers(2),
    option("--seconds", type=positive, default=20.0, help="length of the measurement after that (%(default)g)"),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print; return 1 if probes were too late, else 0."""
    record = Record("loop_lag", options.words, options.out)
    with TemporaryDirectory(prefix="atoll-benchmark-") as folder:
        lags, kinds, taken = measured(options, Path(folder))
    columns = "event={kind} | number={number} | ms of processor in all={total_ms:.0f} | longest={longest_ms:.1f} | "
    say(Columns(columns + "by the clock={total_wall_ms:.0f} | longest={longest_wall_ms:.0f}").table(kinds[:15]))
    for name, (median, most, longest) in (("the clock", lags.wall), ("processor time", lags.processor)):
        say(f"lag by {name}: median {median:.1f} ms, 99 % {most:.1f} ms, longest {longest:.1f} ms")
    say(f"{lags.probes} probes; coordinator {taken:.1f} s of processor time; load {load():.1f}; goal {GOAL_MS:g} ms")
    record.write(lags=asdict(lags), kinds=[asdict(kind) for kind in kinds], processor_s=taken)
    return 1 if lags.processor[1] > GOAL_MS else 0


if __name__ == "__main__":
    sys.exit(main())
