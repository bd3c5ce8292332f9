"""Requests that nobody sends by mistake, over a real connection: what they want is not done, and nothing breaks."""

import asyncio
import itertools
import logging
from urllib.parse import quote

import numpy as np
import pytest

from atoll.web.access import LOCAL_HOSTS, Access, digest_of
from atoll.web.description import describe
from atoll.web.server import build_application
from atoll_core.data.table import Table
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.clients import ClientRequest as Question
from atoll_core.wire.messages.clients import ListJobs
from tests.http import LOCAL as LOCAL_HOST
from tests.http import ask, ask_async
from tests.unit.library.web.made import READERS, TOKEN, Asked, AtHand, application
from tests.unit.library.web.test_connections import listening
from tests.views import job_view

KEY = b"authorization: Bearer " + TOKEN.encode()
LOCAL = b"host: localhost"


def sent(client: Asked, line: bytes, *headers: bytes, body: bytes = b"") -> tuple[int, bytes]:
    """Return status and all bytes that are answered to a request."""

    async def go() -> tuple[int, bytes]:
        async with listening(application(client)) as connect:
            reader, writer = await connect()
            close = [] if b"connection: keep-alive" in headers else [b"connection: close"]
            writer.write(b"\r\n".join([line + b" HTTP/1.1", *headers, *close, b"", body]))
            said = await reader.read()
            return int(said[9:12]), said

    return asyncio.run(go())


@pytest.fixture
def client() -> Asked:
    return Asked(job_view(job="b"))


def cancelled(client: Asked, *headers: bytes, line: bytes = b"POST /api/v1/jobs/b/cancel", body: bytes = b"") -> int:
    """Return the status where somebody tries to cancel a job; it must not be, unless it is answered by 200."""
    status = sent(client, line, *headers, body=body)[0]
    assert client.calls == ([("cancel", "b")] if status == 200 else [])
    return status


def test_what_is_tried_here_would_work(client) -> None:
    assert cancelled(client, LOCAL, KEY) == 200


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ([KEY], 400),
        ([LOCAL, LOCAL, KEY], 400),
        ([LOCAL, KEY, b"authorization: Bearer other"], 400),
        ([LOCAL, b"authorization: Bearer other", KEY], 400),
        ([LOCAL, KEY, b"sec-fetch-site: same-origin", b"sec-fetch-site: cross-site"], 400),
        ([LOCAL, KEY, b"content-length: 0", b"transfer-encoding: chunked"], 400),
        ([LOCAL, KEY, b"content-length: 0", b"content-length: 5"], 400),
        ([LOCAL, KEY, b"transfer-encoding: chunked, identity"], 400),
        ([LOCAL, KEY, b"transfer-encoding : chunked"], 400),
        ([LOCAL, KEY, b"x: a\rb"], 400),
        ([b"host: localhost.", KEY], 421),
        ([b"host: evil.example", b"x-forwarded-host: localhost", KEY], 421),
        ([b"host: localhost:80:90", KEY], 421),
        ([b"host: user@localhost", KEY], 421),
        ([b"host: [::1", KEY], 421),
        ([LOCAL, b"x-forwarded-for: 127.0.0.1"], 401),
        ([LOCAL, KEY, b"sec-fetch-site: cross-site", b"content-type: text/plain"], 403),
        ([LOCAL, KEY, b"sec-fetch-site: same-site"], 403),
        ([LOCAL, KEY, b"sec-fetch-site:"], 403),
        ([LOCAL, KEY, b"origin: null"], 403),
        ([LOCAL, KEY, b"origin: http://localhost.evil.example"], 403),
        ([LOCAL, b"cookie: token=" + TOKEN.encode()], 401),
    ],
)
def test_headers_that_lie_change_nothing(client, headers, status) -> None:
    assert cancelled(client, *headers) == status


@pytest.mark.parametrize(
    ("line", "status"),
    [
        (b"GET /api/v1/jobs/b/cancel", 405),
        (b"HEAD /api/v1/jobs/b/cancel", 405),
        (b"OPTIONS /api/v1/jobs/b/cancel", 405),
        (b"TRACE /api/v1/jobs/b/cancel", 405),
        (b"CONNECT localhost:80", 404),
        (b"POST http://localhost/api/v1/jobs/b/cancel", 404),
        (b"POST //api/v1/jobs/b/cancel", 404),
        (b"POST /api/v1/jobs/b/cancel/", 404),
        (b"POST /api/v1/jobs/b%0A/cancel", 404),
        (b"POST /api/v1/jobs/b%00/cancel", 404),
    ],
)
def test_paths_and_methods_that_are_none_change_nothing(client, line, status) -> None:
    override = (b"x-http-method-override: POST", b"x-http-method: POST", b"x-method-override: POST")
    assert cancelled(client, LOCAL, KEY, *override, line=line) == status


