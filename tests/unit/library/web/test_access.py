"""Who may ask what: hosts, origins, tokens, and the headers of every answer."""

import pytest

from atoll.client.over_http import TOKEN as VARIABLE
from atoll.web.access import token_of
from atoll_core.errors import UsageError
from tests.http import ask
from tests.unit.library.web.made import AUTHORIZED, Asked, application
from tests.views import job_view


@pytest.fixture
def client() -> Asked:
    return Asked(job_view(job="b"))


def answered(client, method="POST", path="/api/v1/jobs/b/cancel", *, is_shown=True, **headers):
    return ask(application(client, is_shown=is_shown), method, path, **headers)


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:7480", "", "localhost.", "[::2]:7480"])
def test_a_name_that_is_not_ours_is_refused_whatever_is_asked(client, host) -> None:
    """A page whose name suddenly leads to this machine could read answers otherwise."""
    for method, path in (("GET", "/"), ("GET", "/api/v1/jobs"), ("POST", "/api/v1/jobs/b/cancel")):
        assert answered(client, method, path, host=host, authorization=AUTHORIZED).status == 421
    assert client.calls == []


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:9", "[::1]:7480", "127.0.0.1"])
def test_names_of_this_machine_are_ours(client, host) -> None:
    assert answered(client, "GET", "/api/v1/version", host=host).status == 200


@pytest.mark.parametrize("headers", [{"sec_fetch_site": "cross-site"}, {"origin": "https://evil.example"}])
def test_pages_of_other_origins_ask_nothing_either(client, headers) -> None:
    """A question may cost the coordinator seconds, whoever may not read its answer."""
    for path in ("/api/v1/jobs", "/api/v1/version", "/api/v1/events"):
        for given in ({}, {"authorization": AUTHORIZED}):
            assert answered(client, "GET", path, **headers, **given).status == 403, path
    assert answered(client, "GET", "/", **headers).status == 200  # a link leads here


def test_our_own_page_may(client) -> None:
    own = {"sec_fetch_site": "same-origin", "origin": "http://127.0.0.1:7480"}
    assert answered(client, authorization=AUTHORIZED, **own).status == 200
    assert client.calls == [("cancel", "b")]


@pytest.mark.parametrize("authorization", [None, "Bearer wrong", "Basic eDp5", "Bearer", "bearer " + "x" * 10_000])
def test_without_the_token_nothing_is_changed(client, authorization) -> None:
    given = {} if authorization is None else {"authorization": authorization}
    answer = answered(client, **given)
    assert (answer.status, answer.headers["www-authenticate"]) == (401, "Bearer")
    assert client.calls == []


def test_beyond_this_machine_nothing_of_jobs_is_shown_without_a_token(client) -> None:
    shown = {path: answered(client, "GET", path, is_shown=False).status for path in ("/api/v1/jobs", "/api/v1/workers")}
    assert set(shown.values()) == {401}
    for path in ("/", "/static/style.css", "/api/v1/session", "/api/v1/version", "/api/v1/health"):
        assert answered(client, "GET", path, is_shown=False).status == 200, path
    assert answered(client, "GET", "/api/v1/jobs", is_shown=False, authorization=AUTHORIZED).status == 200


def test_a_path_is_not_open_because_it_begins_like_one(client) -> None:
    for path in ("/static/../api/v1/jobs", "//api/v1/jobs", "/api/v1/version/../jobs"):
        answer = answered(client, "GET", path, is_shown=False)
        assert answer.status in (401, 404), path


def test_browsers_are_told_to_be_strict_in_every_answer(client) -> None:
    for answer in (answered(client, "GET", "/"), answered(client), answered(client, "GET", "/", host="evil")):
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "frame-ancestors 'none'" in policy
        assert answer.headers["x-content-type-options"] == "nosniff"


def test_a_token_is_made_up_or_long_enough() -> None:
    assert token_of({}) != token_of({})
    for right in ("s" * 16, "c2VjcmV0+/c2VjcmV0=="):
        assert token_of({VARIABLE: right}) == right
    for wrong in ("", "s" * 15, "a b" * 10, "é" * 20, "abc'defghijklmnopq"):
        with pytest.raises(UsageError, match="at least 16" if len(wrong) < 16 else "other characters"):
            token_of({VARIABLE: wrong})
