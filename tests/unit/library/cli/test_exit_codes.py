"""What the end of a job means for people and for a shell."""

import pytest

from atoll.cli.exit_codes import ending
from atoll_core.wire.messages.views import VariableView
from tests.views import job_view


def finished(converged: bool) -> tuple[VariableView, ...]:
    return (VariableView(variable="x", lhs="dx/dt", epoch=3, converged=converged, finished=True),)


FOUND = (VariableView(variable="x", lhs="dx/dt", epoch=3, expression="2.0*x"),)


@pytest.mark.parametrize(
    ("changes", "target", "code", "words"),
    [
        ({"state": "done", "variables": finished(True)}, None, 0, None),
        ({"state": "done", "variables": finished(False)}, None, 0, None),
        ({"state": "done", "variables": finished(True)}, 1e-4, 0, None),
        ({"state": "done", "variables": finished(False)}, 1e-4, 4, "--target-error 0.0001 was not met"),
        ({"state": "failed", "reason": "two workers diverged", "fault": "diverged"}, None, 1, "two workers diverged"),
        ({"state": "failed", "reason": "column x is constant", "fault": "data"}, None, 2, "column x is constant"),
        ({"state": "cancelled"}, None, 130, "was cancelled, before it found any equation"),
        ({"state": "cancelled", "variables": FOUND}, None, 130, "was cancelled; what it had found is kept"),
    ],
)
def test_the_end_of_a_job_decides_the_exit_code(
    changes: dict[str, object], target: float | None, code: int, words: str | None
) -> None:
    found, sentence = ending(job_view(target_error=target, **changes))
    assert found == code
    assert (sentence is None) == (words is None)
    assert words is None or words in (sentence or "")


def test_a_known_equation_misses_no_target() -> None:
    known = VariableView(variable="y", lhs="dy/dt", epoch=0, finished=True, why="known", normalized_error=0.5)
    searched = VariableView(variable="x", lhs="dx/dt", epoch=1, finished=True, why="target", converged=True)
    missed = searched.model_copy(update={"converged": False, "why": "max-epochs"})
    assert ending(job_view(state="done", target_error=1e-6, variables=(known, searched))) == (0, None)
    sentence = "--target-error 1e-06 was not met within the budget by dx/dt"
    assert ending(job_view(state="done", target_error=1e-6, variables=(known, missed))) == (4, sentence)
