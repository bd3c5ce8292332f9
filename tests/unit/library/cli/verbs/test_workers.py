"""Workers as a table and as JSON, all or some, and the counters of the coordinator itself."""

import json
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from atoll.cli.main import main
from atoll.cli.verbs import workers as verb
from atoll.cli.worker_table import coordinator_lines, size, trouble, worker_table
from atoll_core.wire.addresses import Destination
from atoll_core.wire.messages.views import CoordinatorView, Counters, StoreView, Traffic, WorkerView

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


class FakeClient:
    """A coordinator's answers."""

    def __init__(self) -> None:
        self.views = (WORKER,)

    def workers(self, prefix: str = "") -> tuple[WorkerView, ...]:
        return tuple(view for view in self.views if view.worker.startswith(prefix))

    def coordinator(self) -> CoordinatorView:
        return COORDINATOR


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> FakeClient:
    fake = FakeClient()

    @contextmanager
    def connected(address: Destination, wait_s: float) -> Iterator[FakeClient]:
        assert str(address) == "tcp/there:7447"
        yield fake

    monkeypatch.setattr(verb, "connected", connected)
    monkeypatch.setenv("ATOLL_CONNECT", "tcp/there:7447")
    return fake


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


def test_workers_may_be_filtered(client: FakeClient, capsys: pytest.CaptureFixture[str]) -> None:
    client.views = tuple(WORKER.model_copy(update={"worker": name}) for name in ("lab-0", "lab-1", "den-0"))
    assert main(["workers", "lab", "--json"]) == 0
    assert [view["worker"] for view in json.loads(capsys.readouterr().out)] == ["lab-0", "lab-1"]


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
