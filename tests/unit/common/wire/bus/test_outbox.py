import threading

from atoll_core.wire.bus.outbox import Outbox

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
