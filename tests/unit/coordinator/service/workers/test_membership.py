"""Workers come, go, hang and return; who is there is decided by this alone."""

from atoll_coordinator.service.workers.membership import (
    LEASE_S,
    STANDING_S,
    Membership,
)
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.wire.messages.handshake import Hello
from atoll_core.wire.messages.tasks import TaskStatus
from atoll_core.wire.messages.views import WorkerState
from atoll_core.wire.messages.workers import AssignmentStatus, Doing, WorkerStatus


def hello(name: str = "w0", instance: str = "a", fingerprint: str = "f", **changes: object) -> Hello:
    fields = {"protocol": PROTOCOL_VERSION, "version": VERSION, "engine": ENGINE_REVISION, **changes}
    return Hello.model_validate(
        {"role": "worker", "name": name, "instance": instance, "fingerprint": fingerprint, "host": "lab", **fields}
    )


def status(state: WorkerState = "ready", instance: str = "a") -> WorkerStatus:
    assignment_status = AssignmentStatus(job="j", variable="x", term=1, islands=4, reported=0, commit=0)
    return WorkerStatus(instance=instance, incarnation=1, state=state, progress=1, holdings=(assignment_status,))


def with_worker(name: str = "w0") -> Membership:
    membership = Membership()
    assert membership.register(hello(name), 0.0) is None
    assert membership.record_heartbeat(name, status(), 0.0)
    return membership


def test_a_gap_in_our_own_loop_gives_everybody_a_fresh_lease() -> None:
    membership = with_worker()
    membership.expire(1.0)
    assert membership.expire(100.0) == []


def test_other_kernels_are_refused_and_both_fingerprints_named() -> None:
    membership = Membership("f")
    refusal = membership.register(hello("w1", fingerprint="g"), 1.0)
    assert refusal is not None
    assert " g," in refusal
    assert "has f;" in refusal
    assert membership.register(hello("w0", fingerprint="f"), 1.0) is None
    assert membership.register(hello("w1", fingerprint=""), 1.0) is None


def test_views_say_what_a_worker_computes_islands_before_tasks() -> None:
    membership, said = with_worker(), status("computing")
    helping, own = (
        TaskStatus(task=name * 64, job="k", state=state) for name, state in (("a", "helping"), ("b", "running"))
    )
    island = Doing(job="j", variable="x", island=3, epoch=7)
    for told, expected in (
        ({}, ""), ({"tasks": (helping,)}, "k/a task of another worker"), ({"tasks": (helping, own)}, "k/a task"),
        ({"tasks": (own,), "doing": island}, "j/x island 3 epoch 7"),
    ):  # fmt: skip
        membership.record_heartbeat("w0", said.model_copy(update=told), 1.0)
        assert membership.views(1.0)[0].doing == expected
    membership.expire(1_000.0)
    assert [(view.state, view.doing) for view in membership.views(1_000.0)] == [("lost", "")]


def test_lost_workers_are_forgotten_in_the_end() -> None:
    membership = with_worker()
    for minute in range(100):
        for second in (0.0, 2.0, 4.0):
            membership.expire(60.0 * minute + second)
    membership.record_presence("w0", False, 6000.0)
    for second in range(6000, 6000 + 4000, 2):
        membership.expire(float(second))
    assert membership.views(11000.0) == ()


def compute(membership: Membership, until: int, progress: int = 1, since: int = 0) -> list[int]:
    """Let w0 be heard every second, always with the same progress; return the seconds at which it was given up."""
    lost = []
    for second in range(since, until):
        membership.record_heartbeat("w0", status("computing").model_copy(update={"progress": progress}), float(second))
        lost += [second for _ in membership.expire(float(second))]
    return lost


def test_a_worker_that_computes_without_getting_on_is_hung_until_it_gets_on() -> None:
    membership = with_worker()
    assert compute(membership, 100) == [int(STANDING_S)]
    assert membership.is_lost("w0")
    assert membership.ready() == ()
    (view,) = membership.views(100.0)
    assert (view.state, view.standing) == ("hung", 100.0)
    member = membership.member("w0")
    assert member is not None
    assert member.lost_by == "it has computed for 60 s without progress"
    membership.record_heartbeat("w0", status("ready"), 101.0)
    assert membership.is_lost("w0")
    membership.record_heartbeat("w0", status("computing").model_copy(update={"progress": 2}), 102.0)
    assert membership.ready() == ("w0",)
    assert compute(membership, 150, progress=2, since=103) == []


def test_loading_waiting_and_getting_on_are_no_hanging() -> None:
    for state in ("compiling", "waiting", "ready"):
        membership = with_worker()
        for second in range(200):
            membership.record_heartbeat("w0", status(state), float(second))  # type: ignore[arg-type]
            assert membership.expire(float(second)) == []
    membership = with_worker()
    for second in range(200):
        membership.record_heartbeat(
            "w0", status("computing").model_copy(update={"progress": second // 50}), float(second)
        )
        assert membership.expire(float(second)) == []


def test_patience_stretches_every_lease() -> None:
    membership = with_worker()
    lost = [second for second in range(1, 60) if membership.expire(float(second), {"w0": 2.0})]
    assert lost == [int(2 * LEASE_S)]
