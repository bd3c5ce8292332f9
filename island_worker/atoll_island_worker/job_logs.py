"""Log lines for the coordinator: lines about a job, and warnings; limited in number.

Lines are sent with heartbeats, in small batches. Lines that come faster than `RATE` are dropped and counted; the event
log of the job shows the number of dropped lines.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Final

from atoll_core import logs
from atoll_core.wire.messages.workers import MAX_LINES, LogLine, WorkerLog

RATE: Final = 20.0
"""Most lines per second on average, of all jobs together."""

BURST: Final = 200
"""Most lines that may come at once, such as one for each island of many archipelagos; also the most lines kept."""

_PLACES: Final = ("variable", "island", "epoch", "term")
_LEVELS: Final = {logging.INFO: "info", logging.WARNING: "warning", logging.ERROR: "error", logging.CRITICAL: "error"}


class JobLogs(logging.Handler):
    """Keeps the lines to send. Any thread may log."""

    def __init__(self, now: Callable[[], float]) -> None:
        """`now` gives monotonic seconds."""
        super().__init__(logging.INFO)
        self._now = now
        self._lines: deque[LogLine] = deque()
        self._lines_lock = threading.Lock()
        self._dropped = 0
        self._allowance = float(BURST)
        self._counted_at = now()

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a line about a job, or a warning."""
        fields = logs.fields_of(record)
        if fields.get("job") is None and record.levelno < logging.WARNING:
            return
        try:
            line = line_of(record, fields)
        except Exception:  # a faulty log line must not stop the work
            line = None
        with self._lines_lock:
            now = self._now()
            self._allowance = min(float(BURST), self._allowance + RATE * (now - self._counted_at))
            self._counted_at = now
            if line is None or self._allowance < 1.0 or len(self._lines) >= BURST:
                self._dropped += 1
                return
            self._allowance -= 1.0
            self._lines.append(line)

    def take(self) -> WorkerLog | None:
        """Return the lines to send now; None if there are none."""
        with self._lines_lock:
            if not self._lines and not self._dropped:
                return None
            lines = tuple(self._lines.popleft() for _ in range(min(len(self._lines), MAX_LINES)))
            dropped, self._dropped = self._dropped, 0
        return WorkerLog(lines=lines, dropped=dropped)


def line_of(record: logging.LogRecord, fields: dict[str, object]) -> LogLine:
    """Return a record as a message: its text includes all extra fields for which the message has no field."""
    rest = " ".join(f"{name}={value}" for name, value in fields.items() if name not in ("job", *_PLACES))
    trace = logs.trace_of(record)
    text = " ".join(part for part in (record.getMessage(), rest, trace or "") if part)
    job, variable = fields.get("job"), fields.get("variable")
    island, epoch, term = (_whole(fields.get(name)) for name in ("island", "epoch", "term"))
    return LogLine(
        time=datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
        level=_LEVELS.get(record.levelno, "info"),
        text=text[:1000],
        job=str(job) if job is not None else None,
        variable=str(variable)[:256] if variable else None,
        island=island,
        epoch=epoch,
        term=term,
    )


def _whole(value: object) -> int | None:
    return value if isinstance(value, int) and value >= 0 else None
