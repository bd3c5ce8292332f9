"""An error over one event ends the job that it concerns at most: the loop goes on, and clients are answered.

An exception is injected into a sample of the service's methods; `every_method` does so for all of them.
"""

import contextlib
import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, get_args

import msgpack
import pytest

import atoll_coordinator.service
from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.monitoring.breakages import Breakages
from atoll_coordinator.service.requests.dispatch import RequestDispatcher
from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.tasks.background import CheckpointWritten
from atoll_coordinator.service.workers.channel import WorkerChannel
from atoll_coordinator.service.workers.placement import Placer
from atoll_core.errors import AtollError, RefusedError
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Event, Link, Reply
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.epochs import EpochReport, IslandReport, Pull, PullStates
from tests.simulation.harness.schedule_run import hurried
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World

LEFT_OUT = {
    (Breakages, "tolerated"),  # the guards themselves
    (JobController, "guarded"),
    (Service, "start"),  # before the loop begins
    (Service, "step"),
    (WorkerChannel, "take_pull"),  # one look-up in a dict; without it the job of an answer is unknown
}
LEFT_OUT_ALWAYS = {
    (JobController, "_change"),  # these only call the guard of a job, or end the job after an error
    (JobController, "_advance_checkpoint"),
    (RequestDispatcher, "_answer"),
    (RequestDispatcher, "_tell_worker"),
    (JobController, "_end_broken"),
    (JobController, "_end_without_job"),
    (JobController, "_remove"),
    (Placer, "plan_placements"),  # is called with all jobs
    (Store, "job"),
    (Store, "commit_result"),
}


def methods() -> Iterator[tuple[type, str]]:
    """Yield every method of the service but `validate`, which only the simulation calls."""
    room = atoll_coordinator.service
    for module in pkgutil.walk_packages(room.__path__, f"{room.__name__}."):
        if module.name.endswith("child_main"):  # the main program of another process
            continue
        for owner in vars(importlib.import_module(module.name)).values():
            if inspect.isclass(owner) and owner.__module__ == module.name:
                names = [name for name, method in vars(owner).items() if inspect.isfunction(method)]
                yield from ((owner, name) for name in names if not name.startswith("__") and name != "validate")


def sample(step: int, left_out: set[tuple[type, str]]) -> list[tuple[type, str]]:
    """Return one of so many methods; `every_method` breaks all of them."""
    return [method for method in methods() if method not in left_out][::step]


config = partial(short_job, islands=3, max_epochs=8, stagnation=1000)


