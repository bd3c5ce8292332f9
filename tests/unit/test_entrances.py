"""Every entrance is under the rules: a verb or a request over HTTP that is added is tried, too.

Who sees and changes what is tested in `service/requests/test_users.py`, `web/test_hostile_requests.py` and
`cli/test_verbs_of_others.py`, which ask every question, request and verb.
"""

from typing import Final

import pytest

from atoll.cli.options import VERBS as ALL_VERBS
from atoll.web.api import Api
from tests.http import ask
from tests.unit.library.cli.test_verbs_of_others import ASKED, ASKS_NOTHING
from tests.unit.library.web.made import AUTHORIZED, READERS, Asked, application

PROGRAMS: Final = {"run", "serve", "web", "router", "restore", "backup"}
"""Verbs that are entrances themselves: they ask no other coordinator."""

OPEN: Final = {"/version", "/session", "/health", "/openapi.json"}
"""What is answered to everybody: nothing of any job."""


def test_every_verb_is_asked_as_another_user_or_asks_nothing() -> None:
    assert set(ALL_VERBS) == PROGRAMS | set(ASKED) | set(ASKS_NOTHING)


ROUTES: Final = [(min(route.methods), route.path) for route in Api(READERS).routes()]  # type: ignore[attr-defined]


@pytest.mark.parametrize(("method", "path"), ROUTES)
def test_no_request_is_answered_without_a_token_or_to_another_site(method: str, path: str) -> None:
    """A resource that is added is under the same rule, without a list of those that are."""
    asked = Asked()
    app, at = application(asked, is_shown=False), "/api/v1" + path.replace("{job}", "b")
    if path not in OPEN:
        assert ask(app, method, at).status == 401
    assert ask(app, method, at, sec_fetch_site="cross-site", authorization=AUTHORIZED).status == 403
    assert asked.calls == []
