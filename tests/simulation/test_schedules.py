"""Whatever a schedule of faults does, every job ends with the calm run's answer, and nothing is left of it."""

import contextlib
import os
import sqlite3
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from inspect import signature
from typing import get_args

import pytest

from atoll_coordinator.service.store.jobs import JobRecord, Viewer
from atoll_coordinator.service.store.retention import Retention
from atoll_coordinator.service.store.schema import _prepare
from atoll_coordinator.service.store.store import Store
from tests.simulation.harness.fault_schedule import (
    Fault,
    GuestKind,
    GuestPlan,
    JobPlan,
    Kind,
    Schedule,
    job_config,
    schedule_of,
)
from tests.simulation.harness.guests import Guest
from tests.simulation.harness.participants import Cast
from tests.simulation.harness.schedule_run import Outcome, ScheduleRun, calm_schedule
from tests.simulation.harness.simulated_disk import READS, CoordinatorDied, Disk
from tests.simulation.harness.stub_islands import StubCompute
from tests.simulation.soak import ROOT, is_real, play

SEEDS = 20
"""The first ones of those that ``make soak`` plays."""

BLOCK = 5
REAL = (99, 199)


def told(outcome: Outcome) -> str:
    return "\n".join([outcome.schedule.story(), "", *outcome.story, "", *outcome.wrong])


@pytest.mark.parametrize(
    "first", [pytest.param(first, marks=[pytest.mark.slow] * (first > 0)) for first in range(0, SEEDS, BLOCK)]
)
def test_no_schedule_changes_an_answer_stops_a_job_or_leaves_anything(first: int) -> None:
    for seed in range(first, first + BLOCK):
        if not is_real(seed):
            outcome = play(schedule_of(seed))
            assert not outcome.wrong, told(outcome)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [9661])
def test_nor_does_one_that_once_did(seed: int) -> None:
    """9661: a fetch was given up for islands that were placed elsewhere meanwhile, and not begun again."""
    outcome = play(schedule_of(seed))
    assert not outcome.wrong, told(outcome)


@pytest.mark.parametrize("seed", REAL)
def test_nor_does_it_with_real_islands(seed: int) -> None:
    assert is_real(seed)
    outcome = play(schedule_of(seed))
    assert not outcome.wrong, told(outcome)


@pytest.mark.slow
def test_a_seed_is_one_history_however_python_hashes() -> None:
    program = "from tests.simulation.soak import play, schedule_of; print(play(schedule_of(6)).history)"
    histories = {play(schedule_of(6)).history}
    for hash_seed in ("1", "2"):
        environment = {**os.environ, "PYTHONHASHSEED": hash_seed, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
        )
        histories.add(done.stdout.strip())
    assert len(histories) == 1
    assert play(schedule_of(7)).history not in histories


# ---------------------------------------------------------------------------- what the checks would find


def disturbed(*faults: Fault, jobs: tuple[JobPlan, ...] = (JobPlan(0),)) -> Schedule:
    return replace(calm_schedule(0), workers=2, slowness=10.0, jobs=jobs, horizon_s=20.0, faults=faults)


def test_a_calm_schedule_goes_well() -> None:
    outcome = play(disturbed())
    assert not outcome.wrong
    assert outcome.seconds < 20.0


def test_another_answer_is_found() -> None:
    class Wrong(StubCompute):
        def __post_init__(self) -> None:
            super().__post_init__()
            self.corrupt = self.worker == "w1"

    outcome = ScheduleRun(disturbed(), Cast(compute=Wrong)).play()
    assert any("another answer" in sentence for sentence in outcome.wrong), told(outcome)


@pytest.mark.slow
def test_a_job_that_does_not_end_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "atoll_coordinator.service.workers.worker_controller.WorkerController.place", lambda self, now: None
    )
    outcome = play(disturbed())
    assert any("do not end" in sentence for sentence in outcome.wrong), told(outcome)


def test_what_is_left_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("atoll_island_worker.downloads.Datasets.forget", lambda self, job: None)
    outcome = play(disturbed())
    assert any("still holds datasets" in sentence for sentence in outcome.wrong), told(outcome)


def test_an_island_that_is_evolved_twice_under_a_term_is_found() -> None:
    run = ScheduleRun(disturbed())
    run.participants.made |= {("job-0", "x", term, 0, 1): [77] for term in range(1, 9)}
    assert any("was evolved by [77" in sentence for sentence in run.play().wrong)


