"""The API: what it asks the coordinator, what it answers, what it refuses."""

import asyncio
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll.web import api as api_module
from atoll.web.description import describe, to_text
from atoll_core.data.table import Table
from atoll_core.wire.messages.views import EventView
from tests.http import LOCAL, Answer, ask, ask_async
from tests.unit.library.web.made import AUTHORIZED, READERS, Asked, application
from tests.views import job_view

FOUND = {
    "schema": 1, "job": "b", "symbols": {"x": "x"},
    "equations": [{"variable": "x", "lhs": "dx/dt", "expression": "-x"}],
}  # fmt: skip
CSV = b"t,x\n" + b"".join(b"%d,%f\n" % (row, 0.9**row) for row in range(30))


@pytest.fixture
def client() -> Asked:
    return Asked(job_view(job="a", state="done"), job_view(job="b"), job_view(job="c"))


@pytest.fixture
def app(client: Asked):
    return application(client)


def wrote(app, method: str, path: str, body: bytes = b"", **query: str) -> Answer:
    return ask(app, method, f"/api/v1{path}", body, query, authorization=AUTHORIZED)


def read(app, path: str, **query: str) -> Answer:
    return ask(app, "GET", f"/api/v1{path}", query=query)


def test_jobs_come_page_by_page_newest_first(app) -> None:
    first = read(app, "/jobs", limit="2").json
    assert [job["job"] for job in first["jobs"]] == ["c", "b"]
    last = read(app, "/jobs", limit="2", cursor=str(first["next"])).json
    assert ([job["job"] for job in last["jobs"]], last["next"]) == (["a"], None)
    assert [job["job"] for job in read(app, "/jobs", state="done").json["jobs"]] == ["a"]


def test_jobs_of_a_state_are_one_question_to_the_coordinator() -> None:
    """It finds them without reading others, however many there are."""
    asked = Asked(
        *(job_view(job=f"j{number}", state="done") for number in range(200)), job_view(job="new", state="queued")
    )
    answer = read(application(asked), "/jobs", state="queued", limit="2").json
    assert ([job["job"] for job in answer["jobs"]], answer["next"]) == (["new"], None)
    assert asked.asked_for_pages == 1
    refused = read(application(asked), "/jobs", state="lost")
    assert refused.status == 422
    assert "preparing" in refused.body.decode()


@pytest.mark.parametrize(
    ("method", "path", "body", "call"),
    [
        ("POST", "/jobs/b/cancel", b"", ("cancel", "b")),
        ("POST", "/jobs/b/pause", b"", ("pause", True, "b")),
        ("POST", "/jobs/b/resume", b"", ("pause", False, "b")),
        ("PUT", "/jobs/b/priority", b'{"priority": -3}', ("priority", -3, "b")),
        ("PUT", "/jobs/b/sharing", b'{"shared": true}', ("share", True, "b")),
        ("POST", "/jobs/b/retry?", b"", None),
    ],
)
def test_what_is_changed_is_asked_of_the_coordinator_and_needs_a_token(app, client, method, path, body, call) -> None:
    refused = ask(app, method, f"/api/v1{path}".rstrip("?"), body)
    assert (refused.status, client.calls) == (401, [])
    assert refused.headers["content-type"] == "application/problem+json"
    answer = wrote(app, method, path.rstrip("?"), body)
    assert answer.json["job"] == "b"
    assert call is None or client.calls == [call]


def test_a_job_is_deleted_only_when_it_has_ended(app) -> None:
    assert wrote(app, "DELETE", "/jobs/a").status == 204
    refused = wrote(app, "DELETE", "/jobs/b")
    assert (refused.status, refused.json["detail"]) == (409, "job b is running; cancel it")


def test_a_file_is_submitted_with_options_under_an_id_of_ones_own(app, client) -> None:
    options = json.dumps({"seed": "7", "max_epochs": "3"})
    answer = wrote(app, "POST", "/jobs", CSV, filename="d.csv", options=options, id="mine", priority="2", shared="true")
    assert (answer.status, answer.headers["location"]) == (201, "jobs/mine")
    ((_, job, name, config, data, priority, shared),) = client.calls
    assert (job, name, config.seed, config.budget.max_epochs, priority, shared) == ("mine", "d.csv", 7, 3, 2, True)
    assert Table.from_bytes(data).names == ("t", "x")
    again = ask(app, "POST", "/api/v1/jobs", data, {"filename": "d.csv", "id": "mine"},
                authorization=AUTHORIZED, content_type="application/vnd.atoll.table")  # fmt: skip
    assert again.status == 201


@pytest.mark.parametrize(
    ("query", "body", "said"),
    [
        ({"options": "[1]"}, CSV, "must be a JSON object"),
        ({"options": '{"sead": "1"}'}, CSV, "sead is not an option"),
        ({"options": '{"seed": "x"}'}, CSV, "must be a whole number"),
        ({"options": '{"seed": {}}'}, CSV, "must be a text"),
        ({"filename": "../.."}, CSV, "name of a file"),
        ({"filename": "a\nb"}, CSV, "name of a file"),
        ({"id": "no id"}, CSV, "an id has"),
        ({"priority": "11"}, CSV, "10"),
        ({"shared": "yes"}, CSV, "true or false"),
        ({}, b"", ""),
        ({}, b"\x00\xff" * 50, ""),
    ],
)
def test_what_cannot_be_submitted_is_refused_in_a_sentence(app, client, query, body, said) -> None:
    answer = wrote(app, "POST", "/jobs", body, **query)
    assert answer.status == 422
    assert said in answer.json["detail"]
    assert client.calls == []


