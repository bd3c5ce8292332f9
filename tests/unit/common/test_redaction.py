"""Tokens and passwords are shown nowhere: in no error, log line or command that is kept."""

import json
import logging
import urllib.parse

import pytest

from atoll.api.discoverer import Discoverer
from atoll.cli.verbs.web import opening
from atoll.client.over_http import TOKEN, WebAddress, coordinator_at
from atoll.web.access import token_of
from atoll_core.errors import RefusedError, UsageError
from atoll_core.logs import JsonLines, TextLines, fields
from atoll_core.redaction import without_secrets

SECRET = "s3cret-of-sixteen-and-more"
PLACES = (
    f"https://lab.example:7480/atoll/?token={SECRET}",
    f"htps://lab.example?x=1&token={SECRET}",
    f"http://ann:{SECRET}@lab.example:7480/",
    f"Authorization: Bearer {SECRET}",
    f"ATOLL_WEB_TOKEN={SECRET}",
    f"ATOLL_WEB_TOKEN='{SECRET}'",
    f'ATOLL_WEB_TOKEN="{SECRET} and more"',
    f"http://h:1/?token=abc'{SECRET}",
    f'http://h:1/?token=abc"{SECRET}',
    f"http://h:1/?token=abc\\{SECRET}",
    f"http://h:1/?token=abc#{SECRET}",
    f"http://h:1/?token=abc&x='{SECRET}",
    f"http://h:1/#token={SECRET}",
    f"http://h:1/#token=a/b'{SECRET}",
    f"https://ann:a/{SECRET}@h/",
    f"https://ann:a'{SECRET}/b@h/",
    f"https://ann:a@{SECRET}@h/",
    f"ATOLL_WEB_TOKEN: {SECRET}",
    f'"ATOLL_WEB_TOKEN": "a\\"{SECRET}"',
    f"ATOLL_WEB_TOKEN='a'\"'\"'{SECRET}'",
    f"Authorization: Basic {SECRET}",
    f"authorization: {SECRET}",
    f"{{'Authorization': 'Basic a\\'{SECRET}'}}",
    f"Bearer a'{SECRET}",
)


@pytest.mark.parametrize("text", PLACES)
def test_an_error_a_log_line_and_a_command_show_no_secret(text: str) -> None:
    record = logging.LogRecord("a", logging.INFO, "", 0, text, (), None)
    record.__dict__.update(fields(address=text, other=f'"{text}"'))
    error = RefusedError("%s is no address", text, command=f"try {text}")
    told = [
        TextLines({}).format(record), JsonLines({}).format(record), str(error), error.on_command_line,
        without_secrets(f"coordinator submit d.csv --connect '{text}' --seed 3"),
    ]  # fmt: skip
    assert [line for line in told if SECRET in line] == []
    assert json.loads(told[1])["level"] == "info"
    assert told[-1].endswith("--seed 3")


def test_a_long_text_has_an_end() -> None:
    """In time in proportion to its length: by the square, these would take hours."""
    for text in ("?token=" + "," * 10**6, "a://b:" * 50_000 + "@", "bearer " * 50_000, "ATOLL_WEB_TOKEN:" * 20_000):
        assert len(without_secrets(text)) <= len(text)


@pytest.mark.parametrize(
    "token", ["a token of sixteen", "abc'DEF-and-more-of-it", "abc\\DEF-and-more-of", "a+b/c=d" * 3, ""]
)
def test_a_token_that_an_address_cannot_hold_is_refused_everywhere(token: str) -> None:
    with pytest.raises(UsageError) as refused:
        token_of({TOKEN: token})
    assert not token or token not in str(refused.value)
    with pytest.raises(UsageError, match="ATOLL_WEB_TOKEN"):
        coordinator_at("http://h:1/", {}, {TOKEN: token})
    with pytest.raises(UsageError, match="ATOLL_WEB_TOKEN"):
        coordinator_at(f"http://h:1/?token={urllib.parse.quote(token)}", {}, {})


def test_tokens_that_are_made_up_or_fit_an_address_are_taken() -> None:
    for given in ({}, {TOKEN: "0123456789abcdefABCDEF-._~"}):
        coordinator_at("http://h:1/", {}, {TOKEN: token_of(given)})


def test_what_is_no_secret_stays() -> None:
    for text in ("--initial token=3", "tcp/lab:7447", "a column token = 3", "https://lab.example/docs#a", "",
                 "no token; give it in ATOLL_WEB_TOKEN", "the authority is ca.pem"):  # fmt: skip
        assert without_secrets(text) == text


def test_an_address_with_a_token_shows_it_nowhere() -> None:
    address = coordinator_at(PLACES[0], {}, {})
    assert isinstance(address, WebAddress)
    assert (address.token, SECRET in repr(address) + str(address)) == (SECRET, False)
    with pytest.raises(UsageError) as raised:
        coordinator_at(PLACES[1], {}, {})
    assert SECRET not in str(raised.value)


def test_no_estimator_shows_the_token_of_its_address() -> None:
    """Notebooks keep what they show."""
    address = PLACES[0]
    assert SECRET not in repr(Discoverer(connect=address))
    sklearn = pytest.importorskip("sklearn")
    from atoll.api.regressor import Regressor

    one = Regressor(connect=address)
    with sklearn.config_context(display="diagram", print_changed_only=False):
        assert [text for text in (repr(one), str(one._repr_mimebundle_())) if SECRET in text] == []


def test_a_page_shows_its_token_on_a_terminal_alone() -> None:
    url = "http://127.0.0.1:7480/"
    assert opening(url, SECRET, is_terminal=True, is_given=False) == f"open {url}?token={SECRET}"
    for is_given in (True, False):
        assert SECRET not in opening(url, SECRET, is_terminal=False, is_given=is_given)
    assert "ATOLL_WEB_TOKEN" in opening(url, SECRET, is_terminal=False, is_given=False)
