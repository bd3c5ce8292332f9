"""Every entrance under the same rules: which test proves what at each. A new entrance without its row fails here.

Rows are kinds of entrances, columns are rules. Entrances are taken from the code itself: questions on the bus, requests
over HTTP, verbs of the command line, functions in Python, and the ways in which a page, a restart or a copy begins.
"""

import ast
import functools
from typing import Final, get_args

import pytest

import atoll
from atoll.cli.options import VERBS as ALL_VERBS
from atoll.web.api import Api
from atoll_core.wire.messages.clients import ClientRequest
from tests.http import ask
from tests.unit.documents import ROOT
from tests.unit.library.cli.test_verbs_of_others import ASKED, ASKS_NOTHING
from tests.unit.library.web.made import AUTHORIZED, READERS, Asked, application

RULES: Final = ("see", "change", "size", "rate", "quota", "escaping", "secrets", "durable")
"""Who may see and who may change something; sizes, rates and stored bytes have bounds; foreign text is text; tokens and
keys are shown nowhere; what was said to be done outlives the process."""

_USERS: Final = "unit/coordinator/service/requests/test_users.py::"
_CLIENTS: Final = "unit/coordinator/service/requests/test_clients.py::"
_WEB: Final = "unit/library/web/"
_HOSTILE: Final = "unit/library/web/test_hostile_requests.py::"
_INTEGRATED: Final = "integration/test_web.py::"
_STORE: Final = "unit/coordinator/service/store/"
_SECURITY: Final = "integration/test_security.py::"
_SECRETS: Final = "unit/common/test_redaction.py::test_an_error_a_log_line_and_a_command_show_no_secret"
_TURNS: Final = (
    "unit/coordinator/service/requests/test_question_queue.py::"
    "test_a_party_with_thousands_of_names_keeps_no_other_from_its_next_turn"
)
_QUOTA: Final = "property/test_uploads.py::test_who_has_a_table_has_shown_all_of_it_and_quotas_are_what_is_stored"
_PAGE: Final = "unit/library/report/test_page.py::test_no_text_of_a_result_is_taken_for_markup"
_TERMINAL: Final = "unit/library/terminal/test_output.py::test_no_name_steers_a_terminal"
_VERBS: Final = "unit/library/cli/test_verbs_of_others.py::"
_LATER: Final = {
    "see": f"{_USERS}test_after_a_restart_and_a_restore_each_job_is_seen_by_the_same_users",
    "change": f"{_USERS}test_after_a_restart_and_a_restore_each_job_is_changed_by_the_same_users",
}
_ANSWERED: Final = f"{_USERS}test_what_was_answered_holds_after_a_restart"
_OUTPUTS: Final = f"{_INTEGRATED}test_the_token_of_an_address_is_in_no_output"
_RESTORED: Final = f"{_STORE}test_backup.py::test_a_restored_store_has_the_jobs_and_a_name_of_its_own"
_KEPT: Final = "unit/library/cli/test_web_process.py::test_a_page_that_dies_is_started_again_as_it_was"

