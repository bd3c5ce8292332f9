"""The inbox keeps order and bounds memory; alarms ring once."""

import threading

from atoll_core.wire.bus.interface import Message, Posted, Query, Reply
from atoll_core.wire.bus.queues import INBOX_BYTES, Inbox, Outbox


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