def test_a_result_is_asked_for_once_however_many_pages_want_it_and_anew_when_its_job_has_ended(app, client) -> None:
    async def pages() -> list[Answer]:
        asked = (ask_async(app, "GET", "/api/v1/jobs/b/progress", [b""], {}, LOCAL) for _ in range(50))
        return await asyncio.gather(*asked)

    async def go() -> None:
        client.contents = FOUND | {"state": "running"}
        first = await pages()
        assert {answer.status for answer in first} == {200}
        assert client.calls == [("result", "b")]
        tagged = LOCAL | {"if-none-match": first[0].headers["etag"]}
        again = await ask_async(app, "GET", "/api/v1/jobs/b/progress", [b""], {}, tagged)
        assert (again.status, again.body) == (304, b"")

    asyncio.run(go())


def test_an_outline_says_how_a_file_is_read_and_what_the_command_would_be(app) -> None:
    made = wrote(app, "POST", "/outline", CSV, filename="d.csv", options='{"seed": "3", "robust": true}').json
    assert [(column["name"], column["role"]) for column in made["columns"]] == [("t", "time"), ("x", "state")]
    assert made["equations"][0]["lhs"] == "dx/dt"
    assert made["command"] == "coordinator submit d.csv --seed 3 --robust"
    assert "atoll.discover('d.csv', seed='3', robust=True)" in made["python"]
    assert made["columns"][1]["angle"] is None
    turned = wrote(app, "POST", "/outline", CSV, filename="d.csv", options='{"angle": ["x:deg"]}').json
    assert turned["columns"][1]["angle"] == "degrees"


def test_given_equations_are_typeset_by_the_service_and_errors_in_them_name_the_option(app) -> None:
    options = {"equation": ["dx/dt = -c*x + ?"], "parameter": ["c=0.1..10"]}
    made = wrote(app, "POST", "/outline", CSV, filename="d.csv", options=json.dumps(options)).json
    assert made["equations"][0]["mathml"].startswith("<math ")
    assert made["parameters"] == ["c: 0.1 to 10, beginning at 1"]
    assert "--equation 'dx/dt = -c*x + ?' --parameter c=0.1..10" in made["command"]
    assert "equation=['dx/dt = -c*x + ?'], parameter=['c=0.1..10']" in made["python"]
    options["equation"] = ["dx/dt = -c*x + sin"]
    refused = wrote(app, "POST", "/outline", CSV, filename="d.csv", options=json.dumps(options))
    assert (refused.status, refused.json["detail"].startswith("--equation for 'dx/dt'")) == (422, True)


def test_several_files_are_one_table(app, client) -> None:
    sizes = [str(len(CSV))] * 2
    made = wrote(app, "POST", "/outline", CSV + CSV, filename=["a.csv", "b.csv"], bytes=sizes).json
    assert made["files"] == ["a.csv", "b.csv"]
    assert made["command"] == "coordinator submit a.csv b.csv"
    assert "discover(['a.csv', 'b.csv'])" in made["python"]
    drawn = wrote(app, "POST", "/preview", CSV + CSV, filename=["a.csv", "b.csv"], bytes=sizes).json
    assert [trajectory["name"] for trajectory in drawn["trajectories"]] == ["1", "2"]
    for names, wrong in (
        (["a.csv", "b.csv"], []), (["a.csv", "b.csv"], ["1", "1"]), (["a.csv", "a.csv"], sizes), (["a.csv"], ["x"]),
        (["a.csv", "b.csv"], ["-1", str(2 * len(CSV) + 1)]), (["a.csv", "b.csv"], ["9" * 5000, "1"]),
    ):  # fmt: skip
        refused = wrote(app, "POST", "/jobs", CSV + CSV, filename=names, bytes=wrong)
        assert (refused.status, "bytes" in refused.json["detail"]) == (422, True)
    same = wrote(app, "POST", "/jobs", CSV + CSV, filename=["x/a.csv", "y/a.csv"], bytes=sizes)
    assert (same.status, client.calls) == (422, [])


def test_the_data_of_a_job_are_taken_again_for_another(app, client) -> None:
    wrote(app, "POST", "/jobs", CSV, filename="d.csv", id="first")
    client.tables["first"] = client.calls.pop()[4]
    made = wrote(app, "POST", "/outline", of="first", options='{"operators": "+,-,*"}').json
    assert made["equations"][0]["operators"] == ["+", "-", "*"]
    assert made["files"] == ["d.csv"]
    wrote(app, "POST", "/jobs", of="first", id="second")
    assert client.calls[-1][1:3] == ("second", "d.csv")
    assert client.calls[-1][4] == client.tables["first"]
    assert wrote(app, "POST", "/jobs", of="none").status == 404


