"""Workers come, go, hang and return; who is there is decided by this alone."""

from atoll_coordinator.service.workers.membership import (
    ABSENCE_S,
    LEASE_S,
    MEMBER_TRANSITIONS,
    STANDING_S,
    Membership,
    version_refusal,
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


def test_every_state_knows_every_step() -> None:
    steps = {"heard", "gone", "back", "expired", "stands", "moves"}
    assert all(row.keys() == steps for row in MEMBER_TRANSITIONS.values())


def test_a_worker_is_ready_once_it_says_so() -> None:
    membership = Membership()
    membership.register(hello(), 0.0)
    assert (membership.ready(), membership.arriving()) == ((), 1)
    membership.record_heartbeat("w0", status("compiling"), 1.0)
    assert (membership.ready(), membership.arriving()) == ((), 1)
    membership.record_heartbeat("w0", status("waiting"), 2.0)
    assert (membership.ready(), membership.arriving()) == (("w0",), 0)


def test_a_worker_gets_islands_only_once_it_has_named_our_kernels() -> None:
    membership = Membership("f")
    membership.register(hello(fingerprint=""), 0.0)
    membership.record_heartbeat("w0", status("ready"), 1.0)
    assert (membership.ready(), membership.arriving()) == ((), 1)
    membership.register(hello(fingerprint="f"), 2.0)
    assert membership.ready() == ("w0",)
    membership.register(hello(fingerprint=""), 3.0)  # sent before, and late
    assert membership.ready() == ("w0",)


def test_heartbeats_of_unknown_processes_are_not_taken_in() -> None:
    membership = with_worker()
    assert not membership.record_heartbeat("stranger", status(), 1.0)
    assert not membership.record_heartbeat("w0", status(instance="other"), 1.0)


def test_a_worker_whose_presence_is_gone_is_lost_after_a_while() -> None:
    membership = with_worker()
    membership.record_presence("w0", False, 1.0)
    assert membership.ready() == ()
    assert membership.expire(1.0 + 0.9 * ABSENCE_S) == []
    assert not membership.is_lost("w0")
    assert membership.expire(1.0 + ABSENCE_S) == [membership.member("w0")]
    assert membership.is_lost("w0")
    assert membership.expire(1.0 + 2 * ABSENCE_S) == []


def test_nobody_is_lost_for_what_the_coordinator_could_not_hear() -> None:
    membership = with_worker()
    membership.register(hello("w1"), 0.0)
    membership.record_heartbeat("w1", status(), 0.0)
    membership.record_presence("w0", False, 0.5)
    membership.renew_leases(60.0)
    assert membership.expire(60.0 + 0.9 * ABSENCE_S) == []
    assert membership.expire(60.0 + ABSENCE_S) == [membership.member("w0")]
    assert membership.expire(60.0 + ABSENCE_S + 1.0) == []


def test_a_worker_whose_presence_returns_in_time_is_not_lost() -> None:
    membership = with_worker()
    membership.record_presence("w0", False, 1.0)
    membership.record_presence("w0", True, 2.0)
    assert membership.ready() == ("w0",)
    assert membership.expire(4.0) == []


def test_a_silent_worker_is_lost_and_comes_back_when_it_is_heard_again() -> None:
    membership = with_worker()
    lost = [(second, member.hello.name) for second in range(1, 30) for member in membership.expire(float(second))]
    assert lost == [(int(LEASE_S), "w0")]
    assert membership.record_heartbeat("w0", status(), 30.0)
    assert membership.ready() == ("w0",)


def test_a_gap_in_our_own_loop_gives_everybody_a_fresh_lease() -> None:
    membership = with_worker()
    membership.expire(1.0)
    assert membership.expire(100.0) == []


def test_the_same_name_is_free_again_when_its_holder_is_gone() -> None:
    membership = with_worker()
    refusal = membership.register(hello(instance="b"), 1.0)
    assert refusal is not None
    assert "--name" in refusal
    membership.record_presence("w0", False, 2.0)
    assert membership.is_new(hello(instance="b"))
    assert membership.register(hello(instance="b"), 2.1) is None
    assert not membership.is_new(hello(instance="b"))
    assert membership.ready() == ()


def test_other_kernels_are_refused_and_both_fingerprints_named() -> None:
    membership = Membership("f")
    refusal = membership.register(hello("w1", fingerprint="g"), 1.0)
    assert refusal is not None
    assert " g," in refusal
    assert "has f;" in refusal
    assert membership.register(hello("w0", fingerprint="f"), 1.0) is None
    assert membership.register(hello("w1", fingerprint=""), 1.0) is None


def test_clients_need_the_same_protocol_only() -> None:
    assert version_refusal(hello(role="client", version="0.0.1")) is None
    refusal = version_refusal(hello(role="client", protocol=99))
    assert refusal is not None
    assert "protocol 99" in refusal
    assert f"protocol {PROTOCOL_VERSION}" in refusal


def test_views_show_what_people_want_to_know() -> None:
    membership = with_worker()
    membership.register(hello("v", "x", cores=8), 1.0)
    first, second = membership.views(3.0)
    assert [(view.cores, view.joined) for view in (first, second)] == [(8, 2.0), (1, 3.0)]
    assert (first.worker, first.state, first.islands) == ("v", "compiling", 0)
    assert (second.worker, second.state, second.islands, second.silent, second.host) == ("w0", "ready", 4, 3.0, "lab")
    membership.record_presence("w0", False, 3.0)
    membership.expire(20.0)
    assert [view.state for view in membership.views(20.0)] == ["lost", "lost"]


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
    assert member.lost_by == "it has computed for 60 s without getting on"
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


def test_a_hung_worker_that_goes_silent_is_lost_without_being_given_up_twice() -> None:
    membership = with_worker()
    compute(membership, 70)
    assert [second for second in range(70, 100) if membership.expire(float(second))] == []
    assert [view.state for view in membership.views(100.0)] == ["lost"]


def test_patience_stretches_every_lease() -> None:
    membership = with_worker()
    lost = [second for second in range(1, 60) if membership.expire(float(second), {"w0": 2.0})]
    assert lost == [int(2 * LEASE_S)]


def test_words_lost_on_our_side_give_everybody_a_fresh_lease() -> None:
    membership = with_worker()
    lost = []
    for second in range(1, 60):
        if second == 10:
            membership.renew_leases(10.0)
        lost += [second for _ in membership.expire(float(second))]
    assert lost == [10 + int(LEASE_S)]