@pytest.fixture(autouse=True)
def no_hits(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr("tests.simulation.harness.stub_islands.HIT_EPOCHS", 10**9)
    with hurried():
        yield


@contextlib.contextmanager
def broken_once(owner: type, name: str) -> Iterator[list[int]]:
    """Let one call of a method raise what nobody expects; the list gets an entry when it has."""
    real: Callable[..., Any] = getattr(owner, name)
    calls: list[int] = []

    def breaks(*arguments: Any, **options: Any) -> Any:
        calls.append(1)
        if len(calls) == 1:
            raise ZeroDivisionError("float division by zero")
        return real(*arguments, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, name, breaks)
        yield calls


@contextlib.contextmanager
def broken_for(owner: type, name: str, job: str) -> Iterator[list[int]]:
    """Let every call of a method that concerns `job` raise; the list gets an entry for each that has."""
    real: Callable[..., Any] = getattr(owner, name)
    calls: list[int] = []

    def breaks(*arguments: Any, **options: Any) -> Any:
        if any(concerns(value, job) for value in (*arguments, *options.values())):
            calls.append(1)
            raise ZeroDivisionError("float division by zero")
        return real(*arguments, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, name, breaks)
        yield calls


def concerns(what: Any, job: str) -> bool:
    """Tell whether something is a job, one of its parts, its id, or a message about it."""
    if isinstance(what, tuple) and what:
        return concerns(what[0], job)
    if isinstance(what, CheckpointWritten):
        return what.checkpoint.job == job
    if isinstance(what, Job | JobRecord):
        return what.id == job
    part_of = getattr(what, "job", None)
    return job == (part_of.id if isinstance(part_of, Job) else part_of or what)


def ask_everything(world: World) -> None:
    """Ask all that clients and workers ask."""
    cluster = world.store.cluster
    stranger = world.network.bus(f"stranger-{world.network.now}")
    pull = Pull(body=PullStates(job="first", variable="x", term=1, epoch=2, islands=(0,), offset=0))
    for key, payload in (
        (topics.states(cluster, "first"), encode(pull)), (topics.blob(cluster, "0" * 64, 0), b""),
    ):  # fmt: skip
        stranger.get(key, payload)
    for ask in (
        world.client.jobs, world.client.workers, lambda: world.client.status("first"),
        lambda: world.client.result("first"), lambda: world.client.events("first"),
    ):  # fmt: skip
        with contextlib.suppress(AtollError):  # a sentence
            ask()
    stranger.close()


def assert_it_goes_on(world: World, calls: list[int]) -> None:
    """Submit two jobs while something breaks once: the first ends, and the second has its result."""
    with contextlib.suppress(AtollError):
        world.submit(config(), job="first")
    for _ in range(3):
        ask_everything(world)
        world.client.pause(0.5)
    with contextlib.suppress(RefusedError):  # it was not taken in
        view = world.finish("first", 120.0)
        assert view.state == "done" or "float division by zero" in (view.reason or ""), view
    if not calls:
        pytest.skip("it is not called here")
    world.submit(config(), job="second")
    assert world.finish("second", 120.0).state == "done"
    assert not world.service.controller.jobs
    assert world.client.coordinator().counters.broken == 1


def assert_others_go_on(world: World, calls: list[int]) -> None:
    """Submit two jobs while something always breaks for the first: it ends with a sentence, the second with a result.

    A worker leaves and another comes meanwhile.
    """
    world.at(1.0, world.workers["w1"].leave)
    world.at(1.2, lambda: world.crash("w0"))
    world.at(1.4, lambda: world.start_worker("w2"))
    with contextlib.suppress(AtollError):
        world.submit(config(), job="first")
    world.submit(config(), job="second")
    ask_everything(world)
    assert world.finish("second", 60.0).state == "done"
    with contextlib.suppress(AtollError):  # it was not taken in, or the question is answered with what broke
        view = world.finish("first", 60.0)
        assert view.state == "done" or "float division by zero" in (view.reason or ""), view
    if not calls:
        pytest.skip("it is not called here")
    world.submit(config(), job="third")
    assert world.finish("third", 60.0).state == "done"
    assert not world.service.controller.jobs
    assert world.service.controller.breakages.total < 30


@pytest.mark.slow
@pytest.mark.parametrize(
    ("owner", "name"), sample(60, LEFT_OUT | LEFT_OUT_ALWAYS), ids=lambda value: getattr(value, "__name__", value)
)
def test_what_always_breaks_for_one_job_stops_no_other(owner: type, name: str) -> None:
    world = World(workers=2, slowness=10.0)
    with broken_for(owner, name, "first") as calls:
        assert_others_go_on(world, calls)


@pytest.mark.parametrize("name", ["add_report", "_commit_checkpoint"])
def test_a_report_or_checkpoint_that_always_breaks_fails_its_job(name: str) -> None:
    world = World(workers=2, slowness=10.0)
    with broken_for(JobController, name, "first") as calls:
        assert_others_go_on(world, calls)
    assert calls


def test_a_damaged_term_stops_no_other_job() -> None:
    world = World(workers=1, slowness=5.0)
    world.submit(config(), job="first")
    while not world.store.checkpoints("first"):
        world.client.pause(0.1)
    world.network.crash("coordinator")
    world.store._connection.execute("UPDATE archipelagos SET term = -3 WHERE job = 'first'")
    world.service = world.start_service()
    world.submit(config(), job="second")
    assert world.finish("second", 60.0).state == "done"
    view = world.finish("first", 60.0)
    assert view.state == "failed"
    assert "placing islands failed" in (view.reason or "")
    assert "seed 1 and the data as a file" in (view.reason or ""), view.reason


@pytest.mark.parametrize(("owner", "name"), sample(12, LEFT_OUT), ids=lambda value: getattr(value, "__name__", value))
def test_what_breaks_in_a_handler_ends_one_job_at_most(owner: type, name: str) -> None:
    world = World(workers=2)
    with broken_once(owner, name) as calls:
        assert_it_goes_on(world, calls)


@pytest.mark.slow
@pytest.mark.parametrize("kind", get_args(Event), ids=lambda kind: kind.__name__)
def test_what_breaks_over_an_event_of_any_kind_ends_one_job_at_most(
    kind: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    world, calls = World(workers=2), []
    # What a reply answers is looked up first, and its loss would be one that no network has: each `get` ends with one.
    owner, name = (world.service._bus, "count_received") if kind is Reply else (world.service, "_on")
    real = getattr(owner, name)

    def breaks(event: Event) -> None:
        if isinstance(event, kind):
            calls.append(1)
            if len(calls) == 1:
                raise ZeroDivisionError("float division by zero")
        real(event)

    monkeypatch.setattr(owner, name, breaks)
    world.service.step(Link(True))
    assert_it_goes_on(world, calls)


def open_archipelagos(world: World, job: str) -> Sequence[Archipelago]:
    """Return the archipelagos of a job that are searched."""
    return world.service.controller.jobs[job].open_archipelagos if job in world.service.controller.jobs else ()


def test_a_report_of_generations_without_end_is_refused() -> None:
    """Their slices are not even listed."""
    world = World(workers=2)
    world.submit(config(), job="first")
    while not (placements := [one.placement for one in open_archipelagos(world, "first") if one.placement]):
        world.client.pause(0.01)
    placement = placements[0]
    said = IslandReport(
        island=placement.islands_of("w0")[0], generations=2**62, hit=None, additions=(), counters=(), best_error=None,
        digest="ab" * 16,
    )  # fmt: skip
    report = EpochReport(
        job="first", variable=placement.variable, term=placement.term, epoch=placement.epoch, islands=(said,)
    )
    stranger = world.network.bus("stranger")
    stranger.put(topics.worker(world.store.cluster, "w0", "report"), encode(report))
    assert world.finish("first").state == "done"
    assert world.service.rejects.total == 1
    assert world.service.controller.breakages.total == 0


Tree = dict[str, Any]
"""A message as plain data."""


def _claim_islands_of_strangers(status: Tree, size: int) -> None:
    placement = {"variable": "x", "term": 1, "islands": size, "reported": size, "commit": 0, "snapshots": [size] * 8}
    status["holdings"] = [*status["holdings"], *({"job": f"no{number}", **placement} for number in range(9))]


def _claim_evaluations(report: Tree, size: int) -> None:
    for island in report["islands"]:
        for slice_ in island["counters"]:
            slice_["evaluations"] = dict.fromkeys(slice_["evaluations"], size)


def _claim_work(status: Tree, size: int) -> None:
    status |= {"progress": size, "counters": {"dropped": size, "memory_bytes": size, "cpu_s": 1e308, "waited_s": 1e308}}


def _claim_waits(status: Tree, size: int) -> None:
    for assignment_status in status["holdings"]:
        assignment_status |= {"waited_s": 9.9e11, "commit": size, "snapshots": [size] * 8}


@pytest.mark.slow
@pytest.mark.parametrize("size", [2**53 - 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1])
@pytest.mark.parametrize(
    ("part", "spoil"),
    [
        ("status", _claim_islands_of_strangers), ("report", _claim_evaluations), ("status", _claim_work),
        ("status", _claim_waits),
    ],
)  # fmt: skip
def test_what_a_peer_claims_breaks_no_sum_of_it(part: str, spoil: Callable[[Tree, int], None], size: int) -> None:
    """A worker lies for a while, then speaks the truth: everybody is answered, and the job ends."""
    world = World(workers=1)
    publish, spoilt = world.network.publish, []

    def lie(sender: Any, key: str, payload: bytes) -> None:
        tree = msgpack.unpackb(payload) if key.endswith(f"/w0/{part}") and world.network.now < 1.2 else {}
        if tree.get("holdings") or tree.get("islands"):
            spoil(tree, size)
            spoilt.append(key)
            payload = msgpack.packb(tree)
        publish(sender, key, payload)

    world.network.publish = lie  # type: ignore[method-assign]
    world.submit(config(), job="first")
    for _ in range(9):
        ask_everything(world)
        world.client.pause(0.2)
    assert world.finish("first").state == "done"
    assert spoilt
    assert world.service.controller.breakages.total == 0
