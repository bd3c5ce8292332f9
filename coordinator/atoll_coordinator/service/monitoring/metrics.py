"""Metrics of a coordinator for Prometheus, in a separate registry.

The loop sets numbers, which takes microseconds; a thread that answers scrapes reads them. Without a `Metrics` object no
metrics are recorded.
"""

import contextlib
import threading
from collections import Counter as Tally
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Final

from atoll_core.errors import NotNowError, UsageError, may_pass
from atoll_core.wire.messages.views import CoordinatorView, JobState, WorkerState

LAG_S: Final = 0.1
"""Seconds between two measurements of the loop's lag."""

UPDATE_S: Final = 5.0
"""Seconds between two updates of gauges; Prometheus scrapes every 15 s by default."""

MAX_USERS: Final = 200
"""Largest number of users with own time series. All other users are `OTHERS`, so that invented names cannot fill a
database."""

OTHERS: Final = "others"
NO_USER: Final = "unproven"
"""The user of jobs that were submitted without a certificate."""

if TYPE_CHECKING:  # it is imported only when metrics are recorded
    import prometheus_client as prometheus

_LAGS: Final = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0)
_WAITS: Final = (0.1, 0.5, 1.0, 5.0, 15.0, 60.0, 300.0, 900.0, 3600.0, 14400.0, 86400.0)
_TASKS: Final = (0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 300.0, 1800.0, 7200.0)

_TIMED: Final = ("preparing", "refining")
"""States in which a job is one task."""


