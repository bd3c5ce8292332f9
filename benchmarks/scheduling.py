"""Fair share between users, in virtual time: the real queue, drawn users, and what must hold whatever they do.

    python -m benchmarks.scheduling --schedules 10000   # small ones, each of its seed; one in fifty also stores bytes
    python -m benchmarks.scheduling --crowd             # 100 users, 100,000 jobs that wait
    python -m benchmarks.scheduling --seed 123          # one of them; tells what is wrong

Users are greedy (many endless jobs), endless (a few), busy, idle, or malicious: these add, end, pause, resume jobs and
change priorities all the time. Returns 1 when anything is wrong, else 0.
"""

import hashlib
import math
import statistics
import sys
import time
from argparse import Namespace
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from atoll.terminal.output import say
from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.requests import admission
from atoll_coordinator.service.requests.authorization import Authorization
from atoll_coordinator.service.requests.clients import ClientRequests
from atoll_coordinator.service.requests.deletion import JobDeletion
from atoll_coordinator.service.scheduling.fair_share import QUANTUM_S, FairShare
from atoll_coordinator.service.scheduling.job_queue import JobQueue
from atoll_coordinator.service.scheduling.limits import Allowance, Limits, Total
from atoll_coordinator.service.store.store import Store
from atoll_core.config import JobConfig
from atoll_core.search.seeding import Stream, stream_key
from atoll_core.wire.messages.clients import ClientRequest, Delete, Submit, Upload
from atoll_core.wire.messages.views import FINAL_STATES
from atoll_core.wire.security.roles import RoleBindings
from benchmarks.harness.command_line import option, program, whole

KINDS: Final = ("greedy", "endless", "busy", "idle", "malicious")
ENDLESS_S: Final = 1e9
NEWCOMERS: Final = 2
"""Users who come later, each with one small job."""
BYTES_EVERY: Final = 50
"""So many schedules have one that stores tables and results; that takes ten times as long."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A service: places, a quantum, a tick and the longest time of preparing in seconds, and the kind of each user."""

    places: int
    quantum_s: float
    tick_s: float
    preparing_s: float
    kinds: tuple[str, ...]
    running: int | None = None

    @property
    def uninterrupted_s(self) -> float:
        """For how long a place is held at most while a job is prepared: its end is seen at a tick."""
        return self.tick_s * math.ceil(self.preparing_s / self.tick_s)

    def longest_wait_s(self, others: int) -> float:
        """Return the bound of `fair_share` for a newcomer beside so many others, with what preparing adds.

        That is once for each who is ahead of it, and once for a place that is being prepared when it comes; and the
        tick at which it is seen.
        """
        one_s = self.quantum_s + self.tick_s + self.uninterrupted_s
        return others * one_s / self.places + self.uninterrupted_s + self.tick_s

    def longest_gap_s(self) -> float:
        """Return how long a user who wants to be served may not be: two rounds of all others, newcomers included."""
        one_s = 2.0 * self.quantum_s + self.places * self.tick_s + self.uninterrupted_s
        return (len(self.kinds) + NEWCOMERS) * one_s / self.places + 2.0 * (self.uninterrupted_s + self.tick_s)


