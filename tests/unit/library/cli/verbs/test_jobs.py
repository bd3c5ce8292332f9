"""The verbs about jobs, on a client that knows three jobs and three workers."""

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from atoll.cli.main import main
from atoll.cli.verbs import jobs as verbs
from atoll.cli.verbs.jobs import coordinator_lines, line, worker_table
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.store import Store
from atoll_core import VERSION
from atoll_core.errors import RefusedError
from atoll_core.wire.addresses import Destination
from atoll_core.wire.bus.zenoh_bus import open_router
from atoll_core.wire.messages.clients import Following, JobChange
from atoll_core.wire.messages.views import (
    CoordinatorView,
    Counters,
    EventView,
    JobView,
    StoreView,
    Traffic,
    VariableView,
    WorkerService,
    WorkerView,
    Workforce,
)
from tests.views import VARIABLE, job_view


def test_a_coordinator_that_answers_is_told_from_one_whose_loop_does_not_turn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stop = threading.Event()
    with Store.open(tmp_path) as store, open_router("tcp/127.0.0.1:0") as bus:
        service = Service(bus, store)
        service.start()
        ask = ["ping", "--connect", bus.endpoint]
        assert main([*ask, "--wait", "0.5"]) == 3  # the port is open, and nobody takes in what comes
        said = capsys.readouterr().err
        assert (
            f"the coordinator at {bus.endpoint} did not answer within 0." in said
        )  # what the connection has left of it
        assert said.count("\n") == 1
        loop = threading.Thread(target=service.work, args=(stop,))
        loop.start()
        try:
            assert main([*ask, "--wait", "20"]) == 0
            assert capsys.readouterr().out.startswith(f"coordinator {VERSION} at {bus.endpoint} answers, in ")
            assert main([*ask, "--json"]) == 0
            assert json.loads(capsys.readouterr().out)["incarnation"] == 1
        finally:
            stop.set()
            loop.join()


PLACED = EventView(
    number=7, time="2026-01-01T10:11:12.123+00:00", event="placed", text="4 islands on w0", job="alpha", variable="x",
    term=2, details={"workers": 1},
)  # fmt: skip
DONE = EventView(number=9, time="2026-01-01T10:11:13.000+00:00", event="done", text="done", job="alpha")


TRAFFIC = (Traffic(kind="pull", messages_in=2, bytes_in=1500), Traffic(kind="report", messages_out=1, bytes_out=20))
COUNTERS = Counters(traffic=TRAFFIC, memory_bytes=123_400_000, cpu_s=61.0, waited_s=1.5, refused=2, duplicates=1)
WORKER = WorkerView(
    worker="lab2", host="lab", pid=7, state="computing", islands=8, silent=0.1, version="0.1.0", counters=COUNTERS,
    doing="alpha/x island 3 epoch 17", standing=40.0,
)  # fmt: skip
COORDINATOR = CoordinatorView(
    version="0.1.0", incarnation=3, seconds=125.0, counters=COUNTERS, queued=5, under_way=4,
    store=StoreView(transactions=4, total_s=0.01, worst_s=0.005),
)  # fmt: skip


def job(name: str, state: str) -> JobView:
    progress = {"epoch": 2, "normalized_error": 0.1, "complexity": 3, "expression": "2.0*x"}
    variables = (VARIABLE.model_copy(update=progress),)
    return job_view(
        job=name, name=f"{name}.csv", state=state, elapsed=61.0, point_evaluations=1000, variables=variables
    )


