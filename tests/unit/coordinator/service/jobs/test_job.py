"""Jobs: the states of the table, and what is to be done when something happens."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.pools import Pool
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
from atoll_coordinator.service.monitoring.job_views import outcomes_of
from atoll_coordinator.service.search.checkpoints import StoredSearchState
from atoll_coordinator.service.search.collector import SearchState
from atoll_coordinator.service.search.ending import Cut, Stagnation
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.tasks.refining import Searched
from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig
from atoll_core.data.dataset import Dataset, Target
from atoll_core.errors import RemoteProtocolError
from atoll_core.search.pareto import FrontEntry
from atoll_core.wire.messages.epochs import Addition, EpochReport, IslandReport, SliceCounters
from atoll_core.wire.messages.workers import AssignmentStatus, Placement

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


def test_the_fronts_of_all_variables_are_refined_before_a_job_is_done() -> None:
    job = running(max_epochs=1)
    for variable in ("y", "x"):
        job.add_report("w0", report(0, 0, variable), 1.0)
        *_, last = job.add_report("w1", report(1, 0, variable), 2.0)
    assert isinstance(last, Refine)
    errors = {
        name: [entry.error for entry in pool.front]
        for name, pool in Searched("j", tuple(outcomes_of(job))).pools.items()
    }
    assert errors == {"x": [0.5], "y": [0.5]}


def test_time_cuts_every_variable() -> None:
    job = running(max_time=20.0)
    for variable in ("x", "y"):
        for island in (0, 1):
            job.add_report(f"w{island}", report(island, 0, variable), 1.0)
    assert job.tick(9.9) == []
    actions = job.tick(10.0)
    assert [type(action) for action in actions] == [CommitCuts, Refine]
    assert actions[1].seconds == 10.0  # type: ignore[union-attr]
    assert isinstance(actions[0], CommitCuts)
    assert [cut.variable for cut in actions[0].cuts] == ["x", "y"]
    assert job.state == "refining"


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


def test_loading_and_compiling_what_prepares_a_job_do_not_count_for_the_time() -> None:
    job = job_with(max_time=20.0)
    job.start_preparing()
    assert job.tick(1000.0) == []
    assert job.spent_seconds(1000.0) == 0.0
    assert job.start_clock(1000.0) == []
    assert job.spent_seconds(1003.0) == 3.0
    assert job.tick(1020.0) == [CommitResult()]


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


def test_under_a_new_term_old_epochs_count_once() -> None:
    job = running(stagnation=1000)
    for epoch in range(20):
        for island in (0, 1):
            job.add_report(f"w{island}", report(island, epoch), 1.0)
    archipelago = job.archipelagos["x"]
    assert archipelago.placement is not None
    archipelago.place(archipelago.placement.model_copy(update={"term": 3}), 5.0)
    commit = archipelago.commit()
    assert commit is not None
    assert (commit.term, commit.epoch, commit.reported) == (3, 0, 0)
    for island in (0, 1):
        assert job.add_report(f"w{island}", report(island, 0, term=3), 6.0) == []
    assert archipelago.collector.state.epochs == 20
    assert archipelago.collector.state.evaluations == {"offspring": 20}


def test_a_job_goes_on_from_its_checkpoints_and_from_the_time_it_had_taken() -> None:
    job = job_with()
    job.start_preparing()
    job.start_clock(0.0)
    kept = StoredSearchState.of(SearchState(epochs=24, evaluations={"offspring": 7}, improved_at=3), 12.5)
    assert job.start(Prepared(Preparation(DATASET), job.config, BLOB, 100), {}, 0.0, {"x": kept}) == []
    resumed, new = job.archipelagos["x"], job.archipelagos["y"]
    assert (resumed.durable, resumed.collector.state.epochs, resumed.collector.state.improved_at) == (24, 24, 3)
    assert (new.durable, new.collector.state.epochs) == (0, 0)
    assert job.search_seconds(5.0) == 12.5
    job.start_search(5.0)
    assert job.search_seconds(6.0) == 13.5


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


def test_reports_that_a_heartbeat_promises_and_that_did_not_come_are_pulled() -> None:
    job = running()
    job.add_report("w0", report(0, 0), 1.0)
    job.add_report("w0", report(0, 2), 1.0)
    assignment_status = AssignmentStatus(job="job", variable="x", term=2, islands=1, reported=3, commit=0)
    pull = job.archipelagos["x"].missing_reports("w0", assignment_status)
    assert pull is not None
    assert (pull.first, pull.last, pull.term) == (1, 3, 2)
    job.add_report("w0", report(0, 1), 1.0)
    assert job.archipelagos["x"].missing_reports("w0", assignment_status) is None


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


def test_the_number_of_runners_up_and_the_patience_are_those_of_the_configuration() -> None:
    job = job_with(stagnation=7)
    job.start_preparing()
    job.start_clock(0.0)
    config = job.config.model_copy(update={"evolution": job.config.evolution.model_copy(update={"runners_up": 3})})
    job.start(Prepared(Preparation(DATASET), config, BLOB, 100), {}, 0.0)
    limits = job.archipelagos["x"].collector.limits
    assert (limits.runners_up, limits.stagnation) == (3, Stagnation(7))


def test_runners_up_are_handed_on_beside_the_front() -> None:
    job = job_with()
    job.start_preparing()
    job.start_clock(0.0)
    best, next_best = (FrontEntry(1, error, error, 0, 5, 0, bytes([1, 0, 0, 0, 0, 0])) for error in (0.5, 0.6))
    cut = Cut(
        variable="x",
        epochs=3,
        generation=None,
        why="stagnation",
        front=(best,),
        runners_up=(next_best,),
        evaluations={},
        seconds=1.0,
    )
    cuts = {name: cut.model_copy(update={"variable": name}) for name in ("x", "y")}
    (refine,) = job.start(Prepared(Preparation(DATASET), job.config, BLOB, 100), cuts, 0.0)
    assert refine == Refine()
    assert Searched("j", tuple(outcomes_of(job))).pools == {name: Pool((best,), (next_best,)) for name in ("x", "y")}
