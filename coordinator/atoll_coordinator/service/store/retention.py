"""Which ended jobs a store keeps: by age and by size. Pure."""

from dataclasses import dataclass
from typing import Final

from atoll_coordinator.service.store.jobs import JobRecord

LEAST_LIVE: Final = 1024**3
"""Jobs that have not ended may hold this many bytes, however few bytes of ended jobs are kept."""


@dataclass(frozen=True, slots=True)
class Retention:
    """Ended jobs are kept for `age_s` seconds, and as long as they hold no more than the given bytes.

    None is no limit. Only seconds during which the store was served count, so a wrong clock deletes no job. Only bytes
    that a deletion would free count, so tables of waiting or searched jobs never cause the deletion of results; these
    tables have a limit of the same size, above which new ones are refused.
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
        """Bytes that jobs that have not ended may hold; None: no limit."""
        return None if self.size_bytes is None else max(self.size_bytes, LEAST_LIVE)


KEEP_ALL: Final = Retention()
