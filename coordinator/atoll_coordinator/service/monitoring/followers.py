"""Followers: clients that are notified of changes. Each change is encoded once for all followers.

A topic is a job, or all events (None) that a viewer sees. A change of the state of a job is sent at once; other changes
are collected and sent every `INTERVAL_S`. Each change has its own sequence number and the number of the change before
it, so that a follower notices a missed change. The follower then asks again, and gets the missed events from the store.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from atoll_coordinator.service.monitoring.event_log import EventLog
from atoll_coordinator.service.monitoring.job_views import JobViews
from atoll_coordinator.service.store.jobs import Viewer
from atoll_core.errors import RefusedError
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.clients import Follow, Following, JobChange
from atoll_core.wire.messages.views import JobView, Workforce

INTERVAL_S: Final = 0.5
"""Seconds between two updates: fast enough for a person who reads a table of numbers."""

LEASE_S: Final = 30.0
"""Seconds for which a silent follower is notified; a follower renews its lease after a third of this time."""

MAX_FOLLOWERS: Final = 10_000
"""Largest number of followers, equal to the router's largest number of sessions."""

PAGE: Final = 200
"""Largest number of events in one change."""

_LIVES: Final = 2**32
"""Number of sequence numbers of one incarnation, so that no number is used twice with one store."""


_Key = tuple[str | None, Viewer | None]
"""Key of a topic: the job, or None with the viewer of all events. A follower of a job sees all of its events."""


@dataclass
class _Topic:
    """A followed topic. `leases` has the end of each client's lease; `last` is the number of the last event sent."""

    sequence: int
    last: int
    state: str
    view: JobView | None
    workforce: Workforce
    due: float
    leases: dict[str, float] = field(default_factory=dict)


