"""Addresses over HTTP, and what a client says of what it meets there."""

import http.server
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from atoll.client.client import connected
from atoll.client.over_http import WebAddress, coordinator_at
from atoll_core.errors import RefusedError, UnreachableError, UsageError
from atoll_core.wire.addresses import Destination


def test_addresses_are_told_apart_and_tokens_are_taken_from_them_or_the_environment() -> None:
    assert isinstance(coordinator_at("tcp/localhost:7447", {}, {}), Destination)
    web = coordinator_at("https://lab.example:7480/atoll/?token=abc", {"tls_ca": "ca.pem"}, {"ATOLL_WEB_TOKEN": "x"})
    assert web == WebAddress("https://lab.example:7480/atoll", "abc", Path("ca.pem"))
    assert str(web) == "https://lab.example:7480/atoll"  # messages never show a token
    assert coordinator_at("http://h", {}, {"ATOLL_WEB_TOKEN": "x"}) == WebAddress("http://h", "x")


@pytest.mark.parametrize("text", ["http://h:7480/", "https://?token=a", "http://:7480/?token=a"])
def test_what_lacks_a_host_or_a_token_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match=r"has no (host|token)"):
        coordinator_at(text, {}, {})


class Other(http.server.BaseHTTPRequestHandler):
    """Some web server, which is none of ours."""

    status = 200

    def do_POST(self) -> None:
        self.send_response(self.status)
        self.send_header("Content-Length", "2")
        self.end_headers()
        self.wfile.write(b"hi")

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture
def other() -> Iterator[str]:
    server = http.server.HTTPServer(("127.0.0.1", 0), Other)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.mark.parametrize(
    ("status", "error", "said"),
    [
        (200, UnreachableError, "did not answer"),
        (404, RefusedError, "answered 404"),
        (502, UnreachableError, "answered 502"),
    ],
)
def test_a_web_server_that_is_none_of_ours_is_said_to_be_so(monkeypatch, other, status, error, said) -> None:
    monkeypatch.setattr(Other, "status", status)
    with pytest.raises(error, match=said), connected(WebAddress(other, "t"), 0.3):
        pass


def test_where_nothing_listens_it_is_said_at_once() -> None:
    with (
        pytest.raises(UnreachableError, match="nothing answers at"),
        connected(WebAddress("http://127.0.0.1:9", "t"), 0.3),
    ):
        pass