def test_a_preview_has_smoothed_curves_and_derivatives_with_errors(app) -> None:
    made = wrote(app, "POST", "/preview", CSV, filename="d.csv").json
    (drawn,) = made["trajectories"]
    (state,) = drawn["states"]
    assert made["time_name"] == "t"
    assert len(drawn["time"]) == len(state["smoothed"]) == len(state["derivative_sigma"]) == 30
    assert state["derivative"][15] == pytest.approx(0.9**15 * -0.10536, rel=0.05)


def test_bodies_are_bounded(app, client, monkeypatch) -> None:
    monkeypatch.setattr(api_module, "MAX_BODY", 100)
    parts = [b"x" * 60, b"x" * 60]
    told = ask(app, "POST", "/api/v1/jobs", b"", authorization=AUTHORIZED, content_length="1000000")
    untold = ask(app, "POST", "/api/v1/jobs", parts, authorization=AUTHORIZED)
    assert [told.status, untold.status] == [413, 413]
    assert "100 bytes" in told.json["detail"]
    assert client.calls == []


def test_a_silent_coordinator_is_said_to_be_so(app, client) -> None:
    client.is_silent = True
    answer = read(app, "/jobs/b")
    assert (answer.status, answer.headers["retry-after"]) == (503, "1")
    assert read(app, "/health").status == 503


def test_what_is_not_there_is_not_found(app) -> None:
    for path in ("/jobs/none", "/jobs/no%20id", "/nothing", "/jobs/b/exports/exe"):
        answer = read(app, path)
        assert answer.status in (404, 422), path
        assert answer.json["status"] == answer.status


def test_logs_are_given_after_a_number(app, client) -> None:
    client.happened = [EventView(number=n, time="", event="log", text=str(n), job="b") for n in (1, 2, 3)]
    events = read(app, "/jobs/b/logs", after="1").json["events"]
    assert [event["number"] for event in events] == [2, 3]


def test_the_description_is_that_of_the_routes_and_the_file_is_up_to_date() -> None:
    from importlib.resources import files

    assert files("atoll.web").joinpath("openapi.json").read_text("utf-8") == to_text(), (
        "run: python -m atoll.web.description"
    )
    paths = describe()["paths"]
    assert sum(len(operations) for operations in paths.values()) == len(api_module.Api(READERS).routes())


PATHS = sorted(describe()["paths"])
TEXTS = st.text(max_size=20)
FIELDS = ["limit", "cursor", "state", "prefix", "options", "filename", "id", "priority", "after", "shared"]


@settings(max_examples=300, deadline=None)
@given(
    path=st.sampled_from(PATHS), job=st.sampled_from(["a", "b", "x y", "é", "..", "%2e"]), body=st.binary(max_size=50),
    method=st.sampled_from(["GET", "POST", "PUT", "DELETE", "PATCH"]),
    query=st.dictionaries(
        st.sampled_from(FIELDS),
        TEXTS | st.integers().map(str), max_size=4,
    ),
)  # fmt: skip
def test_whatever_is_asked_nothing_of_ours_breaks(path, job, body, method, query) -> None:
    client = Asked(job_view(job="a", state="done"), job_view(job="b"))
    if path in ("/events", "/jobs/{job}/report", "/jobs/{job}/islands", "/coordinator", "/workers/{worker}/service",
                "/coordinator/queue"):  # fmt: skip
        return  # streams, and what this client does not have
    asked = path.replace("{job}", job).replace("{format}", "python")
    answer = ask(application(client), method, f"/api/v1{asked}", body, query,
                 authorization=AUTHORIZED)  # fmt: skip
    assert answer.status < 500


def test_unfinished_messages_take_bounded_memory(monkeypatch) -> None:
    monkeypatch.setattr(api_module, "MAX_OF_USER", 8 * 2**20)
    app, refused = application(Asked()), list[int]()

    async def sending() -> None:
        scope = {
            "type": "http", "method": "POST", "path": "/api/v1/messages", "root_path": "", "http_version": "1.1",
            "query_string": b"", "scheme": "http", "raw_path": b"/api/v1/messages",
            "headers": [(b"host", b"127.0.0.1"), (b"authorization", AUTHORIZED.encode())],
        }  # fmt: skip

        async def one() -> None:
            parts = iter([{"type": "http.request", "body": b"x" * 2**20, "more_body": True}])

            async def receive() -> object:
                part = next(parts, None)
                return part if part is not None else await asyncio.Event().wait()

            async def send(message: dict[str, object]) -> None:
                if message["type"] == "http.response.start":
                    refused.append(message["status"])  # type: ignore[arg-type]

            await app(dict(scope), receive, send)

        tasks = [asyncio.create_task(one()) for _ in range(50)]
        while len(refused) < 42:  # the others wait for the rest of their bodies
            await asyncio.sleep(0.001)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    asyncio.run(sending())
    assert refused == [429] * 42
    assert wrote(app, "POST", "/messages", b"x").status == 422  # those have gone
