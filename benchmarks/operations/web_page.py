"""What the page of a job with many islands and events takes in a browser: frames a second, bytes, memory.

Real programs as in `benchmarks.operations.web`, and headless Chromium (what `make browser` installs). The page is open
while the events come; then it is measured with new ones, at a rate that a search has. An empty page is measured beside
it, since a browser without a display has a frame rate of its own.

    python -m benchmarks.operations.web_page
"""

import itertools
import statistics
import sys
import threading
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from importlib import import_module
from typing import Any, Final

from atoll.client.client import Client, connected
from atoll.terminal.output import note, say
from atoll_core.errors import UsageError
from benchmarks.harness.command_line import OUT, option, positive, program, whole
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import CONNECT_LIMIT_S, TIED_COORDINATOR, wait_until
from benchmarks.harness.tables import Columns
from benchmarks.operations.web import A_MINUTE, JOB, READY_LIMIT_S, SECRET, served
from tests.browsers import CHROMIUM, SWITCHES

FRAMES: Final = 60.0
"""Frames a second that are aimed at; a view must not fall below what an empty page has."""

SETTLE_S: Final = 5.0
EACH: Final = 50
EXCITED_COORDINATOR: Final = f"""
from atoll_coordinator.service.monitoring.event_log import EventLog
record = EventLog.record
def several(log, kind, text, *job, **values):
    is_sharing = kind == "changed" and "priority" not in text
    for number in range({EACH} if is_sharing else 1):
        record(log, kind, text, *job, **values)
EventLog.record = several
{TIED_COORDINATOR}"""
"""A coordinator that records each change of who may see a job so many times."""

MEASURE: Final = """seconds => new Promise((done) => {
  const [frames, tasks] = [[], []];
  const observer = new PerformanceObserver((list) => tasks.push(...list.getEntries().map((entry) => entry.duration)));
  observer.observe({ type: "longtask" });
  const began = performance.now();
  const step = (now) => {
    frames.push(now);
    if (now - began < 1000 * seconds) return requestAnimationFrame(step);
    observer.disconnect();
    done({ frames, tasks });
  };
  requestAnimationFrame(step);
})"""


@dataclass(frozen=True)
class Looked:
    """Frames a second over each second, the longest frame and tasks of over 50 ms in ms, bytes a minute, heap in MB."""

    page: str
    median: float
    fifth: float
    longest: float
    tasks: int
    longest_task: float
    bytes_a_minute: float
    heap_before: float
    heap_after: float
    elements: int


