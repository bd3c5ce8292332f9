"""What a coordinator takes over from the store when it starts."""

import json

import pytest

from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.store.store import JobRecord, Store
from atoll_core.config import JobConfig
from atoll_core.errors import StoreError
from atoll_core.wire.messages.clients import JobList
from tests.blobs import put_blob
from tests.unit.coordinator.service.requests.test_clients import Tasks, controller_of

EQUATION = {
    "variable": "x", "lhs": "dx/dt", "epoch": 3, "error": 0.1, "normalized_error": 0.01, "complexity": 3,
    "expression": "x*y", "converged": True, "why": "target", "point_evaluations": 7,
}  # fmt: skip
READABLE = json.dumps({"equations": [EQUATION], "point_evaluations": 7, "warnings": ["a warning"]})


def recovered(store: Store, result: str) -> JobController:
    """Return the controller of a store that has one job, which has ended with `result`."""
    blob = put_blob(store, b"t,x\n0,1\n")
    store.add_job(JobRecord("job", "a job", JobConfig(seed=3).model_dump_json(), blob, "2026-01-01T00:00:00"))
    store.commit_result("job", "done", result)
    controller = controller_of(store, Tasks())
    controller.recover(0.0)
    return controller


def test_an_ended_job_is_shown_with_its_equations() -> None:
    with Store.open(None) as store:
        view = recovered(store, READABLE).shown.view("job", 1.0)
    assert view is not None
    assert (view.state, view.seed, view.point_evaluations, view.warnings) == ("done", 3, 7, ("a warning",))
    assert [variable.expression for variable in view.variables] == ["x*y"]


@pytest.mark.parametrize(
    "result",
    [
        "{",
        "[]",
        "{}",
        '{"equations": [], "point_evaluations": "a", "warnings": []}',
        '{"equations": [{}], "point_evaluations": 1, "warnings": []}',
    ],
)
def test_a_result_that_this_version_cannot_read_hinders_nobody(result: str) -> None:
    with Store.open(None) as store:
        controller = recovered(store, result)
        view = controller.shown.view("job", 1.0)
        assert controller.shown.result("job") == result
    assert view is not None
    assert (view.state, view.seed, view.variables) == ("done", 3, ())
    assert "cannot be read by version" in view.warnings[0]


def test_no_result_is_read_at_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    def is_damaged(self: Store, job: str) -> str:
        raise StoreError("damaged")

    monkeypatch.setattr(Store, "result", is_damaged)
    with Store.open(None) as store:
        assert not recovered(store, READABLE).jobs


def test_what_a_list_shows_of_an_ended_job_is_made_of_its_result_once(monkeypatch: pytest.MonkeyPatch) -> None:
    with Store.open(None) as store:
        first = recovered(store, READABLE).shown.view("job", 1.0)

        def is_read_again(self: Store, job: str) -> str:
            raise AssertionError(job)

        monkeypatch.setattr(Store, "result", is_read_again)
        again = controller_of(store, Tasks())
        again.recover(2.0)
        assert again.shown.view("job", 3.0) == first


@pytest.mark.parametrize("kept", ["{", "[]", '{"colour": "red"}'])
def test_a_view_that_another_version_has_kept_is_made_anew(kept: str) -> None:
    with Store.open(None) as store:
        controller = recovered(store, READABLE)
        whole = controller.shown.view("job", 1.0)
        store.keep_views({"job": kept})
        assert controller.shown.view("job", 1.0) == whole


@pytest.mark.parametrize(
    "damage", ["elapsed = 'x'", "priority = 'x'", "name = x'ff00'", "submitted = 7", "state = 'lost'", "spec = 3"]
)
def test_a_damaged_record_takes_no_list_of_jobs_with_it(damage: str) -> None:
    with Store.open(None) as store:
        recovered(store, READABLE)
        for name in ("damaged", "live"):
            store.add_job(JobRecord(name, "a job", JobConfig().model_dump_json(), "0", "2026-01-01T00:00:00"))
        store.commit_result("damaged", "done", READABLE)
        store._connection.execute(f"UPDATE jobs SET {damage} WHERE id != 'job'")
        controller = controller_of(store, Tasks())
        controller.recover(0.0)
        views = {view.job: view for view in controller.shown.views(["job", "damaged", "live"], 1.0)}
    assert (views["job"].state, views["job"].name) == ("done", "a job")
    assert views.keys() == {"job", "damaged", "live"}
    assert views["live"].state in ("failed", "queued")  # what can be read is understood
    JobList(jobs=tuple(views.values())).model_dump_json()