class FakeClient:
    """A coordinator's answers about jobs, workers and events; each look at a followed job takes it further."""

    def __init__(self, *jobs: JobView) -> None:
        self._jobs = {view.job: view for view in jobs}
        self.asked: list[tuple[object, ...]] = []
        self.log = [PLACED]
        self.looks = 0
        self.clock = 0.0

    def jobs(self, prefix: str = "", *, is_open: bool = False, last: int | None = None) -> tuple[JobView, ...]:
        ended = ("done", "failed", "cancelled")
        views = [view for name, view in self._jobs.items() if name.startswith(prefix)]
        return tuple([view for view in views if not (is_open and view.state in ended)][-(last or len(views)) :])

    def status(self, name: str) -> JobView:
        return self._jobs[name]

    def resolve(self, prefix: str) -> str:
        names = [name for name in self._jobs if name.startswith(prefix)]
        if len(names) != 1:
            raise RefusedError(f"the coordinator has no job {prefix!r}")
        return names[0]

    def delete(self, name: str) -> None:
        if self._jobs[name].state == "running":
            raise RefusedError(f"job {name} is running; cancel it")
        del self._jobs[name]

    def cancel_and_wait(self, name: str) -> JobView:
        view = self._jobs[name]
        ended = view.state in ("done", "failed", "cancelled")
        return view if ended else view.model_copy(update={"state": "cancelled"})

    def _changed(self, *asked: object, **changes: object) -> JobView:
        self.asked.append(asked)
        return job_view(job="alpha", **changes)

    def pause_job(self, job: str, *, paused: bool = True) -> JobView:
        return self._changed("pause", job, paused, paused=paused, reason="waits for its turn (it is next)")

    def set_priority(self, job: str, priority: int) -> JobView:
        return self._changed("priority", job, priority, priority=priority)

    def share(self, job: str, *, shared: bool = True) -> JobView:
        return self._changed("share", job, shared, shared=shared)

    def retry(self, job: str, again: str) -> JobView:
        return self._changed("retry", job, again).model_copy(update={"job": again})

    def workers(self, prefix: str = "") -> tuple[WorkerView, ...]:
        views = (WORKER.model_copy(update={"worker": name}) for name in ("lab-0", "lab-1", "den-0"))
        return tuple(view for view in views if view.worker.startswith(prefix))

    def set_worker(self, worker: str, service: WorkerService) -> tuple[WorkerView, ...]:
        self.asked.append(("worker", worker, service))
        return tuple(view.model_copy(update={"service": service}) for view in self.workers())

    def coordinator(self) -> CoordinatorView:
        return COORDINATOR

    def pause_queue(self, *, paused: bool = True) -> CoordinatorView:
        self.asked.append(("queue", paused))
        return COORDINATOR.model_copy(update={"paused": paused})

    def events(
        self, job: str | None, after: int = 0, limit: int = 200, *, of_workers: bool = False
    ) -> tuple[EventView, ...]:  # fmt: skip
        self.asked.append((job, after, limit))
        asked = [event for event in self.log if event.number > after and (event.event == "log" or not of_workers)]
        return tuple(asked)[:limit]

    def follow(self, name: str, after: int | None, sequence: int) -> Following:
        """Say that the job goes on, and the third time that it is done."""
        self.looks += 1
        if self.looks == 3:
            self.log.append(DONE)
        events = tuple(event for event in self.log if event.number > (after or 0))
        view = job_view(
            job=name, state="done" if self.looks >= 3 else "running", elapsed=1.0, point_evaluations=self.looks,
            target_error=1e-9, variables=(),
        )  # fmt: skip
        change = JobChange(
            job=name, sequence=self.looks, previous=sequence, view=view, events=events,
            last=events[-1].number if events else 0, workforce=Workforce.of(self.workers()),
        )  # fmt: skip
        return Following(lease_s=30.0, change=change)

    def now(self) -> float:
        return self.clock

    def next_change(self, limit_s: float) -> None:
        self.clock += limit_s


@pytest.fixture
def connect(monkeypatch: pytest.MonkeyPatch) -> Callable[..., FakeClient]:
    """Have the verbs ask a coordinator of these jobs."""

    def asking(*jobs: JobView) -> FakeClient:
        fake = FakeClient(*jobs)

        @contextmanager
        def connected(address: Destination, wait_s: float) -> Iterator[FakeClient]:
            assert str(address) == "tcp/there:7447"
            yield fake

        monkeypatch.setattr(verbs, "connected", connected)
        monkeypatch.setenv("ATOLL_CONNECT", "tcp/there:7447")
        return fake

    return asking


@pytest.fixture
def client(connect: Callable[..., FakeClient]) -> FakeClient:
    return connect(job("alpha", "done"), job("beta", "running"), job("gamma", "failed"))


def test_a_followed_status_ends_with_the_exit_code_of_the_job(
    connect: Callable[..., FakeClient], capsys: pytest.CaptureFixture[str]
) -> None:
    client = connect(job("alpha", "running"))
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
    variables: tuple[VariableView, ...], said: str, connect: Callable[..., FakeClient],
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    connect(job("one", "running").model_copy(update={"variables": variables}))
    assert main(["cancel"]) == 0
    assert said in capsys.readouterr().out


def test_cancel_without_a_name_refuses_to_choose(
    connect: Callable[..., FakeClient], capsys: pytest.CaptureFixture[str]
) -> None:
    connect(job("one", "running"), job("two", "queued"))
    assert main(["cancel"]) == 2
    assert "one, two; name one" in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["jobs", "status", "workers"])
def test_an_address_is_needed_and_checked(
    verb: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("ATOLL_CONNECT", raising=False)
    assert main([verb]) == 2
    assert "--connect" in capsys.readouterr().err
    assert main([verb, "--connect", "there:7447"]) == 2
    assert "tcp/HOST:PORT" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "asked", "printed"),
    [
        (["pause", "al"], ("pause", "alpha", True), "job alpha is paused; continue it with: coordinator resume"),
        (["resume", "al"], ("pause", "alpha", False), "job alpha continues: it waits for its turn"),
        (["priority", "al", "-3"], ("priority", "alpha", -3), "job alpha has priority -3"),
        (["share", "al"], ("share", "alpha", True), "job alpha is visible to all users"),
        (["share", "al", "--private"], ("share", "alpha", False), "job alpha is private"),
        (["retry", "al", "--id", "beta"], ("retry", "alpha", "beta"), "beta"),
        (["cordon", "den"], ("worker", "den-0", "cordoned"), "worker den-0 keeps its islands"),
        (["uncordon", "lab-1"], ("worker", "lab-1", "open"), "worker lab-1 gets islands again"),
        (["drain", "gone"], ("worker", "gone", "draining"), "worker gone hands over its islands"),
        (["queue", "pause"], ("queue", True), "the queue is paused"),
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


@pytest.mark.usefixtures("client")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["cordon", "lab"], "lab-0, lab-1"),
        (["pause", "delta"], "the coordinator has no job 'delta'"),
        (["priority", "alpha", "11"], "expected a whole number from -10 to 10"),
        (["retry", "alpha", "--id", "a b"], "--id must be 1 to 64 letters"),
        (["queue", "stop"], "must be one of"),
    ],
)
def test_what_cannot_be_is_said(capsys: pytest.CaptureFixture[str], words: list[str], said: str) -> None:
    assert main(words) == 2
    assert said in capsys.readouterr().err


