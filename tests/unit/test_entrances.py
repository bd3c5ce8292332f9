"""Every request over HTTP is under the rules of tokens and origins; `cli/test_verbs_of_others.py` tries every verb."""

from typing import Final

import pytest

from atoll.web.api import Api
from tests.http import ask
from tests.unit.library.web.made import AUTHORIZED, READERS, Asked, application

OPEN: Final = {"/version", "/session", "/health", "/openapi.json"}
"""What is answered to everybody: nothing of any job."""


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
