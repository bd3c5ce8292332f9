"""A subscription to changes of one job, or to all that happens: in order, without gaps, resumed after a cut.

The coordinator puts changes on a key of ours as long as the lease lasts. The question that takes the lease also answers
with what we do not have yet: so it renews, closes gaps, and finds a coordinator that has started anew.
"""

from typing import Final

from atoll.client.client import Client
from atoll_core.wire.messages.clients import JobChange

QUIET_S: Final = 2.0
"""After so many seconds without a change it is asked whether there was none: the last one may have been lost, or the
coordinator be gone."""

RENEWED_AT: Final = 1.0 / 3.0
"""Of a lease; two renewals may be lost."""


class Subscription:
    """What changes, from now on or, with `after`, from behind the event of that number."""

    def __init__(self, client: Client, job: str | None, after: int | None = None) -> None:
        """Nothing is asked before the first `wait`. With `after` None no events are told that came before that."""
        self._client = client
        self._job = job
        self._after = after
        self._sequence = 0
        self._ask_at = 0.0
        self._lease_ends = 0.0
        self._is_behind = True

    def wait(self, limit_s: float) -> JobChange | None:
        """Return the next change, waiting so many seconds at most; None when there was none.

        Raises UnreachableError when the coordinator is asked and does not answer, RefusedError when it knows no such
        job.
        """
        end = self._client.now() + limit_s
        while True:
            now = self._client.now()
            if self._is_behind or now >= min(self._ask_at, self._lease_ends):
                change = self._ask()
                if change is not None:
                    return change
            change = self._client.next_change(max(0.0, min(end, self._ask_at) - now))
            if change is not None and self._fits(change):
                return self._take(change)
            if self._client.now() >= end:
                return None

    def _ask(self) -> JobChange | None:
        self._is_behind = True  # also when this is not answered
        answer = self._client.follow(self._job, self._after, self._sequence)
        self._is_behind = False
        now = self._client.now()
        self._ask_at, self._lease_ends = now + QUIET_S, now + RENEWED_AT * answer.lease_s
        return self._take(answer.change) if answer.change is not None else None

    def _fits(self, change: JobChange) -> bool:
        """Tell whether this is the next change; when some have been missed, they are asked for."""
        if change.job != self._job or change.sequence <= self._sequence:
            return False
        self._is_behind = change.previous != self._sequence
        return not self._is_behind

    def _take(self, change: JobChange) -> JobChange:
        self._sequence, self._is_behind = change.sequence, change.has_more
        self._ask_at = self._client.now() + QUIET_S
        if self._after is None:
            return change
        events = tuple(event for event in change.events if event.number > self._after)  # the answer had others already
        self._after = max(self._after, change.last)
        return change.model_copy(update={"events": events})
