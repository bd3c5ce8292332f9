"""A file instead of an address: written by who listens, read by who shall connect."""

import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from atoll_core.errors import UnreachableError, UsageError
from atoll_core.wire.connect_file import address_in, announced


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


def test_without_a_file_nothing_is_written() -> None:
    with announced(None, ["tcp/one:1"]):
        pass


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
