"""What the service needs from outside itself, next to bus and store: a background thread, the time, what is kept."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import UTC, datetime

from atoll_coordinator.service.store.retention import KEEP_ALL, Retention


def iso_now() -> str:
    """Return the time of day, UTC, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


@dataclass(frozen=True, slots=True)
class Dependencies:
    """The outside world of a service, beside its bus and its store.

    `background` does what it is given in the order in which it came, one piece at a time, and `clock` gives the time
    of day as ISO text; `retention` says which ended jobs are kept.
    """

    clock: Callable[[], str] = iso_now
    retention: Retention = KEEP_ALL
    background: Callable[[Callable[[], None]], object] = field(
        default_factory=lambda: ThreadPoolExecutor(1, "background").submit
    )
