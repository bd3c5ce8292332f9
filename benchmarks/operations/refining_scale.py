"""How refining scales: batches of real jobs timed here, and what 1 to 256 workers would make of them.

``python -m benchmarks.operations.refining_scale TITLE ...`` refines stored pools (of ``benchmarks.pools``)
as if so many as ``--batches-for`` took batches (of these there are two for each, as far as items suffice), computes
each batch in this process, and notes its processor seconds and those between batches.
Then the trace is played on simulated workers, batches given out in order: one core does what lies between batches, each
batch takes `OVERHEAD_S` more, and `LATENCY_S` on the way there and back. Speed-up and efficiency are those of the sum
of all seconds over the workers' span; what the span consists of is named.
"""

import heapq
import sys
import threading
import time
from argparse import Namespace
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Final, TypeVar

from atoll.terminal.output import say, table
from atoll_coordinator.model import pipeline
from atoll_coordinator.model.batches import FUNCTIONS, Batches, Spread
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.pools import Pools
from atoll_coordinator.tasks.preparing import prepare_job
from benchmarks.harness.command_line import option, program, whole
from benchmarks.pools.campaign import POOLS
from benchmarks.pools.cases import Folders, Job, job_of
from benchmarks.pools.stored import file_of, read_pools

Made = TypeVar("Made")

OVERHEAD_S: Final = 0.002
"""Of each batch on its worker: its bytes read, its result written."""
LATENCY_S: Final = 0.002
"""From the call to the first batch on a worker, and from the last result to the caller."""
WORKERS: Final = (1, 2, 4, 8, 16, 32, 64, 128, 256)
_SAMPLE_S: Final = 0.005
_DEPTH: Final = 3
"""Stages are named by functions of the model, so many levels below `refine_all`."""


@dataclass(frozen=True)
class Serial:
    """Seconds of the coordinator's process between batches."""

    seconds: float


@dataclass(frozen=True)
class Mapped:
    """Seconds of the batches of one call."""

    function: str
    seconds: tuple[float, ...]


@dataclass(frozen=True)
class Fork:
    """Traces that have nothing to do with each other."""

    branches: "tuple[Trace, ...]"


Trace = tuple[Serial | Mapped | Fork, ...]


@dataclass
class Recorder:
    """Batches that are computed here, one after another, and what they take."""

    workers: int = max(WORKERS)
    threads: int = 1
    parts: list[Serial | Mapped | Fork] = field(default_factory=list)
    begun: float = field(default_factory=time.thread_time)
    is_mapping: bool = False

    def map(
        self, function: str, context: bytes, items: Sequence[bytes], cancel_after: float | None = None
    ) -> list[bytes]:
        """Return what a function makes of batches, and note their seconds."""
        del cancel_after
        self.end_serial()
        self.is_mapping, made, seconds = True, list[bytes](), list[float]()
        for item in items:
            begun = time.thread_time()
            made.append(FUNCTIONS[function](context, item))
            seconds.append(time.thread_time() - begun)
        self.parts.append(Mapped(function, tuple(seconds)))
        self.is_mapping, self.begun = False, time.thread_time()
        return made

    def note(self, compared: int) -> None:
        """Do nothing: nobody is told."""

    def end_serial(self) -> None:
        """Note what has gone by since the last batch."""
        self.parts.append(Serial(time.thread_time() - self.begun))
        self.begun = time.thread_time()

    def fork(self, calls: Sequence[Callable[[], Made]]) -> list[Made]:
        """Make calls one after another, and note the parts of each."""
        self.end_serial()
        before, made, branches = self.parts, list[Made](), list[Trace]()
        for call in calls:
            self.parts, self.begun = [], time.thread_time()
            made.append(call())
            self.end_serial()
            branches.append(tuple(self.parts))
        self.parts, self.begun = before, time.thread_time()
        self.parts.append(Fork(tuple(branches)))
        return made


class RecordedSpread(Spread):
    """Notes which calls have nothing to do with each other."""

    def __init__(self, recorder: Recorder) -> None:
        super().__init__(recorder)
        self._recorder = recorder

    def run_calls(self, calls: Sequence[Callable[[], Made]]) -> list[Made]:
        """Make calls one after another."""
        return self._recorder.fork(calls)


def recorded(job: Job, pools: Pools, workers: int = max(WORKERS)) -> tuple[Trace, Counter[str]]:
    """Return the trace of refining, and how often the time between batches was spent in which stage.

    Batches are as small as for so many `workers`.
    """
    prepared, _ = prepare_job(job.table.to_bytes(), job.config)
    recorder, stages, is_over = Recorder(workers), Counter[str](), threading.Event()
    refining = threading.get_ident()

    @contextmanager
    def spreading(batches: Batches | None, threads: int, deadline: Deadline) -> Iterator[Spread]:
        yield RecordedSpread(recorder)

    def look() -> None:
        while not is_over.wait(_SAMPLE_S):
            if not recorder.is_mapping:
                stages[_stage(sys._current_frames().get(refining))] += 1

    before = vars(pipeline)["spreading"]
    vars(pipeline)["spreading"] = spreading
    watch = threading.Thread(target=look, daemon=True)
    watch.start()
    try:
        pipeline.refine_all(prepared.preparation, prepared.config, pools, laws=prepared.laws)
    finally:
        vars(pipeline)["spreading"] = before
        is_over.set()
        watch.join()
    recorder.end_serial()
    return tuple(recorder.parts), stages