class Followers:
    """All followers of one coordinator. The loop calls `notify` after each event, and `expire` at each tick."""

    def __init__(  # the parts of a change, and its receivers
        self, incarnation: int, shown: JobViews, events: EventLog,
        workforce: Callable[[float], Workforce], put: Callable[[str, bytes], None],
    ) -> None:  # fmt: skip
        """`workforce` returns the numbers of workers now; `put` sends bytes to a client by its name."""
        self._sequences = itertools.count(incarnation * _LIVES + 1)
        self._shown = shown
        self._events = events
        self._workforce = workforce
        self._put = put
        self._topics: dict[_Key, _Topic] = {}
        self._changed: set[_Key] = set()
        self._of_all: set[_Key] = set()

    def __len__(self) -> int:
        return sum(len(topic.leases) for topic in self._topics.values())

    def __bool__(self) -> bool:
        return True

    def follow(
        self, client: str, question: Follow, now: float, viewer: Viewer | None = None
    ) -> Following | None:  # fmt: skip
        """Begin or renew a client's lease; return the changes that it does not have yet. None: there is no such job.

        A follower of all events gets the events that its `viewer` sees (None: all events). The caller must have checked
        that the client may see the job.

        Raises:
            RefusedError: There are too many followers.
        """
        if question.job is not None and self._shown.view(question.job, now) is None:
            return None
        key = (question.job, viewer if question.job is None else None)
        topic = self._topics.get(key) or self._begin(key, now)
        if client not in topic.leases and len(self) >= MAX_FOLLOWERS:
            raise RefusedError(
                f"{MAX_FOLLOWERS} programs follow jobs already; ask for the status instead, every few seconds"
            )
        topic.leases[client] = now + LEASE_S
        return Following(lease_s=LEASE_S, change=self._missed(question, key, topic, now))

    def keep(self, may_follow: Callable[[str, str | None, Viewer | None], bool]) -> None:
        """End the leases of clients that may not follow any more: `may_follow` takes client, job and viewer."""
        for (job, viewer), topic in self._topics.items():
            topic.leases = {
                client: end for client, end in topic.leases.items() if may_follow(client, job, viewer)
            }  # fmt: skip
        self._forget_unfollowed()

    def touch(self, job: str | None) -> None:
        """Mark the topics of a job, or of no particular job, as changed."""
        if (job, None) in self._topics:
            self._changed.add((job, None))
        self._changed.update(self._of_all)

    def look(self, now: float) -> None:
        """Mark topics whose values change without an event: numbers of workers, and positions in the queue."""
        if not self._topics:
            return
        workforce = self._workforce(now)
        for key, topic in self._topics.items():
            if key[0] is not None and (topic.workforce != workforce or topic.state == "queued"):
                self._changed.add(key)

    def notify(self, now: float) -> float | None:
        """Send the changes that are due; return the seconds until the next change is due, None: no change waits."""
        for key in [key for key in self._changed if self._is_due(key, now)]:
            self._changed.discard(key)
            self._notify(key, self._topics[key], now)
        return min((max(0.0, self._topics[key].due - now) for key in self._changed), default=None)

    def expire(self, now: float) -> None:
        """Forget followers whose leases are over, and topics without followers."""
        for topic in self._topics.values():
            topic.leases = {client: end for client, end in topic.leases.items() if end > now}
        self._forget_unfollowed()

    def _forget_unfollowed(self) -> None:
        self._topics = {key: topic for key, topic in self._topics.items() if topic.leases}
        self._of_all = {key for key in self._topics if key[0] is None}
        self._changed &= self._topics.keys()

    def _begin(self, key: _Key, now: float) -> _Topic:
        newest = self._events.read(key[0], 0, 1, key[1])
        last = newest[-1].number if newest else 0
        topic = _Topic(next(self._sequences), last, self._state(key[0]), None, Workforce(), now)
        self._topics[key] = topic
        self._of_all |= {key} if key[0] is None else set()
        return topic

    def _missed(self, question: Follow, key: _Key, topic: _Topic, now: float) -> JobChange | None:
        """Return the status and the events that a client does not have; None: it has all."""
        events = () if question.after is None else self._events.read(question.job, question.after, PAGE, key[1])
        if question.sequence == topic.sequence and not events:
            return None
        return JobChange(
            job=question.job,
            sequence=topic.sequence,
            previous=question.sequence,
            view=self._view(question.job, now),
            workforce=self._workforce(now),
            events=events,
            last=events[-1].number if events else question.after or 0,
            has_more=len(events) == PAGE,
        )

    def _is_due(self, key: _Key, now: float) -> bool:
        topic = self._topics[key]
        return now >= topic.due or topic.state != self._state(key[0])

    def _state(self, job: str | None) -> str:
        return (self._shown.state(job) or "") if job is not None else ""

    def _notify(self, key: _Key, topic: _Topic, now: float) -> None:
        """Send the status of a topic to its followers, unless nothing has changed."""
        name, viewer = key
        topic.due = now + INTERVAL_S
        view, workforce = self._view(name, now), self._workforce(now)
        events = self._events.read(name, topic.last, PAGE, viewer)
        topic.state = self._state(name)
        if not events and workforce == topic.workforce and _without_times(view) == _without_times(topic.view):
            return
        previous, topic.sequence = topic.sequence, next(self._sequences)
        topic.view, topic.workforce = view, workforce
        topic.last = events[-1].number if events else topic.last
        change = JobChange(
            job=name, sequence=topic.sequence, previous=previous, view=view, workforce=workforce, events=events,
            last=topic.last, has_more=len(events) == PAGE,
        )  # fmt: skip
        payload = encode(change)
        for client in topic.leases:
            self._put(client, payload)

    def _view(self, job: str | None, now: float) -> JobView | None:
        return self._shown.view(job, now) if job is not None else None


def _without_times(view: JobView | None) -> JobView | None:
    """Return a view without the fields that change with time alone."""
    return view and view.model_copy(update={"elapsed": 0.0, "point_evaluations_per_second": None})
