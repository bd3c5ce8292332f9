"""How much work waits, for those who start and end workers. Pure."""

from collections.abc import Iterable

from atoll_coordinator.service.jobs.job import Job
from atoll_core.config import JobConfig
from atoll_core.wire.messages.clients import QueueDepth


def queue_depth(begun: Iterable[Job], queued: int, ready: int, places: int, analyses: int = 0) -> QueueDepth:
    """Return how many jobs are in which state, and what could be computed at once.

    Of a job whose data are not prepared yet it is not known how many equations it has: it counts with the islands of
    one, and so does one that is refined, whose batches keep about as many workers busy. Of those that wait for their
    turn only as many count as there are `places` left; the others give nobody work yet, nor do those that are held.

    Args:
        begun: the jobs that do not wait for their turn.
        queued: how many do.
        ready: how many of these wait for nothing else: neither they nor the queue are paused.
        places: how many jobs may be prepared and searched at once.
        analyses: how many questions about results have no answer yet.
    """
    jobs = tuple(begun)
    states = [job.state for job in jobs]
    searched = [job for job in jobs if not job.is_held]
    islands = sum(archipelago.collector.limits.islands for job in searched for archipelago in job.open_archipelagos)
    tasks = states.count("preparing") + states.count("refining")
    under_way = states.count("preparing") + sum(job.state == "running" for job in searched)
    soon = min(ready, max(0, places - under_way)) * JobConfig().evolution.islands
    wanted = sum(job.config.evolution.islands for job in jobs if job.state in ("preparing", "refining"))
    return QueueDepth(
        queued=queued,
        preparing=states.count("preparing"),
        running=states.count("running"),
        refining=states.count("refining"),
        tasks_ready=islands + tasks + analyses,
        workers_wanted=islands + wanted + soon + analyses,
    )