def test_what_breaks_a_rule_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: object) -> None:
        raise AssertionError("planted")

    monkeypatch.setattr("atoll_coordinator.service.jobs.job.Job.validate", broken)
    assert any("planted" in sentence for sentence in play(disturbed()).wrong)


# ---------------------------------------------------------------------------------------- faults by kind


@pytest.mark.parametrize("kind", get_args(Kind))
def test_every_kind_of_fault_strikes_and_is_undone(kind: Kind) -> None:
    needs_router = kind in ("kill-router", "hang-router", "cut-coordinator")
    fault = Fault(0.9, kind, "late0" if kind == "join" else "w1", 3.0, 2.0 if "die" in kind else 0.3)
    schedule = replace(disturbed(fault), has_own_router=needs_router, is_hurried=kind == "old-store")
    outcome = play(schedule)
    assert not outcome.wrong, told(outcome)
    assert outcome.struck == Counter([kind])


@pytest.mark.parametrize(
    ("kind", "met"),
    [("crash-task", "crash"), ("starve-task", "memory"), ("break-task", "error"), ("kill-in-task", "lost")],
)
def test_a_task_that_meets_something_is_done_all_the_same(
    monkeypatch: pytest.MonkeyPatch, kind: Kind, met: str
) -> None:
    """That of preparing, of which a second failure would be the job's; and helpers of refining get batches."""
    # Else a thread would take the place of the only helper.
    monkeypatch.setattr("atoll_coordinator.service.tasks.task_table.MOST_THREADS", 1)
    run = ScheduleRun(disturbed(Fault(0.0, kind, "", 15.0, 1.0)))
    outcome = run.play()
    assert not outcome.wrong, told(outcome)
    assert run.participants.fate.counts == {met: 1}
    assert sum(tasks.helped for tasks in run.participants.tasks.values()) > 1


@pytest.mark.parametrize(
    ("kind", "commit"),
    [
        *(("die-before-commit", commit) for commit in range(1, 12)),
        *(pytest.param("die-after-commit", commit, marks=[pytest.mark.slow] * (commit > 3)) for commit in range(1, 12)),
    ],
)
def test_the_coordinator_may_die_at_any_commit(kind: Kind, commit: int) -> None:
    outcome = play(disturbed(Fault(0.0, kind, "", 0.5, float(commit))))
    assert not outcome.wrong, told(outcome)
    assert any("dies at commit" in line for line in outcome.story)


def test_a_job_that_a_full_disk_refuses_is_taken_once_there_is_room() -> None:
    """Who submits is told why it cannot be, and tries again; the job ends as if nothing had happened."""
    outcome = play(disturbed(Fault(1.0, "full-disk", "", 3.0), jobs=(JobPlan(0, submit_s=1.0), JobPlan(1))))
    assert not outcome.wrong, told(outcome)
    (submitted,) = [line for line in outcome.story if "job-0 is submitted" in line]
    assert float(submitted.split()[0]) > 4.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["die-before-commit", "die-after-commit"])
@pytest.mark.parametrize("commit", range(1, 5))
def test_a_cancellation_that_dies_half_way_is_whole_or_has_not_been(kind: Kind, commit: int) -> None:
    jobs = (JobPlan(4, cancel_s=2.0), JobPlan(5))
    outcome = play(disturbed(Fault(2.0, kind, "", 1.0, float(commit)), jobs=jobs))
    assert not outcome.wrong, told(outcome)


# ------------------------------------------------------------------------------------------------ guests


def visited(*kinds: GuestKind, for_s: float = 1.0) -> Schedule:
    """Return a schedule of one job, to whose coordinator such guests come."""
    guests = tuple(GuestPlan(0.3 * number, f"guest{number}", kind, 4, for_s, 3) for number, kind in enumerate(kinds))
    return replace(disturbed(), guests=guests)


@pytest.mark.parametrize("kind", get_args(GuestKind))
def test_no_guest_costs_anybody_a_result_or_waits_for_ever(kind: GuestKind) -> None:
    outcome = play(visited(kind, kind))
    assert not outcome.wrong, told(outcome)


