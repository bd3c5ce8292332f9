"""Plays a schedule of faults over the whole service in virtual time; tells what happened, and what must not.

Coordinator, store, workers and client are real; bus, time, disk and (but for some schedules) islands are simulated.
"""

import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Final

from atoll.client.client import Client
from atoll_coordinator.service.requests import deletion
from atoll_coordinator.service.search import archipelago
from atoll_coordinator.service.search import checkpoint_schedule as checkpoints
from atoll_core.config import JobConfig
from atoll_core.errors import AtollError, RefusedError, UnreachableError
from atoll_core.wire.messages.views import FINAL_STATES, JobView
from tests.simulation.bus.fault_plan import Plan
from tests.simulation.harness.fault_injector import FaultInjector
from tests.simulation.harness.fault_schedule import GuestPlan, JobPlan, Schedule
from tests.simulation.harness.guests import Guest
from tests.simulation.harness.participants import STUBS, Cast, Participants
from tests.simulation.harness.simulated_cluster import comparable
from tests.simulation.harness.simulated_disk import FULL

LIMIT_S: Final = 300.0
"""A job that has not ended so long after the last fault is stuck."""

POLL_S: Final = 1.0
"""How often the client looks how jobs get on."""

SETTLE_S: Final = 60.0
"""After the last job's end, time for the last words."""

_HURRIED: Final = (
    (archipelago, "FIRST_INTERVAL", 2), (archipelago, "PLAN_COMMITS", 1), (archipelago, "FORGET_EPOCHS", 2),
    (checkpoints, "LEAST_INTERVAL", 1), (checkpoints, "PAUSE_S", 0.1),
    (checkpoints, "COST_S", 0.0), (deletion, "CHECK_INTERVAL_S", 1.0),
)  # fmt: skip


class StuckError(AssertionError):
    """Raised when a job does not end, or the coordinator does not answer, long after the last fault."""


@dataclass
class Outcome:
    """What came of a schedule. `wrong` is empty when nothing happened that must not; `history` hashes every event."""

    schedule: Schedule
    wrong: list[str]
    story: list[str]
    struck: Counter[str]
    seconds: float
    history: str