@dataclass
class Play:
    """Users who use the queue, tick by tick. `left` is how long each job still takes; `wrong` what must not be."""

    setting: Setting
    seed: int
    wrong: list[str] = field(default_factory=list)
    now: float = 0.0
    served_s: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    waits: list[float] = field(default_factory=list)
    worst: float = 0.0
    decisions_s: list[float] = field(default_factory=list)
    left: dict[str, float] = field(default_factory=dict)
    owner: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        setting = self.setting
        limits = Limits(total=Total(running=setting.places), user=Allowance(running=setting.running))
        self.queue = JobQueue(limits, FairShare(setting.quantum_s))
        self._stream = Stream(stream_key(self.seed, "", -1, 0, "scheduling"))
        self._ready_at: dict[str, float] = {}
        self._asked: dict[str, float] = {}
        self._beside: dict[str, set[str]] = {}
        self._wants_since: dict[str, float] = {}
        self._own: dict[str, list[str]] = {}
        self._paused: set[str] = set()
        self._number = 0

    def chance(self, probability: float) -> bool:
        return self._stream.uniform() < probability

    def add(self, user: str, seconds: float, priority: int = 0) -> str:
        """Submit a job that takes so long."""
        self._number += 1
        job = f"{user}-{self._number}"
        self.left[job], self.owner[job] = seconds, user
        self._own.setdefault(user, []).append(job)
        self.queue.add(job, user, priority, self.now)
        return job

    def add_small(self, user: str) -> str:
        """Submit a job of somebody who has no other; it is seen when it has a place."""
        job = self.add(user, 0.5 * self.setting.quantum_s)
        self._asked[job], self._beside[job] = self.now, set()
        return job

    def remove(self, job: str) -> None:
        """End a job."""
        self.queue.remove(job)
        del self.left[job]
        self._own[self.owner.pop(job)].remove(job)
        self._paused.discard(job)
        self._ready_at.pop(job, None)

    def begin(self) -> None:
        """Let everybody submit what they begin with."""
        for number, kind in enumerate(self.setting.kinds):
            if kind in ("greedy", "endless"):
                for _ in range(12 if kind == "greedy" else 1 + self._stream.below(3)):
                    self.add(f"u{number}", ENDLESS_S, self._stream.below(21) - 10)

    def step(self) -> None:
        """Let a tick pass: time is charged, users act, and it is decided whose turn it is."""
        self.now += self.setting.tick_s
        self._work()
        for number, kind in enumerate(self.setting.kinds):
            self._act(f"u{number}", kind)
        began = time.perf_counter()
        self.queue.charge(self.now)
        decision = self.queue.decide()
        self.decisions_s.append(time.perf_counter() - began)
        self._check_waits()
        for job in decision.take_up:
            self.queue.begin(job)
            self._ready_at[job] = self.now + self.setting.preparing_s * self._stream.uniform()
            if job in self._asked:
                self.waits.append(self.now - self._asked.pop(job))
        self._check()

    def _work(self) -> None:
        for job in [entry.id for entry in self.queue._holders()]:
            ready_at = self._ready_at.get(job)
            if ready_at is not None:
                if ready_at <= self.now:
                    del self._ready_at[job]
                    self.queue.search(job)
                continue
            self.served_s[self.owner[job]] += self.setting.tick_s
            self.left[job] -= self.setting.tick_s
            if self.left[job] <= 0.0:
                self.remove(job)

    def _act(self, user: str, kind: str) -> None:
        own = self._own.get(user, [])
        if kind == "busy" and len(own) < 3:
            self.add(user, 3.0 * self.setting.quantum_s * self._stream.uniform())
        elif kind == "idle" and not own and self.chance(0.02):
            self.add(user, self.setting.quantum_s * self._stream.uniform())
        elif kind == "malicious":
            self._do_harm(user, own)

    def _do_harm(self, user: str, own: list[str]) -> None:
        if len(own) < 20 and self.chance(0.4):
            self.add(user, ENDLESS_S, 10)
        if not own:
            return
        job = own[self._stream.below(len(own))]
        if self.chance(0.2):
            self.remove(job)
        elif self.chance(0.3):
            is_paused = job not in self._paused
            self.queue.pause(job, is_paused)
            (self._paused.add if is_paused else self._paused.discard)(job)
        elif self.chance(0.3):
            self.queue.set_priority(job, self._stream.below(21) - 10)

    def _check_waits(self) -> None:
        """Look how long small jobs wait beside all who have had jobs meanwhile; `worst` is the share of a bound."""
        users = {user for user, own in self._own.items() if own} if self._asked else set()
        for job, asked in self._asked.items():
            self._beside[job] |= users
            waited, bound = self.now - asked, self.setting.longest_wait_s(len(self._beside[job]) - 1)
            self.worst = max(self.worst, waited / bound)
            if waited > bound:
                self.wrong.append(f"a small job waited {waited:.1f} s of {bound:.1f}")

    def _check(self) -> None:
        try:
            self.queue.validate()
        except AssertionError as error:
            self.wrong.append(f"{error} at {self.now:.1f} s")
        served = {entry.user for entry in self.queue._holders()}
        for user, own in self._own.items():
            if user in served or all(job in self._paused for job in own):
                self._wants_since.pop(user, None)
            elif self.now - self._wants_since.setdefault(user, self.now) > self.setting.longest_gap_s():
                self.wrong.append(f"{user} has not been served since {self._wants_since[user]:.1f} s")


def setting_of(seed: int) -> Setting:
    """Return the service and the users of a seed."""
    stream = Stream(stream_key(seed, "", -1, 0, "scheduling/setting"))
    kinds = tuple(KINDS[stream.below(len(KINDS))] for _ in range(1 + stream.below(6)))
    places, running = 1 + stream.below(4), (None, None, 1, 2)[stream.below(4)]
    return Setting(places, 4.0 + 8.0 * stream.uniform(), 0.5 + stream.uniform(), 3.0 * stream.uniform(), kinds, running)


def play(seed: int) -> list[str]:
    """Play the schedule of a seed; return what is wrong."""
    played = Play(setting_of(seed), seed)
    played.begin()
    newcomers = 0
    while played.now < 100.0 and not played.wrong:
        if played.now > 20.0 * (newcomers + 1) and newcomers < NEWCOMERS:
            newcomers += 1
            played.add_small(f"newcomer{newcomers}")
        played.step()
    return played.wrong


# -------------------------------------------------------------------------------------------------- bytes


class Silent:
    """Takes the place of channel, writer and loop."""

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *_: None