@pytest.mark.parametrize(
    "path",
    ["../api.py", "..%2fapi.py", "%2e%2e/api.py", "..%5capi.py", "%00", "a" * 5000, "/etc/passwd", "%2fetc%2fpasswd",
     "main.js/../../api.py", "....//api.py"],
)  # fmt: skip
def test_only_what_is_static_is_given(client, path) -> None:
    status, said = sent(client, b"GET /static/" + path.encode(), LOCAL)
    assert (status, b"import asyncio" in said, b"root:" in said) == (404, False, False)


def test_what_is_reflected_begins_no_header(client) -> None:
    evil = quote("a\r\nset-cookie: x=1\r\n\r\n<script>")
    for line in (f"GET /api/v1/jobs/b/exports/{evil}?download=true", f"GET /{evil}", f"GET /api/v1/{evil}/",
                 f"POST /api/v1/jobs/b/retry?id={evil}", f"GET /api/v1/jobs?state={evil}"):  # fmt: skip
        status, said = sent(client, line.encode(), LOCAL, KEY)
        head = said.partition(b"\r\n\r\n")[0].lower()
        assert (status < 500, b"set-cookie" in head, b"text/html" in head) == (True, False, False), line


def test_no_redirect_names_a_host_or_scheme_that_was_sent(client) -> None:
    forwarded = (b"x-forwarded-proto: gopher", b"x-forwarded-host: evil.example", b"x-forwarded-prefix: /evil")
    for path in (b"/static", b"/api/v1/jobs/", b"/api/v1"):
        status, said = sent(client, b"GET " + path, LOCAL, *forwarded)
        assert (status, b"location" in said.lower()) == (404, False), path


def test_a_second_request_in_a_body_is_no_request(client) -> None:
    """A proxy that believes in the length sees one request; one that believes in chunks sees two."""
    inner = b"POST /api/v1/jobs/b/cancel HTTP/1.1\r\n" + LOCAL + b"\r\n" + KEY + b"\r\n\r\n"
    body = b"0\r\n\r\n" + inner
    headers = (LOCAL, b"content-length: %d" % len(body), b"transfer-encoding: chunked", b"connection: keep-alive")
    status, said = sent(client, b"GET /api/v1/version", *headers, body=body)
    assert (status, said.count(b"HTTP/1.1 "), client.calls) == (400, 1, [])
    sent(client, b"GET /api/v1/version", LOCAL, b"content-length: %d" % len(inner), body=inner)
    assert client.calls == []


def test_no_token_is_logged(client, caplog) -> None:
    caplog.set_level(logging.DEBUG)
    for line in (b"GET /?token=", b"GET /api/v1/jobs?token=", b"GET /api/v1/none?token=", b"BAD\0 /?token="):
        sent(client, line + TOKEN.encode(), LOCAL)
    assert TOKEN not in caplog.text


def test_the_head_of_a_stream_ends(client) -> None:
    assert sent(client, b"HEAD /api/v1/events", LOCAL)[0] == 200


# ------------------------------------------------------------------------------------------------------- roles

OPERATIONS = [(method.upper(), path) for path, methods in describe()["paths"].items() for method in methods]
OPEN = ("/openapi.json", "/version", "/session", "/health")
BODIES = {"/jobs/{job}/priority": b'{"priority": 1}', "/jobs/{job}/sharing": b'{"shared": true}'}
"""What is needed for the coordinator to be asked at all."""


def asked(client: Asked, method: str, path: str, *headers: bytes, is_shown: bool = True) -> int:
    """Return the status of an operation on job b."""
    target = path.replace("{job}", "b").replace("{format}", "python").replace("{worker}", "w")
    body = BODIES.get(path, b"")

    async def go() -> int:
        async with listening(application(client, is_shown=is_shown)) as connect:
            reader, writer = await connect()
            length = b"content-length: %d" % len(body)
            line = f"{method} /api/v1{target} HTTP/1.1".encode()
            writer.write(b"\r\n".join([line, LOCAL, *headers, length, b"", body]))
            return int((await reader.readuntil(b"\r\n"))[9:12])

    return asyncio.run(go())


@pytest.mark.parametrize(("method", "path"), OPERATIONS)
def test_no_operation_does_without_a_token_what_it_may_not(method, path) -> None:
    client = Asked(job_view(job="b"))
    if method != "GET":
        assert asked(client, method, path) == 401
    assert asked(client, method, path, is_shown=False) == (200 if path in OPEN else 401)
    assert asked(client, method, path, KEY, b"sec-fetch-site: cross-site") == 403
    assert client.calls == []


