"""What a worker is sent after a heartbeat, so that it holds what is placed on it and nothing else."""

from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest

from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.workers.reconciliation import Correction, corrections
from atoll_core.wire.messages.epochs import PullReports
from atoll_core.wire.messages.workers import (
    AssignmentStatus,
    Close,
    CloseJob,
    Placements,
    WorkerStatus,
)
from tests.unit.coordinator.service.workers import archipelagos

TERM = 2


archipelago = partial(archipelagos.archipelago, islands=2, term=TERM)


def job(made: Archipelago, state: str = "running") -> Job:
    is_open = state == "running" and made.cut is None
    fields = {"state": state, "archipelagos": {"x": made}, "open_archipelagos": (made,) if is_open else ()}
    return cast(Job, SimpleNamespace(**fields))


def answer(jobs: dict[str, Job], *statuses: AssignmentStatus, datasets: tuple[str, ...] = ()) -> list[Correction]:
    status = WorkerStatus(instance="i", incarnation=1, state="computing", progress=1, holdings=statuses, jobs=datasets)
    return corrections(jobs, jobs, "a", status)


def assignment_status(**changes: Any) -> AssignmentStatus:
    return AssignmentStatus(
        **{"job": "job", "variable": "x", "term": TERM, "islands": 2, "reported": 0, "commit": 0, **changes}
    )


def test_a_worker_that_holds_what_is_placed_on_it_is_sent_nothing() -> None:
    assert answer({"job": job(archipelago("a", "b"))}, assignment_status(), datasets=("job",)) == []


def test_a_missing_placement_is_sent_again() -> None:
    made = archipelago("a", "b")
    assert answer({"job": job(made)}) == [Placements(placements=(made.placement,))]
    assert answer({"job": job(archipelago("b", "b"))}) == []


def test_an_old_term_is_answered_with_the_placement_and_a_later_one_with_nothing() -> None:
    made = archipelago("b", "b")
    assert answer({"job": job(made)}, assignment_status(term=1)) == [Placements(placements=(made.placement,))]
    assert answer({"job": job(made)}, assignment_status(term=3)) == []


def test_what_is_placed_nowhere_may_be_held() -> None:
    assert answer({"job": job(archipelago())}, assignment_status()) == []


def test_what_was_cut_is_closed_under_the_term_that_is_held() -> None:
    made = archipelago("a", "a")
    made.collector.cut_now("cancelled")
    assert answer({"job": job(made)}, assignment_status()) == [Close(job="job", variable="x", term=TERM)]


@pytest.mark.parametrize("state", ["refining", "done", None])
def test_a_job_whose_search_has_ended_is_closed_with_its_dataset(state: str | None) -> None:
    jobs = {"job": job(archipelago("a", "a"), state)} if state is not None else {}
    assert answer(jobs, assignment_status(), datasets=("job",)) == [CloseJob(job="job")] * 2


@pytest.mark.parametrize("state", ["queued", "preparing"])
def test_a_job_that_is_prepared_again_keeps_its_dataset(state: str) -> None:
    assert answer({"job": job(archipelago(), state)}, assignment_status(), datasets=("job",)) == []


def test_lost_reports_are_pulled_and_a_lost_commit_is_sent_again() -> None:
    made = archipelago("a", "b")
    made.durable = 4
    pull, commit = answer({"job": job(made)}, assignment_status(reported=3))
    assert pull == PullReports(job="job", variable="x", term=TERM, first=0, last=3)
    assert commit == made.commit()
