"""The verbs about jobs, on a client that knows three jobs and three workers."""

import json
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from atoll.cli.main import main
from atoll.cli.verbs import jobs as verbs
from atoll_core.errors import RefusedError
from atoll_core.wire.addresses import Destination
from atoll_core.wire.messages.clients import Following, JobChange
from atoll_core.wire.messages.views import JobView, VariableView, WorkerView, Workforce
from tests.views import VARIABLE, job_view


def job(name: str, state: str) -> JobView:
    progress = {"epoch": 2, "normalized_error": 0.1, "complexity": 3, "expression": "2.0*x"}
    variables = (VARIABLE.model_copy(update=progress),)
    return job_view(
        job=name, name=f"{name}.csv", state=state, elapsed=61.0, point_evaluations=1000, variables=variables
    )


class FakeClient:
    """A coordinator's answers."""

    def __init__(self, *jobs: JobView) -> None:
        self._jobs = {view.job: view for view in jobs}

    def jobs(self, prefix: str = "", *, is_open: bool = False, last: int | None = None) -> tuple[JobView, ...]:
        ended = ("done", "failed", "cancelled")
        views = [view for name, view in self._jobs.items() if name.startswith(prefix)]
        return tuple([view for view in views if not (is_open and view.state in ended)][-(last or len(views)) :])

    def status(self, name: str) -> JobView:
        return self._jobs[name]

    def resolve(self, prefix: str) -> str:
        names = [name for name in self._jobs if name.startswith(prefix)]
        if len(names) != 1:
            raise RefusedError(f"no job {prefix!r}")
        return names[0]

    def workers(self) -> tuple[WorkerView, ...]:
        return tuple(
            WorkerView(worker=name, host="h", pid=7, state="computing", islands=8, silent=0.1, version="0.1.0")
            for name in ("lab-0", "lab-1", "den-0")
        )

    def delete(self, name: str) -> None:
        if self._jobs[name].state == "running":
            raise RefusedError(f"job {name} is running; cancel it")
        del self._jobs[name]

    def cancel_and_wait(self, name: str) -> JobView:
        view = self._jobs[name]
        ended = view.state in ("done", "failed", "cancelled")
        return view if ended else view.model_copy(update={"state": "cancelled"})


class EndingClient(FakeClient):
    """A coordinator whose only job has gone on each time it is asked for, and is done the third time."""

    def __init__(self) -> None:
        super().__init__(job("alpha", "running"))
        self.looks = 0
        self.clock = 0.0

    def follow(self, name: str, after: int | None, sequence: int) -> Following:
        self.looks += 1
        view = job_view(
            job=name, state="done" if self.looks >= 3 else "running", elapsed=1.0, point_evaluations=self.looks,
            target_error=1e-9, variables=(),
        )  # fmt: skip
        workforce = Workforce.of(self.workers())
        change = JobChange(job=name, sequence=self.looks, previous=sequence, view=view, workforce=workforce)
        return Following(lease_s=30.0, change=change)

    def now(self) -> float:
        return self.clock

    def next_change(self, limit_s: float) -> None:
        self.clock += limit_s


