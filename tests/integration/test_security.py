"""Certificates and access rules on a real router: who is refused and why, and what a hostile principal can do."""

import contextlib
import socket
import ssl
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from atoll.cli.main import main
from atoll.cli.verbs.serve import upstream_settings
from atoll.client.client import Client, connected
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.tasks.background import Dependencies
from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig
from atoll_core.errors import RefusedError, UnreachableError
from atoll_core.wire import topics
from atoll_core.wire.addresses import Destination, destination
from atoll_core.wire.bus import zenoh_bus
from atoll_core.wire.bus.interface import Message, Presence, Query, Reply
from atoll_core.wire.bus.zenoh_bus import ZenohBus, open_client, open_router
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.clients import ClientRequest, ListJobs
from atoll_core.wire.messages.handshake import Greeting, Hello
from atoll_core.wire.messages.limits import MAX_MESSAGE
from atoll_core.wire.messages.workers import CloseJob, Control, Shutdown
from atoll_core.wire.security.credentials import Credentials, load
from atoll_core.wire.security.roles import RoleBindings, read_role_bindings
from atoll_island_worker.worker import Worker
from tests.certificates import Lab
from tests.integration.local_tasks import LocalTasks
from tests.integration.test_foreign_messages import AtOnce, wait_until
from tests.simulation.harness.simulated_cluster import World, comparable
from tests.simulation.harness.stub_islands import StubCompute

LIMIT_S = 60.0
CONFIG = JobConfig(seed=1, evolution=EvolutionConfig(islands=4), budget=BudgetConfig(max_epochs=14))


@pytest.fixture(scope="module", autouse=True)
def _soon() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zenoh_bus, "_ATTEMPT_MS", 1_000)
        patch.setattr("atoll_core.wire.security.credentials._PROBE_LIMIT_S", 1.0)
        yield


@pytest.fixture(scope="module")
def role_bindings(lab: Lab) -> RoleBindings:
    return read_role_bindings(lab.folder / "roster.toml")


@pytest.fixture(scope="module")
def router(lab: Lab) -> Iterator[ZenohBus]:
    """A router with certificates and no role bindings: what is refused here is refused by the handshake."""
    with open_router(serving(lab)) as bus:
        yield bus


def serving(lab: Lab) -> Destination:
    return destination("tls/127.0.0.1:0", load(*lab.files("coordinator"), use="serve"))


def dialling(bus: ZenohBus, credentials: Credentials, host: str = "localhost") -> Destination:
    return destination(bus.endpoint.replace("127.0.0.1", host), credentials)


def refusal(to: Destination) -> str:
    with pytest.raises(RefusedError) as caught, open_client(to):
        pass
    assert str(caught.value).startswith(f"no connection to the coordinator at {to}: ")
    return str(caught.value).removeprefix(f"no connection to the coordinator at {to}: ")


# -------------------------------------------------------------------------------------------- handshakes


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ann", "lab1"])
def test_a_certificate_of_the_authority_is_let_in(name: str, lab: Lab, router: ZenohBus) -> None:
    with open_client(dialling(router, load(*lab.files(name), use="connect"))):
        pass


def test_whoever_has_no_certificate_is_refused(lab: Lab, router: ZenohBus) -> None:
    address = router.endpoint.replace("tls/", "tcp/")
    place = address.removeprefix("tcp/")
    assert (
        refusal(destination(address)) == f"it asks for TLS; write tls/{place} and give --tls-ca, --tls-cert, --tls-key"
    )
    context = ssl.create_default_context(cafile=lab.files("ann")[0])
    host, port = place.split(":")
    with (
        socket.create_connection((host, int(port))) as plain,
        context.wrap_socket(plain, server_hostname=host) as connection,
        pytest.raises(ssl.SSLError, match="CERTIFICATE_REQUIRED"),
    ):
        connection.recv(1)


def test_a_certificate_of_a_foreign_authority_is_refused(lab: Lab, other_lab: Lab, router: ZenohBus) -> None:
    both = lab.folder / "both.pem"
    both.write_bytes(lab.files("ann")[0].read_bytes() + other_lab.files("ann")[0].read_bytes())
    stranger = load(both, *other_lab.files("ann")[1:], use="connect")
    assert "it trusts another authority than the one that issued our certificate" in refusal(dialling(router, stranger))


