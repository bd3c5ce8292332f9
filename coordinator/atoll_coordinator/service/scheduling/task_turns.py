"""Whose task is next: users in turn (`FairShare`), within a user by priority, then by age. Pure."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final, Protocol

from atoll_coordinator.service.scheduling.fair_share import FairShare, Principal

_RUNNING_S: Final = 1e10
"""Seconds that no age and no priority makes up for: what runs comes before what waits."""


class TaskJob(Protocol):
    """What is asked of a job that has a task; `submitted_at` is in seconds, of which only differences count."""

    @property
    def id(self) -> str: ...

    @property
    def submitter(self) -> str | None: ...

    @property
    def priority(self) -> int: ...

    @property
    def submitted_at(self) -> float: ...


@dataclass(frozen=True, slots=True)
class _Turn:
    """A job with a task, as `FairShare` sees it."""

    id: str
    principal: str | None
    priority: int
    since: float


class TaskTurns:
    """The shares that users have of the workers' task processes, charged in seconds of one worker."""

    def __init__(self) -> None:
        self._fair_share = FairShare()

    def order(self, waiting: Collection[TaskJob], running: Collection[TaskJob]) -> list[str]:
        """Return the ids of jobs with tasks that wait, the next one first.

        Tasks that run count as their users' first turns: who has some lets others go before.
        """
        turns = [_Turn(job.id, job.submitter, job.priority, job.submitted_at - _RUNNING_S) for job in running]
        turns += [_Turn(job.id, job.submitter, job.priority, job.submitted_at) for job in waiting]
        content = {job.submitter for job in running} - {job.submitter for job in waiting}
        wanted = {job.id for job in waiting}
        return [job for job in self._fair_share.order(turns, content) if job in wanted]

    def charge(self, user: str | None, seconds: float) -> None:
        """Charge a user for what a worker has done."""
        self._fair_share.charge(Principal(user), seconds)

    def forget(self, job: str) -> None:
        """Forget a job that has ended."""
        self._fair_share.forget(job)
