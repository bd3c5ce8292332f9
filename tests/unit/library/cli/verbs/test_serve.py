"""What a coordinator says when it starts."""

from argparse import Namespace
from pathlib import Path

import pytest

from atoll.cli import listener
from atoll.cli.listener import heard_on, own_address_of
from atoll.cli.verbs import serve
from atoll.cli.verbs.serve import greeting
from atoll_core.errors import UsageError
from atoll_core.wire.addresses import Address, Destination, destination
from atoll_core.wire.security.credentials import Credentials


def test_one_address_gives_the_line_that_starts_a_worker() -> None:
    lines = greeting(destination("tcp/10.0.0.5:7447"), "state").splitlines()
    assert "  island-worker --connect tcp/10.0.0.5:7447" in lines
    assert "  coordinator submit DATA --connect tcp/10.0.0.5:7447" in lines
    assert any(line.startswith("NOT ENCRYPTED") for line in lines)
    own = greeting(destination("tcp/127.0.0.1:7447"), "state")
    assert "ENCRYPTED" not in own


def test_every_address_heard_on_is_named_when_listening_everywhere(monkeypatch) -> None:
    monkeypatch.setattr(listener, "_interface_address", {"lo": "127.0.0.1", "a": "10.0.0.5", "b": None}.get)
    monkeypatch.setattr(listener.socket, "if_nameindex", lambda: [(1, "lo"), (2, "a"), (3, "b")])
    lines = greeting(destination("tcp/0.0.0.0:7447"), "state").splitlines()
    assert [line.split()[-1] for line in lines if "island-worker" in line] == [
        "tcp/10.0.0.5:7447",
        "tcp/127.0.0.1:7447",
    ]
    assert "trusted network" in lines[-2]


def test_this_machine_hears_on_its_own_address() -> None:
    assert "127.0.0.1" in heard_on("0.0.0.0")


def test_a_state_that_cannot_be_a_folder_is_bad_usage(tmp_path: Path) -> None:
    place = tmp_path / "file"
    place.write_text("")
    options = Namespace(
        http=None,
        http_users=None,
        metrics=None,
        listen="tcp/127.0.0.1:0",
        router=None,
        state=str(place),
        roster=None,
        limits=None,
        log_format="text",
        log_level="info",
        standby=False,
    )
    with pytest.raises(UsageError, match="choose another directory with --state"):
        serve.serve(options)


@pytest.mark.parametrize(
    ("host", "named", "dialled"),
    [
        ("127.0.0.1", ("lab.example", "127.0.0.1"), "127.0.0.1"),
        ("0.0.0.0", ("lab.example", "localhost"), "localhost"),
        ("0.0.0.0", ("lab.example",), "lab.example"),
        ("10.0.0.5", ("lab.example", "10.0.0.5"), "10.0.0.5"),
        ("::1", ("lab.example", "::1"), "[::1]"),
        ("0.0.0.0", None, "127.0.0.1"),
        ("10.0.0.5", None, "10.0.0.5"),
    ],
)
def test_the_page_dials_where_its_coordinator_listens(host, named, dialled) -> None:
    """The first name in a certificate may lead elsewhere, or nowhere from here."""
    protocol = "tcp" if named is None else "tls"
    credentials = None if named is None else Credentials(Path("a"), Path("b"), Path("c"), "lab", named)
    at = Destination(Address(protocol, host, 7447), credentials)
    assert own_address_of(at) == f"{protocol}/{dialled}:7447"
