"""Log lines that workers send, attached to the jobs that they tell of; bounded, whatever a worker sends."""

from typing import Final

from atoll_coordinator.service.monitoring.event_log import EventLog
from atoll_core.wire.messages.workers import LogLine, WorkerLog

RATE: Final = 40.0
"""Lines a second that are taken of one worker in the long run: twice what one sends."""

BURST: Final = 400

MAX_WORKERS: Final = 10_000
"""Workers whose lines are counted at a time: as many as sessions of the router."""


class WorkerLogs:
    """Takes lines in as events of the kind `log`."""

    def __init__(self, events: EventLog) -> None:
        self.dropped = 0
        """Lines that were too many, there or here."""
        self._events = events
        self._allowances: dict[str, tuple[float, float]] = {}

    def take(self, worker: str, message: WorkerLog, known_jobs: set[str], now: float) -> None:
        """Keep what a worker says of jobs that are there, and of none in particular."""
        allowance, at = self._allowances.get(worker, (float(BURST), now))
        allowance = min(float(BURST), allowance + RATE * (now - at))
        wanted = [line for line in message.lines if line.job is None or line.job in known_jobs]
        taken = wanted[: int(allowance)]
        if worker not in self._allowances and len(self._allowances) >= MAX_WORKERS:
            self._allowances.clear()
        self._allowances[worker] = (allowance - len(taken), now)
        for line in taken:
            self._keep(worker, line)
        dropped = message.dropped + len(wanted) - len(taken)
        if dropped:
            self.dropped += dropped
            for job in {line.job: None for line in taken} or (None,):
                text = f"about {dropped} lines of this worker's log were too many, and are not here"
                self._events.add_line(job, {"text": text, "worker": worker, "level": "warning"})

    def _keep(self, worker: str, line: LogLine) -> None:
        said = line.model_dump(exclude={"job", "time"}, exclude_none=True)
        self._events.add_line(line.job, said | {"worker": worker}, line.time)