def play_bytes(seed: int) -> list[str]:
    """Let users of a real store upload, submit, end and delete as drawn; return whose bytes were ever too many."""
    stream = Stream(stream_key(seed, "", -1, 0, "scheduling/bytes"))
    own, total = 200 + stream.below(300), 800
    roles = RoleBindings({f"u{number}": "submitter" for number in range(3)})
    reserve, admission.RESULT_RESERVE = admission.RESULT_RESERVE, 20  # type: ignore[misc]
    wrong: list[str] = []
    silent: Any = Silent()
    try:
        with Store.open(None) as store:
            controller = JobController(store, silent, silent, silent.post, lambda: "2026-01-01T00:00:00")
            controller.queue.limits = Limits(total=Total(stored=total), user=Allowance(stored=own))
            clients = ClientRequests(
                controller, store, Authorization(roles, store), JobDeletion(controller, store), lambda: 0.0
            )
            for number in range(30):
                _one_thing(stream, controller, clients, number)
                stored = {user: store.held(user).stored for user in roles.roles}
                wrong += [f"{user} stores {amount} bytes of {own}" for user, amount in stored.items() if amount > own]
    finally:
        admission.RESULT_RESERVE = reserve  # type: ignore[misc]
    return wrong


def _one_thing(stream: Stream, controller: JobController, clients: ClientRequests, number: int) -> None:
    user = f"u{stream.below(3)}-1"
    choice = stream.below(4)
    if choice < 2:
        table = bytes([stream.below(6)]) * (1 + stream.below(120))
        digest = hashlib.sha256(table).hexdigest()
        upload = Upload(blob=digest, size=len(table), index=0, sha256=digest, data=table)
        submit = Submit(job=f"j{number}", name="", config=_CONFIG, table=digest)
        for body in (upload, submit)[: 1 + stream.below(4)]:
            clients.answer(user, ClientRequest(body=body))
    elif choice == 2 and controller.jobs:
        job = list(controller.jobs.values())[stream.below(len(controller.jobs))]
        text = controller._fitting(job, "x" * stream.below(150))
        controller._store.commit_result(job.id, "done" if text is not None else "failed", text, None, f"{number:04}")
        controller._remove(job.id)
        controller._apply_decision(0.0)
    elif ended := [record.id for record in controller._store.jobs() if record.state in FINAL_STATES]:
        clients.answer(user, ClientRequest(body=Delete(job=ended[stream.below(len(ended))])))


_CONFIG: Final = JobConfig()


# -------------------------------------------------------------------------------------------------- a crowd


def crowd(queued: int, hours: float) -> Play:
    """Return a service of 100 users, one of whom has so many jobs that wait, after so many hours."""
    kinds = ("greedy",) * 20 + ("endless",) * 40 + ("busy",) * 15 + ("idle",) * 15 + ("malicious",) * 10
    played = Play(Setting(4, QUANTUM_S, 2.0, 5.0, kinds), 0)
    played.begin()
    for _ in range(queued):
        played.add("u0", ENDLESS_S)
    number = 0
    while played.now < 3600.0 * hours and not played.wrong:
        if played.now > 600.0 * (number + 1):
            number += 1
            played.add_small(f"newcomer{number}")
        played.step()
    return played


def jain(amounts: Sequence[float]) -> float:
    """Return Jain's index of fairness, 1 where all amounts are equal."""
    return sum(amounts) ** 2 / (len(amounts) * sum(amount * amount for amount in amounts))


def crowd_lines() -> Iterator[str]:
    """Yield what a crowd of users came to."""
    for queued in (1_000, 100_000):
        played = crowd(queued, 4.0)
        equal = [played.served_s[f"u{number}"] for number in range(60)]
        times = sorted(1000.0 * seconds for seconds in played.decisions_s)
        yield (
            f"{queued} waiting: {len(played.waits)} small jobs, longest wait {max(played.waits):.0f} s, median "
            f"{statistics.median(played.waits):.0f} s, at most {played.worst:.2f} of its bound (99 others: "
            f"{played.setting.longest_wait_s(99):.0f} s); Jain's index of "
            f"60 users who always want more {jain(equal):.4f}; least and most service {min(equal):.0f} and "
            f"{max(equal):.0f} s; a decision {statistics.median(times):.2f} ms in the median, "
            f"{times[len(times) * 99 // 100]:.2f} ms p99; {len(played.wrong)} wrong"
        )
        yield from played.wrong[:5]


@program(
    "benchmarks.scheduling",
    __doc__,
    option("--schedules", type=whole, default=1000, help="how many (%(default)s)"),
    option("--seed", type=int, help="play this one"),
    option("--crowd", action="store_true", help="play 100 users, with a thousand and with a hundred thousand jobs"),
)
def main(options: Namespace) -> bool:
    """Play what was asked for; return whether anything is wrong."""
    if options.crowd:
        lines = list(crowd_lines())
        say("\n".join(lines))
        return len(lines) > 2
    seeds = [options.seed] if options.seed is not None else range(options.schedules)
    wrong: dict[int, list[str]] = {}
    began = time.process_time()
    for seed in seeds:
        found = play(seed) + (play_bytes(seed) if seed % BYTES_EVERY == 0 or options.seed is not None else [])
        if found:
            wrong[seed] = found
            say(f"seed {seed}: {setting_of(seed)}: {found[0]}")
    cpu_s = time.process_time() - began
    say(f"{len(seeds)} schedules, {len(wrong)} with something wrong, {1000 * cpu_s / len(seeds):.1f} ms of CPU each")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
