"""Events are logged at once, stored soon, and come back as they were noted."""

import logging

import pytest

from atoll.logs import fields_of
from atoll_coordinator.service.monitoring.event_log import Chronicle
from atoll_coordinator.service.store.store import Store


def test_what_is_noted_is_logged_with_its_fields_and_comes_back_from_the_store(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    with Store.open(None) as store:
        chronicle = Chronicle(store, lambda: "2026-01-01T00:00:00")
        chronicle.note("placed", "4 islands on 2 workers", "a", variable="x", term=3, workers=2, island=None)
        chronicle.note("worker-lost", "silent for 15 s", worker="w1")
        assert store.events(None, 0, 9) == ()
        placed, lost = chronicle.read(None, 0, 9)
        assert chronicle.read("a", 0, 9) == (placed,)
        assert chronicle.read(None, placed.number, 9) == (lost,)
    assert (placed.event, placed.text, placed.job, placed.variable, placed.term) == (
        "placed", "4 islands on 2 workers", "a", "x", 3,
    )  # fmt: skip
    assert (placed.island, placed.details, placed.time) == (None, {"workers": 2}, "2026-01-01T00:00:00")
    assert (lost.job, lost.worker) == (None, "w1")
    first, second = caplog.records
    assert fields_of(first) == {
        "job": "a", "variable": "x", "term": 3, "workers": 2, "text": "4 islands on 2 workers",
    }  # fmt: skip
    assert [first.levelname, second.levelname] == ["INFO", "WARNING"]


def test_nothing_is_written_when_nothing_happened() -> None:
    with Store.open(None) as store:
        chronicle = Chronicle(store, lambda: "")
        before = store.timing().transactions
        chronicle.flush()
        assert store.timing().transactions == before
