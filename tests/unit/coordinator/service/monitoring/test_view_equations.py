"""Equations of views are written in the background, one at a time, and only the last front of each variable."""

from typing import cast

import pytest

from atoll_coordinator.model.result.building import VariableOutcome
from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.monitoring.view_equations import FrontWritten, ViewEquations, ViewFront
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.tasks.preparing import Prepared
from atoll_core.config import JobConfig
from atoll_core.expression.operators import VARIABLE
from atoll_core.expression.program import Program
from atoll_core.search.pareto import FrontEntry

PREPARED = cast(Prepared, None)  # only the background thread uses it


def outcome(error: float, variable: str = "x") -> VariableOutcome:
    program = Program.of([(VARIABLE, 0, 0, 0.0)]).to_bytes()
    return VariableOutcome(variable, (FrontEntry(1, error, error, 0, 10, 0, program),), 1)


@pytest.fixture
def job() -> Job:
    return Job(JobRecord("job", "a job", "", "", ""), JobConfig(), 0.0)


def test_only_the_last_front_of_a_variable_is_written_and_one_at_a_time(job: Job) -> None:
    begun: list[ViewFront] = []
    shown = ViewEquations(begun.append)
    assert [shown.fields(job, PREPARED, outcome(error)) for error in (0.3, 0.2, 0.1)] == [{}, {}, {}]
    assert [front.outcome.front[0].error for front in begun] == [0.3]
    shown.add_written(FrontWritten(begun[0], {"expression": "first"}), job)
    assert [front.outcome.front[0].error for front in begun] == [0.3, 0.1]
    assert shown.fields(job, PREPARED, outcome(0.1)) == {"expression": "first"}
    shown.add_written(FrontWritten(begun[1], {"expression": "last"}), job)
    shown.add_written(FrontWritten(begun[1], {"expression": "last"}), job)
    assert shown.fields(job, PREPARED, outcome(0.1)) == {"expression": "last"}


def test_the_equation_that_is_shown_is_not_written_again_but_variables_have_their_own(job: Job) -> None:
    begun: list[ViewFront] = []
    shown = ViewEquations(begun.append)
    shown.fields(job, PREPARED, outcome(0.1))
    shown.add_written(FrontWritten(begun[0], {}, ValueError("planted")), job)
    assert shown.fields(job, PREPARED, outcome(0.1)) == {}
    assert len(begun) == 1
    shown.fields(job, PREPARED, outcome(0.1, "y"))
    assert begun[1].outcome.variable == "y"


def test_the_equation_of_a_job_that_has_ended_is_not_kept_and_the_next_one_is_written(job: Job) -> None:
    begun: list[ViewFront] = []
    shown = ViewEquations(begun.append)
    shown.fields(job, PREPARED, outcome(0.1))
    shown.fields(job, PREPARED, outcome(0.1, "y"))
    shown.add_written(FrontWritten(begun[0], {"expression": "late"}), None)
    assert len(begun) == 2
    assert shown.fields(job, PREPARED, outcome(0.1)) == {}


def test_nothing_is_written_before_there_is_a_front(job: Job) -> None:
    begun: list[ViewFront] = []
    assert ViewEquations(begun.append).fields(job, PREPARED, VariableOutcome("x", (), 0)) == {}
    assert begun == []


def test_the_front_that_is_being_written_is_not_requested_again(job: Job) -> None:
    begun: list[ViewFront] = []
    shown = ViewEquations(begun.append)
    for _ in range(2):
        shown.fields(job, PREPARED, outcome(0.1))
    shown.add_written(FrontWritten(begun[0], {"expression": "first"}), job)
    assert len(begun) == 1


def test_a_question_waits_for_the_fronts_of_its_job_and_not_for_later_ones(job: Job) -> None:
    begun: list[ViewFront] = []
    shown = ViewEquations(begun.append)
    assert shown.awaited({"job"}) is None
    shown.fields(job, PREPARED, outcome(0.1))
    shown.fields(job, PREPARED, outcome(0.1, "y"))
    number = shown.awaited({"job"})
    assert shown.awaited({"other"}) is None
    shown.fields(job, PREPARED, outcome(0.05))
    shown.fields(job, PREPARED, outcome(0.05, "y"))  # written in place of the earlier one
    while not begun or begun[-1].number != number:
        shown.add_written(FrontWritten(begun[-1], {}), job)
    assert [front.outcome.variable for front in begun] == ["x", "y"]
    assert begun[-1].outcome.front[0].error == 0.05
    shown.add_written(FrontWritten(begun[-1], {}), job)
    shown.add_written(FrontWritten(begun[-1], {}), job)
    assert shown.awaited({"job"}) is None
