"""The queue: turns of one slice, and what a hit ends."""

import random
from dataclasses import dataclass, field

import pytest

from atoll_core.errors import RemoteProtocolError
from atoll_core.search.commit_order import CommitOrder, Position
from atoll_core.wire.messages.epochs import HitStatement, IslandReport
from atoll_island_worker.compute.run_queue import RunQueue
from atoll_island_worker.session.interface import (
    Abandoned,
    Broken,
    EpochComputed,
    EpochTask,
    Outcome,
    Rejected,
    ShardKey,
    Snapshot,
    TaskKey,
)

LAST = 50
COMMIT_ORDER = CommitOrder(generations=LAST, stride=10, joining=8)
SHARD = ShardKey("job", "x", 1)


def key(island: int, epoch: int = 0, job: str = "job", variable: str = "x", term: int = 1) -> TaskKey:
    return TaskKey(job, variable, term, island, epoch)


@dataclass
class Bench:
    """Islands that do as they are told, and a note of every slice. A slice takes a second, or what `takes` says."""

    hits: set[tuple[int, int, int]] = field(default_factory=set)
    takes: dict[str, float] = field(default_factory=dict)
    slices: list[tuple[str, str, int, int, int]] = field(default_factory=list)
    now: float = 0.0

    def begin(self, task: EpochTask) -> "Fake":
        if task.key.island == 7:
            raise RemoteProtocolError("malformed")
        return Fake(self, task)


@dataclass
class Fake:
    bench: Bench
    task: EpochTask
    generation: int = 0
    hit: HitStatement | None = None

    @property
    def snapshot(self) -> bytes | None:
        return b"state" if self.task.takes_snapshot else None

    def advance(self) -> bool:
        key = self.task.key
        if key.island == 6:
            raise ZeroDivisionError("as it was told")
        self.generation += 10
        self.bench.now += self.bench.takes.get(key.job, 1.0)
        self.bench.slices.append((key.job, key.variable, key.epoch, self.generation, key.island))
        if (key.epoch, self.generation, key.island) in self.bench.hits:
            self.hit = HitStatement(generation=self.generation, error=0.0)
        return self.hit is not None or self.generation == LAST

    def computed(self) -> EpochComputed:
        report = IslandReport(
            island=self.task.key.island,
            generations=self.generation,
            hit=self.hit,
            additions=(),
            counters=(),
            best_error=None,
            digest="ab" * 16,
        )
        return EpochComputed(self.task.key, report, {}, frozenset())


def queue_of(bench: Bench, *keys: TaskKey) -> RunQueue:
    queue = RunQueue(bench.begin, lambda: bench.now)
    for task_key in keys:
        assert queue.add(EpochTask(task_key, None, is_last=False, commit_order=COMMIT_ORDER)) == []
    return queue


def emptied(queue: RunQueue) -> list[Snapshot | Outcome]:
    outcomes: list[Snapshot | Outcome] = []
    while not queue.is_idle:
        outcomes += queue.turn()
    return outcomes


def reached(outcomes: list[Outcome]) -> dict[tuple[int, int], int | None]:
    """Return by (epoch, island) the generation reported; None where the task was given up."""
    generations: dict[tuple[int, int], int | None] = {}
    for outcome in outcomes:
        assert isinstance(outcome, EpochComputed | Abandoned)
        generations[outcome.key.epoch, outcome.key.island] = (
            outcome.report.generations if isinstance(outcome, EpochComputed) else None
        )
    return generations


def test_islands_take_turns_slice_by_slice() -> None:
    bench = Bench(takes={"job": 0.0})
    queue = queue_of(bench, key(1), key(0), key(0, variable="y"), key(2, epoch=1))
    emptied(queue)
    expected = [
        ("job", name, 0, end, island)
        for end in range(10, 51, 10)
        for name, island in zip("xxy", (0, 1, 0), strict=True)
    ]
    assert bench.slices == expected + [("job", "x", 1, end, 2) for end in range(10, 51, 10)]


@pytest.mark.parametrize("seed", range(20))
def test_the_next_slice_is_the_first_in_commit_order_while_tasks_come_and_go(seed: int) -> None:
    draw, bench = random.Random(seed), Bench()
    queue, generations = queue_of(bench), dict[TaskKey, int]()
    for _ in range(400):
        step = draw.random()
        new = key(draw.randrange(8, 200), draw.randrange(3), variable=draw.choice("xyz"))
        if step < 0.4 and new not in generations:
            add_all(queue, new)
            generations[new] = 0
        elif step < 0.42:
            queue.discard(new.shard)
            generations = {one: done for one, done in generations.items() if one.shard != new.shard}
        elif generations:
            first = min(generations, key=lambda one: rank(one, generations[one]))
            queue.turn()
            generations[first] += 10
            assert bench.slices[-1] == ("job", first.variable, first.epoch, generations[first], first.island)
            if generations[first] == LAST:
                del generations[first]
        assert queue.is_idle == (not generations)


