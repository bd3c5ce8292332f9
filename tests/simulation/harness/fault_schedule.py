"""What is to go wrong, and when: a schedule of faults in virtual time, drawn from a seed. Pure data.

A schedule disturbs until its `horizon_s` and not after it, and leaves somebody to compute: so every job can end.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal, get_args

from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig, MigrationConfig
from atoll_core.search.seeding import Stream, stream_key
from tests.simulation.bus.fault_plan import Plan

Kind = Literal[
    "kill", "hang", "stuck", "slow", "cut", "join", "leave", "close",
    "kill-coordinator", "die-before-commit", "die-after-commit", "hang-coordinator",
    "kill-router", "hang-router", "cut-coordinator",
    "crash-task", "starve-task", "break-task", "kill-in-task",
    "storm", "slow-disk", "slow-background", "cut-client", "clock-jump", "full-disk", "old-store",
]  # fmt: skip

WHAT_IT_IS: Final[dict[Kind, str]] = {
    "kill": "{who} dies without a word{back}",
    "hang": "{who} is stopped for {span:.2f} s",
    "stuck": "{who}'s compute thread hangs for {span:.2f} s, its heartbeat does not",
    "slow": "{who} computes {strength:.0f} times slower for {span:.2f} s",
    "cut": "{who} is cut off for {span:.2f} s",
    "join": "{who} joins, {strength:.1f} times as slow as others{stay}",
    "leave": "{who} is asked to leave",
    "close": "{who} ends at once, and says so",
    "kill-coordinator": "the coordinator dies, and is back after {span:.2f} s",
    "die-before-commit": "the coordinator dies before it commits for the {strength:.0f}. time, back after {span:.2f} s",
    "die-after-commit": "the coordinator dies after it commits for the {strength:.0f}. time, back after {span:.2f} s",
    "hang-coordinator": "the coordinator is stopped for {span:.2f} s",
    "kill-router": "the router dies, and is back after {span:.2f} s",
    "hang-router": "the router is stopped for {span:.2f} s",
    "cut-coordinator": "the coordinator is cut off for {span:.2f} s",
    "storm": "for {span:.2f} s, {strength:.0%} of all messages are lost, as many doubled, as many late",
    "slow-disk": "for {span:.2f} s, every access to the store takes {strength:.3f} s",
    "slow-background": "for {span:.2f} s, preparing and refining take {strength:.2f} s",
    "crash-task": "the process of the next task dies in the middle, of tasks that take {strength:.2f} s",
    "starve-task": "the next task runs out of memory in the middle, of tasks that take {strength:.2f} s",
    "break-task": "the next task breaks, of tasks that take {strength:.2f} s",
    "kill-in-task": "the worker of the next task dies in its middle, of tasks that take {strength:.2f} s",
    "cut-client": "the client is cut off for {span:.2f} s",
    "full-disk": "for {span:.2f} s, nothing can be written to the store",
    "old-store": "the coordinator dies, and what it stored is found to be another version's {span:.2f} s later",
    "clock-jump": "the time of day jumps by {strength:+.0f} s",
}

GuestKind = Literal[
    "half-uploads", "uploads", "vanishes", "stalls", "cancels", "deletes", "asks-everything", "old-client", "old-worker"
]

WHAT_THEY_DO: Final[dict[GuestKind, str]] = {
    "half-uploads": "begins {times} uploads and vanishes",
    "uploads": "uploads {times} tables that it never submits",
    "vanishes": "submits a job and vanishes",
    "stalls": "submits a job, is stopped for {span:.2f} s and asks for its result",
    "cancels": "submits a job and cancels it after {span:.2f} s",
    "deletes": "submits a job, and deletes it before and after its end",
    "asks-everything": "asks for everything {times} times",
    "old-client": "asks {times} times in the words of another version",
    "old-worker": "works with another version, and says so {times} times",
}

JOB_SEEDS: Final = 12
"""So few different jobs that their calm results can be kept."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that goes wrong at `at_s`. `for_s` is how long (0: for good), `strength` how much, as kinds have it."""

    at_s: float
    kind: Kind
    who: str = ""
    for_s: float = 0.0
    strength: float = 0.0

    def __str__(self) -> str:
        back = f", and a new process of that name comes after {self.for_s:.2f} s" if self.for_s else ""
        stay = f", and leaves after {self.for_s:.2f} s" if self.for_s else ""
        words = WHAT_IT_IS[self.kind].format(
            who=self.who, span=self.for_s, strength=self.strength, back=back, stay=stay
        )
        return f"{self.at_s:8.3f}  {words}"


