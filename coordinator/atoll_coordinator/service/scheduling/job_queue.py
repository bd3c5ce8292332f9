"""The jobs that wait and those that hold places: which is taken up, held or released next. Pure; seconds come in.

A *place* is held by a job that is prepared or searched; refining takes none. Which jobs have the places is decided by
`FairShare`, where users are charged for the time for which their jobs hold some. A job that loses its place to another
user's is *held*: its islands stop at a checkpoint, and it goes on from there when it is its user's turn again. Within a
user jobs that have begun come first, then priority, then age. A job that a person has paused keeps its place in the
line, and lets others pass.

A decision takes as long as there are users times places, and a change of one job log n among n jobs of its user (and
the move of as many pointers): how many jobs wait does not matter.
"""

from bisect import bisect_left, insort
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, Literal

from atoll_coordinator.service.scheduling.fair_share import AGE_S, FairShare, Principal
from atoll_coordinator.service.scheduling.limits import NO_LIMITS, Limits

Stage = Literal["waiting", "preparing", "searching", "held"]

NO_TIME: Final = "waits: the task time that limits allow for a day is used up"

_BEFORE_S: Final = 1e10
"""Seconds that no age and no priority makes up for: what has a place comes before what is held, and that before what
waits."""


@dataclass(slots=True)
class _Entry:
    """A job in the line or in a place, as `FairShare` sees it."""

    id: str
    principal: str | None
    priority: int
    asked_at: float
    number: int
    stage: Stage = "waiting"
    is_paused: bool = False
    had_begun: bool = False
    """Before a restart: a queue that is paused holds up what is new, and nothing that had begun."""

    @property
    def has_begun(self) -> bool:
        return self.stage != "waiting"

    @property
    def since(self) -> float:
        return self.asked_at - _BEFORE_S * {"waiting": 0, "held": 1}.get(self.stage, 2)

    @property
    def key(self) -> tuple[float, int, str]:
        """Where it stands among its user's jobs that wait."""
        return self.asked_at - AGE_S * self.priority, self.number, self.id


@dataclass(slots=True)
class _User:
    """The jobs of a user: the keys of those that wait, in order; those that have begun; how many are paused in line."""

    waiting: list[tuple[float, int, str]] = field(default_factory=list)
    begun: dict[str, _Entry] = field(default_factory=dict)
    paused: int = 0


@dataclass(frozen=True, slots=True)
class Decision:
    """What changes: jobs to be prepared, jobs that lose their places, held ones that have one again."""

    take_up: tuple[str, ...] = ()
    hold: tuple[str, ...] = ()
    release: tuple[str, ...] = ()


