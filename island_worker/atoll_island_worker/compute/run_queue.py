"""What is under way on a worker, slice by slice: the compute thread's order of work. Pure; time comes from a clock.

Islands take turns of one slice: first the job charged least by its weight, then the slice that counts first
(`atoll_core.search.commit_order`). When the target is met, what is no longer needed is given up at once, and what has
come far enough is reported.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

from atoll_core.errors import RemoteProtocolError
from atoll_core.search.commit_order import CommitOrder, Position
from atoll_island_worker.session.epoch_tasks import ShardKey, Task, TaskKey
from atoll_island_worker.session.events import Abandoned, Broken, Computed, Outcome, Rejected, Snapshot


class Work(Protocol):
    """One island's epoch under way."""

    @property
    def generation(self) -> int:
        """Generations of the epoch that have passed."""
        ...

    @property
    def snapshot(self) -> bytes | None:
        """The island's state before generation 0, if the task wants it."""

    def advance(self) -> bool:
        """Compute one slice, or part of a long one; return True when the epoch is over or the target was met.

        Nothing was met before the end of a slice.
        """
        ...

    def computed(self) -> Computed:
        """Return what came of it so far."""
        ...


Begin = Callable[[Task], Work]
"""Begins an island's epoch; raises RemoteProtocolError when the immigrants are malformed."""


@dataclass(slots=True)
class _Open:
    """A task; `work` is None before its first turn."""

    task: Task
    work: Work | None = None

    @property
    def generation(self) -> int:
        return self.work.generation if self.work is not None else 0


class RunQueue:
    """The tasks of one worker that are not done yet."""

    def __init__(self, begin: Begin, clock: Callable[[], float]) -> None:
        """`clock` gives seconds, by which jobs are charged for their turns; `current` is the task of the last turn."""
        self._begin = begin
        self._clock = clock
        self._open: dict[TaskKey, _Open] = {}
        self._hits: dict[ShardKey, Position] = {}
        self._charged: dict[str, float] = {}
        self._weights: dict[str, float] = {}
        self.current: TaskKey | None = None

    @property
    def is_idle(self) -> bool:
        """Whether there is nothing to compute."""
        return not self._open

    def set_weight(self, job: str, weight: float) -> None:
        """Charge a job's turns by 1/`weight` of their time, so that it gets that many times the share of others."""
        self._weights[job] = weight

    def add(self, task: Task) -> list[Outcome]:
        """Take in a task; return that it is given up when it is not needed."""
        job = task.key.job
        if job not in self._charged:
            self._charged[job] = min(self._charged.values(), default=0.0)
        self._open[task.key] = _Open(task)
        return self._settle([task.key])

    def stop_at(self, shard: ShardKey, hit: Position, commit_order: CommitOrder) -> list[Outcome]:
        """Note that the target was met; return what came of the tasks of which no more is needed."""
        self._hits[shard] = min(hit, self._hits.get(shard, hit), key=commit_order.rank)
        return self._settle([key for key in self._open if key.shard == shard])

    def turn(self) -> list[Snapshot | Outcome]:
        """Compute one slice of the task whose turn it is; return its snapshot and what came of tasks done by it."""
        key = min(self._open, key=self._rank)
        open_task = self._open[key]
        task = open_task.task
        self.current = key
        began = self._clock()
        results: list[Snapshot | Outcome] = []
        outcome: Outcome | None = None
        try:
            if open_task.work is None:
                open_task.work = self._begin(task)
                if open_task.work.snapshot is not None:
                    results.append(Snapshot(key, open_task.work.snapshot, task.is_at_barrier))
            if not task.is_at_barrier and open_task.work.advance():
                outcome = open_task.work.computed()
        except RemoteProtocolError as error:
            outcome = Rejected(key, str(error))
        except Exception as error:  # it is the job that fails, not the worker
            outcome = Broken(key, f"island {key.island} of {key.variable} broke in epoch {key.epoch}: {brief(error)}")
        self._charged[key.job] += (self._clock() - began) / self._weights.get(key.job, 1.0)
        if outcome is None and not task.is_at_barrier:
            return results + self._settle([key])
        del self._open[key]
        if outcome is not None:
            results.append(outcome)
        if isinstance(outcome, Computed) and outcome.report.hit is not None:
            hit = Position(key.epoch, outcome.report.hit.generation, key.island)
            results += self.stop_at(key.shard, hit, task.commit_order)
        return results

    def discard(self, shard: ShardKey) -> None:
        """Forget the tasks of an archipelago's term."""
        self._hits.pop(shard, None)
        for key in [key for key in self._open if key.shard == shard]:
            del self._open[key]

    def discard_job(self, job: str) -> None:
        """Forget the tasks of a job and what it was charged."""
        self._open = {key: open_task for key, open_task in self._open.items() if key.job != job}
        self._hits = {shard: hit for shard, hit in self._hits.items() if shard.job != job}
        self._charged.pop(job, None)
        self._weights.pop(job, None)

    def _rank(self, key: TaskKey) -> tuple[float, int, int, int, str, str, int]:
        open_task = self._open[key]
        at = Position(key.epoch, open_task.generation, key.island)
        epoch, group, generation, island = open_task.task.commit_order.rank(at)
        return (self._charged.get(key.job, 0.0), epoch, group, generation, key.job, key.variable, island)

    def _settle(self, keys: Iterable[TaskKey]) -> list[Outcome]:
        """Close those of these tasks of which no more is needed, and return what came of them."""
        outcomes: list[Outcome] = []
        for key in keys:
            open_task, hit = self._open[key], self._hits.get(key.shard)
            if hit is None or self._is_needed(open_task, hit):
                continue
            del self._open[key]
            part = open_task.work if key.epoch == hit.epoch else None
            outcomes.append(part.computed() if part is not None else Abandoned(key))
        return outcomes

    def _is_needed(self, open_task: _Open, hit: Position) -> bool:
        key = open_task.task.key
        if key.epoch != hit.epoch:
            return key.epoch < hit.epoch
        return open_task.generation < open_task.task.commit_order.needed(hit, key.island)


def brief(error: BaseException) -> str:
    """Return an error's kind and words, of a length that can be shown."""
    return f"{type(error).__name__}: {error}"[:500]
