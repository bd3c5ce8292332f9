"""Jobs: the states of the table, and what is to be done when something happens."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.service.jobs.job import (
    CommitCuts,
    CommitResult,
    Job,
    JobAction,
    Prepared,
    Refine,
    commit_order_of,
    measure_of,
)
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig
from atoll_core.data.dataset import Dataset, Target
from atoll_core.errors import RemoteProtocolError
from atoll_core.search.pareto import FrontEntry
from atoll_core.wire.messages.epochs import Addition, EpochReport, IslandReport, SliceCounters
from atoll_core.wire.messages.workers import Placement

VALUES = np.linspace(0.0, 1.0, 30)
DATASET = Dataset(
    ("x", "y"),
    np.stack([VALUES, VALUES]),
    tuple(Target(name, f"d{name}/dt", VALUES, 0.0, 0.3) for name in ("x", "y")),
    {"x": "x", "y": "y"},
)
BLOB = "a" * 64


def job_with(**budget: object) -> Job:
    config = JobConfig(evolution=EvolutionConfig(islands=2), budget=BudgetConfig(**budget))
    return Job(JobRecord("job", "name", config.model_dump_json(), BLOB, "2026-01-01"), config, 0.0)


def running(**budget: object) -> Job:
    job = job_with(**budget)
    job.start_preparing()
    job.start_clock(0.0)
    job.start(Prepared(Preparation(DATASET), job.config, BLOB, 100), {}, 0.0)
    for archipelago in job.archipelagos.values():
        archipelago.place(
            Placement(
                incarnation=1,
                term=2,
                job="job",
                variable=archipelago.variable,
                workers=("w0", "w1"),
                epochs=archipelago.collector.limits.epochs,
                interval=16,
                commit_order=commit_order_of(job.config),
            ),
            0.0,
        )
    job.start_search(0.0)
    return job


def report(island: int, epoch: int, variable: str = "x", term: int = 2, program: bytes | None = None) -> EpochReport:
    code = program if program is not None else bytes([1, 0]) + bytes(4)
    addition = Addition(complexity=1, error=0.5, mse=0.25, generation=1, program=code)
    archipelago = IslandReport(
        island=island,
        generations=100,
        hit=None,
        additions=(addition,),
        counters=tuple(SliceCounters(generation=end, evaluations={"offspring": 10}) for end in range(10, 101, 10)),
        best_error=0.5,
        digest=f"{epoch:032x}",
    )
    return EpochReport(job="job", variable=variable, term=term, epoch=epoch, islands=(archipelago,))


def test_a_job_runs_until_every_variable_is_cut() -> None:
    job = running(max_epochs=1)
    for variable in ("x", "y"):
        assert job.add_report("w0", report(0, 0, variable), 1.0) == []
        actions = job.add_report("w1", report(1, 0, variable), 2.0)
        assert isinstance(actions[0], CommitCuts)
        assert any(isinstance(action, Refine) for action in actions) == (variable == "y")
    assert job.state == "refining"
    job.validate()
    assert job.finish("{}") == [CommitResult()]
    assert job.state == "done"
    assert job.finish("{}") == []


def searched(job: Job, now: float) -> list[JobAction]:
    """Report the only epoch of a job that has one, all at `now`; return what follows."""
    actions: list[JobAction] = []
    for variable in ("x", "y"):
        for island in (0, 1):
            actions = job.add_report(f"w{island}", report(island, 0, variable), now)
    return actions


def test_preparing_counts_for_the_time_and_waiting_for_workers_does_not() -> None:
    job = job_with(max_time=20.0)
    job.start_preparing()
    job.start_clock(100.0)
    assert job.tick(119.9) == []
    job.start(Prepared(Preparation(DATASET), job.config, BLOB, 100), {}, 104.0)
    assert job.tick(1000.0) == []
    job.start_search(1000.0)
    assert (job.spent_seconds(1003.0), job.spent_seconds(1006.0)) == (7.0, 10.0)


def test_a_job_whose_time_ends_while_it_is_prepared_fails_and_says_why() -> None:
    job = job_with(max_time=2.0)
    job.start_preparing()
    job.start_clock(5.0)
    assert job.tick(7.0) == [CommitResult()]
    assert (job.state, job.fault) == ("failed", "data")
    assert "--max-time" in str(job.reason)


def test_refining_gets_what_is_left_of_the_time_and_is_ended_with_it() -> None:
    job = running(max_time=20.0, max_epochs=1)
    *_, last = searched(job, 4.0)
    assert isinstance(last, Refine)
    assert last.seconds == 16.0
    assert job.tick(19.9) == []
    assert job.tick(20.0) == [CommitResult()]
    assert (job.state, job.refinement.end, job.refinement.equations) == ("done", "not refined", {})
    assert "--max-time" in job.refinement.warnings[0]


def test_cancelling_keeps_what_was_found_and_happens_once() -> None:
    job = running()
    job.add_report("w0", report(0, 0), 1.0)
    job.add_report("w1", report(1, 0), 1.0)
    assert job.cancel() == [CommitResult()]
    cuts = [archipelago.cut for archipelago in job.archipelagos.values() if archipelago.cut is not None]
    assert [(cut.variable, cut.epochs, cut.why) for cut in cuts] == [("x", 1, "cancelled"), ("y", 0, "cancelled")]
    assert job.state == "cancelled"
    assert job.refinement.end == "not refined"
    assert "was cancelled before refining had ended" in job.refinement.warnings[0]
    assert job.cancel() == job.fail("internal", "too late") == []
    assert job.reason is None


@pytest.mark.parametrize(
    ("worker", "wrong"),
    [
        ("w1", report(0, 0)),
        ("stranger", report(0, 0)),
        ("w0", report(0, 0, term=3)),
        ("w0", report(0, 0, variable="z")),
        ("w0", report(0, 2000)),
        ("w0", report(0, 0, program=b"")),
        ("w0", report(0, 0, program=bytes([1, 0, 9, 0, 0, 0]))),
    ],
)
def test_reports_that_cannot_be_are_refused_and_change_nothing(worker: str, wrong: EpochReport) -> None:
    job = running()
    with pytest.raises(RemoteProtocolError):
        job.add_report(worker, wrong, 1.0)
    assert job.archipelagos["x"].collector.first_missing([0], 1) == 0


def test_the_time_of_what_has_ended_counts_after_a_restart() -> None:
    before = running(max_epochs=9, max_epochs_of={"y": 1})
    for island in (0, 1):
        before.add_report(f"w{island}", report(island, 0, "y"), 3.5)
    cut = before.archipelagos["y"].cut
    assert cut is not None
    job = job_with()
    job.start_preparing()
    job.start_clock(0.0)
    job.start(Prepared(Preparation(DATASET), job.config, BLOB, 100), {"y": cut}, 0.0)
    assert job.search_seconds(5.0) == 3.5


def test_a_noisy_target_s_search_goes_on_below_its_floor() -> None:
    """Many a wrong equation lies below the floor; that they get better is progress all the same."""
    fronts = [(FrontEntry(3, error, error * error, 0, 0, 0, bytes([1, 0, 0, 0, 0, 0])),) for error in (0.05, 0.01)]
    clean = Target("x", "dx/dt", VALUES, 9e-4, 300.0)
    noisy = replace(clean, noise=0.1)
    assert measure_of(clean, 30.0)(fronts[1]) == measure_of(clean, 30.0)(fronts[0])
    assert measure_of(noisy, 30.0)(fronts[1]) < measure_of(noisy, 30.0)(fronts[0]) - 1.0
    assert measure_of(noisy, 30.0)(()) == float("inf")


def test_what_is_gained_at_the_level_of_errors_that_go_together_is_no_progress() -> None:
    fronts = [(FrontEntry(3, error, error * error, 0, 0, 0, bytes([1, 0, 0, 0, 0, 0])),) for error in (0.05, 0.045)]
    target = Target("x", "dx/dt", VALUES, 0.0, 1.0)
    assert measure_of(target, 30.0)(fronts[1]) < measure_of(target, 30.0)(fronts[0]) - 1.0
    assert measure_of(target, 2.0)(fronts[1]) > measure_of(target, 2.0)(fronts[0]) - 1.0
