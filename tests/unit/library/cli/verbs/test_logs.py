"""Events as lines and as JSON, once and until the job has ended; how workers and the coordinator are shown."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from atoll.cli.main import main
from atoll.cli.verbs import jobs as jobs_module
from atoll.cli.verbs.jobs import line
from atoll.cli.worker_table import coordinator_lines, size, trouble, worker_table
from atoll_core.wire.messages.views import CoordinatorView, Counters, EventView, JobView, StoreView, Traffic, WorkerView

PLACED = EventView(
    number=7, time="2026-01-01T10:11:12.123+00:00", event="placed", text="4 islands on w0", job="alpha", variable="x",
    term=2, details={"workers": 1},
)  # fmt: skip
DONE = EventView(number=9, time="2026-01-01T10:11:13.000+00:00", event="done", text="done", job="alpha")


class FakeClient:
    """A coordinator on which something more has happened each time it is asked."""

    def __init__(self) -> None:
        self.log = [PLACED]
        self.looks = 0
        self.asked: list[tuple[str | None, int, int]] = []

    def resolve(self, prefix: str) -> str:
        return "alpha"

    def events(self, job: str | None, after: int = 0, limit: int = 200) -> tuple[EventView, ...]:
        self.asked.append((job, after, limit))
        return tuple(event for event in self.log if event.number > after)[:limit]

    def status(self, job: str) -> JobView:
        self.looks += 1
        if self.looks == 3:
            self.log.append(DONE)
        state: Any = "done" if self.looks >= 3 else "running"
        return JobView(
            job="alpha", name="n", state=state, seed=0, preset="default", submitted="", elapsed=1.0, workers=1,
            point_evaluations=self.looks, target_error=1e-9,
        )  # fmt: skip

    def jobs(self, prefix: str = "", **_: object) -> tuple[JobView, ...]:
        return (JobView.model_validate({**self.status("alpha").model_dump(), "state": "running"}),)

    def workers(self) -> tuple[WorkerView, ...]:
        return (WORKER,)

    def coordinator(self) -> CoordinatorView:
        return COORDINATOR

    def now(self) -> float:
        return float(self.looks)

    def pause(self, seconds: float) -> None:
        assert seconds <= 1.0


TRAFFIC = (Traffic(kind="mail", messages_in=2, bytes_in=1500), Traffic(kind="report", messages_out=1, bytes_out=20))
COUNTERS = Counters(traffic=TRAFFIC, memory_bytes=123_400_000, cpu_s=61.0, waited_s=1.5, refused=2, duplicates=1)
WORKER = WorkerView(
    worker="lab2", host="lab", pid=7, state="computing", islands=8, silent=0.1, version="0.1.0", counters=COUNTERS,
    doing="alpha/x island 3 epoch 17", standing=40.0,
)  # fmt: skip
COORDINATOR = CoordinatorView(
    version="0.1.0", incarnation=3, seconds=125.0, counters=COUNTERS,
    store=StoreView(transactions=4, total_s=0.01, worst_s=0.005),
)  # fmt: skip


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> FakeClient:
    fake = FakeClient()

    @contextmanager
    def connected(address: str, wait_s: float) -> Iterator[FakeClient]:
        yield fake

    monkeypatch.setattr(jobs_module, "connected", connected)
    monkeypatch.setenv("ATOLL_CONNECT", "tcp/there:7447")
    return fake


def test_an_event_is_one_line_with_where_it_happened() -> None:
    assert line(PLACED) == "2026-01-01 10:11:12.123  placed         4 islands on w0  [job=alpha variable=x term=2]"


def test_the_log_of_a_job_is_lines_or_a_list(client: FakeClient, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["logs", "al", "--lines", "5"]) == 0
    assert capsys.readouterr().out == line(PLACED) + "\n"
    assert client.asked == [("alpha", 0, 5)]
    assert main(["logs", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == [PLACED.model_dump(mode="json")]
    assert client.asked[-1] == (None, 0, 200)


def test_an_empty_log_says_so(client: FakeClient, capsys: pytest.CaptureFixture[str]) -> None:
    client.log.clear()
    assert main(["logs", "al"]) == 0
    assert capsys.readouterr().out == "nothing is noted of job alpha\n"


def test_followed_logs_end_with_the_job_and_miss_nothing(
    client: FakeClient, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["logs", "al", "--follow"]) == 0
    assert capsys.readouterr().out.splitlines() == [line(PLACED), line(DONE)]
    client.looks, client.log = 0, []
    assert main(["logs", "al", "--follow", "--json"]) == 0
    assert [json.loads(cell)["event"] for cell in capsys.readouterr().out.splitlines()] == ["done"]


def test_a_followed_status_ends_with_the_exit_code_of_the_job(
    client: FakeClient, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["status", "al", "--follow", "--json"]) == 0
    views = [json.loads(cell) for cell in capsys.readouterr().out.splitlines()]
    assert [view["state"] for view in views] == ["running", "running", "done"]
    client.looks = 0
    assert main(["status", "--follow"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0].startswith("job alpha running")
    assert out[-1].startswith("job alpha done")


def test_workers_show_what_they_do_and_take(client: FakeClient, capsys: pytest.CaptureFixture[str]) -> None:
    del client
    heads, row = worker_table([WORKER]).splitlines()
    cells = dict(zip(heads.split(), [cell for cell in row.split("  ") if cell], strict=True))
    assert {name: cells[name].strip() for name in ("MEMORY", "CPU", "IN", "OUT", "WAITED", "TROUBLE", "DOING")} == {
        "MEMORY": "123 MB", "CPU": "1:01", "IN": "1.5 kB", "OUT": "20 B", "WAITED": "1.5 s",
        "TROUBLE": "2 refused, 1 twice", "DOING": "alpha/x island 3 epoch 17, 40 s without progress",
    }  # fmt: skip
    assert main(["workers", "--json"]) == 0
    (view,) = json.loads(capsys.readouterr().out)
    assert view["counters"]["traffic"][0]["bytes_in"] == 1500


def test_the_coordinators_own_counters(client: FakeClient, capsys: pytest.CaptureFixture[str]) -> None:
    del client
    assert main(["workers", "--coordinator"]) == 0
    out = capsys.readouterr().out
    assert out == coordinator_lines(COORDINATOR) + "\n"
    assert "store: 4 transactions, 2.5 ms each, 5.0 ms at most" in out
    assert main(["workers", "--coordinator", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["store"]["transactions"] == 4


def test_sizes_and_troubles_are_short() -> None:
    assert [size(count) for count in (0, 999, 1000, 999_600, 5_000_000_000)] == ["0 B", "999 B", "1 kB", "1 MB", "5 GB"]
    assert trouble(Counters()) == "-"


@pytest.mark.parametrize(
    "words", [["submit", "x", "--priority", "11"], ["logs", "--lines", "0"], ["logs", "--lines", "x"]]
)
def test_numbers_out_of_range_are_refused_with_the_range(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    assert "expected a whole number from" in capsys.readouterr().err
