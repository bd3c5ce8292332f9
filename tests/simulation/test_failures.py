"""What cannot go well: it ends with a sentence, never in silence."""

from functools import partial

import pytest

from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.errors import DataError
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Reply
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.epochs import EpochReport, IslandReport
from atoll_core.wire.messages.handshake import Greeting, GreetingAnswer, Hello, Refusal
from atoll_core.wire.messages.limits import MAX_MESSAGE
from atoll_core.wire.messages.workers import (
    AssignmentStatus,
    IslandFailure,
    WorkerStatus,
)
from atoll_island_worker.compute.compute_thread import ComputeFailed
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World, bus_of, comparable
from tests.simulation.harness.stub_islands import OURS

config = partial(short_job, islands=4, generations=100, max_epochs=14)


def undisturbed(seed: int = 1) -> str:
    return comparable(World(workers=1, seed=seed).run(config(seed)))


# -------------------------------------------------------------------------------------------- workers


def test_a_job_whose_workers_all_die_waits_for_another_and_says_so() -> None:
    world = World(workers=2)
    world.at(1.2, lambda: [world.crash(name) for name in ("w0", "w1")])
    world.submit(config())
    world.client.pause(6.0)
    assert "all are lost" in (world.client.status("job").reason or "")
    assert {view.state for view in world.client.workers()} == {"lost"}
    world.start_worker("late")
    world.finish()
    assert comparable(world.result()) == undisturbed()


def test_an_island_that_breaks_fails_its_job_with_its_reason() -> None:
    world = World(workers=2, broken=(2, 3))
    world.submit(config())
    view = world.finish()
    assert view.state == "failed"
    assert view.fault == "internal"
    assert "broke as it was told to" in (view.reason or "")
    assert all(part in (view.reason or "") for part in ("please report it with this sentence", "seed 1", "the data"))


def test_two_workers_that_disagree_fail_the_job_as_diverged_and_are_both_named() -> None:
    world = World(workers=1)
    world.submit(config())
    world.at(world.network.now + 1.5, lambda: world.crash("w0"))
    world.at(world.network.now + 1.6, lambda: world.start_worker("liar", corrupt=True))
    view = world.finish()
    assert (view.state, view.fault) == ("failed", "diverged")
    assert "w0" in (view.reason or "")
    assert "liar" in (view.reason or "")


def test_a_worker_whose_compute_thread_fails_ends_with_its_error_and_another_goes_on() -> None:
    world = World(workers=2)
    broken = world.workers["w0"]
    world.at(1.2, lambda: world.network._buses["w0"].post(ComputeFailed("the compute thread failed: KeyError: 'job'")))
    assert comparable(world.run(config())) == undisturbed()
    assert (broken.exit_code, str(broken.error)) == (1, "the compute thread failed: KeyError: 'job'")


def test_a_second_worker_of_the_same_name_is_refused_and_told_which_option_to_use() -> None:
    world = World(workers=1)
    world.network.run(1.0)
    first = world.workers["w0"]
    bus = world.network.bus("impostor")
    from atoll_island_worker.worker import Worker
    from tests.simulation.harness.stub_islands import StubCompute

    second = Worker(bus, StubCompute(world.network, "impostor", 0), "w0", wait_s=10.0)
    bus.handle_with(second.step)
    second.start()
    world.network.run(2.0)
    assert second.exit_code == 2
    assert "--name" in str(second.error)
    assert first.exit_code is None


def test_a_worker_with_other_kernels_is_refused_even_when_it_comes_first() -> None:
    world = World(workers=0)
    other = world.start_worker("other", fingerprint="different")
    world.network.run(2.0)
    right = world.start_worker("right")
    world.submit(config())
    assert world.finish().state == "done"
    assert other.exit_code == 2
    assert OURS in str(other.error)
    assert "different" in str(other.error)
    assert right.exit_code is None


def test_no_worker_fails_what_is_placed_on_another() -> None:
    """`bystander` is ready, and says under the right term that islands failed, and that it holds some."""
    world = World(workers=1, slowness=30.0)
    world.submit(config())
    world.network.run(world.network.now + 1.0)
    bystander = world.network.bus("bystander")
    controller = world.service.controller
    hello = Hello(
        role="worker", name="bystander", instance="b", protocol=PROTOCOL_VERSION, version=VERSION,
        engine=ENGINE_REVISION, fingerprint=OURS,
    )  # fmt: skip
    assert controller.workers.register(hello, world.network.now) is None
    placement = controller.jobs["job"].archipelagos["x"].placement
    assert placement is not None
    place = {"job": "job", "variable": "x", "term": placement.term}
    failure = IslandFailure(**place, island=0, sentence="planted")
    assignment_status = AssignmentStatus(**place, islands=1, reported=3, commit=0)
    before = world.service.rejects.total
    for claim in ({"failures": (failure,)}, {"holdings": (assignment_status,)}):
        status = WorkerStatus(instance="b", incarnation=world.store.incarnation, state="computing", progress=1, **claim)
        bystander.put(topics.worker(world.store.cluster, "bystander", "status"), encode(status))
        world.network.run(world.network.now + 0.5)
    assert world.service.rejects.total == before + 2
    assert world.finish().state == "done"


@pytest.mark.parametrize("has_own_router", [False, True])
def test_a_worker_leaves_when_the_coordinator_stays_away_for_too_long(has_own_router: bool) -> None:
    world = World(workers=1, has_own_router=has_own_router)
    world.network.run(2.0)
    worker = world.workers["w0"]
    world.network.crash("coordinator")
    world.network.run(30.0)
    assert worker.exit_code is None
    world.network.run(100.0)
    assert worker.exit_code == 3
    assert "has not answered" in str(worker.error)