@dataclass(frozen=True, slots=True)
class JobPlan:
    """One job: which of the known ones it is, when it is submitted, and when it is cancelled (None: never)."""

    seed: int
    submit_s: float = 0.0
    cancel_s: float | None = None
    priority: int = 0


@dataclass(frozen=True, slots=True)
class GuestPlan:
    """One guest: when it comes, what it does, how often or for how long, and of which seed its job is."""

    at_s: float
    name: str
    kind: GuestKind
    times: int
    for_s: float
    seed: int

    def __str__(self) -> str:
        return f"{self.at_s:8.3f}  {self.name} {WHAT_THEY_DO[self.kind].format(times=self.times, span=self.for_s)}"


@dataclass(frozen=True, slots=True)
class Schedule:
    """Who takes part, what they do, and what goes wrong. The same schedule gives the same history."""

    seed: int
    workers: int
    slowness: float
    has_own_router: bool
    is_hurried: bool
    plan: Plan
    jobs: tuple[JobPlan, ...]
    horizon_s: float
    faults: tuple[Fault, ...]
    guests: tuple[GuestPlan, ...] = ()

    def story(self) -> str:
        """Return what is to happen, in lines of virtual time."""
        router = "a router of its own" if self.has_own_router else "the coordinator's router"
        pace = "checkpoints in quick succession" if self.is_hurried else "checkpoints at their usual pace"
        lines = [f"seed {self.seed}: {self.workers} workers at first, {router}, {pace}, {self.plan}"]
        for number, job in enumerate(self.jobs):
            end = f", cancelled at {job.cancel_s:.2f} s" if job.cancel_s is not None else ""
            words = f"  job-{number} is that of seed {job.seed}, of priority {job.priority}"
            lines.append(f"{words}, submitted at {job.submit_s:.2f} s{end}")
        return "\n".join(
            [*lines, *map(str, self.guests), *map(str, self.faults), f"{self.horizon_s:8.3f}  all faults are over"]
        )


def job_config(seed: int) -> tuple[JobConfig, str]:
    """Return one of `JOB_SEEDS` small jobs and its variables."""
    draw = Draw(seed, "job")
    config = JobConfig(
        seed=seed,
        evolution=EvolutionConfig(islands=draw.whole(2, 4), runners_up=draw.pick((0, 2))),
        migration=MigrationConfig(generations=draw.pick((10, 10, 20, 25)), joining=draw.pick((None, 1, 2))),
        budget=BudgetConfig(max_epochs=draw.whole(8, 24), stagnation=1000),
    )
    return config, draw.pick(("x", "x,y", "x,y"))


class Draw:
    """Draws by name from a seed."""

    def __init__(self, seed: int, purpose: str) -> None:
        self._stream = Stream(stream_key(seed, "", -1, 0, "schedule/" + purpose))

    def chance(self, probability: float) -> bool:
        return self._stream.uniform() < probability

    def whole(self, low: int, high: int) -> int:
        """Both included."""
        return low + self._stream.below(high - low + 1)

    def real(self, low: float, high: float) -> float:
        return low + (high - low) * self._stream.uniform()

    def spread(self, low: float, high: float) -> float:
        """Uniform in the logarithm."""
        return low * (high / low) ** self._stream.uniform()

    def pick(self, options):  # type: ignore[no-untyped-def]
        return options[self._stream.below(len(options))]


