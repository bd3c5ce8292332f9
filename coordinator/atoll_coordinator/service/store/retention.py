"""Which ended jobs a store keeps: by age and by size. Pure."""

from dataclasses import dataclass
from typing import Final

from atoll_coordinator.service.store.jobs import JobRecord

LEAST_LIVE: Final = 1024**3
"""Least limit on the bytes of jobs that have not ended, even if fewer bytes of ended jobs are kept."""


@dataclass(frozen=True, slots=True)
class Retention:
    """Ended jobs are kept for `age_s` seconds, as long as they take no more than `size_bytes`; None: no limit.

    Only seconds during which the store was served count, so a wrong clock deletes no job. Only bytes that a deletion
    would free count, so tables of waiting or searched jobs never cause the deletion of results. These tables have a
    separate limit of the same size (`most_live`), above which new tables are refused.
    """

    age_s: float | None = None
    size_bytes: int | None = None

    def is_too_old(self, job: JobRecord, served_s: float) -> bool:
        """Return whether an ended job is too old to be kept; `served_s` is `Store.served_s`."""
        return self.age_s is not None and served_s - job.ended_at > self.age_s

    def is_too_much(self, freeable: int) -> bool:
        """Return whether ended jobs take more bytes than are kept; `freeable` is `store.holdings.Held.freeable`."""
        return self.size_bytes is not None and freeable > self.size_bytes

    @property
    def most_live(self) -> int | None:
        """Largest number of bytes for jobs that have not ended; None: no limit."""
        return None if self.size_bytes is None else max(self.size_bytes, LEAST_LIVE)


KEEP_ALL: Final = Retention()