def test_a_result_that_goes_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A store without room deletes the jobs that have ended."""
    monkeypatch.setattr("tests.simulation.harness.participants.RETENTION", Retention(size_bytes=0))
    outcome = play(replace(visited("asks-everything"), is_hurried=True))
    assert any("job-0 is gone" in sentence for sentence in outcome.wrong), told(outcome)


def test_a_guest_without_an_answer_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def misled(self: Guest) -> Iterator[float]:
        self._cluster = "elsewhere"
        yield 0.1

    monkeypatch.setattr(Guest, "greet", misled)
    outcome = play(replace(visited("asks-everything"), jobs=(), horizon_s=0.1))
    assert any("got no answer" in sentence for sentence in outcome.wrong), told(outcome)


def test_what_breaks_is_found_although_it_ends_no_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: object) -> None:
        raise ZeroDivisionError("planted")

    monkeypatch.setattr("atoll_coordinator.service.monitoring.event_log.EventLog.flush", broken)
    assert "something broke in the coordinator" in play(disturbed()).wrong


# -------------------------------------------------------------------------------------- schedules, disk


def test_schedules_are_drawn_from_their_seeds_and_know_all_kinds() -> None:
    assert schedule_of(3) == schedule_of(3)
    schedules = [schedule_of(seed) for seed in range(400)]
    assert {fault.kind for schedule in schedules for fault in schedule.faults} == set(get_args(Kind))
    assert {guest.kind for schedule in schedules for guest in schedule.guests} == set(get_args(GuestKind))
    assert all(str(guest) in schedule.story() for schedule in schedules for guest in schedule.guests)
    assert {len(schedule.jobs) for schedule in schedules} == {1, 2, 3}
    for schedule in schedules:
        times = [fault.at_s for fault in schedule.faults]
        assert times == sorted(times)
        assert all(0.0 <= at_s < schedule.horizon_s for at_s in times)
        assert all(str(fault) in schedule.story() for fault in schedule.faults)
        assert len({job.seed for job in schedule.jobs}) == len(schedule.jobs)
        assert job_config(schedule.jobs[0].seed)[0].seed == schedule.jobs[0].seed


def test_a_disk_keeps_what_was_committed_and_counts_incarnations() -> None:
    disk, spent = Disk(), []
    store = disk.open(spent.append)
    disk.die_at(2, before=True)
    store.add_job(JobRecord("a", "", "{}", "", ""))
    with pytest.raises(CoordinatorDied):
        store.add_job(JobRecord("b", "", "{}", "", ""))
    store.is_dead = True
    with pytest.raises(CoordinatorDied):
        store.jobs()
    again = disk.open(spent.append)
    assert (again.cluster, again.incarnation) == (store.cluster, store.incarnation + 1)
    disk.die_at(1, before=False)
    disk.slow_s = 0.5
    with pytest.raises(CoordinatorDied):
        again.add_job(JobRecord("c", "", "{}", "", ""))
    assert [job.id for job in disk.open(spent.append).jobs()] == ["a", "c"]
    assert spent == [0.5, 0.5]
    disk.close()


@pytest.mark.parametrize("name", sorted(READS))
def test_what_reads_the_store_needs_no_room(name: str) -> None:
    """One wrongly among READS would hide that a full disk ends the coordinator."""
    connection = sqlite3.connect(":memory:", isolation_level=None)
    _prepare(connection, None)
    store = Store(connection, None, None)
    store.add_job(JobRecord("a", "", "{}", "", ""))
    writes = (sqlite3.SQLITE_INSERT, sqlite3.SQLITE_UPDATE, sqlite3.SQLITE_DELETE)
    connection.set_authorizer(lambda action, *_: sqlite3.SQLITE_DENY if action in writes else sqlite3.SQLITE_OK)
    known: dict[str, object] = {
        "job": "a",
        "digest": "",
        "prefix": "",
        "island": 0,
        "viewer": Viewer("ann"),
        "jobs": ("a",),
    }
    needed = [
        parameter.name
        for parameter in signature(getattr(store, name)).parameters.values()
        if parameter.default is parameter.empty
    ]
    with contextlib.suppress(KeyError):  # there is no such blob and no such state
        getattr(store, name)(**{argument: known.get(argument, 1) for argument in needed})
    connection.close()


# ------------------------------------------------------------------------------------- shrinking, tallies