class ScheduleRun:
    """One schedule, its participants, and the client that submits its jobs."""

    def __init__(self, schedule: Schedule, cast: Cast = STUBS) -> None:
        self.participants = Participants(schedule, cast)
        self._injector = FaultInjector(self.participants)
        self.guests: list[Guest] = []
        for plan in schedule.guests:
            self.participants.at(plan.at_s, partial(self._welcome, plan))
        self.client = Client(self.participants.network.bus("client"), "simulated")

    def play(self) -> Outcome:
        """Let everything happen; return what came of it."""
        try:
            with hurried() if self.participants.schedule.is_hurried else nullcontext():
                self._play()
        except (AssertionError, AtollError) as error:
            self.participants.wrong.append("".join(traceback.format_exception_only(error)).strip())
            self.participants.story.append("".join(traceback.format_exception(error)))
        finally:
            self.participants.disk.close()
        everybody, struck = self.participants, self._injector.struck
        seconds, history = everybody.network.now, everybody.history.hexdigest()
        return Outcome(everybody.schedule, everybody.wrong, everybody.story, struck, seconds, history)

    def result_of(self, job: JobPlan) -> dict[str, Any]:
        """Submit a job that nothing disturbs, and return its result."""
        self._submit(0, job)
        (view,) = self._finish()
        assert view.state == "done", view
        result: dict[str, Any] = self._patiently(lambda: self.client.result(view.job))
        self.participants.disk.close()
        return result

    def _play(self) -> None:
        jobs = dict(enumerate(self.participants.schedule.jobs))
        moments = [(job.submit_s, partial(self._submit, number, job)) for number, job in jobs.items()]
        moments += [
            (job.cancel_s, partial(self._cancel, number)) for number, job in jobs.items() if job.cancel_s is not None
        ]
        for at_s, act in sorted(moments, key=lambda equation: equation[0]):
            self.client.pause(max(0.0, at_s - self.participants.network.now))
            act()
        views = {view.job: view for view in self._finish()}
        self.participants.note(f"all jobs have ended: {', '.join(view.state for view in views.values())}")
        for number, job in jobs.items():
            self._check_kept(f"job-{number}", job, views)
        for guest in self.guests:
            if guest.submitted is not None and not guest.deleted:
                # Whether a guest's cancellation came in time is nobody's business.
                self._check_kept(guest.submitted, JobPlan(guest.plan.seed, cancel_s=guest.plan.for_s), views)
        self._injector.end_faults()
        network = self.participants.network
        network.run(network.now + SETTLE_S, lambda: not self._is_busy() and not self._remains())
        self.participants.wrong += [*self._remains(), *self.participants.fate.wrong]

    def _welcome(self, plan: GuestPlan) -> None:
        self.participants.note(f"{plan.name} comes")
        self.guests.append(Guest(plan, self.participants))

    def _check_kept(self, job_id: str, job: JobPlan, views: dict[str, JobView]) -> None:
        """Nobody's results go."""
        if job_id in views:
            self._check_result(job, views[job_id])
        else:
            self.participants.wrong.append(f"{job_id} is gone")

    def _submit(self, number: int, job: JobPlan) -> None:
        config, variables = self.participants.cast.job(job.seed)
        table = variables.encode()
        self._patiently(lambda: self.client.hand_in(f"job-{number}", "a simulated job", config, table, job.priority))
        self.participants.note(f"job-{number} is submitted")

    def _cancel(self, number: int) -> None:
        view = self._patiently(lambda: self.client.cancel(f"job-{number}"))
        self.participants.note(f"job-{number} is cancelled ({view.state})")

    def _finish(self) -> list[JobView]:
        """Follow all jobs to their ends."""
        while True:
            is_quiet = len(self.guests) == len(self.participants.schedule.guests) and not self._guests_here()
            views = self._patiently(self.client.jobs)
            if is_quiet and all(view.state in FINAL_STATES for view in views):
                return sorted(views, key=lambda view: view.job)
            if self.participants.network.now > self.participants.schedule.horizon_s + LIMIT_S:
                open_ones = [(view.job, view.state, view.reason) for view in views]
                raise StuckError(f"jobs do not end, or guests {self._guests_here()} wait: {open_ones}")
            self.client.pause(POLL_S)

    def _guests_here(self) -> list[str]:
        return [guest.plan.name for guest in self.guests if guest.is_here]

    def _patiently(self, ask: Callable[[], Any]) -> Any:
        """Ask until there is an answer that is not one of a full disk, which passes."""
        while self.participants.network.now < self.participants.schedule.horizon_s + LIMIT_S + 2 * POLL_S:
            try:
                return ask()
            except UnreachableError:
                continue
            except AtollError as error:
                if not self._injector.struck["full-disk"] or FULL not in str(error):
                    raise
                self.client.pause(POLL_S)
        raise StuckError("the coordinator does not answer")

    def _check_result(self, job: JobPlan, view: JobView) -> None:
        is_cancelled = job.cancel_s is not None and view.state == "cancelled"
        if view.state == "failed" and self._injector.struck["old-store"] and "version" in (view.reason or ""):
            self.participants.note(f"{view.job} has failed: {view.reason}")
            return
        if view.state != "done" and not is_cancelled:
            self.participants.wrong.append(f"{view.job} is {view.state}: {view.reason}")
            return
        try:
            result = self._patiently(lambda: self.client.result(view.job))
        except RefusedError as error:
            if not is_cancelled:
                raise
            self.participants.note(f"{view.job} has no result: {error}")
            return
        self._check_digest(job, result, is_cancelled)

    def _check_digest(self, job: JobPlan, result: dict[str, Any], is_cancelled: bool) -> None:
        """Compare with the calm run, or, for a cancelled job, with the calm run of as many epochs."""
        epochs = {equation["variable"]: equation["epoch"] for equation in result["equations"]}
        if not is_cancelled:
            if comparable(result) != calm(job.seed, self.participants.cast):
                self.participants.wrong.append(f"{result['job']} has another answer than the calm run")
        elif min(epochs.values()) > 0 and result["digest"] != calm_digest(
            job.seed, self.participants.cast, tuple(epochs.items())
        ):
            self.participants.wrong.append(
                f"{result['job']}, cancelled after {epochs}, has another digest than that many epochs"
            )

    # --------------------------------------------------------------------------------------- remainders

    def _is_busy(self) -> bool:
        """Tell whether somebody still waits for an answer."""
        return self.participants.service is None or any(bus.asking for bus in self.participants.buses.values())

    def _remains(self) -> list[str]:
        """Return what is still held of jobs that have all ended."""
        leftovers = [f"{name} still holds {what}" for name in self.participants.workers for what in self._held_by(name)]
        service = self.participants.service
        if service is None:
            return [*leftovers, "there is no coordinator"]
        if len(service.controller.tasks.table) or service.controller.tasks._blobs:
            leftovers.append("the coordinator still has tasks or their inputs")
        if service.controller.jobs:
            leftovers.append(f"the coordinator still has jobs {list(service.controller.jobs)}")
        if self.participants.disk.rows("checkpoints") or self.participants.disk.rows("states"):
            leftovers.append("the store still holds checkpoints")
        expected = {
            "coordinator",
            "client",
            *self.participants.workers,
            *(["router"] if self.participants.schedule.has_own_router else []),
        }
        if expected != set(self.participants.network.participants):
            leftovers.append(f"there are {self.participants.network.participants}, expected were {sorted(expected)}")
        return leftovers

    def _held_by(self, name: str) -> list[str]:
        worker, compute = self.participants.workers[name], self.participants.computes[name]
        session, queue = worker.session, compute._queue
        held = {
            "shards": session.assignment_statuses(),
            "failures": session.failures(),
            "states of jobs": session.jobs(),
            "datasets": worker._datasets.jobs(),
            "configurations": list(compute._jobs),
            "islands": list(compute._islands),
            "tasks": list(worker._tasks.statuses()),
            "epochs": list(queue._open),
            "charges": list(queue._charged),
            "hits": list(queue._hits),
        }
        return [f"{what}: {which}" for what, which in held.items() if which]


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
    return ScheduleRun(calm_schedule(seed), cast).result_of(JobPlan(seed))
