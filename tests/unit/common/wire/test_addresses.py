"""Addresses as text, what answers there, and connect files."""

import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from atoll_core.errors import UnreachableError, UsageError
from atoll_core.wire.addresses import (
    Address,
    address_in,
    announced,
    bindable,
    destination,
    own_address,
    parse_address,
    why_unreachable,
)
from atoll_core.wire.security.credentials import Credentials


@pytest.mark.parametrize(
    "text",
    [
        "tcp/127.0.0.1:7447",
        "tls/host.example:1",
        "tcp/[::1]:0",
        "quic/localhost:65535",
        "tcp/0.0.0.0:7447",
        "unixsock-stream//tmp/mine/bus",
    ],
)
def test_an_address_is_read_and_written_back(text: str) -> None:
    assert str(parse_address(text)) == text


@pytest.mark.parametrize(
    "text",
    ["", "127.0.0.1:7447", "tcp/127.0.0.1", "tcp/:7447", "tcp/h:70000", "tcp/h:-1", "udp/h:1", "tcp/h:٣", "tcp/a b:1"],
)
def test_what_is_no_address_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(UsageError, match="tcp/HOST:PORT was expected"):
        parse_address(text)


@pytest.mark.parametrize("text", ["unixsock-stream/", "unixsock-stream//tmp/a?b", "unixsock-stream//" + 30 * "long"])
def test_what_is_no_socket_is_refused(text: str) -> None:
    with pytest.raises(
        UsageError, match=r"such as unixsock-stream//tmp/mine/bus|or a line break|longer than 103 bytes"
    ):
        parse_address(text)


@pytest.mark.parametrize("deep", ["", 20 * "deep/", "what?/"])
def test_only_this_user_reaches_its_own_address_and_nothing_is_left_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, deep: str
) -> None:
    (tmp_path / deep).mkdir(parents=True, exist_ok=True)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / deep))
    with own_address() as address:
        folder = Path(address.host).parent
        assert parse_address(str(address)) == bindable(address) == address
        assert folder.stat().st_mode & 0o077 == 0
        assert why_unreachable(address) == "no such file or directory"
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(address.host)
            server.listen()
            assert why_unreachable(address) is None
            with pytest.raises(UsageError, match="another program listens there"):
                bindable(address)
    assert not folder.exists()
    with pytest.raises(UsageError, match="not there or cannot be written"):
        bindable(address)


def test_port_zero_becomes_a_free_port() -> None:
    port = bindable(Address("tcp", "127.0.0.1", 0))
    assert port.port > 0
    assert bindable(port) == port


def test_a_port_in_use_is_refused_with_advice() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = Address("tcp", "127.0.0.1", taken.getsockname()[1])
        with pytest.raises(UsageError, match=r"in use .* choose another with --listen"):
            bindable(address)


def test_why_nothing_can_be_reached_is_said() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = Address("tcp", "127.0.0.1", server.getsockname()[1])
        assert why_unreachable(address) is None
    assert why_unreachable(address) == "connection refused"
    assert why_unreachable(Address("tcp", "no-such-host.invalid", 1)) == "the host 'no-such-host.invalid' is not known"


def test_several_addresses_of_one_service_stand_between_commas() -> None:
    there = destination("tcp/a:1, tcp/b:2,tcp/a:1")
    assert [str(address) for address in there.addresses] == ["tcp/a:1", "tcp/b:2"]
    assert str(there) == "tcp/a:1,tcp/b:2"
    assert destination(str(there)) == there
    assert destination("unixsock-stream//tmp/a,b/bus,tcp/c:1").addresses[0].host == "/tmp/a,b/bus"


@pytest.mark.parametrize("text", ["tcp/a:1,", "tcp/a:1,b:2", ",tcp/a:1", "tcp/a:1,tls/b:2"])
def test_each_of_several_addresses_must_be_one_of_the_same_kind(text: str) -> None:
    with pytest.raises(UsageError):
        destination(text)


FILES = Credentials(Path("ca"), Path("certificate"), Path("key"), "lab", ("localhost", "::1"))


@pytest.mark.parametrize("text", ["tls/[::1]:7447", "quic/[2001:db8::5]:7447", "tls/lab:7447,tls/[::1]:7447"])
def test_no_ipv6_address_is_dialled_with_certificates(text: str) -> None:
    """The bus would try for ever: it checks names and IPv4 addresses alone."""
    with pytest.raises(UsageError, match=r"cannot be dialled.* write tls/NAME:7447 with a NAME of its certificate"):
        destination(text, FILES)
    assert str(destination(text, FILES, listens=True)) == text


@pytest.mark.parametrize(
    ("text", "advice"),
    [
        ("tcp/lab:7447", "write tls/lab:7447, or leave out"),
        ("tcp/[::1]:7447", "write tls/NAME:7447 with a NAME of its certificate, or leave out"),
    ],
)
def test_how_an_address_is_written_with_certificates_can_be_dialled(text: str, advice: str) -> None:
    with pytest.raises(UsageError, match=advice):
        destination(text, FILES)


@pytest.fixture
def open_port() -> Iterator[str]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"tcp/127.0.0.1:{server.getsockname()[1]}"


def closed_port() -> str:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"tcp/127.0.0.1:{server.getsockname()[1]}"


def test_the_file_is_there_while_the_block_lasts_and_nothing_stays(tmp_path: Path, open_port: str) -> None:
    file = tmp_path / "address"
    with announced(file, [open_port]):
        assert file.read_text() == f"{open_port}\n"
        assert address_in(file, 0.0) == open_port
    assert list(tmp_path.iterdir()) == []


def test_the_file_of_a_successor_is_left_alone(tmp_path: Path) -> None:
    file = tmp_path / "address"
    with announced(file, ["tcp/one:1"]):
        file.write_text("tcp/two:2\n")
    assert file.read_text() == "tcp/two:2\n"


def test_a_folder_that_is_not_there_is_bad_usage(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="name another file with --connect-file"), announced(tmp_path / "no" / "a", []):
        pass


def test_the_first_address_that_accepts_connections_is_taken(tmp_path: Path, open_port: str) -> None:
    file = tmp_path / "address"
    file.write_text(f"{closed_port()}\n{open_port}\n")
    assert address_in(file, 0.0) == open_port


def test_a_file_that_comes_later_is_waited_for(tmp_path: Path, open_port: str) -> None:
    file = tmp_path / "address"
    later = threading.Timer(0.3, lambda: file.write_text(f"{open_port}\n"))
    later.start()
    try:
        assert address_in(file, 30.0) == open_port
    finally:
        later.join()


@pytest.mark.parametrize(
    ("contents", "reason"), [(None, "it does not exist"), ("", "it is empty"), ("stale", "connection refused")]
)
def test_whoever_waits_in_vain_is_told_for_what(tmp_path: Path, contents: str | None, reason: str) -> None:
    file = tmp_path / "address"
    if contents is not None:
        file.write_text(closed_port() if contents == "stale" else contents)
    with pytest.raises(UnreachableError, match=r"within 0\.3 s") as caught:
        address_in(file, 0.3)
    assert reason in str(caught.value)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize("contents", [b"hello\n", b"\xff\xfe", b"tcp/a:99999999\n"])
def test_a_file_that_holds_something_else_is_bad_usage(tmp_path: Path, contents: bytes) -> None:
    file = tmp_path / "address"
    file.write_bytes(contents)
    with pytest.raises(UsageError, match=str(file)):
        address_in(file, 5.0)
