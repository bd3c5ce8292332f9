"""What a coordinator says when it starts."""

import errno
import ipaddress
import os
import socket
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from atoll.cli.main import main
from atoll.cli.verbs import serve
from atoll.cli.verbs.serve import greeting
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import NotNowError, StoreError, UnreachableError, UsageError, WrongStoreError
from atoll_core.wire.addresses import Address, Destination, destination
from atoll_core.wire.bus.zenoh_bus import ZenohBus, open_client, open_router
from atoll_core.wire.security.credentials import Credentials


def test_one_address_gives_the_line_that_starts_a_worker() -> None:
    lines = greeting(destination("tcp/10.0.0.5:7447"), "state").splitlines()
    assert "  island-worker --connect tcp/10.0.0.5:7447" in lines
    assert "  coordinator submit DATA --connect tcp/10.0.0.5:7447" in lines
    assert any(line.startswith("NOT ENCRYPTED") for line in lines)
    own = greeting(destination("tcp/127.0.0.1:7447"), "state")
    assert "ENCRYPTED" not in own


def test_every_address_heard_on_is_named_when_listening_everywhere(monkeypatch) -> None:
    monkeypatch.setattr(serve, "_interface_address", {"lo": "127.0.0.1", "a": "10.0.0.5", "b": None}.get)
    monkeypatch.setattr(serve.socket, "if_nameindex", lambda: [(1, "lo"), (2, "a"), (3, "b")])
    lines = greeting(destination("tcp/0.0.0.0:7447"), "state").splitlines()
    assert [line.split()[-1] for line in lines if "island-worker" in line] == [
        "tcp/10.0.0.5:7447",
        "tcp/127.0.0.1:7447",
    ]
    assert "trusted network" in lines[-2]


def test_a_state_that_cannot_be_a_folder_is_bad_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["serve", "--listen", "tcp/127.0.0.1:0", "--state", str(tmp_path / "file")]) == 2
    assert "choose another directory with --state" in capsys.readouterr().err


