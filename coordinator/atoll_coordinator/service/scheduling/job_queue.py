"""Waiting jobs and jobs that have places: which job is started, held or released next. Pure; times are arguments.

A job that is prepared or searched has a *place*; refining needs no place. `FairShare` decides which jobs have places,
and charges users for the time for which their jobs have places. A job that loses its place to the job of another user
is *held*: its islands stop at a checkpoint, and the job continues there at the next turn of its user. The jobs of one
user are ordered: jobs that have begun come first, then priority and age decide. A paused job keeps its position in the
queue, but other jobs are started before it.

The time of a decision grows with the product of users and places, and not with the number of waiting jobs. A change of
the queue takes O(log n) comparisons for n waiting jobs of one user.
"""

from bisect import bisect_left, insort
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, Literal

from atoll_coordinator.service.scheduling.fair_share import AGE_S, FairShare, Turn
from atoll_coordinator.service.scheduling.limits import NO_LIMITS, Limits, TaskTime

Stage = Literal["waiting", "preparing", "searching", "held"]

NO_TIME: Final = "waits: the task time that limits allow for a day is used up"

_BEFORE_S: Final = 1e10
"""A number of seconds that is larger than the worth of any age or priority: jobs with a place come first, then held
jobs, then waiting jobs."""


@dataclass(slots=True)
class _Entry:
    """A job in the queue or in a place."""

    id: str
    user: str | None
    priority: int
    asked_at: float
    number: int
    stage: Stage = "waiting"
    is_paused: bool = False
    had_begun: bool = False
    """Whether the job had begun before a restart: a paused queue stops only jobs that had not begun."""

    @property
    def has_begun(self) -> bool:
        return self.stage != "waiting"

    @property
    def turn(self) -> Turn:
        since = self.asked_at - _BEFORE_S * {"waiting": 0, "held": 1}.get(self.stage, 2)
        return Turn(self.id, self.user, self.priority, since)

    @property
    def key(self) -> tuple[float, int, str]:
        """The position of the job among the waiting jobs of its user."""
        return self.asked_at - AGE_S * self.priority, self.number, self.id


@dataclass(slots=True)
class _User:
    """The jobs of a user: sorted keys of waiting jobs, jobs that have begun, and the number of paused waiting jobs."""

    waiting: list[tuple[float, int, str]] = field(default_factory=list)
    begun: dict[str, _Entry] = field(default_factory=dict)
    paused: int = 0


@dataclass(frozen=True, slots=True)
class SchedulingDecision:
    """The jobs to prepare, the jobs that lose their places, and the held jobs that get places again."""

    take_up: tuple[str, ...] = ()
    hold: tuple[str, ...] = ()
    release: tuple[str, ...] = ()