def schedule_of(seed: int) -> Schedule:
    """Return the schedule of a seed."""
    draw = Draw(seed, "setting")
    workers = draw.whole(1, 4)
    slowness = draw.spread(1.0, 60.0)
    has_own_router, is_hurried = draw.chance(0.3), draw.chance(0.7)
    jobs = _jobs(draw)
    length_s = 1.0 + 0.5 * slowness * len(jobs) / workers
    plan = Plan(
        drop=draw.pick((0.0, 0.0, 0.01, 0.05)),
        duplicate=draw.pick((0.0, 0.0, 0.05)),
        late=draw.pick((0.0, 0.02, 0.1)),
        late_s=(0.05, draw.spread(0.2, 8.0)),
        detection_s=draw.pick((0.002, 0.5, 4.0)),
        unsent_s=draw.pick((0.0, 0.005)),
    )
    horizon_s = length_s + draw.spread(2.0, 40.0)
    several = draw.pick((1, 2, 3, 3, 4, 5, 6, 8, 12))
    faults = [_fault(draw, workers, has_own_router, min(length_s, 30.0)) for _ in range(several)]
    faults += _task_faults(Draw(seed, "tasks"), min(length_s, 30.0))
    kept = tuple(sorted((fault for fault in faults if fault.at_s < horizon_s), key=lambda fault: fault.at_s))
    guests = _guests(Draw(seed, "guests"), min(horizon_s, 30.0))
    return Schedule(seed, workers, slowness, has_own_router, is_hurried, plan, jobs, horizon_s, _named(kept), guests)


def _guests(draw: Draw, length_s: float) -> tuple[GuestPlan, ...]:
    count = draw.pick((0, 0, 1, 1, 2, 2, 3, 5))
    return tuple(
        GuestPlan(
            at_s=draw.real(0.0, length_s),
            name=f"guest{number}",
            kind=draw.pick(get_args(GuestKind)),
            times=draw.whole(1, 4),
            for_s=draw.spread(0.1, 30.0),
            seed=draw.whole(0, JOB_SEEDS - 1),
        )
        for number in range(count)
    )


def _task_faults(draw: Draw, length_s: float) -> list[Fault]:
    """Return what is to happen to tasks, which there are at the beginnings and ends of jobs only."""
    several = draw.pick((0, 0, 1, 1, 2, 3))
    return [
        _in_task(draw, draw.real(0.0, length_s) * draw.pick((0.0, 1.0)), draw.pick(_TASK_KINDS), "")
        for _ in range(several)
    ]


def _jobs(draw: Draw) -> tuple[JobPlan, ...]:
    count = draw.pick((1, 1, 1, 2, 3))
    seeds = Stream(draw.whole(0, 2**30)).permutation(JOB_SEEDS)
    jobs = [
        JobPlan(seeds[number], draw.pick((0.0, draw.spread(0.1, 10.0))), priority=draw.pick((0, 0, 2, -3)))
        for number in range(count)
    ]
    if draw.chance(0.35 if count > 1 else 0.1):
        victim = draw.whole(0, count - 1)
        jobs[victim] = replace(jobs[victim], cancel_s=jobs[victim].submit_s + draw.spread(0.2, 20.0))
    return tuple(jobs)


def _fault(draw: Draw, workers: int, has_own_router: bool, length_s: float) -> Fault:
    at_s = draw.real(0.0, 1.0 + 1.5 * length_s)
    kinds = [*_WORKER_KINDS, *_SERVICE_KINDS]
    if has_own_router:
        kinds += _ROUTER_KINDS
    kind = draw.pick(kinds)
    who = f"w{draw.whole(0, workers - 1)}"
    return _MAKERS[kind](draw, at_s, kind, who)


