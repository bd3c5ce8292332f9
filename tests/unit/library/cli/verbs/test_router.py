"""Routers that are not the coordinator's own: one in front of it, and one for each site, over real connections."""

import threading
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

import pytest

from atoll.cli.verbs import router, serve
from atoll.client.client import Client
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import UnreachableError, UsageError
from atoll_core.wire.addresses import destination
from atoll_core.wire.bus.zenoh_bus import ZenohBus, open_client, open_router

LOGS = {"log_format": "text", "log_level": "info", "standby": False}


@pytest.fixture
def central() -> Iterator[ZenohBus]:
    with open_router("tcp/127.0.0.1:0") as bus:
        yield bus


@pytest.fixture
def site(central: ZenohBus) -> Iterator[ZenohBus]:
    with open_router("tcp/127.0.0.1:0", router.upstream_settings([central.endpoint])) as bus:
        yield bus


@pytest.fixture
def coordinator(central: ZenohBus, tmp_path: Path) -> Iterator[str]:
    """A coordinator that joined the central router; its cluster."""
    stop = threading.Event()
    with Store.open(tmp_path) as store, open_client(central.endpoint, 5.0) as bus:
        service = Service(bus, store)
        service.start()
        loop = threading.Thread(target=service.work, args=(stop,))
        loop.start()
        try:
            yield store.cluster
        finally:
            stop.set()
            loop.join()


def test_a_client_of_a_site_reaches_the_coordinator_behind_the_central_router(site: ZenohBus, coordinator: str) -> None:
    with open_client(site.endpoint, 5.0) as bus:
        client = Client(bus, site.endpoint)
        assert client.greet() == coordinator
        assert client.jobs() == ()
        assert client.workers() == ()


def test_a_router_knows_whether_a_coordinator_is_behind_it(
    central: ZenohBus, site: ZenohBus, request: pytest.FixtureRequest
) -> None:
    assert router.coordinator_behind(central) is None
    cluster = request.getfixturevalue("coordinator")
    assert router.coordinator_behind(central) == cluster
    assert router.coordinator_behind(site) == cluster


def test_a_second_coordinator_behind_one_router_is_refused(
    central: ZenohBus, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    with open_client(central.endpoint, 5.0) as bus:
        serve.refuse_another(bus, central.endpoint)
        request.getfixturevalue("coordinator")
        with pytest.raises(UsageError, match="stop it first, or use another router"):
            serve.refuse_another(bus, central.endpoint)
    place = str(tmp_path / "two")
    options = Namespace(
        http=None,
        http_users=None,
        metrics=None,
        router=central.endpoint,
        listen=None,
        state=place,
        roster=None,
        limits=None,
        connect_file=None,
        wait=1.0,
        **LOGS,
    )
    with pytest.raises(UsageError, match="is there already behind the router"):
        serve.serve(options)


def test_a_coordinator_whose_router_is_not_there_says_so_after_the_wait(tmp_path: Path) -> None:
    options = Namespace(
        http=None,
        http_users=None,
        metrics=None,
        router="tcp/127.0.0.1:9",
        listen=None,
        state=str(tmp_path),
        roster=None,
        limits=None,
        connect_file=None,
        wait=0.2,
        **LOGS,
    )
    with pytest.raises(UnreachableError, match=r"tcp/127\.0\.0\.1:9 within 0\.2 s"):
        serve.serve(options)


def test_a_router_starts_without_those_above_it_and_says_how_to_use_it() -> None:
    with open_router("tcp/127.0.0.1:0", router.upstream_settings(["tcp/127.0.0.1:9"])) as bus:
        lines = router.greeting(destination(bus.endpoint), ["tcp/127.0.0.1:9"]).splitlines()
        assert lines[0].endswith("passes on to tcp/127.0.0.1:9")
        assert f"  island-worker --connect {bus.endpoint}" in lines
        assert not any("serve" in line for line in lines), "the coordinator is at the central one"
    assert any(
        "serve --router tcp/10.0.0.1:1" in line
        for line in router.greeting(destination("tcp/10.0.0.1:1"), []).splitlines()
    )
