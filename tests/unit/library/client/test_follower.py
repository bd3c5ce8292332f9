"""Following a job: what is shown, and when it ends."""

import pytest

from atoll.client.follower import PATIENCE_S, Follower, phase
from atoll_core.errors import UnreachableError
from atoll_core.wire.messages.clients import Following, JobChange
from atoll_core.wire.messages.views import JobView, VariableView, WorkerView, Workforce
from tests.views import job_view


def worker_of(**changes: object) -> WorkerView:
    view = WorkerView(worker="w0", host="h", pid=1, state="computing", islands=8, silent=0.0, version="0.1.0")
    return view.model_copy(update=changes)


class ScriptedClient:
    """Tells `views` one after the other, the last for ever; an exception is raised by the question."""

    def __init__(self, *views: JobView | Exception) -> None:
        self._views = list(views)
        self._now = 0.0
        self._told = 0
        self._last: JobView | None = None

    def follow(self, job: str, after: int | None, sequence: int) -> Following:
        view = self._views.pop(0) if len(self._views) > 1 else self._views[0]
        if isinstance(view, Exception):
            self._now += 10.0
            raise view
        return Following(lease_s=30.0, change=self._change(view, sequence))

    def next_change(self, limit_s: float) -> JobChange | None:
        self._now += limit_s
        view = self._views[0]
        if view is self._last or isinstance(view, Exception):
            return None
        self._views = self._views[1:] or self._views
        return self._change(view, self._told)

    def now(self) -> float:
        return self._now

    def _change(self, view: JobView, previous: int) -> JobChange:
        self._told, self._last = previous + 1, view
        workforce = Workforce.of([worker_of()])
        return JobChange(job="j1", sequence=self._told, previous=previous, view=view, workforce=workforce)


class Recorder:
    """A display that keeps what it was given."""

    def __init__(self) -> None:
        self.states: list[str] = []
        self.sentences: list[str] = []
        self.elapsed: list[float] = []

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None: ...

    def show(self, view: JobView, workers: Workforce, now: float) -> None:
        self.states.append(view.state)
        self.elapsed.append(view.elapsed)

    def print_note(self, sentence: str) -> None:
        self.sentences.append(sentence)


def follow(*views: JobView | Exception) -> tuple[JobView, Recorder]:
    display = Recorder()
    follower = Follower(ScriptedClient(*views), "j1", display)  # type: ignore[arg-type]
    return follower.follow(), display


def test_a_job_is_shown_until_it_ends() -> None:
    view, display = follow(job_view(state="queued"), job_view(), job_view(state="done"))
    assert view.state == "done"
    assert display.states == ["queued", "running", "done"]


def test_a_long_silence_is_an_error_that_says_the_job_may_go_on() -> None:
    with pytest.raises(UnreachableError, match="coordinator status j1"):
        follow(UnreachableError("silent"))
    assert PATIENCE_S > 0


def test_what_the_check_returns_is_printed_and_what_it_raises_ends_the_following() -> None:
    display = Recorder()
    sayings = [["worker w1 ended"], []]

    def check() -> list[str]:
        if not sayings:
            raise RuntimeError("gone")
        return sayings.pop(0)

    with pytest.raises(RuntimeError, match="gone"):
        Follower(ScriptedClient(job_view()), "j1", display, check).follow()  # type: ignore[arg-type]
    assert display.sentences == ["worker w1 ended"]


def test_time_is_counted_for_the_phase_that_was_seen() -> None:
    views = (job_view(), job_view(state="refining"), job_view(variables=FOUND), job_view(state="done", variables=FOUND))
    follower = Follower(ScriptedClient(*views), "j1", Recorder())  # type: ignore[arg-type]
    follower.follow()
    assert follower.phases.keys() == {"searching", "refining"}
    assert follower.phases["refining"] == pytest.approx(0.3)
    assert follower.phases["searching"] > follower.phases["refining"]


def test_time_passes_on_the_display_also_while_nothing_changes() -> None:
    display = Recorder()

    def check() -> list[str]:
        if len(display.states) == 4:
            raise RuntimeError("enough")
        return []

    with pytest.raises(RuntimeError, match="enough"):
        Follower(ScriptedClient(job_view(elapsed=1.0)), "j1", display, check).follow()  # type: ignore[arg-type]
    assert display.elapsed == pytest.approx([1.0, 1.3, 1.6, 1.9])


READY: dict[str, object] = {"state": "ready"}
LOADING: dict[str, object] = {"state": "compiling", "detail": "loading kernels"}
COMPILING: dict[str, object] = {"state": "compiling", "detail": "compiling kernels, first time on this machine"}
FOUND = (VariableView(variable="x", lhs="dx/dt", epoch=1),)


@pytest.mark.parametrize(
    ("changes", "workers", "name"),
    [
        ({"state": "queued"}, [], "starting"),
        ({"state": "preparing"}, [LOADING], "loading kernels"),
        ({"state": "running"}, [LOADING, COMPILING], "compiling kernels"),
        ({"state": "preparing"}, [READY], "preparing"),
        ({"state": "running"}, [READY, READY], "searching"),
        ({"state": "running", "variables": FOUND}, [READY, LOADING], "searching"),
        ({"state": "refining", "variables": FOUND}, [READY], "refining"),
    ],
)
def test_time_goes_into_phases(changes: dict[str, object], workers: list[dict[str, object]], name: str) -> None:
    assert phase(job_view(**changes), Workforce.of([worker_of(**worker) for worker in workers])) == name
