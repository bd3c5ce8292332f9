"""Workers whose islands only pretend: they wait for the time of an epoch, and send what real islands send.

The program of one process with many workers, started by `benchmarks.operations.scale`. Everything but the computing is
real: sessions on the bus, greetings, heartbeats, placements, reports, emigrants, pulls. An island sends each island of
its archipelago, itself included, the same number of emigrants, and waits for all of them. If there are more islands
than solutions of an island, it sends one emigrant to as many islands as it has solutions.

With `--epoch-times`, a worker computes one island at a time, as a real one does: its `RunQueue` is the real one, and a
slice lasts its share of the time of an epoch. This time is drawn from measured times, by the name of the epoch.
`--slower 8` makes all of them eight times longer, so that the simulated workers have the time to send their messages on
a machine with few cores.

Once a second a line of JSON says what happened in it: see `Counts`.
"""

import hashlib
import heapq
import itertools
import json
import signal
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

from atoll_core.compilation.cache import WORKER, source_digest
from atoll_core.config import JobConfig
from atoll_core.search.commit_order import CommitOrder, Position
from atoll_core.wire.bus.interface import Bus, Query
from atoll_core.wire.bus.zenoh_bus import open_client
from atoll_core.wire.messages.epochs import Addition, IslandReport
from atoll_island_worker.compute.compute_thread import WarmedUp
from atoll_island_worker.compute.run_queue import RunQueue
from atoll_island_worker.session.interface import EpochComputed, EpochTask, JobReady, ShardKey, Snapshot, TaskKey
from atoll_island_worker.worker import Worker
from benchmarks.harness.command_line import option, program
from benchmarks.operations.island_samples import Samples

CONNECT_LIMIT_S: Final = 30.0
WAIT_S: Final = 60.0
FINGERPRINT: Final = source_digest(WORKER)
TICK_S: Final = 1.0


@dataclass
class Counts:
    """What the workers of a process did until the second `at` (monotonic, the same in all processes).

    `epochs` of islands that ended; messages and bytes of reports and of answers to pulls (migrants); `waits`:
    milliseconds from the end of an island's epoch to the beginning of its next one; `busy_s`: seconds in which workers
    computed slices (with `--epoch-times`); `late_ms`: the longest delay of a slice by a lack of processors here.
    """

    at: float = 0.0
    epochs: int = 0
    reports: int = 0
    report_bytes: int = 0
    mails: int = 0
    mail_bytes: int = 0
    waits: list[float] = field(default_factory=list)
    busy_s: float = 0.0
    late_ms: float = 0.0
    processor_s: float = 0.0


class Books:
    """The counts of this second, from many threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts = Counts()
        self._processor_s = 0.0

    def note_put(self, key: str, size: int) -> None:
        """Count one message."""
        with self._lock:
            if key.endswith("/report"):
                self._counts.reports += 1
                self._counts.report_bytes += size
            elif key.endswith("/pull"):
                self._counts.mails += 1
                self._counts.mail_bytes += size

    def note_epoch(self) -> None:
        """Count one island's epoch."""
        with self._lock:
            self._counts.epochs += 1

    def note_slice(self, seconds: float, late_s: float) -> None:
        """Count one slice that was computed in so many seconds, and noticed so much later."""
        with self._lock:
            self._counts.busy_s += seconds
            self._counts.late_ms = max(self._counts.late_ms, 1e3 * late_s)

    def note_wait(self, seconds: float) -> None:
        """Note how long an island waited between two epochs."""
        with self._lock:
            self._counts.waits.append(round(1e3 * seconds, 2))

    def take(self) -> Counts:
        """Return the counts since the last time."""
        with self._lock:
            taken, self._counts = self._counts, Counts()
        taken.at = time.monotonic()
        processor_s = time.process_time()
        taken.processor_s, self._processor_s = processor_s - self._processor_s, processor_s
        return taken


class CountedBus:
    """A bus that counts what is put on it."""

    def __init__(self, bus: Bus, books: Books) -> None:
        self._bus = bus
        self._books = books

    def put(self, key: str, payload: bytes) -> None:
        """See `Bus.put`."""
        self._books.note_put(key, len(payload))
        self._bus.put(key, payload)

    def reply(self, query: Query, payload: bytes | None, party: str | None = None) -> None:
        """See `Bus.reply`."""
        self._books.note_put(query.key, len(payload or b""))
        self._bus.reply(query, payload, party)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bus, name)


class Pacer:
    """One thread that does things at their time."""

    def __init__(self) -> None:
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._changed = threading.Condition()
        threading.Thread(target=self._run, name="pacer", daemon=True).start()

    def at(self, moment: float, act: Callable[[], None]) -> None:
        """Have `act` done at a monotonic second."""
        with self._changed:
            heapq.heappush(self._due, (moment, next(self._order), act))
            if self._due[0][0] == moment:
                self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._due or (left := self._due[0][0] - time.monotonic()) > 0.0:
                    self._changed.wait(left if self._due else None)
                _, _, act = heapq.heappop(self._due)
            act()


