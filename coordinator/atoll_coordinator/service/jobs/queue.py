"""In which order jobs are taken up: by priority, then as they came. Pure."""

from collections.abc import Iterable
from typing import Final

from atoll_coordinator.service.jobs.job import Job

MAX_RUNNING: Final = 4
"""Jobs searched at the same time; further ones wait for their turn."""


def waiting_jobs(jobs: Iterable[Job]) -> list[Job]:
    """Return the jobs that wait for their turn, the next one first; `jobs` are in the order in which they came."""
    waiting = [job for job in jobs if job.state == "queued"]
    return sorted(waiting, key=lambda job: -job.priority)


def next_job(jobs: Iterable[Job]) -> Job | None:
    """Return the job to prepare now: one at a time, while there is room for more; None when there is none."""
    jobs = tuple(jobs)
    states = [job.state for job in jobs]
    if "preparing" in states or states.count("running") >= MAX_RUNNING:
        return None
    return next(iter(waiting_jobs(jobs)), None)


class Line:
    """The jobs that wait as they stand in line, looked through once for any number of questions."""

    def __init__(self, jobs: Iterable[Job]) -> None:
        """`jobs` are all live ones, in the order in which they came."""
        jobs = tuple(jobs)
        self._ahead = {job.id: ahead for ahead, job in enumerate(waiting_jobs(jobs))}
        self._under_way = sum(job.state in ("preparing", "running") for job in jobs)

    def ahead_of(self, job: Job) -> int | None:
        """Return how many jobs are before this one in the line; None when it does not wait there."""
        return self._ahead.get(job.id)

    def waiting_reason(self, job: Job) -> str:
        """Return in words what a queued job waits for."""
        ahead, running = self._ahead[job.id], self._under_way
        if ahead:
            return f"waits for its turn ({ahead} {'job' if ahead == 1 else 'jobs'} before it)"
        return f"waits for its turn (it is next; {running} {'job is' if running == 1 else 'jobs are'} under way)"
