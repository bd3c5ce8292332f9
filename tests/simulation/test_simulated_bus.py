"""The simulated network: faults come as planned, and a seed is a history."""

from atoll_core.wire.bus.interface import Event, Link, Message, Presence, Query, Reply, Timer
from tests.simulation.bus.fault_plan import Crash, Partition, Plan
from tests.simulation.bus.network import SimulatedNetwork
from tests.simulation.bus.participant import SimulatedBus


def everything(bus: SimulatedBus, until_s: float = 60.0) -> list[Event]:
    events = []
    while bus.now() < until_s:
        event = bus.receive(until_s - bus.now())
        if event is not None:
            events.append(event)
    return events


def pair(plan: Plan, seed: int = 0) -> tuple[SimulatedNetwork, SimulatedBus, SimulatedBus]:
    network = SimulatedNetwork(seed, plan)
    return network, network.bus("one"), network.bus("two")


def history(seed: int) -> list[tuple[float, str, Event]]:
    plan = Plan(
        drop=0.2, duplicate=0.2, late=0.1, partitions=(Partition("one", 0.5, 1.0),), crashes=(Crash("three", 0.7),)
    )
    network = SimulatedNetwork(seed, plan)
    events: list[tuple[float, str, Event]] = []

    def echo(bus: SimulatedBus, event: Event) -> None:
        events.append((network.now, bus.name, event))
        if isinstance(event, Timer):
            bus.put("x/" + bus.name, b"%d" % len(events))
            bus.call_later(0.05, "again")

    for name in ("one", "two", "three"):
        bus = network.bus(name)
        bus.subscribe("x/*")
        bus.watch("alive/*")
        bus.announce("alive/" + name)
        bus.handle_with(lambda event, bus=bus: echo(bus, event))  # type: ignore[misc]
        bus.call_later(0.05, "again")
    network.run(2.0)
    return events


def test_the_same_seed_is_the_same_history_and_another_seed_another() -> None:
    assert history(3) == history(3)
    assert history(3) != history(4)


def test_puts_on_one_key_stay_in_order_however_late_some_are() -> None:
    _, one, two = pair(Plan(late=0.3))
    two.subscribe("*")
    for number in range(300):
        one.put("xy"[number % 2], b"%d" % number)
    events = [event for event in everything(two) if isinstance(event, Message)]
    for parity, key in enumerate("xy"):
        assert [int(event.payload) for event in events if event.key == key] == list(range(parity, 300, 2))
    assert [int(event.payload) for event in events] != list(range(300))


def test_who_is_cut_off_neither_sends_nor_receives_and_both_sides_are_told() -> None:
    network, one, two = pair(Plan(partitions=(Partition("two", 1.0, 2.0),)))
    two.announce("alive/two")
    two.subscribe("x")
    one.watch("alive/*")
    one.subscribe("y")
    one.serve("q")
    heard_one: list[Event] = []
    heard_two: list[Event] = []
    one.handle_with(heard_one.append)
    two.handle_with(heard_two.append)
    network.at(1.5, lambda: one.put("x", b"lost"))
    network.at(1.5, lambda: two.put("y", b"lost"))
    network.at(1.5, lambda: network.at(0.0, lambda: two.get("q", timeout_s=60.0) and None))
    network.at(2.5, lambda: one.put("x", b"heard"))
    network.run(5.0)
    assert heard_one == [Presence("alive/two", present) for present in (True, False, True)]
    assert heard_two == [Link(False), Reply(1, None), Link(True), Message("x", b"heard")]


def test_who_hangs_takes_in_later_what_has_come_and_a_line_that_is_given_up_carries_nothing() -> None:
    network, one, two = pair(Plan(lease_s=2.0))
    one.watch("alive/*")
    two.announce("alive/two")
    two.subscribe("x")
    heard_one: list[Event] = []
    heard_two: list[tuple[float, Event]] = []
    one.handle_with(heard_one.append)
    two.handle_with(lambda event: heard_two.append((network.now, event)))
    two.call_later(1.5, "meanwhile")
    network.at(1.0, lambda: network.hang("two"))
    network.at(2.0, lambda: one.put("x", b"kept"))
    network.at(4.0, lambda: one.put("x", b"lost"))
    network.at(5.0, lambda: network.resume("two"))
    network.at(6.0, lambda: one.put("x", b"heard"))
    network.run(8.0)
    assert [event for at_s, event in heard_two if at_s == 5.0] == [
        Timer("meanwhile"), Message("x", b"kept"), Link(False), Link(True),
    ]  # fmt: skip
    assert heard_two[-1][1] == Message("x", b"heard")
    assert heard_one == [Presence("alive/two", present) for present in (True, False, True)]


def test_a_router_that_hangs_holds_what_passes_it_and_is_given_up_by_all() -> None:
    network = SimulatedNetwork(0, Plan(lease_s=2.0))
    network.bus("router", is_router=True)
    one, two = network.bus("one"), network.bus("two")
    two.subscribe("x")
    two.serve("q")
    heard: list[tuple[float, Event]] = []
    two.handle_with(lambda event: heard.append((network.now, event)))
    network.at(1.0, lambda: network.hang("router"))
    network.at(1.5, lambda: one.put("x", b"held"))
    network.at(1.6, lambda: one.get("q", timeout_s=9.0) and None)
    network.at(2.0, lambda: network.resume("router"))
    network.at(3.0, lambda: network.hang("router"))
    network.at(5.5, lambda: one.put("x", b"lost"))
    network.at(6.0, lambda: network.resume("router"))
    network.run(8.0)
    assert [(at_s, type(event)) for at_s, event in heard] == [(2.0, Message), (2.0, Query), (5.0, Link), (6.0, Link)]


def test_a_router_that_dies_takes_all_links_with_it_until_another_comes() -> None:
    network = SimulatedNetwork(0)
    network.bus("router", is_router=True)
    one, two = network.bus("one"), network.bus("two")
    two.subscribe("x")
    heard: list[Event] = []
    two.handle_with(heard.append)
    network.at(1.0, lambda: network.crash("router"))
    network.at(1.5, lambda: one.put("x", b"lost"))
    network.at(2.0, lambda: network.bus("router", is_router=True) and None)
    network.at(2.5, lambda: one.put("x", b"heard"))
    network.run(3.0)
    assert heard == [Link(False), Link(True), Message("x", b"heard")]
    assert network.participants == ("one", "two", "router")


def test_what_a_participant_said_in_its_last_moments_may_be_lost() -> None:
    network, one, two = pair(Plan(delay_s=(0.2, 0.2), unsent_s=0.1))
    two.subscribe("x")
    one.put("x", b"sent")
    network.at(0.15, lambda: one.put("x", b"unsent"))
    network.at(0.2, lambda: network.crash("one"))
    assert everything(two, until_s=1.0) == [Message("x", b"sent")]