class Metrics:
    """All metrics of one coordinator."""

    def __init__(self) -> None:
        import prometheus_client

        self._library = prometheus_client
        self.registry: Final = prometheus_client.CollectorRegistry()
        self._lag = self._histogram("loop_lag_seconds", "Delay between the due time of a probe and its handling", _LAGS)
        self._step = self._histogram("loop_step_seconds", "Time that the loop takes for one event", _LAGS)
        self._wait = self._histogram("queue_wait_seconds", "From a job's submission to its preparation", _WAITS)
        self._task = self._histogram("task_seconds", "Durations of tasks, by kind", _TASKS, "kind")
        self._leases = self._counter("leases_lost", "Workers that were lost to their islands")
        self._ended = self._counter("jobs_ended", "Jobs that have ended since the start, by final state", "state")
        self._bytes = self._counter("bus_bytes", "Bytes of payloads, by kind of key", "direction", "kind")
        self._messages = self._counter("bus_messages", "Messages, by kind of key", "direction", "kind")
        self._dropped = self._counter("messages_dropped", "Messages lost because they came too fast")
        self._refused = self._counter("messages_refused", "Messages that were malformed or of another cluster")
        self._broken = self._counter("broken", "Events that caused an internal error")
        self._questions = self._counter(
            "questions_refused", "Requests of clients that were refused because too many waited"
        )
        self._transactions = self._counter("store_transactions", "Transactions of the store")
        self._store_s = self._counter("store_seconds", "Seconds that transactions of the store took")
        self._cpu = self._counter("cpu_seconds", "Processor time of the coordinator's process")
        self._store_bytes = self._gauge("store_bytes", "Size of the store's file")
        self._memory = self._gauge("memory_bytes", "Memory that the coordinator's process occupies")
        self._followers = self._gauge("followers", "Leases of clients that follow jobs")
        self._jobs = self._gauge("jobs", "Jobs that have not ended, by state", "state")
        self._users = self._gauge("user_jobs", "Jobs that have not ended, by user and state", "user", "state")
        self._ready = self._gauge("tasks_ready", "Islands and tasks that could be computed at once")
        self._tasks = self._gauge("tasks", "Tasks that have not ended, by function and state", "function", "state")
        self._helpers = self._gauge("helpers", "Workers that help with the tasks of others")
        self._workers = self._gauge("workers", "Workers, by state", "state")
        self._lines = self._counter(
            "worker_log_lines_dropped", "Log lines of workers that were dropped because of their number"
        )
        self._states: dict[str, tuple[JobState, float]] = {}
        self._totals: dict[tuple[object, ...], float] = {}

    # ------------------------------------------------------------------------------------------ as it happens

    def observe_lag(self, seconds: float) -> None:
        """Add a measurement of the loop's lag."""
        self._lag.observe(seconds)

    def observe_step(self, seconds: float) -> None:
        """Add the time that the loop spent on one event."""
        self._step.observe(seconds)

    def note_state(self, job: str, state: JobState | None, submitted_at: float, now: float) -> None:
        """Record the state of a job (None: ended); a change of state ends a wait or a task."""
        before, since = self._states.get(job, (None, submitted_at))
        if state == before:
            return
        if state is None:
            self._states.pop(job, None)
        else:
            self._states[job] = (state, now)
        if before == "queued" or (before is None and state == "preparing"):
            self._wait.observe(max(0.0, now - submitted_at))
        elif before in _TIMED:
            self._task.labels(before).observe(max(0.0, now - since))

    def note_event(self, kind: str) -> None:
        """Record an event of this kind."""
        if kind in ("done", "failed", "cancelled"):
            self._ended.labels(kind).inc()
        elif kind == "worker-lost":
            self._leases.inc()

    # ------------------------------------------------------------------------------------------ now and then

    def set_process(self, view: CoordinatorView, store_bytes: int, followers: int, questions_refused: int) -> None:
        """Set the counters of the coordinator's process."""
        counters = view.counters
        for traffic in counters.traffic:
            for way, messages, size in (
                ("in", traffic.messages_in, traffic.bytes_in), ("out", traffic.messages_out, traffic.bytes_out)
            ):  # fmt: skip
                self._raise(self._messages, messages, way, traffic.kind)
                self._raise(self._bytes, size, way, traffic.kind)
        self._raise(self._dropped, counters.dropped)
        self._raise(self._refused, counters.refused)
        self._raise(self._broken, counters.broken)
        self._raise(self._questions, questions_refused)
        self._raise(self._transactions, view.store.transactions)
        self._raise(self._store_s, view.store.total_s)
        self._raise(self._cpu, counters.cpu_s)
        self._store_bytes.set(store_bytes)
        self._memory.set(counters.memory_bytes)
        self._followers.set(followers)

    def set_dropped_lines(self, total: int) -> None:
        """Set the number of dropped log lines of workers."""
        self._raise(self._lines, total)

    def set_jobs(self, counts: Mapping[tuple[str | None, JobState], int]) -> None:
        """Set the numbers of jobs, in all and by user (None: without a certificate)."""
        by_user = Tally({(user or NO_USER, state): number for (user, state), number in counts.items()})
        known = {user for user, _ in sorted(by_user, key=lambda pair: -by_user[pair])[:MAX_USERS]}
        by_state: Tally[str] = Tally()
        shown: Tally[tuple[str, ...]] = Tally()
        for (user, state), number in by_user.items():
            by_state[state] += number
            shown[user if user in known else OTHERS, state] += number
        _set(self._jobs, {(state,): number for state, number in by_state.items()})
        _set(self._users, shown)

    def set_tasks(self, ready: int, counts: Mapping[tuple[str, ...], int], helpers: int) -> None:
        """Set the numbers of islands and tasks that are ready, of tasks by function and state, and of helpers."""
        self._ready.set(ready)
        _set(self._tasks, counts)
        self._helpers.set(helpers)

    def set_workers(self, states: Iterable[WorkerState]) -> None:
        """Set the numbers of workers."""
        _set(self._workers, {(state,): number for state, number in Tally(states).items()})

    def exposition(self) -> str:
        """Return all metrics in the format of Prometheus."""
        return self._library.generate_latest(self.registry).decode()

    # ------------------------------------------------------------------------------------------ parts

    def _histogram(self, name: str, text: str, buckets: tuple[float, ...], *labels: str) -> "prometheus.Histogram":
        return self._library.Histogram(f"atoll_{name}", text, labels, buckets=buckets, registry=self.registry)

    def _counter(self, name: str, text: str, *labels: str) -> "prometheus.Counter":
        return self._library.Counter(f"atoll_{name}", text, labels, registry=self.registry)

    def _gauge(self, name: str, text: str, *labels: str) -> "prometheus.Gauge":
        return self._library.Gauge(f"atoll_{name}", text, labels, registry=self.registry)

    def _raise(self, counter: "prometheus.Counter", total: float, *labels: str) -> None:
        """Raise a counter to a total that was counted elsewhere."""
        key = (id(counter), *labels)
        more = total - self._totals.get(key, 0.0)
        self._totals[key] = total
        if more >= 0.0:
            (counter.labels(*labels) if labels else counter).inc(more)


def _set(gauge: "prometheus.Gauge", numbers: Mapping[tuple[str, ...], int]) -> None:
    """Set a gauge for these labels, and remove all its other labels."""
    gauge.clear()
    for labels, number in numbers.items():
        gauge.labels(*labels).set(number)


@contextlib.contextmanager
def served(address: tuple[str, int] | None) -> Iterator[Metrics | None]:
    """Answer scrapes at host and port during the block; None: no metrics are recorded.

    Raises:
        UsageError: The address cannot be used; NotNowError if it may be usable later.
    """
    if address is None:
        yield None
        return
    import prometheus_client

    metrics, (host, port) = Metrics(), address
    try:
        server, thread = prometheus_client.start_http_server(port, host, metrics.registry)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise (NotNowError if may_pass(error) else UsageError)(
            f"metrics cannot be served at {host}:{port}: {reason}; name another address with --metrics"
        ) from error
    try:
        yield metrics
    finally:
        server.shutdown()
        server.server_close()
        if isinstance(thread, threading.Thread):
            thread.join(1.0)
