"""A stub of the compute port: islands that only hash, so that any loss, disorder or double changes the digest.

The queue is the real one. The state of an island is the hash of (state, immigrants by slot, epoch, slice); evaluations
are counted; the target is met at seeded (epoch, generation) of some islands. Time passes as drawn from a stream of the
worker's own.
"""

import hashlib
import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from atoll_coordinator.service.jobs.job import commit_order_of
from atoll_core.compilation.cache import WORKER, source_digest
from atoll_core.config import JobConfig
from atoll_core.errors import RemoteProtocolError
from atoll_core.expression.operators import CONSTANT, COS, SIN, TANH
from atoll_core.search.commit_order import CommitOrder, Position
from atoll_core.search.seeding import Stream, stream_key
from atoll_core.wire.messages.epochs import Addition, HitStatement, IslandReport, SliceCounters
from atoll_island_worker.compute.compute_thread import WarmedUp, WarmUpNote
from atoll_island_worker.compute.run_queue import RunningEpoch, RunQueue
from atoll_island_worker.session.interface import EpochComputed, EpochTask, JobReady, ShardKey, TaskKey
from tests.simulation.bus.network import SimulatedNetwork

OURS = source_digest(WORKER)
"""What workers of this installation show: the coordinator accepts no other."""

SLOTS = 4
"""Solutions per island."""

HIT_EPOCHS = 20


@dataclass
class StubIsland:
    """State of one island: a hash, and cumulative evaluations."""

    state: bytes
    evaluations: int = 0

    def stir(self, *parts: bytes) -> None:
        self.state = hashlib.sha256(self.state + b"".join(parts)).digest()

    def to_bytes(self) -> bytes:
        return struct.pack("<q", self.evaluations) + self.state

    @classmethod
    def from_bytes(cls, data: bytes) -> "StubIsland":
        return cls(data[8:40], struct.unpack("<q", data[:8])[0])


@dataclass(frozen=True)
class Shuffle:
    """The reshuffle of one epoch: source of every (destination, slot)."""

    sources: Mapping[tuple[int, int], tuple[int, int]]

    @classmethod
    def of(cls, config: JobConfig, variable: str, epoch: int) -> "Shuffle":
        islands = config.evolution.islands
        order = Stream(stream_key(config.seed, variable, -1, epoch, "stub-shuffle")).permutation(islands * SLOTS)
        return cls({divmod(place, SLOTS): divmod(come_from, SLOTS) for place, come_from in enumerate(order)})

    def blocks_from(self, island: int, state: bytes) -> dict[int, bytes]:
        """Return what an island sends, by destination: (slot, hash) pairs in slot order."""
        blocks: dict[int, bytes] = {}
        for (destination, slot), (source, place) in sorted(self.sources.items()):
            if source == island:
                solution = hashlib.sha256(state + bytes([place])).digest()[:8]
                blocks[destination] = blocks.get(destination, b"") + bytes([slot]) + solution
        return blocks

    def senders_to(self, island: int) -> frozenset[int]:
        return frozenset(source for (to, _), (source, _) in self.sources.items() if to == island) - {island}


def hits_of(config: JobConfig, variable: str) -> frozenset[Position]:
    """Return where the target is met: by one island or more of one epoch; for one variable in four it never is."""
    stream = Stream(stream_key(config.seed, variable, -1, 0, "stub-hit"))
    if stream.below(4) == 0:
        return frozenset()
    epoch, hitters = stream.below(HIT_EPOCHS), 1 + stream.below(3)
    ends = commit_order_of(config).ends(config.migration.generations)
    return frozenset(
        Position(epoch, ends[stream.below(len(ends))], stream.below(config.evolution.islands)) for _ in range(hitters)
    )


