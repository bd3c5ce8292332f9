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
from tests.simulation.bus.fault_plan import Partition, Plan
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


@pytest.mark.slow
def test_a_worker_that_dies_while_its_states_are_pulled_does_not_change_the_answer() -> None:
    """Among so many moments there are those between snapshot, question, answer and commit."""
    for step in range(6):
        world = world_of(workers=2, seed=3, plan=Plan(delay_s=(0.005, 0.02)))
        when(
            world,
            lambda world=world: any(
                equation.snapshots for equation in world.workers["w1"].session.assignment_statuses()
            ),  # type: ignore[misc]
            lambda world=world, step=step: world.at(world.network.now + 0.004 * step, lambda: world.crash("w1")),  # type: ignore[misc]
        )
        assert comparable(world.run(config(3))) == undisturbed(3)


@pytest.mark.slow
def test_lost_and_late_answers_with_states_do_not_change_the_answer() -> None:
    plan = Plan(drop=0.1, duplicate=0.1, late=0.1, partitions=(Partition("w2", 2.0, 3.5),))
    for seed in range(3):
        world = world_of(workers=3, seed=seed, plan=plan)
        world.at(2.5 + 0.2 * seed, lambda world=world: world.crash("w0"))  # type: ignore[misc]
        world.at(3.0, lambda world=world: world.start_worker("w3", slowness=9.0))  # type: ignore[misc]
        assert comparable(world.run(config(seed))) == undisturbed(seed)


def test_states_that_are_larger_than_a_message_come_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("atoll_core.wire.state_pieces.split_states.__defaults__", (25,))  # a state has 40 bytes
    world = world_of(workers=3, seed=2)
    when(world, lambda: last_commit(world) > 0, lambda: crash_one(world))
    assert comparable(world.run(config(2))) == undisturbed(2)
    assert restored(world)


def test_a_worker_killed_again_and_again_never_brings_the_search_back_to_the_start() -> None:
    world = world_of(workers=2, seed=2)

    def kill(number: int) -> None:
        world.crash(f"w{number}")
        world.at(world.network.now + 0.3, lambda: world.start_worker(f"w{number + 1}", slowness=5.0))
        if number < 5:
            world.at(world.network.now + 2.5, lambda: kill(number + 1))

    world.at(2.0, lambda: kill(1))
    assert comparable(world.run(config(2))) == undisturbed(2)
    epochs = [epoch for _, epoch in sorted(world.computes["w0"].restored[i][:2] for i in range(2))]
    assert all(epoch > 0 for epoch in epochs)


def test_no_checkpoint_is_taken_of_a_search_that_ends_before_it() -> None:
    world = world_of(workers=2, seed=1)
    written: list[object] = []
    world.service.controller._background.write_checkpoint = lambda *arguments: written.append(arguments)  # type: ignore[method-assign, assignment]
    world.run(config(max_epochs=8))
    assert written == []


def test_a_checkpoint_is_taken_of_a_search_that_goes_on_after_it() -> None:
    world = world_of(workers=2, seed=1)
    written: list[object] = []
    world.service.controller._background.write_checkpoint = lambda *arguments: written.append(arguments)  # type: ignore[method-assign, assignment]
    world.run(config(max_epochs=14), "x")
    assert len(written) == 1


# --------------------------------------------------------------------------------- coordinator and store


@pytest.mark.slow
@pytest.mark.parametrize("at_s", [1.4, 2.2])
def test_a_restarted_coordinator_goes_on_from_the_last_commit(lasting: World, tmp_path: Path, at_s: float) -> None:
    lasting.submit(config())
    lasting.at(lasting.network.now + at_s, lambda: restart(lasting, tmp_path))
    assert lasting.finish().state == "done"
    assert comparable(lasting.result()) == undisturbed()
    assert restored(lasting)
    assert all(epoch > 0 for _, epoch in restored(lasting))
    assert lasting.store.checkpoints("job") == {}


