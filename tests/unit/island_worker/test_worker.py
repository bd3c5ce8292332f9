"""The loop of a worker on a bus in virtual time, with a coordinator that only welcomes it."""

from collections.abc import Callable
from hashlib import sha256
from typing import ClassVar

import pytest

from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.config import JobConfig
from atoll_core.errors import AtollError
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Event, Query
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.handshake import GreetingAnswer, Welcome
from atoll_core.wire.messages.workers import CloseJob, Control, JobAnnouncement, Placement, Placements
from atoll_island_worker.compute.compute_thread import ComputeFailed, WarmedUp
from atoll_island_worker.session.interface import JobReady
from atoll_island_worker.worker import Worker
from tests.simulation.bus.network import SimulatedNetwork

ControlBody = JobAnnouncement | Placements | CloseJob
DATASET = b"a dataset"
ANNOUNCEMENT = JobAnnouncement(
    job="job", config=JobConfig(), variables=("x",), blob=sha256(DATASET).hexdigest(), size=len(DATASET), chunks=1
)
WELCOME = Welcome(realm="cluster", incarnation=1, protocol=PROTOCOL_VERSION, version=VERSION, engine=ENGINE_REVISION)


class RecordingCompute:
    """A compute port that records what it is told to do; a test posts what comes of it."""

    progress = 0
    current = None
    seconds: ClassVar[dict[str, float]] = {"": 1.5}

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
        self._coordinator.serve(topics.ALL_GREETINGS)
        self._coordinator.serve(topics.all_blobs("cluster"))
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

    def control(self, body: ControlBody) -> None:
        """Have the coordinator send a control message."""
        self._coordinator.put(topics.control("cluster", "w"), encode(Control(body=body)))
        self.run()

    def place(self, term: int = 1) -> None:
        """Announce the job, and place its one island on the worker."""
        self.control(ANNOUNCEMENT)
        self.control(Placements(placements=(placement(term),)))
        self.post(JobReady("job"))

    def _answer(self, event: Event) -> None:
        if not isinstance(event, Query):
            return
        if isinstance(topics.parse(event.key), topics.BlobKey):
            self._coordinator.reply(event, DATASET)
        else:
            self._coordinator.reply(event, encode(GreetingAnswer(body=WELCOME)))


def placement(term: int) -> Placement:
    order = CommitOrder(generations=100, stride=10, joining=8)
    return Placement(
        incarnation=1, term=term, job="job", variable="x", workers=("w",), epochs=10, interval=8, commit_order=order
    )


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
