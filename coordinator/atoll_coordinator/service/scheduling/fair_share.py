"""Fair share between users: deficit round robin over users, then priority and age within the jobs of one. Pure.

Deficit round robin (M. Shreedhar, G. Varghese, *Efficient fair queuing using deficit round robin*, IEEE/ACM
Transactions on Networking 4(3), 1996, 375-385) gives each user in turn a quantum of service. What a job costs is known
only afterwards here, so that a user may overdraw the quantum by what is under way when it is used up, which is taken
off the next ones, as in the same authors' surplus round robin. A user's *round* is the number of quanta used up; those
of the lowest round are served first, in the order in which they came. Who comes after having had nothing to do begins
in the lowest round, behind those who are in it: idleness saves nothing up, and what was overdrawn stays owed. The
lowest round is that of the users who want more than they have: who has all that there is use for saves nothing up
either, and who took what nobody else wanted owes nothing for it. While one of these is served in an earlier round, the
lowest is the one before, so that nobody loses the rest of a quantum.

**The longest wait.** Let N users have jobs at some time meanwhile, S jobs be served at once, Q be the quantum, and let
whoever is served be charged after at most t seconds. Somebody who comes with one job enters the lowest round, v. Ahead
are only users who are still in round v, each of them with one job (the second of a user stands a round behind the
first), and each leaves the round once it has been served for Q + t at most; who comes later stands behind, and who
comes back keeps what is owed. As long as the newcomer is not served, all S places are taken by those ahead, so that it
begins within

    (N - 1) (Q + t) / S

seconds, whatever the others have in line, and is not overtaken before it has been served for Q itself. A job that takes
c seconds of service needs k = ceil(c / Q) rounds, in which each other user has at most k quanta, and is charged late
for at most S places: it ends within (N - 1) (k Q + S t) / S + c. What a place is held for that nothing interrupts
(preparing a table, the way to the next checkpoint) comes on top, once a round.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import Final, Protocol

QUANTUM_S: Final = 60.0
"""Seconds of service that a user has in one turn. A change costs about two (waiting at a checkpoint, states on their
way to other workers), and shall cost no more than the 3 % that checkpoints may (`checkpoint_schedule.SHARE`)."""

AGE_S: Final = 3600.0
"""Each step of priority is worth so many seconds of waiting to the jobs of one user: nearly all jobs end in less, so
that priority decides among those of one sitting, and in 20 hours the lowest passes the highest."""


class SchedulableJob(Protocol):
    """What is asked of a job: whose it is (None: nobody has proved it), its priority, and since when it waits."""

    @property
    def id(self) -> str: ...

    @property
    def principal(self) -> str | None: ...

    @property
    def priority(self) -> int: ...

    @property
    def since(self) -> float: ...  # seconds; only differences count


@dataclass(frozen=True, slots=True)
class Principal:
    """A user by name, as one to be charged: a job may be called like a user."""

    name: str | None


@dataclass(slots=True)
class _Account:
    """What a job has been charged, over 2^priority."""

    principal: str | None
    weight: float
    spent: float


@dataclass(slots=True)
class _Share:
    """What a user has been charged, and the place in the round; `level` is where a new job of theirs begins."""

    number: int
    spent: float
    level: float = 0.0
    jobs: set[str] = field(default_factory=set)


class FairShare:
    """The accounts of all users of one thing that is shared: places, or the time of workers.

    Everything that could be served now is asked for at once; what cannot (its user is at a limit, it is paused) is left
    out, and its user saves nothing up meanwhile.
    """

    def __init__(self, quantum_s: float = QUANTUM_S) -> None:
        """`quantum_s` is what a user has in one turn, in seconds."""
        self._quantum = quantum_s
        self._round = 0
        self._next_number = 0
        self._shares: dict[str | None, _Share] = {}
        self._accounts: dict[str, _Account] = {}

    def order(self, jobs: Iterable[SchedulableJob], content: Collection[str | None] = ()) -> list[str]:
        """Return the ids of jobs, the most entitled first; it takes n log n for n jobs.

        `content` are those users of the jobs who have all that they could use now.

        The second job of a user stands a round behind the first, as if each took a quantum. Within a user those come
        first that were charged least, over 2^priority; then those that have waited longest, where each step of priority
        is worth `AGE_S`.
        """
        by_user: dict[str | None, list[SchedulableJob]] = {}
        for job in jobs:
            by_user.setdefault(job.principal, []).append(job)
        self._enter(by_user, content)
        ranked: list[tuple[int, int, str]] = []
        for principal, own in by_user.items():
            first, number = self.turn(principal)
            own.sort(key=self._rank_within)
            ranked += [(first + place, number, job.id) for place, job in enumerate(own)]
        ranked.sort(key=lambda entry: entry[:2])  # equal ones do not exist: a user has one job in a round
        return [job for _, _, job in ranked]

    def charge(self, whom: str | Principal, seconds: float) -> None:
        """Charge a job, by its id, and thereby its user; or a user alone. A job never asked for is nobody's."""
        if isinstance(whom, Principal):
            self._share(whom.name).spent += seconds
            return
        account = self._accounts.get(whom)
        if account is not None:
            account.spent += seconds / account.weight
            self._share(account.principal).spent += seconds

    def forget(self, job: str) -> None:
        """Forget a job that has ended; what its user owes stays owed."""
        account = self._accounts.pop(job, None)
        if account is None:
            return
        share = self._share(account.principal)
        share.jobs.discard(job)
        if not share.jobs and self._round_of(share) <= self._round:
            del self._shares[account.principal]

    def turn(self, principal: str | None) -> tuple[int, int]:
        """Return the round of a user, and the place in it: users are served in the order of both."""
        share = self._shares.get(principal)
        if share is None:
            return self._round, self._next_number
        return self._round_of(share), share.number

    def _enter(self, by_user: dict[str | None, list[SchedulableJob]], content: Collection[str | None]) -> None:
        """Let users and jobs in that were not there, and raise the lowest round to that of those who want more."""
        self._raise_round(by_user, content)
        for principal, own in by_user.items():
            share = self._share(principal)
            if self._round_of(share) < self._round:
                share.spent = self._round * self._quantum
                share.number = self._take_number()
            for job in own:
                self._let_in(job, share)
            share.level = min(self._accounts[job.id].spent for job in own)

    def _raise_round(self, users: Collection[str | None], content: Collection[str | None]) -> None:
        """Raise the lowest round; where nobody wants more, nobody owes anybody anything."""
        wanting = [self.turn(user)[0] for user in users if user not in content]
        lowest = min(wanting) if wanting else max((self.turn(user)[0] for user in users), default=self._round)
        if wanting and any(self.turn(user)[0] < lowest for user in content):
            lowest -= (
                1  # whoever is served has the rest of the quantum, and is not overtaken by those that it is before
            )
        if lowest > self._round:
            self._round = lowest
            idle = [name for name, share in self._shares.items() if not share.jobs and self._round_of(share) <= lowest]
            for name in idle:
                del self._shares[name]

    def _let_in(self, job: SchedulableJob, share: _Share) -> None:
        """Let a job begin where the least charged one of its user is; one that could not be served saves nothing up."""
        account = self._accounts.get(job.id)
        if account is None:
            account = self._accounts[job.id] = _Account(job.principal, 1.0, share.level)
            share.jobs.add(job.id)
        account.weight = 2.0**job.priority
        account.spent = max(account.spent, share.level)

    def _rank_within(self, job: SchedulableJob) -> tuple[float, float]:
        return self._accounts[job.id].spent, job.since - AGE_S * job.priority

    def _round_of(self, share: _Share) -> int:
        return int(share.spent // self._quantum)

    def _share(self, principal: str | None) -> _Share:
        share = self._shares.get(principal)
        if share is None:
            spent = self._round * self._quantum
            share = self._shares[principal] = _Share(self._take_number(), spent)
        return share

    def _take_number(self) -> int:
        self._next_number += 1
        return self._next_number - 1