@pytest.mark.parametrize(("reason", "code"), [(errno.ENOSPC, 1), (errno.EMFILE, 1), (errno.EACCES, 2)])
def test_a_store_that_cannot_be_opened_now_is_no_bad_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], reason: int, code: int
) -> None:
    """Exit code 2 keeps a service of systemd down for good; a disk that was full once must not."""

    def refuses(*_: object, **__: object) -> None:
        raise OSError(reason, os.strerror(reason))

    with monkeypatch.context() as refused:
        refused.setattr(Path, "mkdir", refuses)
        assert main(["serve", "--listen", "tcp/127.0.0.1:0", "--state", str(tmp_path / "state")]) == code
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_an_address_that_is_in_use_is_no_bad_option(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert main(["serve", "--listen", f"tcp/127.0.0.1:{port}", "--state", str(tmp_path)]) == 1
        words = ["serve", "--listen", "tcp/127.0.0.1:0", "--state", str(tmp_path), "--metrics", f"127.0.0.1:{port}"]
        assert main(words) == 1


@pytest.mark.parametrize("service", ["atoll-coordinator", "atoll-web"])
def test_the_unit_of_systemd_stays_down_after_bad_options_alone(service: str) -> None:
    unit = (Path(__file__).parents[5] / "deploy" / "systemd" / f"{service}.service").read_text("utf-8")
    assert "Restart=on-failure\nRestartPreventExitStatus=2\n" in unit
    assert ("StateDirectoryMode=0700\n" in unit) == (service == "atoll-coordinator")
    assert {error.exit_code for error in (StoreError, NotNowError, UnreachableError)} == {1, 3}
    assert {error.exit_code for error in (UsageError, WrongStoreError)} == {2}


HOSTS = {
    "localhost": "127.0.0.1", "vm": "127.0.1.1", "six.example": "::1", "near.example": "10.0.0.5",
    "away.example": "203.0.113.1", "far6.example": "2001:db8::5",
}  # fmt: skip


def first_address(host: str, *_: object, **__: object) -> list[tuple[object, object, object, str, tuple[str, int]]]:
    """What the system says of a host's name, or of an address."""
    try:
        return [(0, 0, 0, "", (str(ipaddress.ip_address(host)), 0))]
    except ValueError:
        if host not in HOSTS:
            raise socket.gaierror(socket.EAI_NONAME, "not known") from None
        return [(0, 0, 0, "", (HOSTS[host], 0))]


def tls(host: str, named: Sequence[str]) -> Destination:
    return Destination(
        Address("tls", host, 7447), Credentials(Path("ca"), Path("b"), Path("c"), "lab", tuple(named))
    )  # fmt: skip


NAMED = ("lab.example", "localhost", "vm", "127.0.0.1", "::1", "10.0.0.5", "localhost", "127.0.0.1")


@pytest.mark.parametrize(
    ("host", "named", "printed"),
    [
        ("127.0.0.1", NAMED, ["localhost", "127.0.0.1"]),
        ("10.0.0.5", NAMED, ["10.0.0.5"]),
        ("10.0.0.5", ("near.example", "localhost", "lab.example"), ["near.example"]),
        ("10.0.0.5", ("away.example", "lab.example", "localhost", "::1"), ["away.example", "lab.example"]),
        ("0.0.0.0", NAMED, ["lab.example", "localhost", "vm", "127.0.0.1", "10.0.0.5"]),
        ("0.0.0.0", ("six.example", "localhost", "away.example"), ["localhost", "away.example"]),
        ("::", NAMED, ["lab.example", "localhost", "vm", "127.0.0.1", "10.0.0.5"]),
        ("::1", (*NAMED, "six.example"), ["six.example"]),
    ],
)
def test_each_address_is_printed_once_and_somebody_listens_there(monkeypatch, host, named, printed) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", first_address)
    lines = greeting(tls(host, named), "state").splitlines()
    started = [line.split()[-1] for line in lines if "island-worker" in line]
    assert started == [f"tls/{name}:7447" for name in printed]
    assert f"coordinator submit DATA --connect tls/{printed[0]}:7447" in "\n".join(lines)


@pytest.mark.parametrize("host", ["::1", "2001:db8::5", "::"])
@pytest.mark.parametrize("verb", ["serve", "router"])
def test_a_listener_that_nobody_could_dial_is_refused(tmp_path, monkeypatch, capsys, host, verb) -> None:
    """The bus dials no IPv6 address with a certificate, and on ::1 no name of the certificate leads to it."""
    named = ("::1", "2001:db8::5") if host != "::1" else NAMED
    monkeypatch.setattr(serve, "credentials_of", lambda *_: tls(host, named).credentials)
    monkeypatch.setattr(socket, "getaddrinfo", first_address)
    words = [verb, "--listen", f"tls/[{host}]:7447", *(["--state", str(tmp_path / "state")] if verb == "serve" else [])]
    assert main(words) == 2
    (sentence,) = capsys.readouterr().err.splitlines()
    assert f"tls/[{host}]:7447" in sentence
    assert "::1, " in sentence or ", ::1" in sentence
    assert "make-authority" in sentence
    assert not (tmp_path / "state").exists()


@pytest.fixture
def central() -> Iterator[ZenohBus]:
    with open_router("tcp/127.0.0.1:0") as bus:
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


def test_a_second_coordinator_behind_one_router_is_refused(
    central: ZenohBus, request: pytest.FixtureRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_client(central.endpoint, 5.0) as bus:
        serve.refuse_another(bus, central.endpoint)
        request.getfixturevalue("coordinator")
        with pytest.raises(UsageError, match="stop it first, or use another router"):
            serve.refuse_another(bus, central.endpoint)
    assert main(["serve", "--router", central.endpoint, "--state", str(tmp_path / "two"), "--wait", "1"]) == 1
    assert "behind the router" in capsys.readouterr().err


def test_a_coordinator_whose_router_is_not_there_says_so_after_the_wait(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["serve", "--router", "tcp/127.0.0.1:9", "--state", str(tmp_path), "--wait", "0.2"]) == 3
    assert "tcp/127.0.0.1:9 within 0.2 s" in capsys.readouterr().err


def test_a_router_starts_without_those_above_it_and_says_how_to_use_it() -> None:
    with open_router("tcp/127.0.0.1:0", serve.upstream_settings(["tcp/127.0.0.1:9"])) as bus:
        lines = serve.router_greeting(destination(bus.endpoint), ["tcp/127.0.0.1:9"]).splitlines()
        assert lines[0].endswith("passes on to tcp/127.0.0.1:9")
        assert f"  island-worker --connect {bus.endpoint}" in lines
        assert not any("serve" in line for line in lines), "the coordinator is at the central one"
    assert any(
        "serve --router tcp/10.0.0.1:1" in line
        for line in serve.router_greeting(destination("tcp/10.0.0.1:1"), []).splitlines()
    )
