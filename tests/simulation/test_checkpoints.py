"""Checkpoints: what was committed is never computed again, and whatever happens to one, the answer is the same."""

import contextlib
import sqlite3
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path

import pytest

from atoll_coordinator.service.store.store import Store
from atoll_core.errors import RemoteProtocolError, StoreError
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Event, Message, Query
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.workers import Close, Control, Placements, WorkerStatus
from tests.simulation.bus.fault_plan import Plan
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World, bus_of, comparable
from tests.simulation.harness.stub_islands import StubIsland

EPOCHS = 40
ISLANDS = 3
SLICES = 2 * ISLANDS * EPOCHS * 2
"""Of a whole job with two variables."""

HELD = 2 * ISLANDS
"""Turns that are taken for nothing but a snapshot when all islands wait at a barrier."""


@pytest.fixture(autouse=True)
def no_hits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.simulation.harness.stub_islands.HIT_EPOCHS", 10**9)


config = partial(short_job, islands=ISLANDS, max_epochs=EPOCHS, stagnation=1000)


def world_of(workers: int, seed: int = 1, plan: Plan | None = None) -> World:
    """Return a world in which an epoch of few slices takes its time."""
    return World(workers=workers, seed=seed, plan=plan, slowness=5.0)


@cache
def undisturbed(seed: int = 1) -> str:
    return comparable(world_of(workers=1, seed=seed).run(config(seed)))


@pytest.fixture
def lasting(tmp_path: Path) -> Iterator[World]:
    """A world of two workers whose store survives its coordinator."""
    world = world_of(workers=2)
    world.network.crash("coordinator")
    world.store = Store.open(tmp_path)
    world.service = world.start_service()
    yield world
    world.close()


def restart(world: World, tmp_path: Path) -> None:
    if "coordinator" in world.network.participants:
        world.network.crash("coordinator")
    world.store.close()
    world.store = Store.open(tmp_path)
    world.service = world.start_service()


def turns(world: World) -> int:
    return sum(compute.turns for compute in world.computes.values())


def restored(world: World) -> list[tuple[int, int]]:
    """Return (term, epoch) of every island that went on from a checkpoint."""
    return [(term, epoch) for compute in world.computes.values() for term, epoch, _ in compute.restored]


def committed(world: World, variable: str = "x") -> int:
    job = world.service.controller.jobs.get("job")
    return job.archipelagos[variable].durable if job is not None and job.archipelagos else 0


def last_commit(world: World) -> int:
    """Return the epoch of the last commit of any variable that is still searched."""
    job = world.service.controller.jobs.get("job")
    return max((archipelago.durable for archipelago in job.open_archipelagos), default=0) if job is not None else 0


def crash_one(world: World) -> None:
    """Let a worker die that has islands of what is still searched."""
    (archipelago, *_) = world.service.controller.jobs["job"].open_archipelagos
    world.crash(min(archipelago.workers))


def when(world: World, happens: Callable[[], bool], act: Callable[[], object]) -> None:
    """Have something done as soon as something is so."""
    world.at(world.network.now + 0.01, lambda: act() if happens() else when(world, happens, act))


# ------------------------------------------------------------------------------------------- unplanned


@pytest.mark.parametrize("epoch", [1, 12])
def test_after_the_loss_of_a_worker_the_search_goes_on_from_the_last_commit(epoch: int) -> None:
    for seed in (1, 2):
        world = world_of(workers=3, seed=seed)
        when(world, lambda world=world, epoch=epoch: last_commit(world) >= epoch, lambda world=world: crash_one(world))  # type: ignore[misc]
        assert comparable(world.run(config(seed))) == undisturbed(seed)
        assert restored(world)
        assert all(epoch > 0 for _, epoch in restored(world))


def test_states_that_are_larger_than_a_message_come_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("atoll_core.wire.state_pieces.split_states.__defaults__", (25,))  # a state has 40 bytes
    world = world_of(workers=3, seed=2)
    when(world, lambda: last_commit(world) > 0, lambda: crash_one(world))
    assert comparable(world.run(config(2))) == undisturbed(2)
    assert restored(world)