@pytest.mark.slow
def test_coordinator_and_a_worker_may_die_together(lasting: World, tmp_path: Path) -> None:
    lasting.submit(config())

    def both() -> None:
        lasting.crash("w0")
        restart(lasting, tmp_path)

    lasting.at(lasting.network.now + 2.5, both)
    assert lasting.finish().state == "done"
    assert comparable(lasting.result()) == undisturbed()
    assert len({epoch for _, epoch in restored(lasting)}) <= 2


@pytest.mark.parametrize("side", ["before", "after"])
def test_a_coordinator_may_die_on_either_side_of_a_commit(lasting: World, tmp_path: Path, side: str) -> None:
    lasting.submit(config())
    store, commit = lasting.store, lasting.store.commit_checkpoint
    dead: list[int] = []

    def dies(*arguments: object, **more: object) -> bool:
        epoch = arguments[2]
        if dead or epoch == 8:
            return commit(*arguments, **more)  # type: ignore[arg-type]
        if side == "after":
            commit(*arguments, **more)  # type: ignore[arg-type]
        dead.append(epoch)  # type: ignore[arg-type]
        lasting.network.crash("coordinator")
        lasting.at(lasting.network.now + 0.5, lambda: restart(lasting, tmp_path))
        return True

    store.commit_checkpoint = dies  # type: ignore[method-assign, assignment]
    assert lasting.finish().state == "done"
    assert comparable(lasting.result()) == undisturbed()
    assert {epoch for _, epoch in restored(lasting)} >= {dead[0]} if side == "after" else {8}


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
    assert "what the store keeps of its search is not understood by version" in (view.reason or "")
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
    with pytest.raises(StoreError, match="full"):
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
    assert f"committing a checkpoint broke ({type(error).__name__}: {error})" in (view.reason or "")
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


def test_a_worker_with_nothing_to_hand_over_is_let_go_at_once() -> None:
    world = world_of(workers=1)
    world.network.run(2.0)
    world.workers["w0"].leave()
    world.network.run(3.0)
    assert world.workers["w0"].exit_code == 0


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
def test_a_worker_that_comes_later_takes_part_from_a_checkpoint_on() -> None:
    world = world_of(workers=1, seed=1)
    world.at(6.5, lambda: world.start_worker("late", slowness=5.0))
    calm = world_of(workers=1, seed=1).run(config(max_epochs=80))
    assert comparable(world.run(config(max_epochs=80))) == comparable(calm)
    assert world.computes["late"].turns > 0
    assert turns(world) == 2 * SLICES + HELD
    assert {term for term, _ in restored(world)} == {2}


@pytest.mark.slow
def test_planned_changes_are_rare() -> None:
    world = World(workers=1, seed=1, slowness=20.0)
    for number in range(2):
        world.at(6.5 + 4.0 * number, lambda number=number: world.start_worker(f"late{number}", slowness=20.0))  # type: ignore[misc]
    world.run(config(max_epochs=200), "x")
    assert {term for term, _ in restored(world)} == {2, 3}


@pytest.mark.slow
def test_workers_that_come_and_go_do_not_change_the_answer() -> None:
    for seed in range(3):
        world = world_of(workers=2, seed=seed, plan=Plan(drop=0.03, late=0.05))
        world.at(2.0 + 0.1 * seed, lambda world=world: world.workers["w0"].leave())  # type: ignore[misc]
        world.at(2.5, lambda world=world: world.start_worker("w2", slowness=5.0))  # type: ignore[misc]
        world.at(4.0, lambda world=world: world.workers["w1"].leave())  # type: ignore[misc]
        world.at(4.2, lambda world=world: world.crash("w2"))  # type: ignore[misc]
        world.at(4.4, lambda world=world: world.start_worker("w3", slowness=5.0))  # type: ignore[misc]
        assert comparable(world.run(config(seed))) == undisturbed(seed)


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
