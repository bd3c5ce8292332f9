"""``coordinator ping``: 0 when the loop of a coordinator answers, 3 when it does not, within the time given."""

import json
import threading
from pathlib import Path

import pytest

from atoll.cli.main import main
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.store import Store
from atoll_core import VERSION
from atoll_core.wire.bus.zenoh_bus import open_router


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


def test_nobody_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ping", "--connect", "tcp/127.0.0.1:9", "--wait", "0.1"]) == 3
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "within 0.1 s" in said
