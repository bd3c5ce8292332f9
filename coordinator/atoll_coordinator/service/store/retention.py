"""Which ended jobs a store keeps: by age and by size. Pure."""

from dataclasses import dataclass
from typing import Final

from atoll_coordinator.service.store.jobs import JobRecord

LEAST_LIVE: Final = 1024**3
"""Bytes of jobs that have not ended that are taken in however little is to be kept of those that have."""


@dataclass(frozen=True, slots=True)
class Retention:
    """Which ended jobs are kept: those that ended in the last `age_s` seconds, while they take no more bytes.

    None is no limit. Seconds are those in which the store was served: the time of day may be set to any year, and no
    job is deleted for that. Bytes are those that a deletion frees: tables that wait, or are searched, delete nobody's
    results, and as many bytes of them are taken in; then new ones are refused.
    """

    age_s: float | None = None
    size_bytes: int | None = None

    def is_too_old(self, job: JobRecord, served_s: float) -> bool:
        """Tell whether an ended job is not kept any more; `served_s` is `Store.served_s`."""
        return self.age_s is not None and served_s - job.ended_at > self.age_s

    def is_too_much(self, freeable: int) -> bool:
        """Tell whether ended jobs hold more bytes than are kept; `freeable` is `store.holdings.Held.freeable`."""
        return self.size_bytes is not None and freeable > self.size_bytes

    @property
    def most_live(self) -> int | None:
        """How many bytes of jobs that have not ended are taken in; None: any number."""
        return None if self.size_bytes is None else max(self.size_bytes, LEAST_LIVE)


KEEP_ALL: Final = Retention()