@dataclass
class Tab:
    """A page in the browser, and the bytes that came for it."""

    page: Any
    bytes: int = 0
    session: Any = field(init=False)

    def __post_init__(self) -> None:
        self.session = self.page.context.new_cdp_session(self.page)
        self.session.on("Network.dataReceived", self._count)
        self.session.on("Network.responseReceived", self._count_head)
        for domain in ("Network", "Performance", "HeapProfiler"):
            self.session.send(f"{domain}.enable")

    def _count(self, event: dict[str, Any]) -> None:
        self.bytes += event["encodedDataLength"] or event["dataLength"]

    def _count_head(self, event: dict[str, Any]) -> None:
        self.bytes += int(event["response"]["encodedDataLength"])

    def heap(self) -> float:
        """Return what is in use after everything unused was collected, in MB."""
        self.session.send("HeapProfiler.collectGarbage")
        return self._metric("JSHeapUsedSize") / 1e6

    def _metric(self, name: str) -> float:
        metrics = self.session.send("Performance.getMetrics")["metrics"]
        return float(next(one["value"] for one in metrics if one["name"] == name))

    def look(self, name: str, seconds: float) -> Looked:
        """Measure for so long."""
        heap, before = self.heap(), self.bytes
        seen = self.page.evaluate(MEASURE, seconds)
        came = self.bytes - before
        rates = _rates(seen["frames"])
        gaps = [after - first for first, after in zip(seen["frames"], seen["frames"][1:], strict=False)]
        return Looked(
            name, statistics.median(rates), sorted(rates)[len(rates) // 20], max(gaps), len(seen["tasks"]),
            max(seen["tasks"], default=0.0), came * 60.0 / seconds, heap, self.heap(), int(self._metric("Nodes")),
        )  # fmt: skip


def _rates(frames: list[float]) -> list[float]:
    """Return the frames of each whole second."""
    whole_seconds = int((frames[-1] - frames[0]) // 1000.0)
    counts = [0] * max(1, whole_seconds)
    for frame in frames:
        second = int((frame - frames[0]) // 1000.0)
        if second < len(counts):
            counts[second] += 1
    return [float(one) for one in counts]


@contextmanager
def browsing() -> Iterator[Any]:
    """Start the browser; raises UsageError where there is none."""
    try:
        driver = import_module("playwright.sync_api").sync_playwright
    except ImportError as error:
        raise UsageError("playwright is not installed; make browser installs it") from error
    if CHROMIUM is None:
        raise UsageError("there is no Chromium; Debian's package is chromium")
    with driver() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=SWITCHES)
        yield browser
        browser.close()


def send_events(client: Client, number: int) -> None:
    """Make so many things happen to the job, `EACH` by each request."""
    for index in range(-(-number // EACH)):
        client.share(JOB, shared=index % 2 == 0)


@contextmanager
def happening(address: str, rate: float) -> Iterator[None]:
    """Let things happen to the job, so many a second."""
    is_over = threading.Event()

    def go() -> None:
        with connected(address, CONNECT_LIMIT_S) as client:
            for priority in itertools.cycle(range(10)):
                if is_over.wait(1.0 / rate):
                    return
                client.set_priority(JOB, priority)

    thread = threading.Thread(target=go)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def measured(options: Namespace) -> Iterator[Looked]:
    """Yield what an empty page and the page of the job take."""
    with served(options.islands, coordinator=EXCITED_COORDINATOR) as (machines, port), browsing() as browser:
        yield Tab(browser.new_page()).look("empty", min(20.0, options.seconds))
        tab = Tab(browser.new_page(viewport={"width": 1280, "height": 900}))
        tab.page.goto(f"http://127.0.0.1:{port}/?token={SECRET}#/jobs/{JOB}")
        tab.page.locator(".cells li").first.wait_for(timeout=1000.0 * READY_LIMIT_S)
        note("the page is open; events come")
        with connected(machines.address, CONNECT_LIMIT_S) as client:
            send_events(client, options.events)
            last = client.events(JOB, 0, 1)[-1].number
            wait_until(client, lambda: _newest(tab) >= last - 1, "the page did not show all events", READY_LIMIT_S)
        tab.page.wait_for_timeout(1000.0 * SETTLE_S)
        note(f"the page has seen {options.events:,} events")
        with happening(machines.address, options.rate):
            yield tab.look(f"{tab.page.locator('.cells li').count():,} islands", options.seconds)


def _newest(tab: Tab) -> int:
    return int(tab.page.evaluate("Math.max(0, ...(document.querySelector('.log').keyed?.keys() ?? []))"))


@program(
    "benchmarks.operations.web_page",
    __doc__,
    option("--islands", type=whole, default=1024, help="of the job, each equation (%(default)s)"),
    option("--events", type=whole, default=10_000, help="that the page has seen before it is measured (%(default)s)"),
    option("--rate", type=positive, default=1.0, help="events a second while it is measured (%(default)g)"),
    option("--seconds", type=positive, default=60.0, help="length of the measurement (%(default)g)"),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print; return 1 where a goal is missed, else 0."""
    record = Record("web_page", options.words, options.out)
    empty, job = list(measured(options))
    say(
        Columns(
            "page={page} | frames/s, median={median:.0f} | 5th percentile={fifth:.0f} | "
            "longest frame, ms={longest:.0f} | long tasks={tasks} | the longest, ms={longest_task:.0f} | "
            "bytes a minute={bytes_a_minute:.0f} | heap, MB={heap_before:.1f} | then={heap_after:.1f} | "
            "nodes={elements}"
        ).table([empty, job])
    )
    say(f"\ngoals: {FRAMES:.0f} frames/s or what an empty page has, {A_MINUTE:,} bytes a minute; load {load():.1f}")
    record.write(looked=[asdict(empty), asdict(job)])
    return int(job.median < min(FRAMES, 0.95 * empty.median) or job.bytes_a_minute > A_MINUTE)


if __name__ == "__main__":
    sys.exit(main())