def _stage(frame: FrameType | None) -> str:
    names: list[str] = []
    while frame is not None:
        if "atoll_coordinator" in frame.f_code.co_filename and "<" not in frame.f_code.co_name:
            names.append(f"{Path(frame.f_code.co_filename).stem}.{frame.f_code.co_name}")
        frame = frame.f_back
    return " > ".join(name.split(".")[1] for name in names[::-1][2 : 2 + _DEPTH])


class Cluster:
    """Plays a trace on so many workers and one core of the coordinator."""

    def __init__(self, workers: int) -> None:
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0
        self._now = 0.0
        self._free = workers
        self._waiting: deque[tuple[float, Callable[[], None]]] = deque()
        self._is_core_free = True
        self._turns: deque[tuple[float, Callable[[], None]]] = deque()

    def span(self, trace: Trace) -> float:
        """Return the seconds until a trace is done."""
        self._play(trace, 0, lambda: None)
        while self._events:
            self._now, _, happen = heapq.heappop(self._events)
            happen()
        return self._now

    def _after(self, seconds: float, happen: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._events, (self._now + seconds, self._count, happen))

    def _play(self, trace: Trace, place: int, done: Callable[[], None]) -> None:
        if place == len(trace):
            done()
            return
        part = trace[place]

        def following() -> None:
            self._play(trace, place + 1, done)

        match part:
            case Serial(seconds):
                self._turns.append((seconds, following))
                self._next_turn()
            case Mapped(_, seconds):
                arrived = _Join(len(seconds), lambda: self._after(LATENCY_S, following))
                self._after(LATENCY_S, lambda: self._give_out(seconds, arrived))
            case Fork(branches):
                joined = _Join(len(branches), following)
                for branch in branches:
                    self._play(branch, 0, joined.one)

    def _next_turn(self) -> None:
        if self._is_core_free and self._turns:
            seconds, following = self._turns.popleft()
            self._is_core_free = False

            def end() -> None:
                self._is_core_free = True
                following()
                self._next_turn()

            self._after(seconds, end)

    def _give_out(self, seconds: Sequence[float], arrived: "_Join") -> None:
        self._waiting.extend((one + OVERHEAD_S, arrived.one) for one in seconds)
        self._work()

    def _work(self) -> None:
        while self._free and self._waiting:
            seconds, done = self._waiting.popleft()
            self._free -= 1

            def end(done: Callable[[], None] = done) -> None:
                self._free += 1
                done()
                self._work()

            self._after(seconds, end)


class _Join:
    """Goes on when so many have come."""

    def __init__(self, count: int, following: Callable[[], None]) -> None:
        self._left = count
        self._following = following

    def one(self) -> None:
        """Take in that one has come."""
        self._left -= 1
        if not self._left:
            self._following()


def flat(trace: Trace) -> Iterator[Serial | Mapped]:
    """Yield all parts that take time."""
    for part in trace:
        if isinstance(part, Fork):
            for branch in part.branches:
                yield from flat(branch)
        else:
            yield part


def report(title: str, trace: Trace, stages: Counter[str]) -> str:
    """Return speed-up and efficiency by workers, the sums by function, and what lies between batches by stage."""
    parts = list(flat(trace))
    between = sum(part.seconds for part in parts if isinstance(part, Serial))
    batches = [part for part in parts if isinstance(part, Mapped)]
    total = between + sum(sum(part.seconds) for part in batches)
    spans = {workers: Cluster(workers).span(trace) for workers in WORKERS}
    lines = [f"{title}: {total:.1f} s of a core, {between:.1f} s of them between batches"]
    rows = [
        (str(workers), f"{span:.2f}", f"{total / span:.1f}", f"{100.0 * total / span / workers:.0f} %")
        for workers, span in spans.items()
    ]
    lines.append(table(("workers", "span s", "speed-up", "efficiency"), rows))
    named = sorted({part.function for part in batches})
    functions = [_of_function(name, [part for part in batches if part.function == name]) for name in named]
    lines.append(table(("function", "calls", "batches", "s", "median ms", "sum of the longest s"), functions))
    seen = max(stages.total(), 1)
    shares = [(f"{between * count / seen:.2f}", name) for name, count in stages.most_common(10)]
    lines.append(table(("s", "between batches, by stage"), shares))
    return "\n".join(lines)


def _of_function(name: str, calls: Sequence[Mapped]) -> tuple[str, ...]:
    seconds = sorted(one for call in calls for one in call.seconds)
    longest = sum(max(call.seconds) for call in calls)
    median = 1e3 * seconds[len(seconds) // 2]
    return name, str(len(calls)), str(len(seconds)), f"{sum(seconds):.2f}", f"{median:.1f}", f"{longest:.2f}"


@program(
    "benchmarks.operations.refining_scale",
    __doc__,
    option("titles", nargs="+", metavar="TITLE", help="of stored pools whose tables are drawn"),
    option("--batches-for", type=whole, default=max(WORKERS), metavar="WORKERS", help="who takes batches (256)"),
)
def main(options: Namespace) -> None:
    """Print a report of each stored pool."""
    for title in options.titles:
        pools = read_pools(file_of(POOLS, title))
        say(report(title, *recorded(job_of(title, Folders()), pools, options.batches_for)))


if __name__ == "__main__":
    sys.exit(main())
