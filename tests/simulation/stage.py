"""The whole service in virtual time while a schedule of faults strikes it; tells what happened, and what must not.

Coordinator, store, workers and client are real; bus, time, disk and (but for some schedules) islands are simulated.
"""

import hashlib
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from functools import cache, partial
from typing import Any, Final

from common.config import JobConfig
from common.errors import AtollError, RefusedError, UnreachableError
from common.wire.bus import Event
from common.wire.faults import Plan
from common.wire.messages import EpochReport
from common.wire.simulated_bus import SimulatedBus, SimulatedNetwork
from common.wire.views import FINAL_STATES, JobView
from coordinator.client import Client
from coordinator.model.refinement import Refinement
from coordinator.service import archipelago, checkpoint
from coordinator.service.ports import Ports
from coordinator.service.service import Service
from island_worker.events import Computed
from island_worker.runtime import Leaving, Worker
from tests.simulation.disk import CoordinatorDied, Disk, DiskStore
from tests.simulation.schedule import Fault, JobPlan, Schedule, job_config
from tests.simulation.stub import StubCompute
from tests.simulation.world import comparable, prepare

LIMIT_S: Final = 300.0
"""A job that has not ended so long after the last fault is stuck."""

POLL_S: Final = 1.0
"""How often the client looks how jobs get on."""

SETTLE_S: Final = 60.0
"""After the last job's end, time for the last words."""

WAIT_S: Final = 60.0
"""How long a worker bears that the coordinator is away."""

SUPERVISED_S: Final = 2.0
"""After which a worker that ended with an error is started again."""


class StuckError(AssertionError):
    """Raised when a job does not end, or the coordinator does not answer, long after the last fault."""


@dataclass(frozen=True)
class Cast:
    """What the islands are made of: stubs that hash, or real ones."""

    compute: type[StubCompute] = StubCompute
    prepare: Callable[..., Any] = prepare
    job: Callable[[int], tuple[JobConfig, str]] = job_config


STUBS: Final = Cast()
_HURRIED: Final = (
    (archipelago, "FIRST_INTERVAL", 2), (archipelago, "PLAN_COMMITS", 1), (archipelago, "FORGET_EPOCHS", 2),
    (checkpoint, "LEAST_INTERVAL", 1), (checkpoint, "PAUSE_S", 0.1), (checkpoint, "COST_S", 0.0),
)  # fmt: skip
_MORNING: Final = datetime(2026, 1, 1, tzinfo=UTC)


@dataclass
class Outcome:
    """What came of a schedule. `wrong` is empty when nothing happened that must not; `history` hashes every event."""

    schedule: Schedule
    wrong: list[str]
    story: list[str]
    struck: Counter[str]
    seconds: float
    history: str


