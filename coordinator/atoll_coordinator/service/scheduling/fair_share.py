"""Fair share between users: deficit round robin over users, then priority and age among a user's jobs. Pure.

Deficit round robin (M. Shreedhar, G. Varghese, *Efficient fair queuing using deficit round robin*, IEEE/ACM
Transactions on Networking 4(3), 1996, 375-385) gives each user in turn a quantum of service. Here the cost of a job is
known only afterwards. So a running job may exceed the quantum; the excess is deducted from the user's next quanta, as
in the same authors' surplus round robin.

A user's *round* is the number of quanta that the user has used up. Users in the lowest round are served first, in the
order of their arrival. A user who was idle enters the lowest round, behind the users who are in it: idle time gives no
credit, and an excess remains a debt. The lowest round is determined only by users who want more service than they have.
A user who already has all the service that the user can use gets no credit, and owes nothing for service that no other
user wanted. If such a user is still served in an earlier round, the lowest round is one less than the lowest round of
the users who want more service, so that no user loses the rest of a quantum.

**The longest wait.** Let N users have jobs, let S jobs be served at once, let Q be the quantum in seconds, and let each
user be charged after at most t seconds. A new user with one job enters the lowest round, v. The users before the new
user are the other users in round v, each with one job (the second job of a user counts one round later). Each of them
leaves the round after at most Q + t seconds of service. Users who arrive later are behind the new user, and returning
users keep their debts. While the new user waits, all S places are used by these users. So the job of the new user
begins within

    (N - 1) (Q + t) / S

seconds, for any number of jobs of the other users. No user overtakes the new user before the new user has been served
for Q. A job that takes c seconds of service needs k = ceil(c / Q) rounds. In these rounds each other user has at most k
quanta, and is charged late for at most S places. So the job ends within (N - 1) (k Q + S t) / S + c seconds. Service
that cannot be interrupted (preparing a table, computing up to the next checkpoint) is added once per round.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import Final

QUANTUM_S: Final = 60.0
"""Seconds of service of a user in one turn. A change of turns costs about two seconds (waiting at a checkpoint, sending
states to other workers). This should be at most 3 % of a turn, as much as checkpoints may cost
(`checkpoint_schedule.SHARE`)."""

AGE_S: Final = 3600.0
"""Among the jobs of one user, each step of priority is worth this number of seconds of waiting. Nearly all jobs take
less time than one step is worth, so that priority decides among jobs submitted together. After 20 hours a job of the
lowest priority comes before a new job of the highest priority."""

_RUNNING_S: Final = 1e10
"""A number of seconds that is larger than the worth of any age or priority: running tasks come before waiting tasks."""


@dataclass(frozen=True, slots=True)
class Turn:
    """A job of a user (None: a user without a certificate). `since` is the time from which the job has waited, in
    seconds from any origin."""

    id: str
    user: str | None
    priority: int = 0
    since: float = 0.0


@dataclass(slots=True)
class _Share:
    """The account of a user: `spent` seconds of service, the `number` in the round, and the jobs that want service."""

    number: int
    spent: float
    jobs: set[str] = field(default_factory=set)


class FairShare:
    """The accounts of all users of one shared resource: places, or the time of workers.

    Each call of `order` must have all jobs that could be served now, and only these. Paused jobs, and jobs of users at
    a limit, are left out, so that their users get no credit for waiting.
    """

    def __init__(self, quantum_s: float = QUANTUM_S) -> None:
        """`quantum_s` is the service of a user in one turn, in seconds."""
        self._quantum = quantum_s
        self._round = 0
        self._next_number = 0
        self._shares: dict[str | None, _Share] = {}
        self._users: dict[str, str | None] = {}

    def order(self, jobs: Iterable[Turn], content: Collection[str | None] = ()) -> list[str]:
        """Return the ids of jobs in the order in which they are served, in O(n log n) for n jobs.

        `content` are the users who have all the service that they can use now. The second job of a user counts one
        round later than the first, as if each job took one quantum. The jobs of one user are ordered by age, where each
        step of priority is worth `AGE_S`.
        """
        by_user: dict[str | None, list[Turn]] = {}
        for job in jobs:
            by_user.setdefault(job.user, []).append(job)
        self._raise_round(by_user, content)
        ranked: list[tuple[int, int, str]] = []
        for user, own in by_user.items():
            share = self._share(user)
            if self._round_of(share) < self._round:
                share.spent, share.number = self._round * self._quantum, self._take_number()
            share.jobs.update(job.id for job in own)
            self._users.update((job.id, user) for job in own)
            own.sort(key=lambda job: job.since - AGE_S * job.priority)
            ranked += [(self._round_of(share) + index, share.number, job.id) for index, job in enumerate(own)]
        ranked.sort(key=lambda entry: entry[:2])  # no two are equal: a user has one job in a round
        return [job for _, _, job in ranked]

    def charge(self, user: str | None, seconds: float) -> None:
        """Charge a user for service."""
        self._share(user).spent += seconds

    def forget(self, job: str) -> None:
        """Forget an ended job; the charges of its user remain."""
        if job not in self._users:
            return
        user = self._users.pop(job)
        share = self._share(user)
        share.jobs.discard(job)
        if not share.jobs and self._round_of(share) <= self._round:
            del self._shares[user]

    def turn(self, user: str | None) -> tuple[int, int]:
        """Return the round of a user, and the position in the round; users are served in this order."""
        share = self._shares.get(user)
        return (self._round_of(share), share.number) if share is not None else (self._round, self._next_number)

    def _raise_round(self, users: Collection[str | None], content: Collection[str | None]) -> None:
        """Raise the lowest round; if no user wants more service, all debts are cancelled."""
        wanting = [self.turn(user)[0] for user in users if user not in content]
        lowest = min(wanting) if wanting else max((self.turn(user)[0] for user in users), default=self._round)
        if wanting and any(self.turn(user)[0] < lowest for user in content):
            lowest -= 1  # a user who is served now keeps the rest of the quantum, before the users in the next round
        if lowest > self._round:
            self._round = lowest
            idle = [name for name, share in self._shares.items() if not share.jobs and self._round_of(share) <= lowest]
            for name in idle:
                del self._shares[name]

    def _round_of(self, share: _Share) -> int:
        return int(share.spent // self._quantum)

    def _share(self, user: str | None) -> _Share:
        share = self._shares.get(user)
        if share is None:
            share = self._shares[user] = _Share(self._take_number(), self._round * self._quantum)
        return share

    def _take_number(self) -> int:
        self._next_number += 1
        return self._next_number - 1


class TaskTurns(FairShare):
    """The shares of users in the task processes of workers, charged in seconds of one worker."""

    def order_tasks(self, waiting: Collection[Turn], running: Collection[Turn]) -> list[str]:
        """Return the ids of jobs with waiting tasks, in the order of their turns.

        Running tasks count as the first turns of their users, so that other users come first.
        """
        turns = [Turn(job.id, job.user, job.priority, job.since - _RUNNING_S) for job in running]
        content = {job.user for job in running} - {job.user for job in waiting}
        wanted = {job.id for job in waiting}
        return [job for job in self.order([*turns, *waiting], content) if job in wanted]