@pytest.mark.parametrize(("epochs", "taken"), [(8, 0), (14, 1)])
def test_a_checkpoint_is_taken_only_of_a_search_that_goes_on_after_it(epochs: int, taken: int) -> None:
    world = world_of(workers=2, seed=1)
    written: list[object] = []
    world.service.controller._background.write_checkpoint = lambda *arguments: written.append(arguments)  # type: ignore[method-assign, assignment]
    world.run(config(max_epochs=epochs), "x")
    assert len(written) == taken


# --------------------------------------------------------------------------------- coordinator and store


@pytest.mark.slow
def test_the_time_of_the_search_adds_up_over_a_restart(lasting: World, tmp_path: Path) -> None:
    lasting.submit(config(max_epochs=1000, max_time=6.0))
    lasting.at(lasting.network.now + 2.5, lambda: restart(lasting, tmp_path))
    lasting.finish()
    result = lasting.result()
    assert {equation["why"] for equation in result["equations"]} == {"max-time"}
    assert 2.9 < max(equation["seconds"] for equation in result["equations"]) < 4.0
    epochs = {equation["variable"]: equation["epoch"] for equation in result["equations"]}
    again = world_of(workers=3, seed=9).run(config(max_epochs_of=epochs))
    assert again["digest"] == result["digest"]


def test_data_that_come_out_differently_after_a_restart_fail_the_job(lasting: World, tmp_path: Path) -> None:
    lasting.submit(config())
    lasting.client.pause(2.5)
    with lasting.store._transaction() as sql:  # as another version leaves it, which prepares otherwise
        sql.execute("UPDATE jobs SET prepared_digest = NULL, dataset_digest = ?", ("0" * 64,))
    restart(lasting, tmp_path)
    view = lasting.finish()
    assert view.state == "failed"
    assert "came out differently" in (view.reason or "")