class JobQueue:
    """All jobs from their submission to the end of their search."""

    def __init__(self, limits: Limits = NO_LIMITS, fair_share: FairShare | None = None) -> None:
        """`limits` may be replaced at any time; `is_paused` keeps jobs that wait from being taken up."""
        self.limits = limits
        self.is_paused = False
        self.exhausted: frozenset[str | None] = frozenset()
        """Users who have used up their task time of the day: none of their jobs has a place."""
        self.is_exhausted = False
        """Whether all users together have."""
        self._fair_share = fair_share or FairShare()
        self._entries: dict[str, _Entry] = {}
        self._users: dict[str | None, _User] = {}
        self._next_number = 0
        self._charged_at: float | None = None

    # ------------------------------------------------------------------------------------------- changes

    def add(
        self, job: str, principal: str | None, priority: int, now: float, *, is_paused: bool = False,
        had_begun: bool = False,
    ) -> None:  # fmt: skip
        """Let a job join the line, behind those of its user that came before; `now` in seconds.

        One that `had_begun` before a restart is taken up even if the queue is paused.
        """
        entry = _Entry(job, principal, priority, now, self._next_number, is_paused=is_paused, had_begun=had_begun)
        self._next_number += 1
        self._entries[job] = entry
        self._stand(entry)

    def begin(self, job: str) -> None:
        """Take in that a job is being prepared."""
        entry = self._entries[job]
        self._step_aside(entry)
        entry.stage = "preparing"
        self._users[entry.principal].begun[job] = entry

    def take_over(self, job: str) -> None:
        """Take in that a job goes on after a restart whose search had begun: it is held until it is its turn."""
        self.begin(job)
        self._entries[job].stage = "held"

    def put_back(self, job: str) -> None:
        """Let a job wait again that nobody has begun to prepare; it keeps its place in the line."""
        entry = self._entries[job]
        del self._users[entry.principal].begun[job]
        entry.stage = "waiting"
        self._stand(entry)

    def search(self, job: str) -> None:
        """Take in that a job is being searched; a paused one is held."""
        entry = self._entries[job]
        entry.stage = "held" if entry.is_paused else "searching"

    def remove(self, job: str) -> None:
        """Let a job go, which has ended or is refined; without effect when it is not here."""
        entry = self._entries.pop(job, None)
        if entry is None:
            return
        user = self._users[entry.principal]
        if entry.has_begun:
            del user.begun[job]
        else:
            self._step_aside(entry)
        self._fair_share.forget(job)
        if not (user.waiting or user.begun or user.paused):
            del self._users[entry.principal]

    def pause(self, job: str, is_paused: bool) -> None:
        """Let a job wait until it is resumed, or resume it; it keeps its place in the line."""
        entry = self._entries[job]
        if entry.is_paused == is_paused:
            return
        self._step_aside(entry)
        entry.is_paused = is_paused
        if is_paused and entry.stage == "searching":
            entry.stage = "held"
        self._stand(entry)

    def set_priority(self, job: str, priority: int) -> None:
        """Change the priority of a job; without effect when it is not here."""
        entry = self._entries.get(job)
        if entry is not None:
            self._step_aside(entry)
            entry.priority = priority
            self._stand(entry)

    def charge(self, now: float) -> None:
        """Charge users for the time for which their jobs have held places since the last call."""
        seconds = now - self._charged_at if self._charged_at is not None else 0.0
        self._charged_at = now
        if seconds > 0.0:
            for principal, places in Counter(entry.principal for entry in self._holders()).items():
                self._fair_share.charge(Principal(principal), seconds * places)

    # ------------------------------------------------------------------------------------------ decisions

    def decide(self) -> Decision:
        """Return what changes now. Held and released jobs count as such at once, others when `begin` is called."""
        preparing = [entry for entry in self._holders() if entry.stage == "preparing"]
        chosen = {entry.id: entry for entry in preparing}
        busy = Counter(entry.principal for entry in preparing)
        places = self.limits.total.running
        content = {principal for principal, user in self._users.items() if self._is_content(principal, user)}
        for job in self._fair_share.order(self._candidates(), content):
            if len(chosen) >= places:
                break
            entry = self._entries[job]
            if job in chosen or self._is_full(entry.principal, busy[entry.principal]):
                continue
            chosen[job] = entry
            busy[entry.principal] += 1
        return self._decided(chosen)

    def _decided(self, chosen: dict[str, _Entry]) -> Decision:
        held = [entry for entry in self._holders() if entry.id not in chosen]
        released = [entry for entry in chosen.values() if entry.stage == "held"]
        for entry in held:
            entry.stage = "held"
        for entry in released:
            entry.stage = "searching"
        return Decision(
            take_up=tuple(job for job, entry in chosen.items() if entry.stage == "waiting"),
            hold=tuple(entry.id for entry in held),
            release=tuple(entry.id for entry in released),
        )

    def _candidates(self) -> Iterator[_Entry]:
        """Yield what could have a place: of each user what has begun, and as many that wait as there are places."""
        for principal, user in self._users.items():
            if self.has_no_time(principal):
                yield from (entry for entry in user.begun.values() if entry.stage == "preparing")
                continue
            yield from (entry for entry in user.begun.values() if not entry.is_paused or entry.stage == "preparing")
            yield from self._next_of(user)

    def _next_of(self, user: _User) -> list[_Entry]:
        """Return the jobs of a user that wait and may be taken up: as many as there are places."""
        first = [self._entries[job] for _, _, job in user.waiting[: self.limits.total.running]]
        return [entry for entry in first if entry.had_begun] if self.is_paused else first

    def _is_content(self, principal: str | None, user: _User) -> bool:
        """Tell whether a user has all places that there is use for: more could not be taken up now."""
        stages = [entry.stage for entry in user.begun.values() if not entry.is_paused]
        busy = stages.count("searching") + stages.count("preparing")
        return self._is_full(principal, busy) or not ("held" in stages or self._next_of(user))

    def has_no_time(self, principal: str | None) -> bool:
        """Tell whether a user may use no more task time today."""
        return self.is_exhausted or principal in self.exhausted

    def _is_full(self, principal: str | None, busy: int) -> bool:
        most = self.limits.of(principal).running
        return most is not None and busy >= most

    # ---------------------------------------------------------------------------------------------- views

    @property
    def under_way(self) -> int:
        """How many jobs hold places."""
        return sum(1 for _ in self._holders())

    @property
    def queued(self) -> int:
        """How many jobs wait, paused ones included."""
        return len(self._entries) - sum(len(user.begun) for user in self._users.values())

    def queued_by_user(self) -> dict[str | None, int]:
        """Return how many jobs of each user wait, paused ones included."""
        return {principal: self.queued_of(principal) for principal in self._users}

    @property
    def ready(self) -> int:
        """How many jobs wait for nothing but a place: no new one in a paused queue, none of users without task time."""
        users = (user for name, user in self._users.items() if not self.has_no_time(name))
        return sum(len(self._next_of(user) if self.is_paused else user.waiting) for user in users)

    def queued_of(self, principal: str | None) -> int:
        """Return how many jobs of a user wait, paused ones included."""
        user = self._users.get(principal)
        return len(user.waiting) + user.paused if user is not None else 0

    def is_held(self, job: str) -> bool:
        """Tell whether a job that has begun has no place now."""
        entry = self._entries.get(job)
        return entry is not None and entry.stage == "held"

    def ahead_of(self, job: str) -> int | None:
        """Return how many jobs that wait are before this one, if each took a turn; None when it does not wait there."""
        entry = self._entries.get(job)
        if entry is None or entry.has_begun or entry.is_paused:
            return None
        own = self._users[entry.principal]
        index = bisect_left(own.waiting, entry.key)
        first, number = self._fair_share.turn(entry.principal)
        rank = first + len(own.begun) + index
        ahead = index
        for principal, user in self._users.items():
            if principal != entry.principal and user.waiting:
                round_, other = self._fair_share.turn(principal)
                before = rank - round_ - len(user.begun) + (other < number)
                ahead += max(0, min(len(user.waiting), before))
        return ahead

    def waiting_reason(self, job: str) -> str | None:
        """Return in words what a job waits for that has no place; None: it has one, or is not here."""
        entry = self._entries.get(job)
        if entry is None or entry.stage in ("preparing", "searching"):
            return None
        principal = entry.principal
        if entry.is_paused:
            return pause_reason(job)
        if self.has_no_time(principal):
            return NO_TIME
        if entry.stage == "held":
            return "waits for its user's next turn; others have theirs"
        if self.is_paused and not entry.had_begun:
            return "waits: the queue is paused by an admin"
        busy = sum(begun.stage in ("preparing", "searching") for begun in self._users[principal].begun.values())
        if self._is_full(principal, busy):
            return f"waits: {busy} of its user's jobs are under way, as many as limits allow"
        return self._turn_reason(self.ahead_of(job) or 0)

    def _turn_reason(self, ahead: int) -> str:
        if ahead:
            return f"waits for its turn ({ahead} {'job' if ahead == 1 else 'jobs'} before it)"
        running = self.under_way
        return f"waits for its turn (it is next; {running} {'job is' if running == 1 else 'jobs are'} under way)"

    def validate(self) -> None:
        """Check the invariants; raises AssertionError."""
        searching = Counter(entry.principal for entry in self._holders())
        assert searching.total() <= self.limits.total.running, "more jobs hold places than there are"
        for principal, places in searching.items():
            assert not self._is_full(principal, places - 1), f"{principal} has more places than allowed"
        assert self.queued == sum(self.queued_of(principal) for principal in self._users), "jobs are lost in the line"

    # -------------------------------------------------------------------------------------------- private

    def _holders(self) -> Iterator[_Entry]:
        for user in self._users.values():
            yield from (entry for entry in user.begun.values() if entry.stage in ("preparing", "searching"))

    def _stand(self, entry: _Entry) -> None:
        """Let a job that has not begun stand in the line of its user."""
        user = self._users.setdefault(entry.principal, _User())
        if entry.has_begun:
            return
        if entry.is_paused:
            user.paused += 1
        else:
            insort(user.waiting, entry.key)

    def _step_aside(self, entry: _Entry) -> None:
        user = self._users[entry.principal]
        if entry.has_begun:
            return
        if entry.is_paused:
            user.paused -= 1
        else:
            del user.waiting[bisect_left(user.waiting, entry.key)]


def pause_reason(job: str) -> str:
    """Return what a job waits for that is paused."""
    return f"is paused; go on with: coordinator resume {job}"
