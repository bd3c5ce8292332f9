"""The loop of a worker on a bus in virtual time, with a coordinator that only welcomes it."""

from collections.abc import Callable

import pytest

from atoll import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll.errors import AtollError
from atoll.wire import topics
from atoll.wire.bus.interface import Event, Query
from atoll.wire.bus.simulated_bus import SimulatedNetwork
from atoll.wire.codec import encode
from atoll.wire.messages.handshake import GreetingAnswer, Welcome
from atoll_island_worker.compute.compute import ComputeFailed, WarmedUp
from atoll_island_worker.worker import Worker


class RecordingCompute:
    """A compute port that records what it is told to do; a test posts what comes of it."""

    progress = 0
    doing = None

    def __init__(self) -> None:
        self.calls: list[tuple[object, ...]] = []
        self.post: Callable[[object], None] = lambda item: None

    def attach(self, post: Callable[[object], None]) -> None:
        self.post = post

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *arguments: self.calls.append((name, *arguments))


class Pair:
    """A worker, its compute port and its coordinator on one network."""

    def __init__(self) -> None:
        self.network = SimulatedNetwork()
        self.compute = RecordingCompute()
        self._coordinator = self.network.bus("coordinator", is_router=True)
        self._coordinator.handle_with(self._answer)
        self._coordinator.serve(topics.all_greetings())
        bus = self.network.bus("w")
        self.worker = Worker(bus, self.compute, "w", wait_s=60.0)  # type: ignore[arg-type]
        bus.handle_with(self.worker.step)
        self.worker.start()
        self.run()

    def run(self, seconds: float = 0.1) -> None:
        self.network.run(self.network.now + seconds)

    def post(self, item: object) -> None:
        """Have the compute port post something."""
        self.compute.post(item)
        self.run()

    def _answer(self, event: Event) -> None:
        if isinstance(event, Query):
            welcome = Welcome(
                realm="realm", incarnation=1, protocol=PROTOCOL_VERSION, version=VERSION, engine=ENGINE_REVISION
            )
            self._coordinator.reply(event, encode(GreetingAnswer(body=welcome)))


@pytest.fixture
def pair() -> Pair:
    pair = Pair()
    pair.post(WarmedUp(0.1, "fingerprint"))
    return pair


def test_a_worker_ends_with_an_error_when_its_compute_thread_fails(pair: Pair) -> None:
    assert pair.worker.exit_code is None
    pair.post(ComputeFailed("the compute thread failed: KeyError: 'job'"))
    assert pair.worker.exit_code == AtollError.exit_code == 1
    assert str(pair.worker.error) == "the compute thread failed: KeyError: 'job'"
