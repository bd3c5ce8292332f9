"""Addresses are read strictly, and what is wrong with one is said in words."""

import socket

import pytest

from atoll.errors import UsageError
from atoll.wire.addresses import Address, bindable, parse_address, why_unreachable


@pytest.mark.parametrize(
    "text", ["tcp/127.0.0.1:7447", "tls/host.example:1", "tcp/[::1]:0", "quic/localhost:65535", "tcp/0.0.0.0:7447"]
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


def test_port_zero_becomes_a_free_port() -> None:
    found = bindable(Address("tcp", "127.0.0.1", 0))
    assert found.port > 0
    assert bindable(found) == found


def test_a_port_in_use_is_refused_with_advice() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = Address("tcp", "127.0.0.1", taken.getsockname()[1])
        with pytest.raises(UsageError, match=r"in use .* choose another with --listen"):
            bindable(address)


@pytest.mark.parametrize(("host", "reason"), [("192.0.2.1", "not this machine"), ("no-such-host.invalid", "not known")])
def test_a_host_that_is_not_this_machine_is_refused(host: str, reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        bindable(Address("tcp", host, 7447))


def test_why_nothing_can_be_reached_is_said() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = Address("tcp", "127.0.0.1", server.getsockname()[1])
        assert why_unreachable(address) is None
    assert why_unreachable(address) == "connection refused"
    assert why_unreachable(Address("tcp", "no-such-host.invalid", 1)) == "the host 'no-such-host.invalid' is not known"