_TASK_KINDS: Final[list[Kind]] = ["crash-task", "starve-task", "break-task", "kill-in-task", "kill-in-task"]
_WORKER_KINDS: Final[list[Kind]] = ["kill", "kill", "hang", "hang", "stuck", "slow", "cut", "cut", "join", "leave"]
_WORKER_KINDS += ["join", "leave", "close"]
_SERVICE_KINDS: Final[list[Kind]] = [
    "kill-coordinator", "die-before-commit", "die-before-commit", "die-after-commit", "die-after-commit",
    "hang-coordinator", "storm", "storm", "slow-disk", "slow-background", "cut-client", "clock-jump", "full-disk",
    "old-store",
]  # fmt: skip
_ROUTER_KINDS: Final[list[Kind]] = ["kill-router", "kill-router", "hang-router", "cut-coordinator"]

_Maker = Callable[[Draw, float, Kind, str], Fault]


def _for_a_while(low_s: float, high_s: float, low: float = 1.0, high: float = 1.0) -> _Maker:
    def make(draw: Draw, at_s: float, kind: Kind, who: str) -> Fault:
        return Fault(at_s, kind, who, draw.spread(low_s, high_s), draw.spread(low, high))

    return make


def _kill(draw: Draw, at_s: float, kind: Kind, who: str) -> Fault:
    return Fault(at_s, kind, who, draw.pick((0.0, draw.spread(0.05, 20.0))))


def _join(draw: Draw, at_s: float, kind: Kind, who: str) -> Fault:
    return Fault(at_s, kind, who, draw.pick((0.0, 0.0, draw.spread(1.0, 30.0))), draw.spread(0.3, 6.0))


def _once(draw: Draw, at_s: float, kind: Kind, who: str) -> Fault:
    return Fault(at_s, kind, who, 0.0, draw.spread(0.3, 6.0))


def _die_at_commit(draw: Draw, at_s: float, kind: Kind, who: str) -> Fault:
    return Fault(at_s, kind, who, draw.spread(0.05, 20.0), float(draw.whole(1, 6)))


def _jump(draw: Draw, at_s: float, kind: Kind, who: str) -> Fault:
    return Fault(at_s, kind, "", 0.0, draw.pick((-1.0, 1.0)) * draw.spread(1.0, 1e8))


def _in_task(draw: Draw, at_s: float, kind: Kind, who: str) -> Fault:
    return Fault(at_s, kind, "", draw.spread(0.5, 20.0), draw.spread(0.01, 5.0))


_MAKERS: Final[dict[Kind, _Maker]] = {
    "kill": _kill,
    "hang": _for_a_while(0.1, 40.0),
    "stuck": _for_a_while(0.1, 30.0),
    "slow": _for_a_while(0.5, 30.0, 2.0, 50.0),
    "cut": _for_a_while(0.05, 40.0),
    "join": _join,
    "leave": _once,
    "close": _once,
    "kill-coordinator": _for_a_while(0.05, 20.0),
    "die-before-commit": _die_at_commit,
    "die-after-commit": _die_at_commit,
    "hang-coordinator": _for_a_while(0.1, 20.0),
    "kill-router": _for_a_while(0.05, 20.0),
    "hang-router": _for_a_while(0.1, 20.0),
    "cut-coordinator": _for_a_while(0.05, 20.0),
    "storm": _for_a_while(0.2, 20.0, 0.05, 0.5),
    "slow-disk": _for_a_while(0.5, 20.0, 0.005, 0.5),
    "slow-background": _for_a_while(0.5, 20.0, 0.1, 10.0),
    "crash-task": _in_task,
    "starve-task": _in_task,
    "break-task": _in_task,
    "kill-in-task": _in_task,
    "cut-client": _for_a_while(0.1, 30.0),
    "clock-jump": _jump,
    "full-disk": _for_a_while(0.1, 10.0),
    "old-store": _for_a_while(0.05, 10.0),
}


def _named(faults: tuple[Fault, ...]) -> tuple[Fault, ...]:
    """Give newcomers names of their own."""
    joins = 0
    named = []
    for fault in faults:
        if fault.kind == "join":
            fault, joins = replace(fault, who=f"late{joins}"), joins + 1
        named.append(fault)
    return tuple(named)
