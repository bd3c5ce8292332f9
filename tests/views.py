"""Views of jobs as a coordinator gives them, for tests that change what matters to them."""

from atoll_core.wire.messages.views import JobView, VariableView

VARIABLE = VariableView(variable="x", lhs="dx/dt", epoch=0)


def job_view(**changes: object) -> JobView:
    """Return the view of a job that one worker has just begun to search, with `changes`."""
    view = JobView(
        job="j1",
        name="n",
        state="running",
        seed=0,
        preset="default",
        submitted="2026-01-01T00:00:00Z",
        elapsed=0.0,
        workers=1,
        point_evaluations=0,
        variables=(VARIABLE,),
    )
    return view.model_copy(update=changes)
