"""The order in which a worker's compute thread works on its tasks, slice by slice. Pure; time comes from a clock.

Islands take turns of one slice; users and jobs are charged with the seconds of their turns. The next turn goes to the
user with the least charge, then to the job of this user with the least charge per weight, then to the first slice of
this job in the commit order (`atoll_core.search.commit_order`). So users have equal shares of a worker, for any number
and priority of jobs, and the weights divide the share of one user. When the target is met, tasks that are no longer
needed are dropped at once, and tasks that have reached the hit are reported.

Each job has a heap of its tasks in the commit order, because a worker may have a thousand islands of a job: looking at
all of them before each slice would take as long as computing.
"""

import heapq
import itertools
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

from atoll_core.errors import RemoteProtocolError
from atoll_core.search.commit_order import CommitOrder, Position
from atoll_island_worker.session import interface as io


class RunningEpoch(Protocol):
    """One island's epoch in progress."""

    @property
    def generation(self) -> int:
        """Number of computed generations of the epoch."""
        ...

    @property
    def snapshot(self) -> bytes | None:
        """The island's state before generation 0, if the task includes a snapshot."""

    def advance(self) -> bool:
        """Compute one slice, or part of a long one; return True when the epoch is over or the target was met.

        The target can only be met at the end of a slice.
        """
        ...

    def computed(self) -> io.EpochComputed:
        """Return the result up to now."""
        ...


Begin = Callable[[io.EpochTask], RunningEpoch]
"""Begins an island's epoch; raises RemoteProtocolError if the immigrants are malformed."""


@dataclass(slots=True, eq=False)
class _Open:
    """A task; `work` is None before its first turn."""

    task: io.EpochTask
    work: RunningEpoch | None = None

    @property
    def generation(self) -> int:
        return self.work.generation if self.work is not None else 0


_Rank = tuple[int, int, int]
"""Epoch, group and generation of the next slice of a task, see `CommitOrder.rank`."""

_Entry = tuple[_Rank, str, int, int, _Open]
"""A task in the heap of its job: rank, variable, island, a unique number, the task."""


