"""On a real router: strangers' messages are counted, and the answer is that of the undisturbed run."""

import contextlib
import threading
from collections import Counter
from collections.abc import Callable, Iterator

import pytest

from atoll.client.client import Client
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.tasks.background import Dependencies
from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig
from atoll_core.wire import topics
from atoll_core.wire.bus.zenoh_bus import ZenohBus, open_client, open_router
from atoll_island_worker.worker import Worker
from tests.integration.local_tasks import LocalTasks
from tests.simulation.harness.simulated_cluster import World, comparable
from tests.simulation.harness.stub_islands import StubCompute
from tests.simulation.hostile_messages import Mutator, Score, is_understood, key_for, overhear
from tests.simulation.test_failures import nonsense

LIMIT_S = 60.0
CONFIG = JobConfig(seed=1, evolution=EvolutionConfig(islands=4), budget=BudgetConfig(max_epochs=14))


class AtOnce:
    """A network without time, for the stub: what is to happen later happens now."""

    now = 0.0

    def at(self, time_s: float, action: Callable[[], None]) -> None:
        action()


def work(endpoint: str, name: str, made: list[Worker]) -> None:
    with open_client(endpoint, wait_s=LIMIT_S) as bus:
        worker = Worker(bus, StubCompute(AtOnce(), name, 0), name, wait_s=LIMIT_S, task_process=LocalTasks())  # type: ignore[arg-type]
        made.append(worker)
        worker.run()


@contextlib.contextmanager
def served() -> Iterator[tuple[Service, Client, ZenohBus, list[Worker]]]:
    """Have a coordinator and two workers at work; yield it, a client, a stranger's bus, and the workers."""
    stop, made = threading.Event(), list[Worker]()
    with Store.open(None) as store, open_router("tcp/127.0.0.1:0") as router:
        dependencies = Dependencies(lambda: "2026-01-01T00:00:00")
        service = Service(router, store, expected_workers=2, dismisses_workers=True, dependencies=dependencies)
        threads = [threading.Thread(target=service.run, args=(stop,))]
        threads += [threading.Thread(target=work, args=(router.endpoint, f"w{index}", made)) for index in range(2)]
        for thread in threads:
            thread.start()
        try:
            with open_client(router.endpoint, wait_s=LIMIT_S) as stranger, open_client(router.endpoint) as bus:
                client = Client(bus, router.endpoint)
                wait_until(lambda: sum(view.state == "ready" for view in client.workers()) == 2, client)
                yield service, client, stranger, made
        finally:
            stop.set()
            for thread in threads:
                thread.join(LIMIT_S)
    assert [worker.exit_code for worker in made] == [0, 0]


@pytest.mark.slow
def test_foreign_messages_change_nothing_on_a_real_router() -> None:
    expected = comparable(World(workers=1, seed=1).run(CONFIG))
    with served() as (service, client, stranger, made):
        cluster = client.welcome.realm
        send_nonsense(stranger.put, cluster)
        # three of four on each key: the router itself drops what is too large
        wait_until(lambda: all(worker.rejects.total >= 3 for worker in made), client)
        wait_until(lambda: service.rejects.total >= 6, client)
        client.submit("job", "", CONFIG, client.upload(b"x,y"))
        wait_until(lambda: client.status("job").state == "done", client)
        assert comparable(client.result("job")) == expected
    assert topics.worker(cluster, "w0", "report") in service.rejects.counts


def test_garbage_on_every_key_while_a_job_runs_changes_nothing() -> None:
    """Mutated messages where true ones go, and what no participant says: at many keys at once, deletions, names."""
    config = CONFIG.model_copy(update={"budget": BudgetConfig(max_epochs=150, stagnation=1000)})
    expected = comparable(World(workers=1, seed=1).run(config))
    messages, mutator, score = overhear(), Mutator(3), Score()
    said: Counter[str] = Counter()
    with served() as (service, client, stranger, _):
        cluster = client.welcome.realm
        client.submit("job", "", config, client.upload(b"x,y"))
        while client.status("job").state != "done":
            assert said.total() < 100_000, "the job does not end"
            for message in messages:
                payload = mutator.mutate(message.payload)
                key = key_for(message, cluster, is_understood(message, payload, score), mutator)
                if key is not None:
                    said[message.kind.__name__] += 1
                    (stranger.get if message.is_question else stranger.put)(key, payload)
            for odd in odd_sayings(stranger, cluster):
                said[odd] += 1
        assert comparable(client.result("job")) == expected
        client.submit("another", "", CONFIG, client.upload(b"x,y"))
        wait_until(lambda: client.status("another").state == "done", client)
        assert service.controller.breakages.total == 0
        assert service.rejects.total > 0
    assert {"ClientRequest", "EpochReport", "Greeting", "Pull", "WorkerStatus"} <= said.keys()


def odd_sayings(stranger: ZenohBus, cluster: str) -> Iterator[str]:
    """Say what no participant of ours can say by its bus; yield names of it."""
    session = stranger._session
    for key in ("atoll/**", f"atoll/{cluster}/**", f"atoll/{cluster}/worker/*/report", topics.all_clients(cluster)):
        session.put(key, b"\xc1")
        session.delete(key)
        session.get(key, lambda _: None, payload=b"\xc1")
        yield "everywhere"
    for name in ("é", "x" * 300, "w0", "a b", "-"):
        session.liveliness().declare_token(f"atoll/{cluster}/worker/{name}/alive").undeclare()
        session.put(f"atoll/{cluster}/worker/{name}/status", b"", attachment=b"x" * 99)
        yield "names"


def send_nonsense(put: Callable[[str, bytes], None], cluster: str) -> None:
    for key, payload in nonsense(cluster):
        put(key, payload)


def wait_until(condition: Callable[[], bool], client: Client) -> None:
    end = client.now() + LIMIT_S
    while not condition():
        assert client.now() < end, "waited for too long"
        client.pause(0.05)