def test_an_event_is_one_line_with_where_it_happened() -> None:
    assert line(PLACED) == "2026-01-01 10:11:12.123  placed         4 islands on w0  [job=alpha variable=x term=2]"


def test_the_log_of_a_job_is_lines_or_a_list(client: FakeClient, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["logs", "al", "--lines", "5"]) == 0
    assert capsys.readouterr().out == line(PLACED) + "\n"
    assert client.asked == [("alpha", 0, 5)]
    assert main(["logs", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == [PLACED.model_dump(mode="json")]
    assert client.asked[-1] == (None, 0, 200)


def test_lines_of_workers_and_warnings_can_be_asked_for(client: FakeClient, capsys: pytest.CaptureFixture[str]) -> None:
    said = {"time": "2026-01-01T10:11:12.123+00:00", "event": "log", "job": "alpha", "worker": "w0"}
    for number, level in ((20, "info"), (21, "warning")):
        client.log.append(
            EventView.model_validate({**said, "number": number, "text": level, "details": {"level": level}})
        )
    stalled = EventView(number=22, time="2026-01-01T10:11:13.000+00:00", event="stalled", text="waits", job="alpha")
    client.log.append(stalled)

    def shown(*words: str) -> list[str]:
        assert main(["logs", "al", *words]) == 0
        out = capsys.readouterr().out
        return [row.split("  ")[-2].strip() if "  " in row else row for row in out.splitlines()]

    assert shown() == ["4 islands on w0", "info", "warning", "waits"]
    assert shown("--workers") == ["info", "warning"]
    assert shown("--level", "warning") == ["warning", "waits"]
    assert shown("--workers", "--level", "error") == ["no events of job alpha"]


def test_followed_logs_end_with_the_job_and_miss_nothing(
    client: FakeClient, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["logs", "al", "--follow"]) == 0
    assert capsys.readouterr().out.splitlines() == [line(PLACED), line(DONE)]
    client.looks, client.log = 0, []
    assert main(["logs", "al", "--follow", "--json"]) == 0
    assert [json.loads(cell)["event"] for cell in capsys.readouterr().out.splitlines()] == ["done"]


@pytest.mark.parametrize(
    "words", [["submit", "x", "--priority", "11"], ["logs", "--lines", "0"], ["logs", "--lines", "x"]]
)
def test_numbers_out_of_range_are_refused_with_the_range(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    assert "expected a whole number from" in capsys.readouterr().err


def test_workers_show_what_they_do_and_take(client: FakeClient, capsys: pytest.CaptureFixture[str]) -> None:
    del client
    heads, row = worker_table([WORKER]).splitlines()
    cells = dict(zip(heads.split(), [cell for cell in row.split("  ") if cell], strict=True))
    assert {name: cells[name].strip() for name in ("MEMORY", "CPU", "IN", "OUT", "WAITED", "TROUBLE", "DOING")} == {
        "MEMORY": "123 MB", "CPU": "1:01", "IN": "1.5 kB", "OUT": "20 B", "WAITED": "1.5 s",
        "TROUBLE": "2 refused, 1 twice", "DOING": "alpha/x island 3 epoch 17, 40 s without progress",
    }  # fmt: skip
    assert main(["workers", "--json"]) == 0
    view, *_ = json.loads(capsys.readouterr().out)
    assert view["counters"]["traffic"][0]["bytes_in"] == 1500


def test_the_coordinators_own_counters(client: FakeClient, capsys: pytest.CaptureFixture[str]) -> None:
    del client
    assert main(["workers", "--coordinator"]) == 0
    out = capsys.readouterr().out
    assert out == coordinator_lines(COORDINATOR) + "\n"
    assert "store: 4 transactions, 2.5 ms each, 5.0 ms at most" in out
    assert main(["workers", "--coordinator", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["store"]["transactions"] == 4


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
        assert "had already ended: done" in capsys.readouterr().out

    def test_delete_takes_a_job_that_has_ended(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["delete", "al"]) == 0
        assert capsys.readouterr().out == "job alpha is deleted\n"
        assert main(["delete", "gamma", "--json"]) == 0
        assert json.loads(capsys.readouterr().out) == {"deleted": "gamma"}
        assert main(["delete", "gamma"]) == 2
        assert main(["delete", "beta"]) == 2
        assert "job beta is running; cancel it" in capsys.readouterr().err