class JobQueue:
    """All jobs from their submission to the end of their search."""

    def __init__(self, limits: Limits = NO_LIMITS, fair_share: FairShare | None = None) -> None:
        """`limits` may be replaced at any time; while `is_paused`, waiting jobs are not started."""
        self.limits = limits
        self.is_paused = False
        self.task_time = TaskTime()
        """Jobs of users who have used up their task time of the day get no places."""
        self._fair_share = fair_share or FairShare()
        self._entries: dict[str, _Entry] = {}
        self._users: dict[str | None, _User] = {}
        self._next_number = 0
        self._charged_at: float | None = None

    # ------------------------------------------------------------------------------------------- changes

    def add(
        self, job: str, user: str | None, priority: int, now: float, *, is_paused: bool = False,
        had_begun: bool = False,
    ) -> None:  # fmt: skip
        """Add a job to the queue; `now` in seconds.

        A job that `had_begun` before a restart is started even if the queue is paused.
        """
        entry = _Entry(job, user, priority, now, self._next_number, is_paused=is_paused, had_begun=had_begun)
        self._next_number += 1
        self._entries[job] = entry
        self._enqueue(entry)

    def begin(self, job: str) -> None:
        """Record that a job is being prepared."""
        entry = self._entries[job]
        self._dequeue(entry)
        entry.stage = "preparing"
        self._users[entry.user].begun[job] = entry

    def take_over(self, job: str) -> None:
        """Hold a job whose search had begun before a restart, until its turn."""
        self.begin(job)
        self._entries[job].stage = "held"

    def put_back(self, job: str) -> None:
        """Let a job wait again because no worker has begun to prepare it; it keeps its position."""
        entry = self._entries[job]
        del self._users[entry.user].begun[job]
        entry.stage = "waiting"
        self._enqueue(entry)

    def search(self, job: str) -> None:
        """Record that a job is being searched; a paused job is held."""
        entry = self._entries[job]
        entry.stage = "held" if entry.is_paused else "searching"

    def remove(self, job: str) -> None:
        """Remove a job that has ended or is being refined; without effect for an unknown job."""
        entry = self._entries.pop(job, None)
        if entry is None:
            return
        user = self._users[entry.user]
        if entry.has_begun:
            del user.begun[job]
        else:
            self._dequeue(entry)
        self._fair_share.forget(job)
        if not (user.waiting or user.begun or user.paused):
            del self._users[entry.user]

    def pause(self, job: str, is_paused: bool) -> None:
        """Pause or resume a job; it keeps its position in the queue."""
        entry = self._entries[job]
        if entry.is_paused == is_paused:
            return
        self._dequeue(entry)
        entry.is_paused = is_paused
        if is_paused and entry.stage == "searching":
            entry.stage = "held"
        self._enqueue(entry)

    def set_priority(self, job: str, priority: int) -> None:
        """Change the priority of a job; without effect for an unknown job."""
        entry = self._entries.get(job)
        if entry is not None:
            self._dequeue(entry)
            entry.priority = priority
            self._enqueue(entry)

    def charge(self, now: float) -> None:
        """Charge users for the time for which their jobs have had places since the last call."""
        seconds = now - self._charged_at if self._charged_at is not None else 0.0
        self._charged_at = now
        if seconds > 0.0:
            for user, places in Counter(entry.user for entry in self._holders()).items():
                self._fair_share.charge(user, seconds * places)

    # ------------------------------------------------------------------------------------------ decisions

    def decide(self) -> SchedulingDecision:
        """Return the changes to make now. This call already marks jobs as held or released; a job is marked as started
        only by `begin`."""
        preparing = [entry for entry in self._holders() if entry.stage == "preparing"]
        chosen = {entry.id: entry for entry in preparing}
        busy = Counter(entry.user for entry in preparing)
        places = self.limits.total.running
        content = {name for name, user in self._users.items() if self._is_content(name, user)}
        for job in self._fair_share.order([entry.turn for entry in self._candidates()], content):
            if len(chosen) >= places:
                break
            entry = self._entries[job]
            if job in chosen or self._is_full(entry.user, busy[entry.user]):
                continue
            chosen[job] = entry
            busy[entry.user] += 1
        held = [entry for entry in self._holders() if entry.id not in chosen]
        released = [entry for entry in chosen.values() if entry.stage == "held"]
        for entry in held:
            entry.stage = "held"
        for entry in released:
            entry.stage = "searching"
        return SchedulingDecision(
            take_up=tuple(job for job, entry in chosen.items() if entry.stage == "waiting"),
            hold=tuple(entry.id for entry in held),
            release=tuple(entry.id for entry in released),
        )

    def _candidates(self) -> Iterator[_Entry]:
        """Yield the jobs that could get a place: for each user the jobs that have begun, and at most as many waiting
        jobs as there are places."""
        for name, user in self._users.items():
            if self.has_no_time(name):
                yield from (entry for entry in user.begun.values() if entry.stage == "preparing")
                continue
            yield from (entry for entry in user.begun.values() if not entry.is_paused or entry.stage == "preparing")
            yield from self._next_of(user)

    def _next_of(self, user: _User) -> list[_Entry]:
        """Return waiting jobs of a user that may be started: as many as there are places."""
        first = [self._entries[job] for _, _, job in user.waiting[: self.limits.total.running]]
        return [entry for entry in first if entry.had_begun] if self.is_paused else first

    def _is_content(self, name: str | None, user: _User) -> bool:
        """Return whether a user has as many places as its jobs and limits allow."""
        stages = [entry.stage for entry in user.begun.values() if not entry.is_paused]
        busy = stages.count("searching") + stages.count("preparing")
        return self._is_full(name, busy) or not ("held" in stages or self._next_of(user))

    def has_no_time(self, user: str | None) -> bool:
        """Return whether a user has no task time left today."""
        return self.task_time.is_used_up(user, self.limits)

    def _is_full(self, user: str | None, busy: int) -> bool:
        most = self.limits.of(user).running
        return most is not None and busy >= most

    # ---------------------------------------------------------------------------------------------- views

    @property
    def under_way(self) -> int:
        """Number of jobs with places."""
        return sum(1 for _ in self._holders())

    @property
    def queued(self) -> int:
        """Number of waiting jobs, including paused jobs."""
        return len(self._entries) - sum(len(user.begun) for user in self._users.values())

    def queued_by_user(self) -> dict[str | None, int]:
        """Return the number of waiting jobs of each user, including paused jobs."""
        return {name: self.queued_of(name) for name in self._users}

    @property
    def ready(self) -> int:
        """Number of jobs that wait only for a place. New jobs in a paused queue, and jobs of users without task time,
        do not count."""
        users = (user for name, user in self._users.items() if not self.has_no_time(name))
        return sum(len(self._next_of(user) if self.is_paused else user.waiting) for user in users)

    def queued_of(self, name: str | None) -> int:
        """Return the number of waiting jobs of a user, including paused jobs."""
        user = self._users.get(name)
        return len(user.waiting) + user.paused if user is not None else 0

    def is_held(self, job: str) -> bool:
        """Return whether a job that has begun has no place now."""
        entry = self._entries.get(job)
        return entry is not None and entry.stage == "held"

    def ahead_of(self, job: str) -> int | None:
        """Return how many waiting jobs will start before this job in the present order; None: this job does not
        wait."""
        entry = self._entries.get(job)
        if entry is None or entry.has_begun or entry.is_paused:
            return None
        own = self._users[entry.user]
        index = bisect_left(own.waiting, entry.key)
        first, number = self._fair_share.turn(entry.user)
        rank = first + len(own.begun) + index
        ahead = index
        for name, user in self._users.items():
            if name != entry.user and user.waiting:
                round_, other = self._fair_share.turn(name)
                before = rank - round_ - len(user.begun) + (other < number)
                ahead += max(0, min(len(user.waiting), before))
        return ahead

    def waiting_reason(self, job: str) -> str | None:
        """Return a sentence on why a job without a place waits; None: the job has a place, or is unknown."""
        entry = self._entries.get(job)
        if entry is None or entry.stage in ("preparing", "searching"):
            return None
        user = entry.user
        if entry.is_paused:
            return pause_reason(job)
        if self.has_no_time(user):
            return NO_TIME
        if entry.stage == "held":
            return "waits for its user's next turn: jobs of other users run now"
        if self.is_paused and not entry.had_begun:
            return "waits: the queue is paused by an admin"
        busy = sum(begun.stage in ("preparing", "searching") for begun in self._users[user].begun.values())
        if self._is_full(user, busy):
            return f"waits: {busy} of its user's jobs are under way, as many as limits allow"
        ahead, running = self.ahead_of(job) or 0, self.under_way
        if ahead:
            return f"waits for its turn ({ahead} {'job' if ahead == 1 else 'jobs'} before it)"
        return f"waits for its turn (it is next; {running} {'job is' if running == 1 else 'jobs are'} under way)"

    def validate(self) -> None:
        """Check the invariants; raises AssertionError."""
        searching = Counter(entry.user for entry in self._holders())
        assert searching.total() <= self.limits.total.running, "more jobs have places than there are places"
        for user, places in searching.items():
            assert not self._is_full(user, places - 1), f"{user} has more places than allowed"
        assert self.queued == sum(self.queued_of(name) for name in self._users), "jobs are lost in the queue"

    # -------------------------------------------------------------------------------------------- private

    def _holders(self) -> Iterator[_Entry]:
        for user in self._users.values():
            yield from (entry for entry in user.begun.values() if entry.stage in ("preparing", "searching"))

    def _enqueue(self, entry: _Entry) -> None:
        """Add a job that has not begun to the waiting jobs of its user."""
        user = self._users.setdefault(entry.user, _User())
        if entry.has_begun:
            return
        if entry.is_paused:
            user.paused += 1
        else:
            insort(user.waiting, entry.key)

    def _dequeue(self, entry: _Entry) -> None:
        user = self._users[entry.user]
        if entry.has_begun:
            return
        if entry.is_paused:
            user.paused -= 1
        else:
            del user.waiting[bisect_left(user.waiting, entry.key)]


def pause_reason(job: str) -> str:
    """Return a sentence on how a paused job is resumed."""
    return f"is paused; continue with: coordinator resume {job}"