def test_a_coordinator_of_a_foreign_authority_is_not_trusted(other_lab: Lab, router: ZenohBus) -> None:
    stranger = load(*other_lab.files("ann"), use="connect")
    assert refusal(dialling(router, stranger)) == (
        f"its certificate was not issued by the authority in {other_lab.files('ann')[0]}"
    )


def test_a_coordinator_that_is_dialled_by_another_name_is_not_trusted(lab: Lab) -> None:
    with open_router(destination("tls/127.0.0.2:0", serving(lab).credentials)) as bus:
        said = refusal(dialling(bus, load(*lab.files("ann"), use="connect")))
    assert said == (
        "its certificate is not for '127.0.0.2' but for lab.example, localhost, 127.0.0.1, ::1; dial it by one of these"
    )


def test_an_expired_certificate_is_refused(lab: Lab, router: ZenohBus) -> None:
    certificate, key = lab.issue("late", days=-1)
    late = lab.unchecked("ann", certificate=certificate, key=key)
    assert refusal(dialling(router, late)) == (f"it finds our certificate {certificate} expired, or its clock is wrong")


def test_a_certificate_for_something_else_is_refused(lab: Lab, router: ZenohBus) -> None:
    certificate, key = lab.issue("server-only", usage="serverAuth")
    other = lab.unchecked("ann", certificate=certificate, key=key)
    assert str(certificate) in refusal(dialling(router, other))


def test_what_does_not_speak_tls_is_told_apart(lab: Lab) -> None:
    with open_router("tcp/127.0.0.1:0") as plain:
        address = plain.endpoint.replace("tcp/", "tls/")
        with pytest.raises(UnreachableError, match="the program that listens there does not speak TLS"):
            open_client(destination(address, load(*lab.files("ann"), use="connect")))