class RunQueue:
    """The tasks of one worker that are not done yet."""

    def __init__(self, begin: Begin, clock: Callable[[], float]) -> None:
        """`clock` returns seconds, by which users and jobs are charged for turns.

        `current` is the task of the last turn.

        `seconds` is the total time of turns, by user.
        """
        self._begin = begin
        self._clock = clock
        self._open: dict[io.TaskKey, _Open] = {}
        self._heaps: dict[str, list[_Entry]] = {}  # by job; tasks that are not open any more may still be in there
        self._number_of_open: Counter[str] = Counter()
        self._numbers = itertools.count()
        self._hits: dict[io.ShardKey, Position] = {}
        self._charged: dict[str, float] = {}
        self._charged_users: dict[str, float] = {}
        self._weights: dict[str, float] = {}
        self._users: dict[str, str] = {}
        self.seconds: dict[str, float] = {}
        self.current: io.TaskKey | None = None

    @property
    def is_idle(self) -> bool:
        """Whether there is no task to compute."""
        return not self._open

    def share(self, job: str, weight: float, user: str) -> None:
        """Set the user of a job ("": no user), and its `weight` among the jobs of that user."""
        self._weights[job] = weight
        self._users[job] = user

    def add(self, task: io.EpochTask) -> list[io.Outcome]:
        """Add a task; return an Abandoned if it is not needed."""
        self._join_shares(task.key.job)
        self._remove(task.key)
        self._open[task.key] = open_task = _Open(task)
        self._number_of_open[task.key.job] += 1
        self._push(open_task)
        return self._close_finished([task.key])

    def stop_at(self, shard: io.ShardKey, hit: Position, commit_order: CommitOrder) -> list[io.Outcome]:
        """Record that the target was met; return the outcomes of tasks that need no more computation."""
        self._hits[shard] = min(hit, self._hits.get(shard, hit), key=commit_order.rank)
        return self._close_finished([key for key in self._open if key.shard == shard])

    def turn(self) -> list[io.Snapshot | io.Outcome]:
        """Compute one slice of the task whose turn it is.

        Return its snapshot, and outcomes of tasks that the slice ends.
        """
        open_task = self._pop()
        task, key = open_task.task, open_task.task.key
        self.current = key
        began = self._clock()
        results: list[io.Snapshot | io.Outcome] = []
        outcome: io.Outcome | None = None
        try:
            if open_task.work is None:
                open_task.work = self._begin(task)
                if open_task.work.snapshot is not None:
                    results.append(io.Snapshot(key, open_task.work.snapshot, task.is_at_barrier))
            if not task.is_at_barrier and open_task.work.advance():
                outcome = open_task.work.computed()
        except RemoteProtocolError as error:
            outcome = io.Rejected(key, str(error))
        except Exception as error:  # the job fails, not the worker
            outcome = io.Broken(
                key, f"island {key.island} of {key.variable} failed in epoch {key.epoch}: {brief(error)}"
            )
        self._charge(key.job, self._clock() - began)
        if outcome is None and not task.is_at_barrier:
            self._push(open_task)
            return results + self._close_finished([key])
        self._remove(key)
        if outcome is not None:
            results.append(outcome)
        if isinstance(outcome, io.EpochComputed) and outcome.report.hit is not None:
            hit = Position(key.epoch, outcome.report.hit.generation, key.island)
            results += self.stop_at(key.shard, hit, task.commit_order)
        return results

    def discard(self, shard: io.ShardKey) -> None:
        """Forget the tasks of an archipelago's term."""
        self._hits.pop(shard, None)
        for key in [key for key in self._open if key.shard == shard]:
            self._remove(key)

    def discard_job(self, job: str) -> None:
        """Forget the tasks of a job and its charge."""
        for key in [key for key in self._open if key.job == job]:
            self._remove(key)
        self._hits = {shard: hit for shard, hit in self._hits.items() if shard.job != job}
        self._charged.pop(job, None)
        self._weights.pop(job, None)
        user = self._users.pop(job, "")
        if user not in self._users.values():
            self._charged_users.pop(user, None)

    def _join_shares(self, job: str) -> None:
        """Give a job without tasks at least the smallest charge among its user's jobs with tasks, and a user without
        tasks at least the smallest charge among users with tasks. So idle time gives no credit."""
        user, open_jobs = self._users.get(job, ""), self._number_of_open.keys()
        if job not in open_jobs:
            own = [self._charged[other] for other in open_jobs if self._users.get(other, "") == user]
            self._charged[job] = max(self._charged.get(job, 0.0), min(own, default=0.0))
        open_users = {self._users.get(other, "") for other in open_jobs}
        if user not in open_users:
            least = min((self._charged_users.get(other, 0.0) for other in open_users), default=0.0)
            self._charged_users[user] = max(self._charged_users.get(user, 0.0), least)

    def _charge(self, job: str, seconds: float) -> None:
        user = self._users.get(job, "")
        self._charged[job] += seconds / self._weights.get(job, 1.0)
        self._charged_users[user] = self._charged_users.get(user, 0.0) + seconds
        self.seconds[user] = self.seconds.get(user, 0.0) + seconds

    def _push(self, open_task: _Open) -> None:
        """Put a task into the heap of its job; to be called again whenever its generation has changed."""
        key = open_task.task.key
        rank = open_task.task.commit_order.rank(Position(key.epoch, open_task.generation, key.island))[:3]
        heap = self._heaps.setdefault(key.job, [])
        heapq.heappush(heap, (rank, key.variable, key.island, next(self._numbers), open_task))

    def _pop(self) -> _Open:
        """Take the task whose turn it is out of the heap of its job."""
        for heap in self._heaps.values():
            while self._open.get(heap[0][-1].task.key) is not heap[0][-1]:
                heapq.heappop(heap)
        return heapq.heappop(self._heaps[min(self._heaps, key=self._turn_of)])[-1]

    def _turn_of(self, job: str) -> tuple[float, float, _Rank, str]:
        of_user = self._charged_users.get(self._users.get(job, ""), 0.0)
        return (of_user, self._charged[job], self._heaps[job][0][0], job)

    def _remove(self, key: io.TaskKey) -> None:
        """Remove a task if it is open."""
        if self._open.pop(key, None) is None:
            return
        self._number_of_open[key.job] -= 1
        if not self._number_of_open[key.job]:
            del self._number_of_open[key.job], self._heaps[key.job]

    def _close_finished(self, keys: Iterable[io.TaskKey]) -> list[io.Outcome]:
        """Close the given tasks that need no more computation, and return their outcomes."""
        outcomes: list[io.Outcome] = []
        for key in keys:
            open_task, hit = self._open[key], self._hits.get(key.shard)
            if hit is None or self._is_needed(open_task, hit):
                continue
            self._remove(key)
            part = open_task.work if key.epoch == hit.epoch else None
            outcomes.append(part.computed() if part is not None else io.Abandoned(key))
        return outcomes

    def _is_needed(self, open_task: _Open, hit: Position) -> bool:
        key = open_task.task.key
        if key.epoch != hit.epoch:
            return key.epoch < hit.epoch
        return open_task.generation < open_task.task.commit_order.needed(hit, key.island)


def brief(error: BaseException) -> str:
    """Return an error's type and message, shortened."""
    return f"{type(error).__name__}: {error}"[:500]