def connect(fake: FakeClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the verbs ask `fake`."""

    @contextmanager
    def connected(address: Destination, wait_s: float) -> Iterator[FakeClient]:
        assert str(address) == "tcp/there:7447"
        yield fake

    monkeypatch.setattr(verbs, "connected", connected)
    monkeypatch.setenv("ATOLL_CONNECT", "tcp/there:7447")


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> FakeClient:
    fake = FakeClient(job("alpha", "done"), job("beta", "running"), job("gamma", "failed"))
    connect(fake, monkeypatch)
    return fake


@pytest.mark.usefixtures("client")
class TestWithACoordinator:
    """What each verb prints."""

    def test_jobs_are_a_table(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["jobs"]) == 0
        lines = capsys.readouterr().out.splitlines()
        heads = "ID NAME STATE PRIORITY TIME WORKERS EPOCHS POINT-EVALS FOUND NOTE"
        assert " ".join(lines[0].split()) == heads
        assert [line.split()[0] for line in lines[1:]] == ["alpha", "beta", "gamma"]

    def test_jobs_may_be_filtered(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["jobs", "al", "--json"]) == 0
        assert [view["job"] for view in json.loads(capsys.readouterr().out)] == ["alpha"]

    def test_the_last_jobs_may_be_listed_alone(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["jobs", "--last", "2", "--json"]) == 0
        assert [view["job"] for view in json.loads(capsys.readouterr().out)] == ["beta", "gamma"]

    def test_status_shows_the_jobs_under_way(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["status"]) == 0
        text = capsys.readouterr().out
        assert text.startswith("job beta running, 1:01, 1 worker")
        assert "dx/dt  epoch 2  error 1.0e-01  size 3  2*x" in text
        assert "alpha" not in text

    def test_status_of_one_job_is_one_object(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["status", "gam", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["state"] == "failed"

    def test_cancel_ends_the_only_job_under_way(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["cancel"]) == 0
        assert "job beta is cancelled" in capsys.readouterr().out
        assert main(["cancel", "alpha"]) == 0
        assert "had ended already: done" in capsys.readouterr().out

    def test_delete_takes_a_job_that_has_ended(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["delete", "al"]) == 0
        assert capsys.readouterr().out == "job alpha is deleted\n"
        assert main(["delete", "gamma", "--json"]) == 0
        assert json.loads(capsys.readouterr().out) == {"deleted": "gamma"}
        assert main(["delete", "gamma"]) == 2
        assert main(["delete", "beta"]) == 2
        assert "job beta is running; cancel it" in capsys.readouterr().err


def test_a_followed_status_ends_with_the_exit_code_of_the_job(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    client = EndingClient()
    connect(client, monkeypatch)
    assert main(["status", "al", "--follow", "--json"]) == 0
    views = [json.loads(cell) for cell in capsys.readouterr().out.splitlines()]
    assert [view["state"] for view in views] == ["running", "running", "done"]
    client.looks = 0
    assert main(["status", "--follow"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0].startswith("job alpha running")
    assert out[-1].startswith("job alpha done")


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ((), "before it found any equation"),
        ((VariableView(variable="x", lhs="dx/dt", epoch=0),), "before it found any equation"),
        ((VariableView(variable="x", lhs="dx/dt", epoch=0, expression="x", why="known"),), "before it found any"),
        ((VariableView(variable="x", lhs="dx/dt", epoch=1, expression="x"),), "its best equations: coordinator result"),
    ],
)
def test_cancel_promises_equations_only_where_there_are_some(
    variables: tuple[VariableView, ...], said: str, client: FakeClient, capsys: pytest.CaptureFixture[str]
) -> None:
    client.__init__(job("one", "running").model_copy(update={"variables": variables}))  # type: ignore[misc]
    assert main(["cancel"]) == 0
    assert said in capsys.readouterr().out


def test_cancel_says_where_the_end_takes_longer_than_it_waits(
    client: FakeClient, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    client.__init__(job("one", "running"))  # type: ignore[misc]
    monkeypatch.setattr(client, "cancel_and_wait", client.status)
    assert main(["cancel"]) == 0
    assert "job one is being cancelled; its result is still composed" in capsys.readouterr().out


def test_cancel_without_a_name_refuses_to_choose(client: FakeClient, capsys: pytest.CaptureFixture[str]) -> None:
    client.__init__(job("one", "running"), job("two", "queued"))  # type: ignore[misc]
    assert main(["cancel"]) == 2
    assert "name one of those under way: one, two" in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["jobs", "status", "workers"])
def test_an_address_is_needed_and_checked(
    verb: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("ATOLL_CONNECT", raising=False)
    assert main([verb]) == 2
    assert "--connect" in capsys.readouterr().err
    assert main([verb, "--connect", "there:7447"]) == 2
    assert "tcp/HOST:PORT" in capsys.readouterr().err
