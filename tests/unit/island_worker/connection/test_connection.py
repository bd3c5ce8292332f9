"""The connection to the coordinator: what greetings carry, what their answers change, absence and drain."""

import pytest

from atoll_core import PROTOCOL_VERSION, VERSION
from atoll_core.errors import RemoteProtocolError, UnreachableError
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.handshake import GreetingAnswer, Welcome
from atoll_island_worker.connection import RETURN_S, START_S, CoordinatorConnection, PendingRequest, Requests
from atoll_island_worker.session.interface import Reset
from tests.simulation.bus.network import SimulatedNetwork

WAIT_S = 10.0


class SentRequests(Requests):
    """Requests that keep the payloads of greetings."""

    def __init__(self, network: SimulatedNetwork, name: str) -> None:
        super().__init__(network.bus(name), name)
        self.greetings: list[bytes] = []

    def ask(self, key: str, payload: bytes, timeout_s: float, request: PendingRequest) -> None:
        self.greetings.append(payload)


class ConnectionBench:
    """A connection whose greetings are kept."""

    def __init__(self, name: str = "w0", grace_s: float = 30.0, wait_s: float | None = WAIT_S) -> None:
        self.network = SimulatedNetwork()
        self.requests = SentRequests(self.network, name)
        self.connection = CoordinatorConnection(self.requests._bus, self.requests, name, wait_s, None, grace_s)


def welcome(cluster: str = "r", incarnation: int = 1) -> bytes:
    body = Welcome(realm=cluster, incarnation=incarnation, protocol=1, version="0", engine=1)
    return encode(GreetingAnswer(body=body))


def test_a_worker_is_accepted_only_after_a_greeting_with_a_fingerprint() -> None:
    bench = ConnectionBench()
    assert bench.connection.handle_answer("", welcome()) is None
    assert not bench.connection.is_accepted
    bench.connection.kernels_ready("f")
    greetings = len(bench.requests.greetings)
    assert bench.connection.handle_answer("", welcome()) is None
    assert len(bench.requests.greetings) == greetings + 1
    assert bench.connection.handle_answer("f", welcome()) is None
    assert len(bench.requests.greetings) == greetings + 1
    assert bench.connection.is_accepted


def test_another_incarnation_or_cluster_voids_what_is_held() -> None:
    bench = ConnectionBench()
    bench.connection.handle_answer("", welcome())
    assert bench.connection.handle_answer("", welcome(incarnation=2)) == Reset(2)
    assert bench.connection.handle_answer("", welcome(cluster="s")) == Reset(0)
    assert bench.connection.handle_answer("", welcome(cluster="r")) == Reset(0)
    assert bench.requests.cluster == "r"


def test_a_late_welcome_of_a_former_coordinator_voids_nothing() -> None:
    """It answers a greeting that was sent before the present coordinator's welcome came."""
    bench = ConnectionBench()
    bench.connection.handle_answer("", welcome(), 0)
    assert bench.connection.handle_answer("", welcome(incarnation=2), 1) == Reset(2)
    sent = len(bench.requests.greetings)
    assert bench.connection.handle_answer("", welcome(), 1) is None
    assert bench.connection.handle_answer("", welcome(cluster="s"), 1) is None
    assert len(bench.requests.greetings) == sent + 2, "what is there now is asked"
    assert bench.connection.handle_answer("", welcome(incarnation=3), 1) == Reset(3)


def test_a_former_coordinator_that_answers_again_is_not_joined() -> None:
    """One that hung while another took over, or a store that was copied back: its terms would be issued twice."""
    bench = ConnectionBench()
    bench.connection.handle_answer("", welcome(incarnation=2))
    assert bench.connection.handle_answer("", welcome(incarnation=1)) is None
    assert bench.connection.welcome is not None
    assert bench.connection.welcome.incarnation == 2
    bench.connection.handle_enquiry(welcome(incarnation=1))
    bench.network.run(2 * WAIT_S)
    bench.connection.check_absence()
    assert isinstance(bench.connection.error, UnreachableError)
    assert "incarnation 2 has taken over" in str(bench.connection.error)


def test_a_placement_of_a_former_coordinator_is_refused() -> None:
    bench = ConnectionBench()
    bench.connection.handle_answer("", welcome(incarnation=2))
    with pytest.raises(RemoteProtocolError, match="incarnation 2 has taken over"):
        bench.connection.incarnation_heard(1)


def test_a_restart_of_the_coordinator_is_waited_for_longer_than_its_first_answer() -> None:
    """A worker that was started as `serve` prints it, without --wait, outlives an upgrade and a full disk."""
    bench = ConnectionBench(wait_s=None)
    bench.connection.handle_answer("", welcome())
    bench.connection.link_lost()
    bench.network.run(100 * START_S)
    bench.connection.check_absence()
    assert bench.connection.exit_code is None
    bench.network.run(RETURN_S + 1.0)
    bench.connection.check_absence()
    assert bench.connection.exit_code == 3
    alone = ConnectionBench(wait_s=None)
    alone.network.run(START_S + 1.0)
    alone.connection.check_absence()
    assert alone.connection.exit_code == 3, "of a mistaken address one hears soon"


@pytest.mark.parametrize("grace_s", [0.0, 30.0])
def test_a_worker_without_a_coordinator_or_without_grace_ends_at_once(grace_s: float) -> None:
    bench = ConnectionBench(grace_s=grace_s)
    if grace_s == 0.0:
        bench.connection.handle_answer("", welcome())
    assert not bench.connection.drain()
    assert bench.connection.exit_code == 0


def test_an_answer_that_is_not_understood_names_our_version() -> None:
    connection = ConnectionBench().connection
    connection.handle_answer("", b"\x00")
    assert f"Atoll {VERSION} (protocol {PROTOCOL_VERSION})" in str(connection.error)