FOUND = {
    "schema": 1, "job": "b", "state": "done", "symbols": {"x": "x"},
    "equations": [{"variable": "x", "lhs": "dx/dt", "expression": "-x"}],
}  # fmt: skip
OF_NO_JOB = {
    ("GET", "/coordinator"), ("GET", "/demo"), ("GET", "/events"), ("GET", "/health"), ("GET", "/jobs"),
    ("GET", "/metrics"), ("GET", "/openapi.json"), ("GET", "/options"), ("GET", "/session"), ("GET", "/version"),
    ("GET", "/logs"), ("GET", "/workers"), ("GET", "/jobs/{job}/exports"), ("PUT", "/coordinator/queue"),
    ("PUT", "/workers/{worker}/service"), ("POST", "/messages"),
}  # fmt: skip
"""What says nothing of a job, or only of those that the coordinator names to whoever asks: tested beside it."""


def test_a_job_of_somebody_else_is_unknown_in_every_operation_also_after_its_owner_has_looked() -> None:
    ann, bob = Asked(job_view(job="b", state="done")), Asked()
    rows = np.arange(30)
    table = Table(
        ("t", "x"), ("", ""), np.array([rows, 0.9**rows], dtype=np.float64), (0,), ("d.csv",), rows * 0, rows + 2
    )
    ann.contents, ann.tables = FOUND, {"b": table.to_bytes()}
    gateways = {digest_of(name * 16): AtHand(client) for name, client in (("a", ann), ("b", bob))}
    app = build_application(Access(gateways, None, LOCAL_HOSTS), READERS)  # type: ignore[arg-type]
    seen: dict[str, dict[tuple[str, str], int]] = {"a": {}, "b": {}}

    async def go() -> None:
        for (method, path), user in itertools.product(OPERATIONS, "ab"):
            if (method, path) in OF_NO_JOB or (user == "a" and method not in ("GET", "POST")):
                continue
            query = {} if "{job}" in path else {"of": "b"}
            headers = LOCAL_HOST | {"authorization": f"Bearer {user * 16}"}
            target = "/api/v1" + path.replace("{job}", "b").replace("{format}", "python")
            answered = await ask_async(app, method, target, [BODIES.get(path, b"")], query, headers)
            seen[user][method, path] = answered.status

    asyncio.run(go())
    assert {*seen["b"].values()} == {404}, seen["b"]
    assert [status for (method, _), status in seen["a"].items() if method == "GET"].count(200) > 4
    assert seen["a"]["POST", "/outline"] == 200


def test_who_has_looked_at_a_shared_job_sees_nothing_of_it_once_it_is_shared_no_more() -> None:
    """What was asked for a moment ago is kept, and shown to those alone who may still see it."""
    bob = Asked(job_view(job="b", state="done"))
    bob.contents = FOUND
    app = build_application(Access({digest_of("b" * 16): AtHand(bob)}, None, LOCAL_HOSTS), READERS)  # type: ignore[arg-type]
    paths = [path for method, path in OPERATIONS if method == "GET" and (method, path) not in OF_NO_JOB]

    async def statuses() -> dict[str, int]:
        headers = LOCAL_HOST | {"authorization": "Bearer " + "b" * 16}
        found = {}
        for path in paths:
            target = "/api/v1" + path.replace("{job}", "b").replace("{format}", "python")
            found[path] = (await ask_async(app, "GET", target, [], {}, headers)).status
        return found

    async def go() -> tuple[dict[str, int], dict[str, int]]:
        seen = await statuses()
        views, bob.views = bob.views, {}
        unseen = await statuses()
        bob.views = views
        assert await statuses() == seen, "it is shared again"
        return seen, unseen

    seen, unseen = asyncio.run(go())
    assert [*seen.values()].count(200) > 4
    assert {*unseen.values()} == {404}, unseen


def test_a_message_is_asked_of_the_coordinator_as_its_sender() -> None:
    ann, bob = Asked(job_view(job="b")), Asked()
    gateways = {digest_of(name * 16): AtHand(client) for name, client in (("a", ann), ("b", bob))}
    app = build_application(Access(gateways, None, LOCAL_HOSTS), READERS)  # type: ignore[arg-type]
    question = Question(body=ListJobs())
    ask(app, "POST", "/api/v1/messages", encode(question), authorization="Bearer " + "b" * 16)
    assert (ann.calls, bob.calls) == ([], [("exchange", question)])
