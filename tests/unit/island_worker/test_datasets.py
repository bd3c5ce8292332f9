"""Downloads: windows, wrong sizes, and the digest of the whole."""

import hashlib

import pytest

from atoll_core.config import JobConfig
from atoll_core.errors import RemoteProtocolError
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.limits import CHUNK_SIZE
from atoll_core.wire.messages.workers import CloseJob, Control, JobAnnouncement
from atoll_island_worker.downloads import Datasets

DATA = bytes(2 * CHUNK_SIZE) + b"rest"


def announcement(data: bytes = DATA, chunks: int = 3, digest: str | None = None) -> JobAnnouncement:
    blob = digest or hashlib.sha256(data).hexdigest()
    return JobAnnouncement(job="j", config=JobConfig(), variables=("x",), blob=blob, size=len(data), chunks=chunks)


def chunk(index: int) -> bytes:
    return DATA[index * CHUNK_SIZE : (index + 1) * CHUNK_SIZE]


def test_an_announcement_whose_numbers_do_not_fit_is_refused() -> None:
    recorder = Recorder()
    with pytest.raises(RemoteProtocolError, match="2 chunks"):
        Datasets(recorder, recorder, lambda job: True).announced(announcement(chunks=2))  # type: ignore[arg-type]
    assert recorder.said == []


class Recorder:
    """Requests and compute thread that record what they are asked for."""

    def __init__(self, wanted: bool = True) -> None:
        self.said: list[tuple[object, ...]] = []
        self.wanted = wanted

    def ask_announcement(self, job: str) -> None:
        self.said.append(("announcement", job))

    def ask_chunk(self, job: str, blob: str, index: int) -> None:
        self.said.append(("chunk", index))

    def ask_later(self, job: str) -> None:
        self.said.append(("later", job))

    def is_wanted(self, job: str) -> bool:
        return self.wanted

    def share(self, job: str, weight: float, user: str) -> None:
        self.said.append(("share", weight, user))

    def load(self, job: str, config: JobConfig, data: bytes) -> None:
        self.said.append(("load", len(data)))

    def discard_job(self, job: str) -> None:
        self.said.append(("discard", job))


def datasets_of(asked: Recorder) -> Datasets:
    return Datasets(asked, asked, asked.is_wanted)  # type: ignore[arg-type]


def test_an_announced_dataset_is_fetched_loaded_and_forgotten() -> None:
    asked = Recorder()
    datasets = datasets_of(asked)
    datasets.announced(announcement())
    datasets.announced(announcement())
    for index in (0, 1, 2):
        datasets.chunk_came("j", index, chunk(index))
    assert asked.said == [("chunk", 0), ("chunk", 1), ("chunk", 2), ("share", 1.0, ""), ("load", len(DATA))]
    datasets.fetch("j")
    assert len(asked.said) == 5
    assert datasets.jobs() == ("j",)
    datasets.forget("j")
    datasets.forget("j")
    assert asked.said[5:] == [("discard", "j")]


def test_a_job_that_was_not_announced_is_asked_for_as_long_as_it_is_wanted() -> None:
    asked = Recorder()
    datasets = datasets_of(asked)
    datasets.fetch("j")
    datasets.announcement_came("j", None)
    datasets.announcement_came("j", encode(Control(body=announcement())))
    assert asked.said == [("announcement", "j"), ("later", "j"), ("chunk", 0), ("chunk", 1)]
    asked.wanted = False
    datasets.announcement_came("k", None)
    datasets.fetch("k")
    assert len(asked.said) == 4


def test_another_answer_than_the_announcement_is_refused() -> None:
    with pytest.raises(RemoteProtocolError, match="'close-job' came"):
        datasets_of(Recorder()).announcement_came("j", encode(Control(body=CloseJob(job="j"))))


def test_a_lost_chunk_is_asked_for_after_a_pause_and_an_unwanted_one_is_dropped() -> None:
    asked = Recorder()
    datasets = datasets_of(asked)
    datasets.announced(announcement())
    datasets.chunk_came("j", 1, None)
    datasets.fetch("j")
    datasets.chunk_came("other", 0, b"")
    assert asked.said == [("chunk", 0), ("chunk", 1), ("later", "j"), ("chunk", 1)]


def test_a_later_announcement_changes_the_share_of_a_job_before_and_after_it_is_loaded() -> None:
    asked = Recorder()
    datasets = datasets_of(asked)
    datasets.announced(announcement())
    datasets.announced(announcement().model_copy(update={"priority": 2, "submitter": "ann"}))
    for index in (0, 1, 2):
        datasets.chunk_came("j", index, chunk(index))
    assert asked.said[3:] == [("share", 4.0, "ann"), ("load", len(DATA))]
    datasets.announced(announcement().model_copy(update={"priority": -1, "submitter": "ann"}))
    assert asked.said[5:] == [("share", 0.5, "ann")]
