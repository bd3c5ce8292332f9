"""Which ended jobs a store keeps: by age and by size. Pure."""

from dataclasses import dataclass
from typing import Final

from atoll_coordinator.service.store.jobs import JobRecord


@dataclass(frozen=True, slots=True)
class Retention:
    """Which ended jobs are kept: those that ended in the last `age_s` seconds, while the store takes no more bytes.

    None is no limit. Seconds are those in which the store was served: the time of day may be set to any year, and no
    job is deleted for that. Live jobs count as part of the store, but are never deleted.
    """

    age_s: float | None = None
    size_bytes: int | None = None

    def reason_to_delete(self, job: JobRecord, served_s: float, used_bytes: int) -> str | None:
        """Return why the oldest ended job is not kept; None: it is. `served_s` is `Store.served_s`."""
        if self.age_s is not None and served_s - job.ended_at > self.age_s:
            return f"it ended more than {self.age_s / 86400:g} days ago"
        if self.size_bytes is not None and used_bytes > self.size_bytes:
            return f"the store holds more than {self.size_bytes / 1e9:g} GB, and it ended before all others"
        return None


KEEP_ALL: Final = Retention()
