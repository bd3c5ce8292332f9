"""How much work waits, for those who start and end workers. Pure."""

from collections.abc import Iterable

from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.jobs.queue import MAX_RUNNING, waiting_jobs
from atoll_core.wire.messages.clients import QueueDepth


def queue_depth(jobs: Iterable[Job]) -> QueueDepth:
    """Return how many jobs are in which state, and what could be computed at once.

    Of a job whose data are not prepared yet it is not known how many equations it has: it counts with one. Those that
    wait for others to end first give nobody work, and do not count among the workers wanted.
    """
    jobs = tuple(jobs)
    states = [job.state for job in jobs]
    ready = sum(archipelago.collector.limits.islands for job in jobs for archipelago in job.open_archipelagos)
    under_way = states.count("preparing") + states.count("running")
    soon = [job for job in jobs if job.state == "preparing"] + waiting_jobs(jobs)[: max(0, MAX_RUNNING - under_way)]
    return QueueDepth(
        queued=states.count("queued"),
        preparing=states.count("preparing"),
        running=states.count("running"),
        refining=states.count("refining"),
        tasks_ready=ready,
        workers_wanted=ready + sum(job.config.evolution.islands for job in soon),
    )