@dataclass
class Stage:
    """Everybody who takes part, and the hand that strikes them."""

    schedule: Schedule
    cast: Cast = STUBS
    wrong: list[str] = field(default_factory=list)
    story: list[str] = field(default_factory=list)
    struck: Counter[str] = field(default_factory=Counter)
    workers: dict[str, Worker] = field(default_factory=dict)
    computes: dict[str, StubCompute] = field(default_factory=dict)
    service: Service | None = None

    def __post_init__(self) -> None:
        schedule = self.schedule
        self.network = SimulatedNetwork(schedule.seed, schedule.plan)
        self.disk = Disk()
        self._store: DiskStore | None = None
        self._storms: list[float] = []
        self._background_s = 0.001
        self._down_s = self._jumped_s = self._written_at = 0.0
        self._buses: dict[str, SimulatedBus] = {}
        self._is_over = False
        self._processes = 0
        self._made: dict[tuple[object, ...], list[int]] = {}
        self._history = hashlib.sha256()
        if schedule.has_own_router:
            self.network.bus("router", is_router=True)
        self._start_coordinator()
        for number in range(schedule.workers):
            self._start_worker(f"w{number}")
        for fault in schedule.faults:
            self._at(fault.at_s, partial(self._strike, fault))
        self._at(schedule.horizon_s, self._end_faults)
        self.client = Client(self.network.bus("client"), "simulated")

    # ------------------------------------------------------------------------------------------- jobs

    def play(self) -> Outcome:
        """Let everything happen; return what came of it."""
        try:
            with hurried() if self.schedule.is_hurried else nullcontext():
                self._play()
        except (AssertionError, AtollError) as error:
            self.wrong.append("".join(traceback.format_exception_only(error)).strip())
            self.story.append("".join(traceback.format_exception(error)))
        finally:
            self.disk.close()
        history = self._history.hexdigest()
        return Outcome(self.schedule, self.wrong, self.story, self.struck, self.network.now, history)

    def _play(self) -> None:
        jobs = dict(enumerate(self.schedule.jobs))
        moments = [(job.submit_s, partial(self._submit, number, job)) for number, job in jobs.items()]
        moments += [
            (job.cancel_s, partial(self._cancel, number)) for number, job in jobs.items() if job.cancel_s is not None
        ]
        for at_s, act in sorted(moments, key=lambda each: each[0]):
            self.client.pause(max(0.0, at_s - self.network.now))
            act()
        views = self._finish()
        self._note(f"all jobs have ended: {', '.join(view.state for view in views)}")
        for number, view in enumerate(views):
            self._check_result(jobs[number], view)
        self._end_faults()
        self.network.run(self.network.now + SETTLE_S, lambda: not self._is_busy() and not self._remains())
        self.wrong += self._remains()

    def _submit(self, number: int, job: JobPlan) -> None:
        config, variables = self.cast.job(job.seed)
        table = self._patiently(lambda: self.client.upload(variables.encode()))
        self._patiently(lambda: self.client.submit(f"job-{number}", "a simulated job", config, table, job.priority))
        self._note(f"job-{number} is submitted")

    def _cancel(self, number: int) -> None:
        view = self._patiently(lambda: self.client.cancel(f"job-{number}"))
        self._note(f"job-{number} is cancelled ({view.state})")

    def _finish(self) -> list[JobView]:
        """Follow all jobs to their ends."""
        while True:
            views = self._patiently(self.client.jobs)
            if all(view.state in FINAL_STATES for view in views):
                return sorted(views, key=lambda view: view.job)
            if self.network.now > self.schedule.horizon_s + LIMIT_S:
                raise StuckError(f"jobs do not end: {[(view.job, view.state, view.reason) for view in views]}")
            self.client.pause(POLL_S)

    def _patiently(self, ask: Callable[[], Any]) -> Any:
        """Ask until there is an answer."""
        while self.network.now < self.schedule.horizon_s + LIMIT_S + 2 * POLL_S:
            with suppress(UnreachableError):
                return ask()
        raise StuckError("the coordinator does not answer")

    def _check_result(self, job: JobPlan, view: JobView) -> None:
        is_cancelled = job.cancel_s is not None and view.state == "cancelled"
        if view.state != "done" and not is_cancelled:
            self.wrong.append(f"{view.job} is {view.state}: {view.reason}")
            return
        try:
            result = self._patiently(lambda: self.client.result(view.job))
        except RefusedError as error:
            if not is_cancelled:
                raise
            self._note(f"{view.job} has no result: {error}")
            return
        self._check_digest(job, result, is_cancelled)

    def _check_digest(self, job: JobPlan, result: dict[str, Any], is_cancelled: bool) -> None:
        """Compare with the calm run, or, for a cancelled job, with the calm run of as many epochs."""
        epochs = {each["variable"]: each["epoch"] for each in result["equations"]}
        if not is_cancelled:
            if comparable(result) != calm(job.seed, self.cast):
                self.wrong.append(f"{result['job']} has another answer than the calm run")
        elif min(epochs.values()) > 0 and result["digest"] != calm_digest(job.seed, self.cast, tuple(epochs.items())):
            self.wrong.append(f"{result['job']}, cancelled after {epochs}, has another digest than that many epochs")

    # ----------------------------------------------------------------------------------------- service

    def _start_coordinator(self) -> None:
        if self.service is not None:
            return
        bus = self._buses["coordinator"] = self.network.bus("coordinator", is_router=not self.schedule.has_own_router)
        store = self._store = self.disk.open(bus.spend)
        background = partial(self._do_later, bus, store)
        writer = partial(self._write_later, bus, store)
        ports = Ports(self.cast.prepare, background, self._time_of_day, lambda *_: Refinement(), writer=writer)
        service = self.service = Service(bus, store, ports=ports)
        self._watch_reports(service)

        def step(event: Event) -> None:
            self._take_down(bus, event)
            self._guarded(store, lambda: service.step(event))
            for job in service.conductor.jobs.values():
                job.validate()

        bus.handle_with(step)
        self._note(f"the coordinator starts, incarnation {store.incarnation}")
        self._guarded(store, service.start)

    def _do_later(self, bus: SimulatedBus, store: DiskStore, work: Callable[[], None]) -> None:
        """Do background work of one incarnation, if that one is still alive then."""
        self._at(bus.now() + self._background_s, lambda: None if store.is_dead else self._guarded(store, work))

    def _write_later(self, bus: SimulatedBus, store: DiskStore, work: Callable[[], None]) -> None:
        """Do what one incarnation's writer is given, one piece after the other; the disk keeps nobody else busy."""

        def write() -> None:
            if not store.is_dead:
                slow_s, self.disk.slow_s = self.disk.slow_s, 0.0
                self._guarded(store, work)
                self.disk.slow_s = slow_s

        self._written_at = max(self._written_at, bus.now()) + self._background_s + self.disk.slow_s
        self._at(self._written_at, write)

    def _guarded(self, store: DiskStore, act: Callable[[], None]) -> None:
        try:
            act()
        except CoordinatorDied:
            self._note(f"the coordinator dies at commit {self.disk.commits}")
            self._kill_coordinator(self._down_s)

    def _kill_coordinator(self, for_s: float) -> None:
        if self.service is None or self._store is None:
            return
        self._store.is_dead, self.service = True, None
        self.network.crash("coordinator")
        self._at(self.network.now + for_s, self._start_coordinator)

    def _watch_reports(self, service: Service) -> None:
        """Have every report that is accepted compared with who computed it."""
        take = service.conductor.report

        def report(worker: str, report: EpochReport, now: float) -> None:
            job = service.conductor.jobs.get(report.job)
            archipelago = job.archipelagos.get(report.variable) if job is not None else None
            placement = archipelago.placement if archipelago is not None and archipelago.cut is None else None
            take(worker, report, now)
            if placement is None or placement.term != report.term:
                return
            for each in report.islands:
                key = (report.job, report.variable, report.term, each.island, report.epoch)
                if len(self._made.get(key, ())) != 1:
                    self.wrong.append(f"{key} was evolved by {self._made.get(key)} and accepted")

        service.conductor.report = report  # type: ignore[method-assign]

    # ----------------------------------------------------------------------------------------- workers

    def _start_worker(self, name: str, slowness: float = 1.0, leaving: Leaving | None = None) -> None:
        if name in self.workers:
            return
        bus = self.network.bus(name)
        self._processes += 1
        process, post = self._processes, bus.post
        compute = self.cast.compute(self.network, name, self.schedule.seed, self.schedule.slowness * slowness)

        def witnessed(item: object) -> None:
            if isinstance(item, Computed):
                key = item.key
                made = self._made.setdefault((key.job, key.variable, key.term, key.island, key.epoch), [])
                made.append(process)
            post(item)

        bus.post = witnessed  # type: ignore[method-assign]
        worker = Worker(bus, compute, name, WAIT_S, leaving)

        def step(event: Event) -> None:
            self._take_down(bus, event)
            worker.step(event)
            worker.session.validate()
            if worker.exit_code is not None:
                self._worker_ended(name, worker)

        bus.handle_with(step)
        self.workers[name], self.computes[name], self._buses[name] = worker, compute, bus
        worker.start()

    def _worker_ended(self, name: str, worker: Worker) -> None:
        if self.workers.get(name) is not worker:
            return
        self._note(f"{name} ends with {worker.exit_code}: {worker.error}")
        self._dismiss(name)
        if worker.exit_code:
            self._at(self.network.now + SUPERVISED_S, lambda: self._start_worker(name))

    def _dismiss(self, name: str) -> None:
        """Let a worker's process end in order."""
        self.computes.pop(name).close()
        self.workers.pop(name)
        self._buses.pop(name).close()
        if self._is_over:
            self._see_to_workers()

    def _see_to_workers(self) -> None:
        """See that somebody is there to compute."""
        if not self.workers:
            self._start_worker("rescue")

    def _crash(self, name: str) -> None:
        self.computes.pop(name).close()
        self.workers.pop(name)
        del self._buses[name]
        self.network.crash(name)

    # ------------------------------------------------------------------------------------------ faults

    def _strike(self, fault: Fault) -> None:
        if self._is_over:
            return
        strike = getattr(self, "_strike_" + fault.kind.replace("-", "_"))
        has_struck = strike(fault) is not False
        self._note(f"{str(fault).strip()}{'' if has_struck else ' (without effect)'}")
        if has_struck:
            self.struck[fault.kind] += 1

    def _end_faults(self) -> None:
        """Undo what is wrong, and see that somebody is there to compute."""
        if self._is_over:
            return
        self._is_over = True
        self._note("all faults are over")
        self.network.plan = replace(self.schedule.plan, drop=0.0, duplicate=0.0, late=0.0)
        self.disk.slow_s, self._background_s = 0.0, 0.001
        self.disk.forget_death()
        for name in self.network.participants:
            self.network.resume(name)
            self.network.heal(name)
        for compute in self.computes.values():
            compute.go_on()
            compute.slowness = min(compute.slowness, self.schedule.slowness)
        self._start_router()
        self._start_coordinator()
        self._see_to_workers()

    def _for_a_while(self, fault: Fault, end: Callable[[], object]) -> None:
        self._at(self.network.now + fault.for_s, end)

    def _strike_kill(self, fault: Fault) -> bool | None:
        if fault.who not in self.workers:
            return False
        self._crash(fault.who)
        if fault.for_s:
            self._for_a_while(fault, lambda: self._start_worker(fault.who))
        return None

    def _strike_hang(self, fault: Fault) -> bool | None:
        compute = self.computes.get(fault.who)
        if compute is None:
            return False
        self.network.hang(fault.who)
        compute.hold()
        self._for_a_while(fault, lambda: self._resume(fault.who, compute))
        return None

    def _resume(self, name: str, compute: StubCompute) -> None:
        if self.computes.get(name) is compute:
            self.network.resume(name)
            compute.go_on()

    def _strike_stuck(self, fault: Fault) -> bool | None:
        compute = self.computes.get(fault.who)
        if compute is None:
            return False
        compute.hold()
        self._for_a_while(fault, compute.go_on)
        return None

    def _strike_slow(self, fault: Fault) -> bool | None:
        compute = self.computes.get(fault.who)
        if compute is None:
            return False
        before = compute.slowness
        compute.slowness = before * fault.strength

        def end() -> None:
            compute.slowness = before

        self._for_a_while(fault, end)
        return None

    def _strike_cut(self, fault: Fault) -> bool | None:
        if fault.who not in self.network.participants:
            return False
        self.network.cut(fault.who)
        self._for_a_while(fault, lambda: self.network.heal(fault.who))
        return None

    def _strike_join(self, fault: Fault) -> None:
        self._start_worker(fault.who, fault.strength, Leaving(lifetime_s=fault.for_s or None))

    def _strike_leave(self, fault: Fault) -> bool | None:
        if fault.who not in self.workers:
            return False
        self.workers[fault.who].leave()
        return None

    def _strike_close(self, fault: Fault) -> bool | None:
        if fault.who not in self.workers:
            return False
        self._dismiss(fault.who)
        return None

    def _strike_kill_coordinator(self, fault: Fault) -> bool | None:
        if self.service is None:
            return False
        self._kill_coordinator(fault.for_s)
        return None

    def _strike_die_before_commit(self, fault: Fault) -> None:
        self._down_s = fault.for_s
        self.disk.die_at(int(fault.strength), before=True)

    def _strike_die_after_commit(self, fault: Fault) -> None:
        self._down_s = fault.for_s
        self.disk.die_at(int(fault.strength), before=False)

    def _strike_hang_coordinator(self, fault: Fault) -> None:
        self._hang("coordinator", fault)

    def _strike_hang_router(self, fault: Fault) -> None:
        self._hang("router", fault)

    def _hang(self, name: str, fault: Fault) -> None:
        self.network.hang(name)
        self._for_a_while(fault, lambda: self.network.resume(name))

    def _strike_kill_router(self, fault: Fault) -> None:
        self.network.crash("router")
        self._for_a_while(fault, self._start_router)

    def _start_router(self) -> None:
        if self.schedule.has_own_router and "router" not in self.network.participants:
            self.network.bus("router", is_router=True)

    def _strike_cut_coordinator(self, fault: Fault) -> None:
        self.network.cut("coordinator")
        self._for_a_while(fault, lambda: self.network.heal("coordinator"))

    def _strike_cut_client(self, fault: Fault) -> None:
        self.network.cut("client")
        self._for_a_while(fault, lambda: self.network.heal("client"))

    def _strike_storm(self, fault: Fault) -> None:
        self._storms.append(fault.strength)
        self._set_weather()

        def end() -> None:
            self._storms.remove(fault.strength)
            self._set_weather()

        self._for_a_while(fault, end)

    def _set_weather(self) -> None:
        if self._is_over:
            return
        worst, plan = max(self._storms, default=0.0), self.schedule.plan
        self.network.plan = replace(
            plan, drop=max(plan.drop, worst), duplicate=max(plan.duplicate, worst), late=max(plan.late, worst)
        )

    def _strike_slow_disk(self, fault: Fault) -> None:
        self.disk.slow_s = fault.strength

        def end() -> None:
            self.disk.slow_s = 0.0

        self._for_a_while(fault, end)

    def _strike_slow_background(self, fault: Fault) -> None:
        self._background_s = fault.strength

        def end() -> None:
            self._background_s = 0.001

        self._for_a_while(fault, end)

    def _strike_clock_jump(self, fault: Fault) -> None:
        self._jumped_s += fault.strength

    # --------------------------------------------------------------------------------------- remainders

    def _is_busy(self) -> bool:
        """Tell whether somebody still waits for an answer."""
        return self.service is None or any(bus.asking for bus in self._buses.values())

    def _remains(self) -> list[str]:
        """Return what is still held of jobs that have all ended."""
        found = [f"{name} still holds {what}" for name in self.workers for what in self._held_by(name)]
        service = self.service
        if service is None:
            return [*found, "there is no coordinator"]
        if service.conductor.jobs:
            found.append(f"the coordinator still has jobs {list(service.conductor.jobs)}")
        if self.disk.rows("checkpoints") or self.disk.rows("states"):
            found.append("the store still holds checkpoints")
        expected = {"coordinator", "client", *self.workers, *(["router"] if self.schedule.has_own_router else [])}
        if expected != set(self.network.participants):
            found.append(f"there are {self.network.participants}, expected were {sorted(expected)}")
        return found

    def _held_by(self, name: str) -> list[str]:
        worker, compute = self.workers[name], self.computes[name]
        session, agenda = worker.session, compute._agenda
        held = {
            "shares": session.holdings(),
            "troubles": session.troubles(),
            "states of jobs": session.jobs(),
            "early mail": session._early,
            "datasets": worker._datasets.jobs(),
            "configurations": list(compute._jobs),
            "islands": list(compute._islands),
            "tasks": list(agenda._open),
            "charges": list(agenda._charged),
            "hits": list(agenda._hits),
        }
        return [f"{what}: {which}" for what, which in held.items() if which]

    # ------------------------------------------------------------------------------------------ private

    def _at(self, time_s: float, act: Callable[[], object]) -> None:
        self.network.at(time_s, lambda: (act(), None)[1])

    def _take_down(self, bus: SimulatedBus, event: Event) -> None:
        self._history.update(f"{self.network.now:.9f} {bus.name} {type(event).__name__}\n".encode())

    def _note(self, sentence: str) -> None:
        self.story.append(f"{self.network.now:8.3f}  {sentence}")

    def _time_of_day(self) -> str:
        return (_MORNING + timedelta(seconds=self.network.now + self._jumped_s)).isoformat(timespec="milliseconds")


