"""Task time: for how long workers have computed islands and tasks for each user today. Pure; seconds come in.

Today is a day of service (`limits.DAY_S`), not of the calendar: whoever sets the clock forward gains nothing.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping

from atoll_coordinator.service.scheduling.limits import Limits

Amounts = Mapping[str | None, float]
"""Seconds by user."""


class TaskTime:
    """What users have used up today, and what of it is not stored yet."""

    def __init__(self, day: int = 0, used: Amounts | None = None) -> None:
        """`used` is what was stored of that day."""
        self._day = day
        self._used: dict[str | None, float] = defaultdict(float, used or {})
        self._unsaved: dict[str | None, float] = defaultdict(float)
        self._said: dict[tuple[str, str], dict[str | None, float]] = {}

    def charge(self, user: str | None, seconds: float) -> None:
        """Add to what a user has used up."""
        self._used[user] += seconds
        self._unsaved[user] += seconds

    def add_heartbeat(self, worker: str, instance: str, computed: Iterable[tuple[str | None, float]]) -> None:
        """Charge users for what a worker process has computed for them since it last said so.

        What it says first is where counting begins: what it computed before, another coordinator has counted.
        """
        totals = dict(computed)
        before = self._said.get((worker, instance))
        if before is None:
            self._said = {key: said for key, said in self._said.items() if key[0] != worker}
            before = totals
        for user, seconds in totals.items():
            if seconds > before.get(user, 0.0):
                self.charge(user, seconds - before.get(user, 0.0))
        self._said[worker, instance] = totals

    def begin_day(self, day: int) -> None:
        """Begin anew, if it is another day."""
        if day != self._day:
            self._day, self._used = day, defaultdict(float)

    def take_unsaved(self) -> dict[str | None, float]:
        """Return what has been added since the last call."""
        unsaved, self._unsaved = self._unsaved, defaultdict(float)
        return dict(unsaved)

    def exhausted(self, limits: Limits) -> frozenset[str | None]:
        """Return the users who have used up what they may today."""
        return frozenset(user for user, seconds in self._used.items() if _is_up(limits, user, seconds))

    def is_used_up(self, limits: Limits) -> bool:
        """Tell whether all users together have used up what they may today."""
        return limits.total.task_time is not None and sum(self._used.values()) >= limits.total.task_time


def _is_up(limits: Limits, user: str | None, seconds: float) -> bool:
    most = limits.of(user).task_time
    return most is not None and seconds >= most
