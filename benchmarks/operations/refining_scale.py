"""How preparing and refining scale: batches and parts of real jobs timed here, and played on 1 to 16 simulated workers.

``python -m benchmarks.operations.refining_scale TITLE ...`` prepares the tables of stored pools (of
``benchmarks.pools``) and refines the pools, once for each number of ``--workers``. Each batch, each part of a divided
integration and the work between them are computed in this process, and their processor seconds are noted. Each
simulated worker has its own built contexts, so the time to build them is noted, too.
Then the trace is played on a host with so many workers and as many cores. Work between batches takes turns, since
Python runs one thread at a time; batches and parts run on any core, in their order. A batch takes `OVERHEAD_S` more, a
call of batches `LATENCY_S` in each direction, and a part `HANDOVER_S` more. The search, about a second, is left out.
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
from atoll_coordinator.model import batches as batch_functions
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
Given = TypeVar("Given")

OVERHEAD_S: Final = 0.002
"""Of each batch on its worker: its bytes read, its result written."""
LATENCY_S: Final = 0.002
"""From the call to the first batch on a worker, and from the last result to the caller."""
HANDOVER_S: Final = 0.0002
"""Of each part of a divided integration: another thread begins it, and its result is taken."""
WORKERS: Final = (1, 2, 4, 8, 16)
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
class Divided:
    """Seconds of the parts of one integration, which run on threads of one process."""

    seconds: tuple[float, ...]


@dataclass(frozen=True)
class Fork:
    """Traces that have nothing to do with each other."""

    branches: "tuple[Trace, ...]"


Part = Serial | Mapped | Divided | Fork
Trace = tuple[Part, ...]


@dataclass
class Recorder:
    """Batches that are computed here, one after another, and what they take; as if there were so many `hands`."""

    hands: int
    threads: int = 1
    parts: list[Part] = field(default_factory=list)
    begun: float = field(default_factory=time.thread_time)
    is_mapping: bool = False
    contexts: dict[int, object] = field(default_factory=dict)

    @property
    def workers(self) -> int:
        """The workers that help the worker with the task."""
        return self.hands - 1

    def map(
        self, function: str, context: bytes, items: Sequence[bytes], cancel_after: float | None = None
    ) -> list[bytes]:
        """Return what a function makes of batches, and note their seconds.

        A batch is computed with the built contexts of the worker that is free first.
        """
        del cancel_after
        self.end_serial()
        self.is_mapping, made, seconds, busy = True, list[bytes](), list[float](), [0.0] * self.hands
        for item in items:
            worker = busy.index(min(busy))
            vars(batch_functions)["_built"] = self.contexts.setdefault(worker, batch_functions._BuiltContexts())
            begun = time.thread_time()
            made.append(FUNCTIONS[function](context, item))
            seconds.append(time.thread_time() - begun)
            busy[worker] += seconds[-1]
        self.parts.append(Mapped(function, tuple(seconds)))
        self.is_mapping, self.begun = False, time.thread_time()
        return made

    def divide(self, function: Callable[[Given], Made], parts: Sequence[Given]) -> list[Made]:
        """Return the results of the parts of an integration, and note their seconds."""
        if self.is_mapping:  # a batch is computed by one thread
            return [function(part) for part in parts]
        self.end_serial()
        made, seconds = list[Made](), list[float]()
        for part in parts:
            begun = time.thread_time()
            made.append(function(part))
            seconds.append(time.thread_time() - begun)
        self.parts.append(Divided(tuple(seconds)))
        self.begun = time.thread_time()
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
        super().__init__(recorder if recorder.workers else None, threads=recorder.hands)
        self._recorder = recorder

    def divide(self, function: Callable[[Given], Made], parts: Sequence[Given]) -> list[Made]:
        """See `Recorder.divide`."""
        return self._recorder.divide(function, parts)

    def run_calls(self, calls: Sequence[Callable[[], Made]]) -> list[Made]:
        """Make calls one after another."""
        return self._recorder.fork(calls)


@contextmanager
def recording(recorder: Recorder) -> Iterator[None]:
    """Context manager: preparing and refining are spread by a recorder."""

    @contextmanager
    def spreading(batches: Batches | None, threads: int, deadline: Deadline) -> Iterator[Spread]:
        yield RecordedSpread(recorder)

    modules = [vars(pipeline), vars(batch_functions)]
    before = [(module["spreading"], module.get("_built")) for module in modules]
    try:
        for module in modules:
            module["spreading"] = spreading
        yield
    finally:
        for module, (function, built) in zip(modules, before, strict=True):
            module["spreading"] = function
            if built is not None:
                module["_built"] = built
        recorder.end_serial()


def recorded(job: Job, pools: Pools, workers: int) -> tuple[Trace, Trace, Counter[str]]:
    """Return the traces of preparing and refining, and how often the time between batches of refining was spent in
    which stage. Batches are as small as for so many `workers`."""
    preparing, refining = Recorder(workers), Recorder(workers)
    stages, is_over, thread = Counter[str](), threading.Event(), threading.get_ident()

    def look() -> None:
        while not is_over.wait(_SAMPLE_S):
            if not refining.is_mapping:
                stages[_stage(sys._current_frames().get(thread))] += 1

    with recording(preparing):
        prepared, _ = prepare_job(job.table.to_bytes(), job.config, batches=preparing)
    watch = threading.Thread(target=look, daemon=True)
    refining.begun = time.thread_time()
    watch.start()
    try:
        with recording(refining):
            pipeline.refine_all(prepared.preparation, prepared.config, pools, laws=prepared.laws)
    finally:
        is_over.set()
        watch.join()
    return tuple(preparing.parts), tuple(refining.parts), stages


def _stage(frame: FrameType | None) -> str:
    names: list[str] = []
    while frame is not None:
        if "atoll_coordinator" in frame.f_code.co_filename and "<" not in frame.f_code.co_name:
            names.append(f"{Path(frame.f_code.co_filename).stem}.{frame.f_code.co_name}")
        frame = frame.f_back
    return " > ".join(name.split(".")[1] for name in names[::-1][2 : 2 + _DEPTH])


class Cluster:
    """Plays a trace on a host with so many workers and cores."""

    def __init__(self, workers: int) -> None:
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0
        self._now = 0.0
        self._free = workers
        self._waiting: deque[tuple[float, Callable[[], None]]] = deque()
        self._is_lock_free = True
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
                self._work()
            case Mapped(_, seconds):
                arrived = _Join(len(seconds), lambda: self._after(LATENCY_S, following))
                costs = [one + OVERHEAD_S for one in seconds]
                self._after(LATENCY_S, lambda: self._give_out(costs, arrived))
            case Divided(seconds):
                self._give_out([one + HANDOVER_S for one in seconds], _Join(len(seconds), following))
            case Fork(branches):
                joined = _Join(len(branches), following)
                for branch in branches:
                    self._play(branch, 0, joined.one)

    def _give_out(self, seconds: Sequence[float], arrived: "_Join") -> None:
        self._waiting.extend((one, arrived.one) for one in seconds)
        self._work()

    def _work(self) -> None:
        """Begin what can begin: the next turn of Python's lock, then batches and parts in their order."""
        while self._free and ((self._is_lock_free and self._turns) or self._waiting):
            has_lock = self._is_lock_free and bool(self._turns)
            seconds, done = (self._turns if has_lock else self._waiting).popleft()
            self._free -= 1
            self._is_lock_free &= not has_lock

            def end(done: Callable[[], None] = done, has_lock: bool = has_lock) -> None:
                self._free += 1
                self._is_lock_free |= has_lock
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


