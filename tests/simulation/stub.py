"""A stub of the compute port: islands that only hash, so that any loss, disorder or double changes the digest.

The state of an island is the hash of (state, immigrants by slot, epoch); evaluations are counted; the target is met at
a seeded (epoch, generation) of a seeded island. Time passes as drawn from a stream of the worker's own.
"""

import hashlib
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from common.config import JobConfig
from common.seeding import Stream, stream_key
from common.wire.messages import Addition, HitStatement, IslandReport
from common.wire.simulated_bus import SimulatedNetwork
from island_worker.compute import WarmedUp, WarmUpNote
from island_worker.events import Abandoned, Broken, Computed, JobReady, Rejected, Task

SLOTS = 4
"""Solutions per island."""


@dataclass
class StubIsland:
    """State of one island: a hash, and cumulative evaluations."""

    state: bytes
    evaluations: int = 0


@dataclass(frozen=True)
class Shuffle:
    """The reshuffle of one epoch: source of every (destination, slot)."""

    sources: Mapping[tuple[int, int], tuple[int, int]]

    @classmethod
    def of(cls, config: JobConfig, variable: str, epoch: int) -> "Shuffle":
        islands = config.evolution.islands
        order = Stream(stream_key(config.seed, variable, -1, epoch, "stub-shuffle")).permutation(islands * SLOTS)
        return cls({divmod(place, SLOTS): divmod(come_from, SLOTS) for place, come_from in enumerate(order)})  # type: ignore[misc]

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


def hit_of(config: JobConfig, variable: str) -> tuple[int, int, int] | None:
    """Return (epoch, generation, island) at which the target is met; for one variable in four it never is."""
    stream = Stream(stream_key(config.seed, variable, -1, 0, "stub-hit"))
    if stream.below(4) == 0:
        return None
    return 1 + stream.below(20), 1 + stream.below(100), stream.below(config.evolution.islands)


@dataclass
class StubCompute:
    """One worker's compute port on the simulated network."""

    network: SimulatedNetwork
    worker: str
    seed: int
    slowness: float = 1.0
    warm_up_s: float = 0.5
    broken: tuple[int, int] | None = None
    corrupt: bool = False
    progress: int = 0
    fingerprint: str = "stub"
    rejected: int = 0
    _jobs: dict[str, JobConfig] = field(default_factory=dict)
    _islands: dict[tuple[str, str, int, int], StubIsland] = field(default_factory=dict)
    _post: Callable[[object], None] | None = None
    _dead: bool = False

    def __post_init__(self) -> None:
        self._stream = Stream(stream_key(self.seed, self.worker, -1, 0, "stub-speed"))

    def attach(self, post: Callable[[object], None]) -> None:
        self._post = post
        self._later(0.0, WarmUpNote("loading"))
        self._later(self.warm_up_s, WarmedUp(self.warm_up_s, self.fingerprint))

    def warm_up(self) -> None:
        """Begins when attached."""

    def load(self, job: str, config: JobConfig, dataset: bytes) -> None:
        self._jobs[job] = config
        self._later(0.01, JobReady(job))

    def advance(self, task: Task) -> None:
        seconds = self.slowness * (0.005 + 0.03 * self._stream.uniform())
        self.network.at(self.network.now + seconds, lambda: self._finish(task, seconds))

    def discard(self, job: str, variable: str, term: int) -> None:
        for key in [key for key in self._islands if key[:3] == (job, variable, term)]:
            del self._islands[key]

    def discard_job(self, job: str) -> None:
        self._jobs.pop(job, None)

    def close(self) -> None:
        self._dead = True

    def _later(self, delay_s: float, word: object) -> None:
        self.network.at(self.network.now + delay_s, lambda: self._say(word))

    def _say(self, word: object) -> None:
        if self._post is not None and not self._dead:
            self._post(word)

    def _finish(self, task: Task, seconds: float) -> None:
        self.progress += 1
        key = task.key
        config = self._jobs.get(key.job)
        place = (key.job, key.variable, key.term, key.island)
        if config is None or (task.blocks is not None and place not in self._islands):
            self._say(Abandoned(key))
        elif (key.island, key.epoch) == self.broken:
            self._say(Broken(key, "the stub broke as it was told to"))
        else:
            self._say(self._advance(task, config, place, seconds))

    def _advance(
        self, task: Task, config: JobConfig, place: tuple[str, str, int, int], seconds: float
    ) -> Computed | Rejected:
        key = task.key
        if task.blocks is None:
            seed = f"{config.seed}/{key.variable}/{key.island}".encode()
            self._islands[place] = StubIsland(hashlib.sha256(seed).digest())
        island = self._islands[place]
        if task.blocks is not None:
            slots = parse_slots(task.blocks)
            if sorted(slots) != list(range(SLOTS)):
                self.rejected += 1
                return Rejected(key, f"slots {sorted(slots)} came")
            island.state = hashlib.sha256(island.state + b"".join(slots[slot] for slot in sorted(slots))).digest()
        island.state = hashlib.sha256(island.state + struct.pack("<q", key.epoch)).digest()
        if self.corrupt and key.epoch == 3:
            island.state = hashlib.sha256(island.state).digest()
        island.evaluations += 100 + island.state[0]
        hit = hit_of(config, key.variable)
        met = hit is not None and (key.epoch, key.island) == (hit[0], hit[2])
        report = report_of(key.island, key.epoch, island, hit[1] if met and hit else None)
        if met or task.is_last:
            return Computed(key, report, {}, frozenset(), seconds)
        shuffle = Shuffle.of(config, key.variable, key.epoch)
        return Computed(
            key, report, shuffle.blocks_from(key.island, island.state), shuffle.senders_to(key.island), seconds
        )


def parse_slots(blocks: Mapping[int, bytes]) -> dict[int, bytes]:
    """Return solutions by slot."""
    joined = b"".join(blocks[source] for source in sorted(blocks))
    return {joined[place]: joined[place + 1 : place + 9] for place in range(0, len(joined), 9)}


def report_of(island: int, epoch: int, state: StubIsland, hit: int | None) -> IslandReport:
    """Return a report whose every field depends on the state."""
    error = (1 + state.state[1]) / (256.0 * (epoch + 1))
    program = bytes([1, 1]) + bytes(4) + struct.pack("<d", error)
    addition = Addition(
        complexity=1 + state.state[2] % 6,
        error=error,
        mse=error * error,
        generation=state.state[3] % 100,
        program=program,
    )
    return IslandReport(
        island=island,
        generations=hit if hit is not None else 100,
        hit=None if hit is None else HitStatement(generation=hit, error=1e-12),
        additions=(addition,),
        evaluations={"offspring": state.evaluations, "trainers": state.state[4]},
        best_error=error,
        digest=state.state.hex(),
    )