class StubWork:
    """One island's epoch under way."""

    def __init__(self, task: EpochTask, island: StubIsland, config: JobConfig, spend: Callable[[], None]) -> None:
        self.generation = 0
        self._spend = spend
        self._task = task
        self._island = island
        self._config = config
        self._hits = hits_of(config, task.key.variable)
        self._additions: list[Addition] = []
        self._near: list[Addition] = []
        self._counters_by_slice: list[SliceCounters] = []
        self._hit: HitStatement | None = None
        self.snapshot = island.to_bytes() if task.takes_snapshot else None

    def advance(self) -> bool:
        key, island, order = self._task.key, self._island, self._task.commit_order
        self._spend()
        self.generation = min(self.generation + order.stride, order.generations)
        island.stir(struct.pack("<qq", key.epoch, self.generation))
        island.evaluations += 10 + island.state[0] % 16
        evaluations = {"offspring": island.evaluations, "trainers": key.epoch * order.generations + self.generation}
        self._counters_by_slice.append(SliceCounters(generation=self.generation, evaluations=evaluations))
        if island.state[5] < 80:
            self._additions.append(addition_of(key.epoch, self.generation, island.state))
        elif island.state[5] < 180:
            self._near.append(addition_of(key.epoch, self.generation, island.state))
        if Position(key.epoch, self.generation, key.island) in self._hits:
            self._hit = HitStatement(generation=self.generation, error=1e-12)
        return self._hit is not None or self.generation >= order.generations

    def computed(self) -> EpochComputed:
        key, state = self._task.key, self._island.state
        report = IslandReport(
            island=key.island,
            generations=self.generation,
            hit=self._hit,
            additions=tuple(self._additions),
            runners_up=tuple(self._near),
            counters=tuple(self._counters_by_slice),
            best_error=state[1] / 256.0,
            digest=state.hex(),
        )
        if self._hit is not None or self.generation < self._task.commit_order.generations or self._task.is_last:
            return EpochComputed(key, report, {}, frozenset())
        shuffle = Shuffle.of(self._config, key.variable, key.epoch)
        return EpochComputed(key, report, shuffle.blocks_from(key.island, state), shuffle.senders_to(key.island))