BUS: Final = {
    "see": f"{_USERS}test_every_question_about_anothers_job_is_answered_as_if_there_were_none",
    "change": f"{_USERS}test_a_job_that_is_shared_is_seen_by_all_and_changed_by_its_own",
    "size": f"{_SECURITY}test_a_router_drops_what_is_larger_than_its_key_allows",
    "rate": _TURNS,
    "quota": _QUOTA,
    "escaping": "unit/common/test_logs.py::test_a_value_cannot_break_out_of_its_field",
    "secrets": _SECRETS,
    "durable": _ANSWERED,
}
HTTP: Final = BUS | {
    "see": f"{_HOSTILE}test_a_job_of_somebody_else_is_unknown_in_every_operation_also_after_its_owner_has_looked",
    "change": f"{_HOSTILE}test_no_operation_does_without_a_token_what_it_may_not",
    "size": f"{_WEB}test_api.py::test_unfinished_messages_take_bounded_memory",
    "rate": f"{_WEB}test_connections.py::test_where_all_are_at_work_the_next_is_told_to_come_later",
    "escaping": f"{_HOSTILE}test_what_is_reflected_begins_no_header",
    "secrets": f"{_HOSTILE}test_no_token_is_logged",
    "durable": f"{_INTEGRATED}test_a_job_by_http_ends_as_one_by_the_command_line_and_its_stream_survives_kills",
}
WEB: Final = HTTP | {
    "see": f"{_WEB}test_server.py::test_nobody_looks_without_a_token_through_credentials_of_others_or_a_proxy",
    "change": f"{_WEB}test_access.py::test_pages_of_other_origins_change_nothing",
    "secrets": "unit/common/test_redaction.py::test_a_page_shows_its_token_on_a_terminal_alone",
}
PROCESS: Final = WEB | {"see": _KEPT, "durable": _KEPT}
"""Of a page that another program starts as `web`, with its own users and certificates, and keeps running."""
CLI: Final = BUS | {
    "see": f"{_VERBS}test_a_private_job_of_another_user_is_as_if_there_were_none",
    "change": f"{_VERBS}test_what_another_user_shares_and_what_is_all_users_is_not_changed",
    "escaping": _TERMINAL,
    "secrets": _OUTPUTS,
}
"""Of verbs that ask a coordinator, which decides: see `BUS`."""
PYTHON: Final = BUS | {
    "escaping": _PAGE,
    "secrets": "unit/common/test_redaction.py::test_no_estimator_shows_the_token_of_its_address",
}
RESTART: Final = {
    **BUS,
    **_LATER,
    "rate": "simulation/test_sharing.py::test_who_has_used_up_the_time_of_a_day_waits",
    "secrets": f"{_STORE}test_store.py::test_a_store_of_an_earlier_version_is_closed_to_others_and_that_is_said_once",
}
RESTORE: Final = {
    **BUS,
    **_LATER,
    "quota": _RESTORED,
    "secrets": _RESTORED,
    "size": f"{_STORE}test_backup.py::test_a_disk_that_is_full_is_one_sentence_and_leaves_nothing",
    "durable": "simulation/test_second_mistakes.py::"
    "test_a_store_that_was_damaged_moved_restored_and_served_has_all_its_jobs",
}
TABLE: Final = {
    "bus": BUS, "HTTP": HTTP, "web": WEB, "run --web": PROCESS, "serve --http": PROCESS, "CLI": CLI,
    "Python": PYTHON, "restart": RESTART, "restore": RESTORE,
}  # fmt: skip

QUESTIONS: Final = {
    "upload", "submit", "jobs", "find-job", "job-status", "workers", "get-queue-depth", "get-result", "get-islands",
    "get-table", "analyse", "cancel", "delete", "get-events", "follow", "pause", "set-priority", "share", "retry",
    "set-worker", "set-queue",
}  # fmt: skip
VERBS: Final = {
    "CLI": {
        "submit", "ping", "jobs", "status", "workers", "cancel", "delete", "pause", "resume", "priority", "share",
        "retry", "logs", "cordon", "uncordon", "drain", "queue", "result", "simulate", "analyse", "report", "suggest",
        "export", "doctor", "adapt", "compare",
    },
    "run --web": {"run"}, "serve --http": {"serve"}, "web": {"web"}, "restart": {"router"},
    "restore": {"restore", "backup"}, "nothing is asked": {"schema", "completion"},
}  # fmt: skip
FUNCTIONS: Final = {"discover", "submit", "Model", "Discoverer", "Regressor"}

OPEN: Final = {"/version", "/session", "/health", "/openapi.json"}
"""What is answered to everybody: nothing of any job."""


def test_every_entrance_has_its_row() -> None:
    (bodies,) = (get_args(field.annotation) for field in [ClientRequest.model_fields["body"]])
    assert {kind.model_fields["kind"].default for kind in bodies} == QUESTIONS
    assert set(ALL_VERBS) == set().union(*VERBS.values())
    assert VERBS["CLI"] == set(ASKED), "each is asked as another user"
    assert VERBS["nothing is asked"] == set(ASKS_NOTHING), "each is run, and asks nothing"
    assert {name for name in atoll.__all__ if not name.isupper()} == FUNCTIONS
    assert set(VERBS) - {"nothing is asked"} <= set(TABLE)


@pytest.mark.parametrize("entrance", TABLE)
def test_each_rule_has_a_test_at_each_entrance(entrance: str) -> None:
    """Cells that an entrance takes from another one (restart and restore from the bus) are looked at there."""
    row = TABLE[entrance]
    assert tuple(row) == RULES
    assert [place for place in row.values() if place.partition("::")[2] not in names_in(place.partition("::")[0])] == []


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


@functools.cache
def names_in(file: str) -> frozenset[str]:
    """Return the names of the tests in a file."""
    tree = ast.parse((ROOT / "tests" / file).read_text("utf-8"))
    return frozenset(node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))
