"""The verbs that change what waits and who computes: what they ask, and what they print."""

import json
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from atoll.cli.main import main
from atoll.cli.verbs import control as verbs
from atoll_core.errors import RefusedError
from atoll_core.wire.addresses import Destination
from atoll_core.wire.messages.views import CoordinatorView, Counters, JobView, StoreView, WorkerService, WorkerView
from tests.views import job_view


class FakeClient:
    """A coordinator with one job, `alpha`, and three workers."""

    def __init__(self) -> None:
        self.asked: list[tuple[object, ...]] = []

    def resolve(self, prefix: str) -> str:
        if not "alpha".startswith(prefix):
            raise RefusedError(f"the coordinator has no job {prefix!r}")
        return "alpha"

    def _job(self, *asked: object, **changes: object) -> JobView:
        self.asked.append(asked)
        return job_view(job="alpha", **changes)

    def pause_job(self, job: str, *, paused: bool = True) -> JobView:
        return self._job("pause", job, paused, paused=paused, reason="waits for its turn (it is next)")

    def set_priority(self, job: str, priority: int) -> JobView:
        return self._job("priority", job, priority, priority=priority)

    def share(self, job: str, *, shared: bool = True) -> JobView:
        return self._job("share", job, shared, shared=shared)

    def retry(self, job: str, again: str) -> JobView:
        return self._job("retry", job, again).model_copy(update={"job": again})

    def workers(self) -> tuple[WorkerView, ...]:
        return tuple(
            WorkerView(worker=name, host="h", pid=7, state="computing", islands=8, silent=0.1, version="0.1.0")
            for name in ("lab-0", "lab-1", "den-0")
        )

    def set_worker(self, worker: str, service: WorkerService) -> tuple[WorkerView, ...]:
        self.asked.append(("worker", worker, service))
        return tuple(view.model_copy(update={"service": service}) for view in self.workers())

    def coordinator(self) -> CoordinatorView:
        return CoordinatorView(
            version="0.1.0", incarnation=1, seconds=1.0, counters=Counters(), store=StoreView(), queued=5, under_way=4
        )

    def pause_queue(self, *, paused: bool = True) -> CoordinatorView:
        self.asked.append(("queue", paused))
        return self.coordinator().model_copy(update={"paused": paused})


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> FakeClient:
    fake = FakeClient()

    @contextmanager
    def connected(address: Destination, wait_s: float) -> Iterator[FakeClient]:
        yield fake

    monkeypatch.setattr(verbs, "connected", connected)
    monkeypatch.setenv("ATOLL_CONNECT", "tcp/there:7447")
    return fake


@pytest.mark.parametrize(
    ("words", "asked", "printed"),
    [
        (["pause", "al"], ("pause", "alpha", True), "job alpha is paused; go on with: coordinator resume alpha"),
        (["resume", "al"], ("pause", "alpha", False), "job alpha goes on: it waits for its turn (it is next)"),
        (["priority", "al", "-3"], ("priority", "alpha", -3), "job alpha has priority -3"),
        (["share", "al"], ("share", "alpha", True), "job alpha is shared with everybody"),
        (["share", "al", "--private"], ("share", "alpha", False), "job alpha is private"),
        (["retry", "al", "--id", "beta"], ("retry", "alpha", "beta"), "beta"),
        (["cordon", "den"], ("worker", "den-0", "cordoned"), "worker den-0 keeps the islands that it has"),
        (["uncordon", "lab-1"], ("worker", "lab-1", "open"), "worker lab-1 gets islands again"),
        (["drain", "gone"], ("worker", "gone", "draining"), "worker gone hands over its islands"),
        (["queue", "pause"], ("queue", True), "the queue is paused; jobs are taken up again after: coordinator queue"),
        (["queue", "resume"], ("queue", False), "the queue is open; 4 jobs are under way, 5 wait"),
    ],
)
def test_what_is_asked_and_printed(
    client: FakeClient, capsys: pytest.CaptureFixture[str], words: list[str], asked: tuple[object, ...], printed: str
) -> None:
    assert main(words) == 0
    assert client.asked == [asked]
    assert capsys.readouterr().out.startswith(printed)


def test_the_queue_is_shown_without_changing_it(client: FakeClient, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["queue", "--json"]) == 0
    assert client.asked == []
    assert json.loads(capsys.readouterr().out)["queued"] == 5


def test_json_has_the_job_or_the_worker(client: FakeClient, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["pause", "al", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["paused"] is True
    assert main(["cordon", "den", "--json"]) == 0
    assert [view["service"] for view in json.loads(capsys.readouterr().out)] == ["cordoned"]


@pytest.mark.usefixtures("client")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["cordon", "lab"], "which worker is meant? 2 begin with 'lab': lab-0, lab-1"),
        (["pause", "beta"], "the coordinator has no job 'beta'"),
        (["priority", "alpha", "11"], "expected a whole number from -10 to 10"),
        (["retry", "alpha", "--id", "a b"], "--id must be 1 to 64 letters"),
        (["queue", "stop"], "must be one of"),
    ],
)
def test_what_cannot_be_is_said(capsys: pytest.CaptureFixture[str], words: list[str], said: str) -> None:
    assert main(words) == 2
    assert said in capsys.readouterr().err