class PacedCompute:
    """A `atoll_island_worker.compute.compute_thread.ComputeThread` whose islands take `period_s` an epoch."""

    def __init__(self, samples: Samples, period_s: float, pacer: Pacer, books: Books) -> None:
        self.progress = 0
        self.current: TaskKey | None = None
        self.seconds: dict[str, float] = {}
        self._samples = samples
        self._period_s = period_s
        self._pacer = pacer
        self._books = books
        self._post: Callable[[object], None] = lambda _: None
        self._ended: dict[tuple[ShardKey, int], float] = {}
        self._dropped: set[ShardKey] = set()
        self._config: dict[str, JobConfig] = {}

    def attach(self, post: Callable[[object], None]) -> None:
        """See `ComputeThread.attach`."""
        self._post = post
        post(WarmedUp(0.0, FINGERPRINT))

    def warm_up(self) -> None:
        """See `ComputeThread.warm_up`."""

    def share(self, job: str, weight: float, user: str) -> None:
        """See `ComputeThread.share`; no time is charged."""

    def load(self, job: str, config: JobConfig, dataset: bytes) -> None:
        """See `ComputeThread.load`."""
        self._config[job] = config
        self._post(JobReady(job))

    def run(self, task: EpochTask) -> None:
        """See `ComputeThread.run`. The first epochs of different archipelagos end at different times."""
        now, key = time.monotonic(), task.key
        self.current = key
        if task.takes_snapshot:
            self._post(Snapshot(key, _bytes_of(key, self._samples.snapshot), task.is_at_barrier))
        if task.is_at_barrier:
            return
        before = self._ended.pop((key.shard, key.island), None)
        if before is not None:
            self._books.note_wait(now - before)
        share = 1.0 if key.epoch else _fraction(f"{key.job}/{key.variable}")
        self._pacer.at(now + share * self._period_s, lambda: self._end(task))

    def stop_at(self, shard: ShardKey, hit: Position, commit_order: CommitOrder) -> None:
        """See `ComputeThread.stop_at`; nothing is ever hit."""

    def discard(self, shard: ShardKey) -> None:
        """See `ComputeThread.discard`."""
        self._dropped.add(shard)

    def discard_job(self, job: str) -> None:
        """See `ComputeThread.discard_job`."""

    def close(self) -> None:
        """See `ComputeThread.close`."""

    def _end(self, task: EpochTask) -> None:
        key = task.key
        if key.shard in self._dropped:
            return
        self.progress += 1
        self._books.note_epoch()
        self._ended[key.shard, key.island] = time.monotonic()
        self._post(self._computed(task))

    def _computed(self, task: EpochTask) -> EpochComputed:
        """Return what a real island would report and send after an epoch."""
        key = task.key
        evolution = self._config[key.job].evolution
        report = pretended(self._samples, key.epoch, key.island, f"{key.job}/{key.variable}/{key.island}/{key.epoch}")
        block = bytes(self._samples.emigrant * max(1, evolution.population // evolution.islands))
        step = max(1, evolution.islands // evolution.population)
        distances = [step * number + number % step for number in range(evolution.islands // step)]
        partners = [(key.island + distance, key.island - distance) for distance in distances]
        emigrants = {} if task.is_last else {to % evolution.islands: block for to, _ in partners}
        senders = frozenset(sender % evolution.islands for _, sender in partners) if emigrants else frozenset()
        return EpochComputed(key, report, emigrants, senders - {key.island})


class SerialCompute(PacedCompute):
    """Computes one slice at a time, in the order of the real queue; an epoch takes one of the `times`."""

    def __init__(self, samples: Samples, times: Sequence[float], pacer: Pacer, books: Books) -> None:
        super().__init__(samples, 0.0, pacer, books)
        self._times = times
        self._turns_lock = threading.Lock()
        self._queue = RunQueue(self._begin, time.monotonic)
        self._is_busy = False
        self._spent_s = 0.0

    def run(self, task: EpochTask) -> None:
        """See `ComputeThread.run`."""
        with self._turns_lock:
            outcomes = self._queue.add(task)
            starts, self._is_busy = not self._is_busy, True
        for outcome in outcomes:
            self._post(outcome)
        if starts:
            moment = time.monotonic()
            self._pacer.at(moment, lambda: self._turn(moment))

    def discard(self, shard: ShardKey) -> None:
        """See `ComputeThread.discard`."""
        with self._turns_lock:
            self._queue.discard(shard)

    def _begin(self, task: EpochTask) -> "SimulatedEpoch":
        key = task.key
        name = f"{key.job}/{key.variable}/{key.island}/{key.epoch}"
        seconds = self._times[int(_fraction(name) * len(self._times))]
        snapshot = _bytes_of(key, self._samples.snapshot) if task.takes_snapshot else None
        return SimulatedEpoch(task, seconds, snapshot, self._computed, self._spend)

    def _spend(self, seconds: float) -> None:
        self._spent_s += seconds

    def _turn(self, moment: float) -> None:
        """Begin a slice at `moment`; post its results when it is over."""
        with self._turns_lock:
            if self._queue.is_idle:
                self._is_busy = False
                return
            self._spent_s = 0.0
            results = self._queue.turn()
            seconds = self._spent_s
            self.current = self._queue.current
        end = moment + seconds
        self._pacer.at(end, lambda: self._end_slice(end, seconds, results))

    def _end_slice(self, end: float, seconds: float, results: Sequence[object]) -> None:
        self._books.note_slice(seconds, time.monotonic() - end)
        self.progress += 1
        for result in results:
            if isinstance(result, EpochComputed):
                self._books.note_epoch()
            self._post(result)
        self._turn(end)


class SimulatedEpoch:
    """An epoch that takes some seconds, which it tells `spend` slice by slice; see `RunningEpoch`."""

    def __init__(
        self, task: EpochTask, seconds: float, snapshot: bytes | None, computed: Callable[[EpochTask], EpochComputed],
        spend: Callable[[float], None],
    ) -> None:  # fmt: skip
        self.generation = 0
        self.snapshot = snapshot
        self._task, self._seconds, self._make, self._spend = task, seconds, computed, spend

    def advance(self) -> bool:
        """See `RunningEpoch.advance`."""
        order = self._task.commit_order
        before, self.generation = self.generation, min(order.generations, self.generation + order.stride)
        self._spend(self._seconds * (self.generation - before) / order.generations)
        return self.generation == order.generations

    def computed(self) -> EpochComputed:
        """See `RunningEpoch.computed`."""
        return self._make(self._task)


def pretended(samples: Samples, epoch: int, island: int, name: str) -> IslandReport:
    """Return a real report as it would be another island's: with its number, and errors a little different."""
    report = samples.report(epoch, island)
    digest = hashlib.sha256(name.encode()).hexdigest()
    factor = 0.9 + 0.2 * _fraction(name)
    change = {
        "island": island,
        "digest": digest,
        "additions": _scaled(report.additions, factor),
        "runners_up": _scaled(report.runners_up, factor),
    }
    return report.model_copy(update=change)


def _scaled(additions: Sequence[Addition], factor: float) -> tuple[Addition, ...]:
    return tuple(
        addition.model_copy(update={"error": addition.error * factor, "mse": addition.mse * factor * factor})
        for addition in additions
    )


def _bytes_of(key: TaskKey, count: int) -> bytes:
    """Return so many bytes, the same for the same island and epoch, that no compression makes fewer."""
    return hashlib.shake_128(f"{key.job}/{key.variable}/{key.island}/{key.epoch}".encode()).digest(count)


def _fraction(name: str) -> float:
    """Return a number from 0 to 1 that looks random."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:4]) / 2.0**32


@program(
    "benchmarks.operations.simulated_islands",
    __doc__,
    option("--connect", required=True, help="address of the coordinator"),
    option("--samples", type=Path, required=True, help="file of what real islands sent"),
    option("--first", type=int, required=True, help="number of the first worker"),
    option("--workers", type=int, required=True, help="how many"),
    option("--period", type=float, required=True, help="seconds of an epoch"),
    option("--epoch-times", type=Path, help="JSON list of seconds of epochs, one of which is drawn for each epoch"),
    option("--slower", type=float, default=1.0, help="factor of these times (%(default)g)"),
)
def main(options: Namespace) -> int:
    """Run the workers until SIGTERM; return 0."""
    samples, books, pacer, stop = Samples.load(options.samples), Books(), Pacer(), threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    times = json.loads(options.epoch_times.read_text("utf-8")) if options.epoch_times else []
    times = [options.slower * seconds for seconds in times]
    with ExitStack() as stack:
        workers = []
        for number in range(options.first, options.first + options.workers):
            bus: Any = CountedBus(stack.enter_context(open_client(options.connect, CONNECT_LIMIT_S)), books)
            compute: Any = (
                SerialCompute(samples, times, pacer, books)
                if times
                else PacedCompute(samples, options.period, pacer, books)
            )
            workers.append(Worker(bus, compute, f"s{number:04}", WAIT_S, grace_s=0.0))
        threads = [threading.Thread(target=worker.run, name=worker.name, daemon=True) for worker in workers]
        for thread in threads:
            thread.start()
        while not stop.wait(TICK_S):
            sys.stdout.write(json.dumps(asdict(books.take())) + "\n")
            sys.stdout.flush()
        for worker in workers:
            worker.leave()
        for thread in threads:
            thread.join()
    return 0


if __name__ == "__main__":
    sys.exit(main())
