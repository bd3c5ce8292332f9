"""A job that is not refined ends when its result is composed in the background, whatever happens meanwhile."""

import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from atoll.client.client import Client
from atoll.client.follower import Subscription
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.model.result.building import Account, build_result
from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.monitoring.job_views import Draft, ended_view, outcomes_of
from atoll_coordinator.service.requests import waiting
from atoll_coordinator.service.store.holdings import ALL
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import AtollError, RefusedError
from tests.simulation.harness.held_background import LONG, SHORT, Held
from tests.simulation.harness.simulated_cluster import World, comparable


@pytest.fixture(autouse=True)
def no_hits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.simulation.harness.stub_islands.HIT_EPOCHS", 10**9)


@pytest.fixture
def world() -> Iterator[Held]:
    made = Held()
    yield made
    made.release()
    made.close()


def other(world: World) -> Client:
    return Client(world.network.bus("other"), "simulated")


def test_a_cancelled_job_is_shown_as_it_was_until_its_end_is_in_the_store(world: Held) -> None:
    world.search()
    world.client.status("job")  # its equations are written
    world.client.pause(0.5)
    world.is_held = True
    before = world.client.status("job")
    assert all(each.expression for each in before.variables)
    view = world.client.cancel("job")
    assert view.state == "running", "nobody is told of an end that is not in the store"
    assert [each.expression for each in view.variables] == [each.expression for each in before.variables]
    assert [each.job for each in world.client.jobs(is_open=True)] == ["job"]
    record = world.store.job("job")
    assert record is not None
    assert record.state == "running"
    begun = len(world.waiting)
    assert world.client.cancel("job").state == "running"
    assert len(world.waiting) == begun, "its result is composed once"
    world.client.pause(3.0)
    assert all(worker.session.assignment_statuses() for worker in world.workers.values()), "it may still go on"
    world.release()
    assert world.client.cancel("job").state == "cancelled"
    assert not world.service.controller.ending
    world.client.pause(3.0)
    assert all(not worker.session.assignment_statuses() for worker in world.workers.values()), "nobody computes it"
    assert [event.event for event in world.client.events("job")].count("cancelled") == 1
    view, record = world.client.status("job"), world.store.job("job")
    assert record is not None
    assert ended_view(record, world.store.result("job")).variables == view.variables
    assert world.store.held(ALL).live == 0


def test_whoever_cancels_is_answered_when_that_lasts(world: Held) -> None:
    world.search()
    world.is_held = True
    asked_at = world.network.now
    world.at(asked_at + 1.0, world.release)
    assert world.client.cancel("job").state == "cancelled"
    assert 1.0 <= world.network.now - asked_at < waiting.PATIENCE_S
    assert len(world.service._deferred) == 0


def test_while_its_result_is_composed_a_job_is_neither_changed_nor_deleted(world: Held) -> None:
    world.search()
    world.is_held = True
    world.client.cancel("job")
    for change in (
        lambda: world.client.pause_job("job"), lambda: world.client.set_priority("job", 3),
        lambda: world.client.delete("job"), lambda: world.client.retry("job", "again"),
        lambda: world.client.analyse("job", "report", b""),
    ):  # fmt: skip
        with pytest.raises(RefusedError):
            change()
    assert world.client.share("job").shared
    world.client.submit("job", "a simulated job", LONG, world.store.job("job").table_digest)  # type: ignore[union-attr]
    world.release()
    assert world.finish().shared
    world.client.delete("job")
    with pytest.raises(RefusedError, match="no job"):
        world.client.status("job")
    assert world.service.controller.breakages.total == 0


def test_who_follows_is_told_of_the_end_once_it_lasts(world: Held) -> None:
    world.search()
    following = Subscription(world.client, "job")
    following.wait(1.0)
    world.is_held = True
    other(world).cancel("job")
    states = []
    for _ in range(4):
        change = following.wait(0.5)
        states += [change.view.state] if change is not None and change.view is not None else []
    assert set(states) <= {"running"}
    world.release()
    while not states or states[-1] != "cancelled":
        change = following.wait(1.0)
        assert change is not None
        states += [change.view.state] if change.view is not None else []


