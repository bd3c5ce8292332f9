"""Messages to workers over the bus."""

from collections.abc import Iterable

from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Bus
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.epochs import Pull, PullReports, PullStates
from atoll_core.wire.messages.workers import Control, ControlBody

PULL_TIMEOUT_S = 5.0


class WorkerChannel:
    """Sends messages to workers, and stores the pulls that have not been answered."""

    def __init__(self, bus: Bus, cluster: str) -> None:
        self._bus = bus
        self._cluster = cluster
        self._pulls: dict[int, tuple[str, PullReports | PullStates]] = {}

    def send(self, worker: str, body: ControlBody) -> None:
        """Send a message to one worker."""
        self.send_to((worker,), body)

    def send_to(self, workers: Iterable[str], body: ControlBody) -> None:
        """Send a message to some workers, one by one."""
        payload = encode(Control(body=body))
        for worker in workers:
            self._bus.put(topics.control(self._cluster, worker), payload)

    def publish(self, body: ControlBody) -> None:
        """Send a message to all workers."""
        self._bus.put(topics.control(self._cluster), encode(Control(body=body)))

    def pull(self, worker: str, body: PullReports | PullStates) -> None:
        """Ask a worker for reports or states; a reply event follows in any case, after a timeout without an answer."""
        key = topics.worker(self._cluster, worker, "pull")
        self._pulls[self._bus.get(key, encode(Pull(body=body)), PULL_TIMEOUT_S)] = (worker, body)

    def take_pull(self, token: int) -> tuple[str, PullReports | PullStates] | None:
        """Return worker and contents of the pull with this token, once; None: there is no such pull."""
        return self._pulls.pop(token, None)
