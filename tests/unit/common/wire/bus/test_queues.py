"""The inbox keeps order and bounds memory; alarms ring once."""

import threading

from atoll_core.wire.bus.interface import Message, Posted, Query, Reply
from atoll_core.wire.bus.queues import INBOX_BYTES, Inbox, Outbox, Timers


def test_events_come_in_the_order_in_which_they_were_added() -> None:
    inbox = Inbox()
    for number in range(3):
        inbox.add(Posted(number))
    assert [inbox.take(0.0) for _ in range(4)] == [Posted(0), Posted(1), Posted(2), None]


def test_a_flood_of_messages_is_dropped_but_nothing_else() -> None:
    inbox = Inbox()
    block = bytes(INBOX_BYTES // 4)
    for _ in range(10):
        inbox.add(Message("a", block))
        inbox.add(Query("a", block, None))
    inbox.add(Reply(1, block))
    inbox.add(Posted("x"))
    events = []
    while (event := inbox.take(0.0)) is not None:
        events.append(event)
    assert len(events) == 5
    assert events[3:] == [Reply(1, block), Posted("x")]


def test_after_a_flood_there_is_room_again() -> None:
    inbox = Inbox()
    for _ in range(3):
        for _ in range(6):
            inbox.add(Message("a", bytes(INBOX_BYTES // 4)))
        count = 0
        while inbox.take(0.0) is not None:
            count += 1
        assert count == 3


def test_alarms_ring_in_order_and_only_when_due() -> None:
    timers = Timers()
    timers.add(2.0, "two")
    timers.add(1.0, "one")
    assert timers.pop_due(0.9) is None
    assert [timers.pop_due(2.0) for _ in range(3)] == ["one", "two", None]
    assert timers.next_time() == float("inf")


def test_an_alarm_set_again_rings_only_at_its_new_time() -> None:
    timers = Timers()
    timers.add(1.0, "one")
    timers.add(3.0, "one")
    assert timers.next_time() == 3.0
    timers.add(0.5, "one")
    assert [timers.pop_due(3.0) for _ in range(2)] == ["one", None]


LIMIT_S = 30.0


def fail() -> None:
    raise ValueError("broken")


def test_an_answer_that_breaks_keeps_no_later_one_of_its_party_from_being_sent(caplog) -> None:
    outbox, sent = Outbox(), threading.Event()
    assert outbox.add("ann", 1, fail)
    assert outbox.add("ann", 1, sent.set)
    assert sent.wait(LIMIT_S)
    outbox.close()
    assert "an answer could not be sent" in caplog.text