def test_the_command_line_says_it_in_one_sentence_and_exits_with_2(
    lab: Lab, other_lab: Lab, router: ZenohBus, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["jobs", "--connect", router.endpoint, *other_lab.options("ann")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("coordinator: no connection to the coordinator at tls/127.0.0.1:")
    assert said.count("\n") == 1


# ------------------------------------------------------------------------------------------------- roles


@contextlib.contextmanager
def served(lab: Lab, role_bindings: RoleBindings, workers: tuple[str, ...] = ()) -> Iterator[tuple[Service, ZenohBus]]:
    """Have a coordinator, and workers that only hash, serve until the end."""
    stop, made = threading.Event(), list[Worker]()
    with Store.open(None) as store, open_router(serving(lab), role_bindings=role_bindings) as bus:
        dependencies = Dependencies(lambda: "2026-01-01T00:00:00")
        service = Service(
            bus,
            store,
            expected_workers=len(workers),
            dismisses_workers=True,
            dependencies=dependencies,
            role_bindings=role_bindings,
        )
        threads = [threading.Thread(target=service.run, args=(stop,))]
        threads += [threading.Thread(target=work, args=(lab, bus, name, made)) for name in workers]
        for thread in threads:
            thread.start()
        try:
            yield service, bus
        finally:
            stop.set()
            for thread in threads:
                thread.join(LIMIT_S)


def work(lab: Lab, router: ZenohBus, name: str, made: list[Worker]) -> None:
    credentials = load(*lab.files(name.partition("-")[0]), use="connect")
    with open_client(dialling(router, credentials), wait_s=LIMIT_S) as bus:
        worker = Worker(bus, StubCompute(AtOnce(), name, 0), name, wait_s=LIMIT_S, task_process=LocalTasks())  # type: ignore[arg-type]
        made.append(worker)
        worker.run()


@contextlib.contextmanager
def bearing(lab: Lab, router: ZenohBus, name: str) -> Iterator[Client]:
    with connected(dialling(router, load(*lab.files(name), use="connect"))) as client:
        yield client


@pytest.mark.slow
def test_a_hostile_worker_changes_nothing_and_learns_nothing(lab: Lab, role_bindings: RoleBindings) -> None:
    expected = comparable(World(workers=1, seed=1).run(CONFIG))
    with served(lab, role_bindings, ("lab1-0", "lab1-1")) as (service, router):
        credentials = load(*lab.files("lab2"), use="connect")
        with bearing(lab, router, "ann") as ann, open_client(dialling(router, credentials)) as hostile:
            wait_until(lambda: sum(view.state == "ready" for view in ann.workers()) == 2, ann)
            cluster = service._store.cluster
            speak_for_others(hostile, cluster)
            ann.submit("job", "", CONFIG, ann.upload(b"x,y"))
            for _ in range(20):
                speak_for_others(hostile, cluster)
            wait_until(lambda: ann.status("job").state == "done", ann)
            assert comparable(ann.result("job")) == expected
            assert [view.worker for view in ann.workers()] == ["lab1-0", "lab1-1"]
            assert heard(hostile) == [None] * QUESTIONS
    assert service.rejects.total == 0, service.rejects.counts


QUESTIONS = 5


def speak_for_others(hostile: ZenohBus, cluster: str) -> None:
    """Say what only others may say; on the first turn also listen, serve, announce and ask where only others may."""
    for key in (topics.control(cluster), topics.control(cluster, "lab1-0")):
        hostile.put(key, encode(Control(body=CloseJob(job="job"))))
        hostile.put(key, encode(Control(body=Shutdown())))
    for part in ("status", "report"):
        hostile.put(topics.worker(cluster, "lab1-0", part), b"nonsense")  # type: ignore[arg-type]
    if getattr(hostile, "has_asked", False):
        return
    hostile.has_asked = True  # type: ignore[attr-defined]
    for expression in ("atoll/**", topics.all_workers(cluster, "report"), topics.control(cluster, "lab1-0")):
        hostile.subscribe(expression)
    for expression in (
        topics.all_states(cluster),
        topics.all_clients(cluster),
        topics.all_blobs(cluster),
        topics.HELLO,
    ):
        hostile.serve(expression)
    hostile.announce(topics.worker(cluster, "lab1-7", "alive"))
    hostile.watch(topics.all_workers(cluster, "alive"))
    hello = Hello(role="worker", name="lab1-0", instance="x", protocol=0, version="", engine=0)
    for key, body in (
        (topics.client(cluster, "ann-1"), ClientRequest(body=ListJobs())),
        (topics.client(cluster, "lab2-1"), ClientRequest(body=ListJobs())),
        (topics.hello("lab1-0"), Greeting(body=hello)),
        (topics.hello("ann-1"), Greeting(body=hello)),
        (topics.worker(cluster, "lab9", "pull"), ClientRequest(body=ListJobs())),
    ):
        hostile.get(key, encode(body), timeout_s=0.2)


def heard(bus: ZenohBus) -> list[object]:
    """Return the answers that came, after making sure that nothing else did but what was our own."""
    events = [event for event in iter(lambda: bus.receive(0.3), None) if not is_own(event)]
    assert all(isinstance(event, Reply) for event in events), events
    return [event.payload for event in events if isinstance(event, Reply)]


def is_own(event: object) -> bool:
    """Tell whether this is what we said ourselves: a session hears itself without asking the router."""
    if isinstance(event, Message):
        return event.payload == b"nonsense" or event.key.split("/")[2] == "control"
    return (isinstance(event, Presence) and "lab1-7" in event.key) or isinstance(event, Query)


def test_roles_that_do_not_fit_hear_why(lab: Lab, role_bindings: RoleBindings) -> None:
    certificate, key = lab.issue("ghost")
    with served(lab, role_bindings) as (_, router):
        said = "'lab1' has the role worker, which may compute islands, but not submit"
        with pytest.raises(RefusedError, match=said), bearing(lab, router, "lab1"):
            pass
        ghost = dialling(router, load(lab.files("ann")[0], certificate, key, use="connect"))
        with pytest.raises(RefusedError, match=r"roster has no entry for 'ghost-\w+'"), connected(ghost):
            pass
        assert worker_error(lab, router, "ann") == (
            "the certificate of 'ann' has the role submitter, which may submit jobs and look at its own and shared "
            "ones, but not compute islands; use another certificate"
        )


def worker_error(lab: Lab, router: ZenohBus, name: str, wait_s: float = LIMIT_S) -> str:
    with open_client(dialling(router, load(*lab.files(name), use="connect"))) as bus:
        worker = Worker(bus, StubCompute(AtOnce(), name, 0), name, wait_s=wait_s, task_process=LocalTasks())  # type: ignore[arg-type]
        worker.run()
        return str(worker.error)


@pytest.mark.slow
def test_a_router_that_does_not_know_a_name_is_named_as_the_probable_cause(
    lab: Lab, role_bindings: RoleBindings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("atoll_island_worker.connection.GREET_TIMEOUT_S", 0.2)
    old = RoleBindings({name: role for name, role in role_bindings.roles.items() if name not in ("bob", "lab2")})
    stop = threading.Event()
    with Store.open(None) as store, open_router(serving(lab), role_bindings=old) as router:
        service = Service(router, store, role_bindings=role_bindings)
        thread = threading.Thread(target=service.run, args=(stop,))
        thread.start()
        try:
            bob = dialling(router, load(*lab.files("bob"), use="connect"))
            with (
                pytest.raises(
                    UnreachableError, match="access control of the router probably does not know the name 'bob-"
                ),
                connected(bob, wait_s=1.0),
            ):
                pass
            assert "access control" in worker_error(lab, router, "lab2", wait_s=0.8)
        finally:
            stop.set()
            thread.join(LIMIT_S)


def test_the_coordinators_own_certificate_is_enough_for_a_probe(lab: Lab, role_bindings: RoleBindings) -> None:
    with served(lab, role_bindings) as (_, router):
        address = str(dialling(router, load(*lab.files("coordinator"), use="connect")))
        assert main(["ping", "--connect", address, *lab.options("coordinator"), "--wait", "20"]) == 0


def test_jobs_are_private_unless_shared_and_cancelled_by_their_own_or_an_admin(
    lab: Lab, role_bindings: RoleBindings
) -> None:
    with served(lab, role_bindings) as (_, router), contextlib.ExitStack() as stack:
        ann, bob, eve = (stack.enter_context(bearing(lab, router, name)) for name in ("ann", "bob", "eve"))
        table = ann.upload(b"x,y")
        for job in ("one", "two"):
            ann.submit(job, "", CONFIG, table)
        assert bob.jobs() == ()
        with pytest.raises(RefusedError, match="there is no job one"):
            bob.status("one")
        with pytest.raises(RefusedError, match="the id one is taken"):
            bob.submit("one", "", CONFIG, bob.upload(b"x,y"))
        ann.share("one")
        assert [view.job for view in bob.jobs()] == ["one"]
        with pytest.raises(RefusedError, match="job one was submitted by ann; only ann or an admin may cancel it"):
            bob.cancel("one")
        assert ann.cancel("one").state == "cancelled"
        assert [view.job for view in eve.jobs()] == ["one", "two"]
        assert eve.cancel("two").state == "cancelled"


def test_behind_a_sites_router_names_are_fenced_by_that_router(lab: Lab, role_bindings: RoleBindings) -> None:
    at_site = destination("tls/127.0.0.1:0", load(*lab.files("site"), use="serve"))
    with served(lab, role_bindings) as (service, central):
        above = upstream_settings([central.endpoint.replace("127.0.0.1", "localhost")])
        with open_router(at_site, above, role_bindings) as site:
            ann = dialling(site, load(*lab.files("ann"), use="connect"))
            with (
                connected(ann, wait_s=LIMIT_S) as client,
                open_client(dialling(site, lab.unchecked("lab2"))) as hostile,
            ):
                assert client.jobs() == ()
                for name in ("lab1-0", "lab2-0"):
                    hostile.put(topics.worker(service._store.cluster, name, "report"), b"nonsense")
                wait_until(lambda: service.rejects.total > 0, client)
                assert client.jobs() == ()
    assert list(service.rejects.counts) == [topics.worker(service._store.cluster, "lab2-0", "report")]


def test_a_router_drops_what_is_larger_than_its_key_allows() -> None:
    with open_router("tcp/127.0.0.1:0") as router, open_client(router.endpoint) as stranger:
        router.subscribe(topics.all_workers("r", "status"))
        stranger.get("barrier", timeout_s=5.0)
        assert isinstance(stranger.receive(5.0), Reply)
        for size in (1024 * 1024 + 1, 1000):
            stranger.put(topics.worker("r", "w", "status"), bytes(size))
        event = router.receive(LIMIT_S)
        assert isinstance(event, Message)
        assert len(event.payload) == 1000
        asked = topics.client("r", "ann-1")
        router.serve(asked)
        for size in (MAX_MESSAGE + 1, 1000):
            stranger.get(asked, bytes(size), timeout_s=LIMIT_S)
        question = router.receive(LIMIT_S)
        assert isinstance(question, Query)
        assert len(question.payload) == 1000


def test_role_bindings_need_certificates(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["serve", "--listen", "tcp/127.0.0.1:0", "--state", str(tmp_path), "--roster", str(tmp_path / "r.toml")]
    assert main(words) == 2
    assert "so it needs --tls-ca" in capsys.readouterr().err
