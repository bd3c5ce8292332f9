"""One question about a job is answered with the equations that it has, and does not wait for ever for them."""

from collections.abc import Iterator

import pytest

from atoll_coordinator.service.requests import waiting
from atoll_core.wire.messages.views import JobView
from tests.simulation.harness.held_background import Held


@pytest.fixture(autouse=True)
def no_hits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.simulation.harness.stub_islands.HIT_EPOCHS", 10**9)


@pytest.fixture
def world() -> Iterator[Held]:
    made = Held()
    yield made
    made.release()
    made.close()


def is_whole(view: JobView) -> bool:
    """Return whether a view has two variables, each with its equation, error and size."""
    fields = [(each.expression, each.error, each.complexity) for each in view.variables]
    return len(fields) == 2 and all(None not in each for each in fields)


def test_a_single_question_has_the_equations(world: Held) -> None:
    world.search()
    assert is_whole(world.client.status("job"))


def test_a_single_list_has_the_equations(world: Held) -> None:
    world.search()
    (view,) = world.client.jobs(is_open=True)
    assert is_whole(view)


def test_the_first_question_after_a_restart_has_the_equations(world: Held) -> None:
    world.search()
    world.restart()
    world.client.pause(0.1)
    assert is_whole(world.client.status("job"))


def test_the_first_question_about_an_ended_job_after_a_restart_has_the_equations(world: Held) -> None:
    world.search()
    world.client.cancel("job")
    world.restart()
    view = world.client.status("job")
    assert view.state == "cancelled"
    assert is_whole(view)


def test_the_answer_waits_for_the_background_thread(world: Held) -> None:
    world.search()
    world.is_held = True
    world.at(world.network.now + 1.0, world.release)
    assert is_whole(world.client.status("job"))


def test_a_background_thread_that_is_busy_does_not_keep_the_status_back(world: Held) -> None:
    world.search()
    world.is_held = True
    asked_at = world.network.now
    view = world.client.status("job")
    assert [each.epoch > 0 for each in view.variables] == [True, True]
    assert view.state == "running"
    assert world.network.now - asked_at < 2 * waiting.PATIENCE_S


def test_too_many_waiting_questions_are_answered_at_once(world: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    world.search()
    monkeypatch.setattr(waiting, "MAX_DEFERRED", 0)
    world.is_held = True
    asked_at = world.network.now
    assert world.client.status("job").state == "running"
    assert world.network.now - asked_at < waiting.PATIENCE_S