def test_checkpoints_of_another_engine_fail_the_job(
    lasting: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lasting.submit(config())
    lasting.client.pause(2.5)
    monkeypatch.setattr("atoll_coordinator.service.jobs.checks.ENGINE_REVISION", 99)
    restart(lasting, tmp_path)
    assert "engine revision" in (lasting.finish().reason or "")


@pytest.mark.slow
@pytest.mark.parametrize("column", ["checkpoints SET progress", "archipelagos SET cut"])
def test_a_search_that_another_version_stored_ends_its_job_and_blocks_no_other(
    lasting: World, tmp_path: Path, column: str
) -> None:
    lasting.submit(config())
    lasting.client.pause(2.5)
    assert lasting.store.checkpoints("job")
    lasting.store._connection.execute(f"UPDATE {column} = x'81a3636f6c6f72a3726564'")  # {"color": "red"}
    restart(lasting, tmp_path)
    lasting.submit(config(), job="other")
    view = lasting.finish()
    assert view.state == "failed"
    assert "the stored search cannot be read by version" in (view.reason or "")
    assert lasting.finish("other").state == "done"


BEFORE = Path(__file__).with_name("store_of_engine_6.sql")
"""A job that has ended, a cancelled one, one in the midst of its search, two that have hardly begun, an upload."""


@pytest.mark.slow
def test_a_whole_store_of_the_version_before_is_served_over_restarts(lasting: World, tmp_path: Path) -> None:
    """What has ended is shown, what can be searched is, and what cannot go on says why; nothing stands in the way."""
    lasting.network.crash("coordinator")
    lasting.store.close()
    (tmp_path / "atoll.sqlite3").unlink()
    with contextlib.closing(sqlite3.connect(tmp_path / "atoll.sqlite3")) as connection:
        connection.executescript(BEFORE.read_text("utf-8"))
    lasting.store = Store.open(tmp_path)
    lasting.service = lasting.start_service()
    for new in ("new", "newer"):
        lasting.submit(config(9, max_epochs=3), job=new)
        assert lasting.finish(new).state == "done"
        restart(lasting, tmp_path)
        views = {view.job: view for view in lasting.client.jobs()}
        states = {job: view.state for job, view in views.items() if not job.startswith("new")}
        assert states == {
            "ended": "done", "searched": "failed", "cancelled": "cancelled", "queued": "done", "queued-too": "done",
        }  # fmt: skip
        assert "begun by engine revision 6" in (views["searched"].reason or "")
        assert [variable.expression is not None for variable in views["ended"].variables] == [True, True]
        assert lasting.result("ended")["state"] == "done"
        assert [event.event for event in lasting.client.events("ended")[-1:]] == ["done"]
    assert lasting.service.controller.breakages.total == 0
    for job in views:
        lasting.client.delete(job)
    assert lasting.client.jobs() == ()


def test_a_full_disk_ends_the_coordinator_with_a_sentence(
    lasting: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    to_bytes = StubIsland.to_bytes
    monkeypatch.setattr(StubIsland, "to_bytes", lambda self: to_bytes(self) + bytes(20_000))
    lasting.submit(config())
    (pages,) = lasting.store._connection.execute("PRAGMA page_count").fetchone()
    lasting.store._connection.execute(f"PRAGMA max_page_count = {pages + 1}")
    with pytest.raises(StoreError, match=r"full.*there is room"):
        lasting.finish()
    restart(lasting, tmp_path)
    assert lasting.finish().state == "done"
    assert comparable(lasting.result()) == undisturbed()


@pytest.mark.slow
@pytest.mark.parametrize("error", [RemoteProtocolError("a state is too long"), ZeroDivisionError("a mistake")])
def test_any_other_error_while_a_checkpoint_is_written_ends_the_job_and_no_other(
    lasting: World, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    """Also one that would be a peer's mistake if a message had caused it."""

    def fail(*_: object) -> bool:
        raise error

    lasting.submit(config())
    monkeypatch.setattr(lasting.store, "commit_checkpoint", fail)
    view = lasting.finish()
    assert view.state == "failed"
    assert f"committing a checkpoint failed ({type(error).__name__}: {error})" in (view.reason or "")
    monkeypatch.undo()
    lasting.submit(config(), job="other")
    assert lasting.finish("other").state == "done"


def test_a_coordinator_whose_worker_heard_of_a_later_one_asks_its_store(lasting: World) -> None:
    lasting.network.run(lasting.network.now + 2.0)
    status = WorkerStatus(instance="i", incarnation=9, state="ready", progress=0)
    stranger = bus_of(lasting, "stranger")
    key = topics.worker(lasting.store.cluster, "stranger", "status")
    stranger.put(key, encode(status))
    lasting.network.run(lasting.network.now + 1.0)
    assert lasting.service.rejects.counts == {key: 1}
    lasting.store._connection.execute("UPDATE realm SET incarnation = 9")
    stranger.put(key, encode(status))
    with pytest.raises(StoreError, match=r"incarnation 9.*taken over"):
        lasting.network.run(lasting.network.now + 1.0)


# --------------------------------------------------------------------------------------------- planned


@pytest.mark.slow
def test_a_worker_that_leaves_hands_over_and_nothing_is_computed_twice() -> None:
    world = World(workers=3, seed=1, expected=3, slowness=5.0)
    leaving = world.workers["w1"]
    when(world, lambda: committed(world) > 0 and committed(world, "y") > 0, leaving.leave)
    calm = world_of(workers=1, seed=1).run(config(max_epochs=60))
    assert comparable(world.run(config(max_epochs=60))) == comparable(calm)
    assert leaving.exit_code == 0
    assert turns(world) == 60 * SLICES // EPOCHS + HELD
    assert {term for term, _ in restored(world)} == {2}


def test_a_worker_whose_lifetime_is_over_leaves() -> None:
    world = world_of(workers=1, seed=1)
    brief = world.start_worker("brief", slowness=5.0, lifetime_s=2.0)
    assert comparable(world.run(config())) == undisturbed()
    assert brief.exit_code == 0


def test_without_anybody_left_the_states_are_kept_and_the_job_waits() -> None:
    world = world_of(workers=1, seed=1)
    alone = world.workers["w0"]
    world.submit(config())
    world.at(world.network.now + 2.0, alone.leave)
    world.client.pause(8.0)
    assert alone.exit_code == 0
    assert "waits for a worker" in (world.client.status("job").reason or "")
    assert not alone.session.assignment_statuses()
    assert committed(world) > 0
    world.start_worker("next", slowness=5.0)
    assert world.finish().state == "done"
    assert comparable(world.result()) == undisturbed()
    assert turns(world) == SLICES + HELD


def test_only_the_workers_of_a_held_archipelago_are_told_to_close_it() -> None:
    world = world_of(workers=1, seed=1)
    heard: list[Event] = []
    bystander = bus_of(world, "bystander")
    bystander.handle_with(heard.append)
    bystander.subscribe(topics.control(world.store.cluster))
    world.submit(config())
    world.at(world.network.now + 2.0, world.workers["w0"].leave)
    world.client.pause(8.0)
    assert not world.workers["w0"].session.assignment_statuses()
    told = [decode(event.payload, Control).body for event in heard if isinstance(event, Message)]
    assert any(isinstance(body, Placements) for body in told)
    assert not any(isinstance(body, Close) for body in told)


def test_a_worker_that_is_not_let_go_ends_when_its_grace_is_over() -> None:
    world = world_of(workers=1)
    world.submit(config(max_epochs=10_000))
    world.network.run(world.network.now + 2.0)
    coordinator = world.service  # it is there and answers questions, but no message reaches it
    world.network._buses["coordinator"].handle_with(
        lambda event: coordinator.step(event) if isinstance(event, Query) else None
    )
    world.workers["w0"].leave()
    world.network.run(world.network.now + 29.0)
    assert world.workers["w0"].exit_code is None
    world.network.run(world.network.now + 3.0)
    assert world.workers["w0"].exit_code == 0


def test_a_worker_that_leaves_does_not_wait_long_for_a_coordinator_that_has_gone() -> None:
    world = world_of(workers=1)
    world.network.run(2.0)
    world.network.crash("coordinator")
    world.workers["w0"].leave()
    world.network.run(6.0)
    assert world.workers["w0"].exit_code == 0


@pytest.mark.slow
def test_planned_changes_are_rare() -> None:
    world = World(workers=1, seed=1, slowness=20.0)
    for number in range(2):
        world.at(6.5 + 4.0 * number, lambda number=number: world.start_worker(f"late{number}", slowness=20.0))  # type: ignore[misc]
    world.run(config(max_epochs=200), "x")
    assert {term for term, _ in restored(world)} == {2, 3}


# ---------------------------------------------------------------------------------------------- damage

DAMAGES = [
    "UPDATE states SET island = island + 500", "UPDATE states SET data = x'00ff'", "UPDATE states SET digest = '00'",
    "DELETE FROM states", "UPDATE states SET data = 'text'",
]  # fmt: skip
LAST = "epoch = (SELECT max(epoch) FROM checkpoints AS c WHERE c.variable = states.variable)"


@pytest.mark.slow
@pytest.mark.parametrize("where", ["", f" WHERE {LAST}"], ids=["all", "last"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_states_cost_time_and_not_the_answer(lasting: World, tmp_path: Path, damage: str, where: str) -> None:
    lasting.submit(config())
    while committed(lasting) < 12 or committed(lasting, "y") < 12:
        lasting.client.pause(0.05)
    lasting.network.crash("coordinator")
    lasting.store._connection.execute(damage + where)
    restart(lasting, tmp_path)
    assert lasting.finish().state == "done"
    assert comparable(lasting.result()) == undisturbed()


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES)
def test_states_that_are_damaged_while_they_are_needed_end_their_job(lasting: World, damage: str) -> None:
    lasting.submit(config())
    while not committed(lasting):
        lasting.client.pause(0.05)
    lasting.store._connection.execute(damage)
    lasting.crash("w0")
    view = lasting.finish(limit_s=60.0)
    assert view.state == "failed"
    assert "missing or damaged in the coordinator's store" in (view.reason or "")
