"""What live jobs have cost beside their point evaluations. Pure."""

from atoll_coordinator.service.jobs.job import Job
from atoll_core.wire.messages.views import JobCounters
from atoll_core.wire.messages.workers import AssignmentStatus


class CounterRegistry:
    """The counters of all live jobs."""

    def __init__(self) -> None:
        self._counters: dict[str, JobCounters] = {}
        self._waited_s: dict[tuple[str, str, int, str], float] = {}

    def add(self, job: str, **counts: int) -> None:
        """Add to fields of a job's `JobCounters`."""
        counters = self._counters.get(job, JobCounters())
        self._counters[job] = counters.model_copy(
            update={name: getattr(counters, name) + count for name, count in counts.items()}
        )

    def set_waited(self, worker: str, assignment_status: AssignmentStatus) -> None:
        """Set how long the islands of a current placement have waited on a worker."""
        self._waited_s[assignment_status.job, assignment_status.variable, assignment_status.term, worker] = (
            assignment_status.waited_s
        )

    def counters(self, job: Job) -> JobCounters:
        """Return the counters of a job."""
        duplicates = sum(archipelago.collector.duplicates for archipelago in job.archipelagos.values())
        waited_s = sum(seconds for key, seconds in self._waited_s.items() if key[0] == job.id)
        counters = self._counters.get(job.id, JobCounters())
        return counters.model_copy(update={"duplicates": duplicates, "waited_s": waited_s})

    def forget(self, job: str) -> None:
        """Forget a job that has ended."""
        self._counters.pop(job, None)
        self._waited_s = {key: seconds for key, seconds in self._waited_s.items() if key[0] != job}
