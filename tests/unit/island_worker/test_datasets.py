"""Downloads: windows, wrong sizes, and the digest of the whole."""

import hashlib
from unittest.mock import Mock, call

import pytest

from atoll_core.config import JobConfig
from atoll_core.errors import RemoteProtocolError
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.limits import CHUNK_SIZE
from atoll_core.wire.messages.workers import CloseJob, Control, JobAnnouncement
from atoll_island_worker.downloads import Datasets

DATA = bytes(2 * CHUNK_SIZE) + b"rest"


def test_an_announcement_whose_numbers_do_not_fit_is_refused() -> None:
    asked, blob = Mock(), hashlib.sha256(DATA).hexdigest()
    wrong = JobAnnouncement(job="j", config=JobConfig(), variables=("x",), blob=blob, size=len(DATA), chunks=2)
    with pytest.raises(RemoteProtocolError, match="2 chunks"):
        Datasets(asked, asked, lambda job: True).announced(wrong)
    assert asked.mock_calls == []


def test_another_answer_than_the_announcement_is_refused() -> None:
    with pytest.raises(RemoteProtocolError, match="'close-job' came"):
        Datasets(Mock(), Mock(), lambda job: True).announcement_came("j", encode(Control(body=CloseJob(job="j"))))


def test_a_job_that_was_not_announced_is_asked_for_as_long_as_it_is_wanted() -> None:
    asked, wanted = Mock(), [True]
    datasets = Datasets(asked, Mock(), lambda job: wanted[0])
    datasets.fetch("j")
    datasets.announcement_came("j", None)
    assert asked.mock_calls == [call.ask_announcement("j"), call.ask_later("j")]
    wanted[0] = False
    datasets.announcement_came("k", None)
    datasets.fetch("k")
    assert len(asked.mock_calls) == 2
