"""Whatever goes through a metered bus is counted by its kind."""

from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Message, Query, Reply
from atoll_core.wire.bus.metered_bus import OTHER, MeteredBus, kind_of
from atoll_core.wire.messages.views import Traffic
from tests.simulation.bus.network import SimulatedNetwork

CLUSTER = "r"


def counted(bus: MeteredBus) -> dict[str, tuple[int, int, int, int]]:
    def numbers(traffic: Traffic) -> tuple[int, int, int, int]:
        return traffic.messages_in, traffic.bytes_in, traffic.messages_out, traffic.bytes_out

    return {traffic.kind: numbers(traffic) for traffic in bus.traffic()}


def test_keys_that_are_none_of_ours_have_one_kind() -> None:
    keys = (topics.states(CLUSTER, "j"), topics.blob(CLUSTER, "0" * 64, 3), "atoll/r/nonsense", "x" * 1000)
    assert [kind_of(key) for key in keys] == ["state", "blob", OTHER, OTHER]


def test_puts_questions_and_answers_are_counted_on_both_sides() -> None:
    network = SimulatedNetwork()
    server, asker = MeteredBus(network.bus("server", is_router=True)), MeteredBus(network.bus("asker"))
    server.serve(topics.all_clients(CLUSTER))
    server.subscribe(topics.all_workers(CLUSTER, "report"))
    asker.put(topics.worker(CLUSTER, "w", "report"), b"12345")
    token = asker.get(topics.client(CLUSTER, "c"), b"123")
    for _ in range(2):
        event = server.receive(1.0)
        assert isinstance(event, Message | Query)
        server.count_received(event)
        if isinstance(event, Query):
            server.reply(event, b"1234567")
    reply = asker.receive(1.0)
    assert reply == Reply(token, b"1234567")
    asker.count_received(reply)
    assert counted(asker) == {"report": (0, 0, 1, 5), "ask": (1, 7, 1, 3)}
    assert counted(server) == {"report": (1, 5, 0, 0), "ask": (1, 3, 1, 7)}


def test_a_question_without_answer_counts_as_sent_only() -> None:
    asker = MeteredBus(SimulatedNetwork().bus("asker", is_router=True))
    token = asker.get(topics.HELLO, b"1", timeout_s=0.5)
    asker.count_received(Reply(token, None))
    assert counted(asker) == {"hello": (0, 0, 1, 1)}
