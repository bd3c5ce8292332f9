"""Decides how many jobs of a batch system should run, and which jobs should end. Pure: time and state are arguments.

The number of jobs grows at once, because the batch system's own queue takes time. It shrinks to the largest number that
was needed in the last `idle_s` seconds: the next search may come soon, and ending workers must hand over their islands.
Kubernetes' autoscaler has the same rule.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from atoll_core.errors import AtollError

MOST_FAILURES: Final = 3
"""`adapt` fails after this number of consecutive jobs that ended before one of their workers had joined; one or two
jobs may get a bad node."""

BatchState = Literal["pending", "running", "ending", "failed"]
"""`failed`: the system could not start the job and keeps it until it is deleted, as Grid Engine does."""


@dataclass(frozen=True, slots=True)
class AdaptLimits:
    """Smallest and largest number of jobs, workers in each job, and seconds of lower need before a job is ended."""

    minimum: int
    maximum: int
    workers: int
    idle_s: float


@dataclass(frozen=True, slots=True)
class BatchJob:
    """A job of the batch system; `number` rises with the time of submission."""

    id: str
    number: int
    state: BatchState


@dataclass(frozen=True, slots=True)
class Need:
    """The coordinator's need: the number of `workers` that could have work, and the number of `others`, the workers
    that our jobs did not start.

    `islands`: number of islands by batch job id, for each of our jobs from which a worker has joined.
    """

    workers: int
    others: int
    islands: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class AdaptDecision:
    """The number of jobs to submit, the ids of pending jobs to cancel and of running jobs to drain."""

    submit: int = 0
    take_back: tuple[str, ...] = ()
    drain: tuple[str, ...] = ()


class AdaptPolicy:
    """Decides at each poll. It remembers the recent needs, the state of each job when it was asked to end, and the jobs
    from which no worker has joined yet.
    """

    def __init__(self, limits: AdaptLimits) -> None:
        self._limits = limits
        self._began_at: float | None = None
        self._needs: list[tuple[float, int]] = []
        self._asked_to_end: dict[str, BatchState] = {}
        self._waited_for: set[str] = set()
        self._failures = 0

    def decide(self, now: float, need: Need, jobs: Sequence[BatchJob]) -> AdaptDecision:
        """Process one poll at `now`, in seconds that only increase; return the jobs to submit and to end.

        Raises:
            AtollError: jobs keep ending before one of their workers has joined.
        """
        self._watch(need.islands.keys(), jobs)
        needed = self._needed(need)
        # at least as many jobs as are needed now, at most as many as were needed recently
        if self._began_at is None:
            self._began_at = now
        self._needs = [(at, count) for at, count in self._needs if now - at < self._limits.idle_s]
        self._needs.append((now, needed))
        has_seen_enough = now - self._began_at >= self._limits.idle_s
        most = max(count for _, count in self._needs) if has_seen_enough else self._limits.maximum
        target = _Target(needed, most)
        failed = [job for job in jobs if job.state == "failed" and job.id not in self._asked_to_end]
        kept = [job for job in jobs if job.state in ("pending", "running") and job.id not in self._asked_to_end]
        ends = sorted(kept, key=lambda job: self._order(job, need))[: max(0, len(kept) - target.most)]
        self._asked_to_end |= {job.id: job.state for job in (*failed, *ends)}
        self._waited_for -= {job.id for job in ends}
        return AdaptDecision(
            submit=max(0, target.least - len(kept)),
            take_back=tuple(job.id for job in (*failed, *ends) if job.state != "running"),
            drain=tuple(job.id for job in ends if job.state == "running"),
        )

    def forget(self, job: str) -> None:
        """Register that a job could not be ended, so that the next poll decides on this job again."""
        self._asked_to_end.pop(job, None)

    def _needed(self, need: Need) -> int:
        workers = max(0, need.workers - need.others)
        jobs = -(-workers // self._limits.workers)
        return min(max(jobs, self._limits.minimum), self._limits.maximum)

    def _order(self, job: BatchJob, need: Need) -> tuple[bool, int, int]:
        """Return the sort key for ending jobs, cheapest first: pending jobs from the newest, then running jobs with few
        islands.

        Among jobs with equally many islands the oldest ends first, because its time limit comes first.
        """
        if job.state == "pending":
            return False, 0, -job.number
        return True, need.islands.get(job.id, 0), job.number

    def _watch(self, joined: Collection[str], jobs: Sequence[BatchJob]) -> None:
        """Count consecutive jobs that ended before one of their workers had joined."""
        here = {job.id: job.state for job in jobs}
        if self._waited_for & set(joined):
            self._failures = 0
        self._waited_for -= set(joined)
        gone = self._waited_for - here.keys()
        self._failures += len(gone)
        self._waited_for = (self._waited_for - gone) | {
            job.id
            for job in jobs
            if job.state != "ending" and job.id not in self._asked_to_end and job.id not in joined
        }
        # A pending job may have started before it was cancelled.
        self._asked_to_end = {
            job: state
            for job, state in self._asked_to_end.items()
            if job in here and (state, here[job]) != ("pending", "running")
        }
        if self._failures >= MOST_FAILURES:
            raise AtollError(
                f"{self._failures} consecutive jobs ended before one of their workers had joined, the last one was "
                f"{', '.join(sorted(gone))}; read their output, and try their command by hand"
            )


@dataclass(frozen=True, slots=True)
class _Target:
    least: int
    most: int
