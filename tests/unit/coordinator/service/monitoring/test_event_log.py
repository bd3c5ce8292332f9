"""Events are logged at once, stored soon, and come back as they were recorded."""

import logging

import pytest

from atoll_coordinator.service.monitoring.event_log import EventLog
from atoll_coordinator.service.store.events import EventRecord
from atoll_coordinator.service.store.store import Store
from atoll_core.logs import fields_of


def test_what_is_recorded_is_logged_with_its_fields_and_comes_back_from_the_store(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    with Store.open(None) as store:
        events = EventLog(store, lambda: "2026-01-01T00:00:00")
        events.record("placed", "4 islands on 2 workers", "a", variable="x", term=3, workers=2, island=None)
        events.record("worker-lost", "silent for 15 s", worker="w1")
        assert store.events(None, 0, 9) == ()
        placed, lost = events.read(None, 0, 9)
        assert events.read("a", 0, 9) == (placed,)
        assert events.read(None, placed.number, 9) == (lost,)
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
        events = EventLog(store, lambda: "")
        before = store.timing().transactions
        events.flush()
        assert store.timing().transactions == before


@pytest.mark.parametrize(
    ("kind", "contents"),
    [("danced", "{}"), ("done", '{"island": "second"}'), ("done", '["done"]'), ("done", "{"), ("done", '{"a": [1]}')],
)
def test_what_another_version_recorded_hides_nothing_else(kind: str, contents: str) -> None:
    with Store.open(None) as store:
        events = EventLog(store, lambda: "2026-01-01T00:00:00")
        store.add_events([EventRecord("a", "2026-01-01T00:00:00", kind, contents)])
        events.record("done", "done", "a")
        assert [event.text for event in events.read("a", 0, 9)] == ["done"]