@contextmanager
def hurried() -> Iterator[None]:
    """Have checkpoints and planned changes of placements follow each other closely, so that faults meet many."""
    before = [(module, name, getattr(module, name)) for module, name, _ in _HURRIED]
    try:
        for module, name, value in _HURRIED:
            setattr(module, name, value)
        yield
    finally:
        for module, name, value in before:
            setattr(module, name, value)


def calm_schedule(seed: int) -> Schedule:
    """Return the schedule in which nothing goes wrong: one worker, one job."""
    return Schedule(seed, 1, 1.0, False, False, Plan(), (JobPlan(seed),), 1.0, ())


@cache
def calm(seed: int, cast: Cast = STUBS) -> str:
    """Return the answer of one worker on a perfect network."""
    return comparable(_calm_result(seed, cast))


@cache
def calm_digest(seed: int, cast: Cast, epochs: tuple[tuple[str, int], ...]) -> str:
    """Return the digest of as many epochs of each variable."""

    def shortened(job: int) -> tuple[JobConfig, str]:
        config, variables = cast.job(job)
        budget = config.budget.model_copy(update={"max_epochs_of": dict(epochs)})
        return config.model_copy(update={"budget": budget}), variables

    digest: str = _calm_result(seed, replace(cast, job=shortened))["digest"]
    return digest


def _calm_result(seed: int, cast: Cast) -> dict[str, Any]:
    stage = Stage(calm_schedule(seed), cast)
    stage._submit(0, JobPlan(seed))
    (view,) = stage._finish()
    assert view.state == "done", view
    result: dict[str, Any] = stage._patiently(lambda: stage.client.result("job-0"))
    return result
