"""How many jobs of a batch system should run, and which of them end. Pure; time and state are arguments.

The number grows at once, because the batch system's own queue takes time. It shrinks to the largest number that was
needed in a recent interval, because the next job may come soon and workers that end have to hand over: the rule of
Kubernetes' autoscaler.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from atoll_core.errors import AtollError

MOST_FAILURES: Final = 3
"""Consecutive jobs that may end before one of their workers has joined: one or two may get a bad node."""

BatchState = Literal["pending", "running", "ending", "failed"]
"""`failed`: the system could not start the job and keeps it until it is deleted, as Grid Engine does."""


@dataclass(frozen=True, slots=True)
class AdaptLimits:
    """Fewest and most jobs, worker processes in each, and seconds for which fewer must suffice before one ends."""

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
    """The coordinator's need: workers that would have work, and workers of other origin.

    `islands`: number of islands by job id, for our jobs from which a worker has joined.
    """

    workers: int
    others: int
    islands: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class AdaptDecision:
    """Number of jobs to submit; pending jobs to take back; running jobs to drain."""

    submit: int = 0
    take_back: tuple[str, ...] = ()
    drain: tuple[str, ...] = ()


class AdaptPolicy:
    """Decides at each poll. It remembers the recent needs, which jobs it has asked to end, in which state they
    were, and which have joined.
    """

    def __init__(self, limits: AdaptLimits) -> None:
        self._limits = limits
        self._began_at: float | None = None
        self._needs: list[tuple[float, int]] = []
        self._told: dict[str, BatchState] = {}
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
        failed = [job for job in jobs if job.state == "failed" and job.id not in self._told]
        kept = [job for job in jobs if job.state in ("pending", "running") and job.id not in self._told]
        ends = sorted(kept, key=lambda job: self._order(job, need))[: max(0, len(kept) - target.most)]
        self._told |= {job.id: job.state for job in (*failed, *ends)}
        self._waited_for -= {job.id for job in ends}
        return AdaptDecision(
            submit=max(0, target.least - len(kept)),
            take_back=tuple(job.id for job in (*failed, *ends) if job.state != "running"),
            drain=tuple(job.id for job in ends if job.state == "running"),
        )

    def forget(self, job: str) -> None:
        """Take in that a job could not be ended; it is decided on again."""
        self._told.pop(job, None)

    def _needed(self, need: Need) -> int:
        workers = max(0, need.workers - need.others)
        jobs = -(-workers // self._limits.workers)
        return min(max(jobs, self._limits.minimum), self._limits.maximum)

    def _order(self, job: BatchJob, need: Need) -> tuple[bool, int, int]:
        """Sort by the cost of ending: pending jobs, the last one first; then running jobs, fewest islands first.

        Of equal jobs the oldest ends: its time limit is the next anyway.
        """
        if job.state == "pending":
            return False, 0, -job.number
        return True, need.islands.get(job.id, 0), job.number

    def _watch(self, joined: Collection[str], jobs: Sequence[BatchJob]) -> None:
        """Count jobs that ended before a worker of theirs had joined."""
        here = {job.id: job.state for job in jobs}
        if self._waited_for & set(joined):
            self._failures = 0
        self._waited_for -= set(joined)
        gone = self._waited_for - here.keys()
        self._failures += len(gone)
        self._waited_for = (self._waited_for - gone) | {
            job.id for job in jobs if job.state != "ending" and job.id not in self._told and job.id not in joined
        }
        # A job that should be taken back may have started meanwhile.
        self._told = {
            job: state
            for job, state in self._told.items()
            if job in here and (state, here[job]) != ("pending", "running")
        }
        if self._failures >= MOST_FAILURES:
            raise AtollError(
                f"{self._failures} jobs one after the other ended before a worker of theirs had joined, the last of "
                f"them {', '.join(sorted(gone))}; read their output, and try their command by hand"
            )


@dataclass(frozen=True, slots=True)
class _Target:
    least: int
    most: int
