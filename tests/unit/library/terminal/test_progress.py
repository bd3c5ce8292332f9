"""What progress looks like, without and with a terminal."""

import io

import pytest

from atoll.terminal.progress import LiveDisplay, PlainDisplay, headline, plain_lines, standing
from atoll_core.wire.messages.views import JobView, TaskView, VariableView, WorkerView, Workforce
from tests.views import job_view

X = VariableView(
    variable="x",
    lhs="dx/dt",
    epoch=3,
    normalized_error=3.14e-14,
    complexity=10,
    expression="3.0000000000000004*x - x**2 - 2.0*x*y",
    point_evaluations=2_130_000,
    converged=True,
    finished=True,
    why="target",
)
Y = VariableView(variable="y", lhs="dy/dt", epoch=0)


def job(**changes: object) -> JobView:
    shown_view = {"job": "a1b2c3d4", "elapsed": 4.2, "workers": 2, "point_evaluations": 4_260_000, "variables": (X, Y)}
    return job_view(**shown_view, point_evaluations_per_second=5.5e7).model_copy(update=changes)


def worker(**changes: object) -> WorkerView:
    view = WorkerView(
        worker="w0", host="here", pid=1, state="computing", islands=8, silent=0.1, version="0.1.0", detail=""
    )
    return view.model_copy(update=changes)


HINT = "island-worker --connect tcp/here:7447"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "searching"),
        ({"finished": True, "why": "stagnation"}, "ended: stagnation"),
        ({"converged": True, "finished": True, "why": "target"}, "converged"),
        ({"converged": True, "finished": True, "why": "known"}, "known"),
        ({"converged": True, "finished": True, "why": "target", "verdict": "doubtful"}, "doubtful"),
    ],
)
def test_the_standing_of_an_equation_is_a_word_or_two(changes: dict[str, object], words: str) -> None:
    assert standing(X.model_copy(update={"converged": False, "finished": False, "why": None} | changes)) == words


def test_the_headline_says_how_many_candidates_refining_has_compared() -> None:
    tasks = (TaskView(function="refine", worker="w", compared=12_345),)
    assert "12,345 candidates compared" in headline(job(state="refining", tasks=tasks), Workforce.of([worker()]), HINT)


def test_the_headline_says_how_to_start_a_worker_when_there_is_none() -> None:
    view = job(state="queued", workers=0, point_evaluations=0, variables=())
    assert headline(view, Workforce.of([worker(state="lost")]), HINT).endswith(
        f"; no worker has joined; start one with: {HINT}"
    )


def test_the_plain_display_writes_on_changes_and_otherwise_only_now_and_then() -> None:
    written: list[str] = []
    display = PlainDisplay(HINT, written.append)
    for now in (0.0, 0.1, 4.9):
        display.show(job(), Workforce.of([worker()]), now)
    assert written == plain_lines(job(), Workforce.of([worker()]), HINT)
    assert len(written) == 2
    display.show(job(), Workforce.of([worker()]), 5.1)
    assert len(written) == 4
    display.show(job(state="done"), Workforce.of([worker()]), 5.2)
    assert len(written) == 6


@pytest.mark.parametrize(("no_color", "is_coloured"), [(None, True), ("", True), ("1", False)])
def test_colours_are_left_out_where_the_user_wants_none(
    no_color: str | None, is_coloured: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    screen = io.StringIO()
    screen.isatty = lambda: True  # type: ignore[method-assign]
    monkeypatch.setattr("sys.stderr", screen)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    if no_color is not None:
        monkeypatch.setenv("NO_COLOR", no_color)
    with LiveDisplay(HINT) as display:
        display.show(job(variables=(X,)), Workforce.of([worker()]), 0.0)
    assert ("\x1b[32m" in screen.getvalue()) == is_coloured
