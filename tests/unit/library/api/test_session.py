"""Local services are kept by their number of workers: none ends under a call that uses it."""

import os
import subprocess
import sys

import pytest

from atoll.api import session
from atoll.api.session import LocalService
from atoll_core.errors import AtollError, UnreachableError, UsageError


class Service:
    """Stands for a process with its workers."""

    def __init__(self, workers: int) -> None:
        self.endpoint = f"tcp/{workers}"
        self.is_alive = True
        self.reason = ""

    def close(self) -> None:
        self.is_alive = False


@pytest.fixture(autouse=True)
def services(monkeypatch: pytest.MonkeyPatch) -> dict[int, Service]:
    kept: dict[int, Service] = {}
    monkeypatch.setattr(session, "LocalService", Service)
    monkeypatch.setattr(session, "_services", kept)
    return kept


def test_another_number_of_workers_does_not_end_the_service_of_a_call(services: dict[int, Service]) -> None:
    assert session.local_address(1) == "tcp/1"
    assert session.local_address(2) == "tcp/2"
    assert session.local_address(None) == session.local_address(1) == "tcp/1"
    assert all(service.is_alive for service in services.values())
    running = [*services.values()]
    session.close()
    assert not any(service.is_alive for service in running)
    assert services == {}


def test_a_service_that_has_ended_is_told_and_replaced(services: dict[int, Service]) -> None:
    address = session.local_address(3)
    session.check_service(address)
    services[3].is_alive = False
    with pytest.raises(AtollError, match="has ended: it was killed; the next call"):
        session.check_service(address)
    services[3].reason = "a child was lost"
    with pytest.raises(AtollError, match="has ended: a child was lost"):
        session.check_service(address)
    assert session.local_address() == f"tcp/{session.usable_cores(os.environ)[0]}"
    session.check_service(address)


@pytest.mark.parametrize("workers", [0, -1, 1.5, "a", 100_000])
def test_a_number_of_workers_that_cannot_be_is_refused(workers: object, services: dict[int, Service]) -> None:
    with pytest.raises(UsageError, match="whole number"):
        session.local_address(workers)  # type: ignore[arg-type]
    assert not services


def test_a_service_that_says_half_a_line_is_given_up_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "_START_LIMIT_S", 0.2)
    words = [sys.executable, "-c", "import os, time; os.write(1, b'x'); time.sleep(60)"]
    service = object.__new__(LocalService)
    with subprocess.Popen(words, stdout=subprocess.PIPE) as child:
        service._process = child
        with pytest.raises(UnreachableError, match="did not start within"):
            service._heard()
    assert child.returncode != 0