@pytest.mark.parametrize("is_killed", [False, True])
@pytest.mark.parametrize("is_worker_lost", [False, True])
@pytest.mark.parametrize("end", ["refining breaks", "out of time"])
def test_the_end_is_the_same_whoever_dies_meanwhile(end: str, is_worker_lost: bool, is_killed: bool) -> None:
    results = []
    for is_disturbed in (False, True):
        world = Held(refiner=broken)
        timed = SHORT.model_copy(update={"budget": SHORT.budget.model_copy(update={"max_time": 60.0})})
        world.submit(timed if end == "out of time" else SHORT)
        while not world.service.controller.jobs["job"].open_archipelagos:
            world.client.pause(0.1)
        world.background_s = 1e6 if end == "out of time" else 5.0
        while world.client.status("job").state != "refining":
            world.client.pause(0.1)
        world.is_held = is_disturbed
        while is_disturbed and not world.service.controller.ending:
            world.client.pause(0.5)
        if is_disturbed:
            assert world.client.status("job").state == "refining"
            if is_worker_lost:
                world.crash("w0")
                world.client.pause(20.0)
            if is_killed:
                world.restart()
            world.release()
        assert world.finish().state == "done"
        results.append(world.result())
        assert world.service.controller.breakages.total == 0
        world.close()
    assert comparable(results[0]) == comparable(results[1])
    assert results[0]["warnings"] == results[1]["warnings"]
    assert results[0]["refining"] == results[1]["refining"] == "not refined"


def broken(*_: object) -> Refinement:
    raise ZeroDivisionError("planted")


@pytest.mark.parametrize("end", [Job.cancel, lambda job: job.fail("diverged", "It diverged.")])
def test_the_result_is_that_of_the_job_to_the_byte(world: Held, end: Callable[[Job], object]) -> None:
    """It is what building the result at once gives, at the moment at which the end takes effect."""
    world.search()
    world.is_held = True
    job, prepared = world.service.controller.jobs["job"], world.service.controller.jobs["job"].prepared
    world.service.controller._change("job", "ending", world.network.now, end)  # type: ignore[arg-type]
    assert prepared is not None
    world.client.pause(5.0)
    world.release()
    assert world.finish().state == job.state
    text = world.store.result("job")
    assert text is not None
    outcomes = outcomes_of(job)
    account = Account(job.state, json.loads(text)["seconds"], max(one.seconds for one in outcomes), job.reason)
    made = build_result("job", prepared.config, prepared.preparation, outcomes, account, job.refinement)
    assert text == made.to_json()


def test_a_job_whose_result_cannot_be_composed_fails_and_no_other(world: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    world.search()
    compose = Draft.compose

    def breaks(draft: Draft) -> str:
        if draft.job == "job":
            raise ZeroDivisionError("float division by zero")
        return compose(draft)

    monkeypatch.setattr(Draft, "compose", breaks)
    with pytest.raises(AtollError, match="float division by zero"):
        world.client.result("job")
    assert world.client.status("job").state == "running"
    view = world.client.cancel_and_wait("job")
    assert view.state == "failed"
    assert "float division by zero" in (view.reason or "")
    world.search("next")
    assert world.client.cancel("next").state == "cancelled"
    assert not world.service.controller.ending


def test_what_breaks_over_a_job_that_ends_has_it_fail_with_what_it_had_found(
    world: Held, monkeypatch: pytest.MonkeyPatch
) -> None:
    world.search()
    commit, calls = Store.commit_result, []

    def breaks(store: Store, job: str, *arguments: Any, **options: Any) -> bool:
        calls.append(job)
        if len(calls) == 1:
            raise ZeroDivisionError("float division by zero")
        return commit(store, job, *arguments, **options)

    monkeypatch.setattr(Store, "commit_result", breaks)
    view = world.client.cancel_and_wait("job")
    assert view.state == "failed"
    assert "float division by zero" in (view.reason or "")
    result = world.result()
    assert result["state"] == "failed"
    assert all(equation["expression"] for equation in result["equations"])
    assert not world.service.controller.ending


def test_the_result_of_a_job_that_is_searched_is_composed_once_for_all_who_ask(
    world: Held, monkeypatch: pytest.MonkeyPatch
) -> None:
    world.search()
    compose, composed = Draft.compose, []
    monkeypatch.setattr(Draft, "compose", lambda draft: composed.append(draft.job) or compose(draft))
    world.is_held = True
    asked_at = world.network.now
    world.at(asked_at + 5.0, world.release)
    assert world.client.result("job")["state"] == "running", "the client asked again after 3.3 s"
    assert world.network.now - asked_at >= 5.0
    assert composed == ["job"]
    assert len(world.service._deferred) == 0


def test_no_more_questions_wait_than_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, "MAX_DEFERRED", 1)
    questions: waiting.DeferredQuestions[int] = waiting.DeferredQuestions()
    end, draft = waiting.ResultOf("job", is_final=True), waiting.ResultOf("job", is_final=False)
    assert questions.add(1, waiting.NotYetError(end), 0.0)
    assert not questions.add(2, waiting.NotYetError(end), 0.0)
    assert questions.take_overdue(1e9) == []
    assert questions.take(draft) == []
    assert [one.question for one in questions.take(end)] == [1]
    assert len(questions) == 0