@dataclass
class StubCompute:
    """One worker's compute port on the simulated network.

    `poisonous` (job, variable, epoch): who begins any island of it there is killed by `kill`. `hangs` (job, epoch): who
    begins one there computes for ever.
    """

    network: SimulatedNetwork
    worker: str
    seed: int
    slowness: float = 1.0
    warm_up_s: float = 0.5
    broken: tuple[int, int] | None = None
    corrupt: bool = False
    poisonous: tuple[str, str, int] | None = None
    kill: Callable[[], None] | None = None
    hangs: tuple[str, int] | None = None
    progress: int = 0
    fingerprint: str = OURS
    rejected: int = 0
    turns: int = 0
    restored: list[tuple[int, int, int]] = field(default_factory=list)
    _jobs: dict[str, JobConfig] = field(default_factory=dict)
    _islands: dict[ShardKey, dict[int, StubIsland]] = field(default_factory=dict)
    _post: Callable[[object], None] | None = None
    _dead: bool = False
    _is_at_work: bool = False
    _is_held: bool = False
    _worked_s: float = 0.0
    _turn_s: float = 0.0
    _dead_loop: bool = False

    def __post_init__(self) -> None:
        self._stream = Stream(stream_key(self.seed, self.worker, -1, 0, "stub-speed"))
        self._queue = RunQueue(self.begin, lambda: self._worked_s)

    def attach(self, post: Callable[[object], None]) -> None:
        self._post = post
        self._later(0.0, WarmUpNote("loading"))
        self._later(self.warm_up_s, WarmedUp(self.warm_up_s, self.fingerprint))

    def warm_up(self) -> None:
        """Begins when attached."""

    @property
    def current(self) -> TaskKey | None:
        return self._queue.current

    @property
    def seconds(self) -> dict[str, float]:
        return self._queue.seconds.copy()

    def share(self, job: str, weight: float, user: str) -> None:
        self._queue.share(job, weight, user)

    def load(self, job: str, config: JobConfig, dataset: bytes) -> None:
        self._jobs[job] = config
        self._later(0.01, JobReady(job))

    def run(self, task: EpochTask) -> None:
        self._say_all(self._queue.add(task))
        self._go_on()

    def stop_at(self, shard: ShardKey, hit: Position, commit_order: CommitOrder) -> None:
        self._say_all(self._queue.stop_at(shard, hit, commit_order))

    def discard(self, shard: ShardKey) -> None:
        self._queue.discard(shard)
        self._islands.pop(shard, None)

    def discard_job(self, job: str) -> None:
        self._queue.discard_job(job)
        self._jobs.pop(job, None)

    def close(self) -> None:
        self._dead = True

    def hold(self) -> None:
        """Get on no more until `go_on`: a thread that hangs."""
        self._is_held = True

    def go_on(self) -> None:
        """Get on again."""
        self._is_held = False
        self._go_on()

    def begin(self, task: EpochTask) -> RunningEpoch:
        """Begin an island's epoch."""
        key = task.key
        if (key.job, key.variable, key.epoch) == self.poisonous and self.kill is not None:
            self.network.at(self.network.now, self.kill)
        if (key.job, key.epoch) == self.hangs:
            self._dead_loop = True
        if (key.island, key.epoch) == self.broken:
            raise ZeroDivisionError("the stub broke as it was told to")
        config = self._jobs[key.job]
        islands = self._islands.setdefault(key.shard, {})
        if task.state is not None:
            self.restored.append((key.term, key.epoch, key.island))
            islands[key.island] = StubIsland.from_bytes(task.state)
        elif task.blocks is None:
            seed = f"{config.seed}/{key.variable}/{key.island}".encode()
            islands[key.island] = StubIsland(hashlib.sha256(seed).digest())
        else:
            slots = parse_slots(task.blocks)
            if sorted(slots) != list(range(SLOTS)):
                self.rejected += 1
                raise RemoteProtocolError(f"slots {sorted(slots)} came")
            islands[key.island].stir(*(slots[slot] for slot in sorted(slots)))
        if task.takes_snapshot:  # whatever a snapshot lacks is lost for good
            islands[key.island] = StubIsland.from_bytes(islands[key.island].to_bytes())
        if self.corrupt and key.epoch == 3:
            islands[key.island].stir()
        return StubWork(task, islands[key.island], config, self._spend)

    def _go_on(self) -> None:
        """Take a turn, if there is one to take, at the end of the time that it takes."""
        if self._is_at_work or self._is_held or self._queue.is_idle or self._dead:
            return
        self._is_at_work = True
        seconds = self.slowness * (0.0005 + 0.003 * self._stream.uniform())
        self.network.at(self.network.now + seconds, lambda: self._turn(seconds))

    def _turn(self, seconds: float) -> None:
        self._is_at_work = False
        if self._dead or self._dead_loop or self._is_held or self._queue.is_idle:
            return
        self.progress += 1
        self.turns += 1
        self._turn_s = seconds
        self._say_all(self._queue.turn())
        self._go_on()

    def _spend(self) -> None:
        """Let the time of the turn pass, while it is taken: jobs are charged for it."""
        self._worked_s += self._turn_s

    def _later(self, delay_s: float, word: object) -> None:
        self.network.at(self.network.now + delay_s, lambda: self._say_all([word]))

    def _say_all(self, words: Iterable[object]) -> None:
        for word in words:
            if self._post is not None and not self._dead:
                self._post(word)


def parse_slots(blocks: Mapping[int, bytes]) -> dict[int, bytes]:
    """Return solutions by slot."""
    joined = b"".join(blocks[source] for source in sorted(blocks))
    return {joined[place]: joined[place + 1 : place + 9] for place in range(0, len(joined), 9)}


def addition_of(epoch: int, generation: int, state: bytes) -> Addition:
    """Return an addition whose every field depends on the state."""
    error = (1 + state[1]) / (256.0 * (epoch + generation / 100))
    function = (SIN, COS, TANH)[state[3] % 3]
    program = bytes([2, CONSTANT, function, *bytes(8)]) + struct.pack("<d", error)
    return Addition(complexity=1 + state[2] % 6, error=error, mse=error * error, generation=generation, program=program)