def test_a_worker_without_work_stays_as_long_as_the_coordinator_behind_a_router() -> None:
    world = World(workers=1, has_own_router=True)
    world.network.run(300.0)
    assert world.workers["w0"].exit_code is None
    world.network.crash("coordinator")
    world.network.run(340.0)
    world.service = world.start_service()
    world.network.run(500.0)
    assert world.workers["w0"].exit_code is None
    world.submit(config())
    assert world.finish().state == "done"


# ----------------------------------------------------------------------------------------- coordinator


# --------------------------------------------------------------------------------------------- clients


def test_a_job_whose_table_has_gone_fails_and_the_others_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(workers=1)
    gone = [False]
    monkeypatch.setattr(world.store, "is_sound", lambda digest: not gone or gone.pop())
    world.submit(config(), job="first")
    world.submit(config(), job="second")
    view = world.finish("first")
    assert (view.state, view.reason) == ("failed", "its table is missing or damaged in the store; submit it again")
    assert world.finish("second").state == "done"


def test_epochs_for_a_variable_that_is_not_sought_fail_the_job_as_a_data_error() -> None:
    world = World(workers=1)
    world.submit(config(max_epochs_of={"z": 3}))
    view = world.finish()
    assert (view.state, view.fault) == ("failed", "data")
    assert "'z'" in (view.reason or "")
    with pytest.raises(DataError, match="'z'"):
        world.result()


# ------------------------------------------------------------------------------------ foreign messages


def nonsense(cluster: str) -> list[tuple[str, bytes]]:
    """Return puts that a stranger could make, none of which may change anything."""
    status = WorkerStatus(instance="x", incarnation=1, state="ready", progress=0)
    report = IslandReport(
        island=0, generations=1, hit=None, additions=(), counters=(), best_error=None, digest="ab" * 16
    )
    reports = EpochReport(job="job", variable="x", term=1, epoch=0, islands=(report,))
    keys = [
        topics.control(cluster),
        topics.control(cluster, "w0"),
        topics.worker(cluster, "w0", "status"),
        topics.worker(cluster, "w0", "report"),
    ]
    return [
        *((key, payload) for key in keys for payload in (b"", b"\xc1", b"\x81\xa4body\x80", bytes(MAX_MESSAGE + 1))),
        (topics.worker(cluster, "stranger", "status"), encode(status)),
        (topics.worker(cluster, "stranger", "report"), encode(reports)),
    ]


def test_foreign_malformed_and_oversized_messages_are_counted_and_change_nothing(
    caplog: pytest.LogCaptureFixture,
) -> None:
    world = World(workers=2, expected=2)
    stranger = bus_of(world, "stranger")
    for repeat in range(30):
        for key, payload in nonsense(world.store.cluster):
            world.at(0.8 + 0.05 * repeat, lambda key=key, payload=payload: stranger.put(key, payload))  # type: ignore[misc]
    assert comparable(world.run(config())) == undisturbed()
    cluster = world.store.cluster
    w0 = {topics.control(cluster), topics.control(cluster, "w0")}
    assert w0 <= world.workers["w0"].rejects.counts.keys()
    assert {
        topics.worker(cluster, "w0", "status"),
        topics.worker(cluster, "w0", "report"),
    } <= world.service.rejects.counts.keys()
    assert min(world.workers["w0"].rejects.counts.values()) > 20
    lines = [record.getMessage() for record in caplog.records if "dropped message" in record.getMessage()]
    sources = world.service.rejects.counts.keys()
    assert len(lines) == len(sources) + sum(len(worker.rejects.counts) for worker in world.workers.values())


def test_questions_that_are_not_understood_are_answered_at_once() -> None:
    world = World(workers=1)
    world.network.run(1.0)
    stranger = bus_of(world, "stranger")
    cluster = world.store.cluster
    keys = [
        topics.client(cluster, "c"),
        topics.worker(cluster, "w0", "pull"),
        f"atoll/{cluster}/job/x/y/z",
        topics.HELLO,
    ]
    tokens = [stranger.get(key, b"nonsense", timeout_s=60.0) for key in keys]
    replies = [stranger.receive(1.0) for _ in tokens]
    assert {reply.token for reply in replies if isinstance(reply, Reply)} == set(tokens)


@pytest.mark.parametrize(
    "changes", [{"protocol": PROTOCOL_VERSION + 1}, {"version": "9.9.9"}, {"engine": ENGINE_REVISION + 1}]
)
def test_a_worker_of_another_version_is_refused_with_both_versions_named(changes: dict[str, object]) -> None:
    world = World(workers=0)
    stranger = bus_of(world, "stranger")
    versions = {"protocol": PROTOCOL_VERSION, "version": VERSION, "engine": ENGINE_REVISION, **changes}
    hello = Hello.model_validate({"role": "worker", "name": "old", "instance": "i", "unknown": 1, **versions})
    stranger.get(topics.HELLO, encode(Greeting(body=hello)))
    reply = stranger.receive(5.0)
    assert isinstance(reply, Reply)
    assert reply.payload is not None
    refusal = decode(reply.payload, GreetingAnswer).body
    assert isinstance(refusal, Refusal)
    for said in (f"Atoll {VERSION} (protocol {PROTOCOL_VERSION}", str(*changes.values())):
        assert said in refusal.sentence
    assert not world.client.workers()
