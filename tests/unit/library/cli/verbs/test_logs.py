"""Events as lines and as JSON, once and until the job has ended."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from atoll.cli.main import main
from atoll.cli.verbs import logs as verb
from atoll.cli.verbs.logs import line
from atoll_core.wire.messages.clients import Following, JobChange
from atoll_core.wire.messages.views import EventView, JobView

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
        self.clock = 0.0
        self.asked: list[tuple[str | None, int, int]] = []

    def resolve(self, prefix: str) -> str:
        return "alpha"

    def events(
        self, job: str | None, after: int = 0, limit: int = 200, *, of_workers: bool = False
    ) -> tuple[EventView, ...]:  # fmt: skip
        self.asked.append((job, after, limit))
        asked = [event for event in self.log if event.number > after and (event.event == "log" or not of_workers)]
        return tuple(asked)[:limit]

    def follow(self, job: str, after: int | None, sequence: int) -> Following:
        self.looks += 1
        if self.looks == 3:
            self.log.append(DONE)
        events = tuple(event for event in self.log if event.number > (after or 0))
        change = JobChange(
            job=job,
            sequence=self.looks,
            previous=sequence,
            view=self._view(),
            events=events,
            last=events[-1].number if events else 0,
        )
        return Following(lease_s=30.0, change=change)

    def next_change(self, limit_s: float) -> None:
        self.clock += limit_s

    def now(self) -> float:
        return self.clock

    def _view(self) -> JobView:
        state: Any = "done" if self.looks >= 3 else "running"
        return JobView(
            job="alpha", name="n", state=state, seed=0, preset="default", submitted="", elapsed=1.0, workers=1,
            point_evaluations=self.looks, target_error=1e-9,
        )  # fmt: skip


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> FakeClient:
    fake = FakeClient()

    @contextmanager
    def connected(address: str, wait_s: float) -> Iterator[FakeClient]:
        yield fake

    monkeypatch.setattr(verb, "connected", connected)
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
    assert shown("--workers", "--level", "error") == ["nothing is noted of job alpha"]


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


@pytest.mark.parametrize(
    "words", [["submit", "x", "--priority", "11"], ["logs", "--lines", "0"], ["logs", "--lines", "x"]]
)
def test_numbers_out_of_range_are_refused_with_the_range(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    assert "expected a whole number from" in capsys.readouterr().err
