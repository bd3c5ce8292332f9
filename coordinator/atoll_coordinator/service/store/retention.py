"""Which ended jobs a store keeps: by age and by size. Pure."""

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

from atoll_coordinator.service.store.jobs import JobRecord


@dataclass(frozen=True, slots=True)
class Retention:
    """Which ended jobs are kept: those that ended in the last `age_s` seconds, while the store takes no more bytes.

    None is no limit. Live jobs count as part of the store, but are never deleted.
    """

    age_s: float | None = None
    size_bytes: int | None = None

    def reason_to_delete(self, job: JobRecord, clock: str, used_bytes: int) -> str | None:
        """Return why the oldest ended job is not kept; None: it is. `clock` is the time of day as ISO text."""
        age_s = (_instant(clock) - _instant(job.finished or job.submitted)).total_seconds()
        if self.age_s is not None and age_s > self.age_s:
            return f"it ended more than {self.age_s / 86400:g} days ago"
        if self.size_bytes is not None and used_bytes > self.size_bytes:
            return f"the store holds more than {self.size_bytes / 1e9:g} GB, and it ended before all others"
        return None


KEEP_ALL: Final = Retention()


def _instant(text: str) -> datetime:
    """Return an ISO time; without a time zone it is UTC."""
    instant = datetime.fromisoformat(text)
    return instant if instant.tzinfo is not None else instant.replace(tzinfo=UTC)