def flat(trace: Trace) -> Iterator[Serial | Mapped | Divided]:
    """Yield all parts that take time."""
    for part in trace:
        if isinstance(part, Fork):
            for branch in part.branches:
                yield from flat(branch)
        else:
            yield part


def report(title: str, traces: Sequence[tuple[int, Trace, Trace, Counter[str]]]) -> str:
    """Return spans and speed-ups by workers, and of the most workers the sums by function and by stage."""
    rows, first = [], (0.0, 0.0)
    for workers, preparing, refining, _ in traces:
        spans = (Cluster(workers).span(preparing), Cluster(workers).span(refining))
        first = spans if first == (0.0, 0.0) else first
        seconds = (*first, sum(first)), (*spans, sum(spans))
        work = sum(map(_seconds, flat((*preparing, *refining))))
        cells = [f"{span:.2f} ({one / span:.1f})" for one, span in zip(*seconds, strict=True)]
        rows.append((str(workers), f"{work:.1f}", *cells))
    heads = ("workers", "processor s", "preparing, s (speed-up)", "refining, s (speed-up)", "both, s (speed-up)")
    lines = [title, table(heads, rows)]
    workers, preparing, refining, stages = traces[-1]
    parts = [*flat((*preparing, *refining))]
    batches = [part for part in parts if isinstance(part, Mapped)]
    batches += [Mapped("parts of integrations", part.seconds) for part in parts if isinstance(part, Divided)]
    named = sorted({part.function for part in batches})
    functions = [_of_function(name, [part for part in batches if part.function == name]) for name in named]
    lines += [f"with {workers} workers:"]
    lines += [table(("function", "calls", "batches", "s", "median ms", "sum of the longest s"), functions)]
    between = sum(part.seconds for part in flat(refining) if isinstance(part, Serial))
    seen = max(stages.total(), 1)
    shares = [(f"{between * count / seen:.2f}", name) for name, count in stages.most_common(10)]
    lines += [table(("s", f"refining between batches and parts ({between:.1f} s), by stage"), shares)]
    return "\n".join(lines)


def _seconds(part: Serial | Mapped | Divided) -> float:
    return part.seconds if isinstance(part, Serial) else sum(part.seconds)


def _of_function(name: str, calls: Sequence[Mapped]) -> tuple[str, ...]:
    seconds = sorted(one for call in calls for one in call.seconds)
    longest = sum(max(call.seconds) for call in calls)
    median = 1e3 * seconds[len(seconds) // 2]
    return name, str(len(calls)), str(len(seconds)), f"{sum(seconds):.2f}", f"{median:.1f}", f"{longest:.2f}"


@program(
    "benchmarks.operations.refining_scale",
    __doc__,
    option("titles", nargs="+", metavar="TITLE", help="of stored pools whose tables are drawn"),
    option("--workers", type=whole, nargs="+", default=list(WORKERS), help="of the simulated host, 1 first"),
)
def main(options: Namespace) -> None:
    """Print a report of each stored pool."""
    for title in options.titles:
        pools, job = read_pools(file_of(POOLS, title)), job_of(title, Folders())
        recorded(job, pools, 1)  # loads kernels and modules
        say(report(title, [(workers, *recorded(job, pools, workers)) for workers in options.workers]))


if __name__ == "__main__":
    sys.exit(main())
