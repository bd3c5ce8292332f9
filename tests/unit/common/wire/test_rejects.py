"""Dropped messages are counted, and each source is logged once."""

import logging

import pytest

from atoll_core.errors import RemoteProtocolError
from atoll_core.logs import fields_of
from atoll_core.wire.rejects import MAX_SOURCES, OTHERS, Rejects


def test_a_source_is_counted_each_time_and_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    rejects = Rejects(logging.getLogger("test"))
    for _ in range(3):
        rejects.count("atoll/r/worker/w/status", RemoteProtocolError("it is malformed"))
    assert rejects.counts == {"atoll/r/worker/w/status": 3}
    assert [record.getMessage() for record in caplog.records] == ["dropped message"]
    said = fields_of(caplog.records[0])
    assert (said["source"], str(said["reason"])) == ("atoll/r/worker/w/status", "it is malformed")


def test_a_flood_of_sources_does_not_fill_memory(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL)
    rejects = Rejects(logging.getLogger("test"))
    for index in range(MAX_SOURCES + 50):
        rejects.count(f"key{index}", RemoteProtocolError("no"))
    assert len(rejects.counts) == MAX_SOURCES + 1
    assert rejects.counts[OTHERS] == 50
    assert rejects.total == MAX_SOURCES + 50