def rank(one: TaskKey, generation: int) -> tuple[int, int, int, str, int]:
    """Return the sort key of the next slice: in epoch 0, islands begin in groups of eight."""
    return (one.epoch, one.island // 8 if one.epoch == 0 else 0, generation, one.variable, one.island)


def test_a_job_that_comes_later_does_not_make_up_for_what_the_others_had() -> None:
    bench = Bench()
    queue = queue_of(bench, key(0, job="a"))
    for _ in range(3):
        queue.turn()
    queue.add(EpochTask(key(0, job="b"), None, is_last=False, commit_order=COMMIT_ORDER))
    for _ in range(4):
        queue.turn()
    assert [job for job, *_ in bench.slices[3:]] == ["b", "a", "b", "a"]


def test_a_hit_ends_every_island_where_it_is_not_needed_any_more() -> None:
    bench = Bench(hits={(0, 20, 2)})
    outcomes = emptied(queue_of(bench, *(key(island) for island in range(4)), key(5, epoch=1)))
    assert reached(outcomes) == {(0, 0): 20, (0, 1): 20, (0, 2): 20, (0, 3): 10, (1, 5): None}
    assert len(bench.slices) == 4 + 3


def test_a_hit_elsewhere_lets_the_islands_before_it_catch_up() -> None:
    bench = Bench()
    queue = queue_of(bench, key(0), key(3))
    for _ in range(3):
        queue.turn()
    assert reached(queue.stop_at(SHARD, Position(0, 20, 2), COMMIT_ORDER)) == {(0, 0): 20, (0, 3): 10}
    queue = queue_of(bench, key(0), key(3))
    assert queue.stop_at(SHARD, Position(0, 20, 2), COMMIT_ORDER) == []
    assert reached(emptied(queue)) == {(0, 0): 20, (0, 3): 10}


def test_what_is_discarded_is_forgotten_with_its_hits() -> None:
    bench = Bench()
    queue = queue_of(bench, key(0), key(0, variable="y"))
    queue.stop_at(SHARD, Position(0, 20, 0), COMMIT_ORDER)
    queue.discard(SHARD)
    emptied(queue)
    assert {variable for _, variable, *_ in bench.slices} == {"y"}
    queue.add(EpochTask(key(0), None, is_last=False, commit_order=COMMIT_ORDER))
    assert reached(emptied(queue)) == {(0, 0): 50}


@pytest.mark.parametrize(("island", "kind"), [(6, Broken), (7, Rejected)])
def test_what_goes_wrong_ends_its_task_alone(island: int, kind: type) -> None:
    outcomes = emptied(queue_of(Bench(), key(island), key(0)))
    assert [type(outcome) for outcome in outcomes] == [kind, EpochComputed]


def test_users_share_a_worker_evenly_whatever_number_of_jobs_of_whatever_priority_they_have() -> None:
    bench = Bench()
    queue = RunQueue(bench.begin, lambda: bench.now)
    for job, weight, user in (("a1", 1024.0, "ann"), ("a2", 1.0, "ann"), ("a3", 1.0, "ann"), ("b", 2.0**-10, "bob")):
        queue.share(job, weight, user)
    add_all(queue, *(key(island, job=job) for job in ("a1", "a2", "a3", "b") for island in range(6)))
    for _ in range(40):
        queue.turn()
    turns = [job for job, *_ in bench.slices]
    assert turns.count("b") == 20
    assert queue.seconds == {"ann": 20.0, "bob": 20.0}


def test_who_had_nothing_to_do_saves_nothing_up() -> None:
    bench = Bench()
    queue = RunQueue(bench.begin, lambda: bench.now)
    queue.share("a", 1.0, "ann")
    queue.share("b", 1.0, "bob")
    add_all(queue, key(0, job="b"))
    emptied(queue)
    add_all(queue, *(key(island, job="a") for island in range(6)))
    for _ in range(20):
        queue.turn()
    add_all(queue, *(key(island, job="b") for island in range(6)))
    bench.slices.clear()
    for _ in range(10):
        queue.turn()
    assert [job for job, *_ in bench.slices].count("b") == 5


def add_all(queue: RunQueue, *keys: TaskKey) -> None:
    for task_key in keys:
        assert queue.add(EpochTask(task_key, None, is_last=False, commit_order=COMMIT_ORDER)) == []
