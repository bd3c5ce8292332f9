"""Datasets: announced, wanted, loaded and forgotten."""

import hashlib

import pytest

from atoll_core.config import JobConfig
from atoll_core.errors import RemoteProtocolError
from atoll_core.wire.messages.limits import CHUNK_SIZE
from atoll_core.wire.messages.workers import JobAnnouncement
from atoll_island_worker.downloads import Datasets

DATA = bytes(2 * CHUNK_SIZE) + b"rest"
BLOB = hashlib.sha256(DATA).hexdigest()
ANNOUNCEMENT = JobAnnouncement(job="j", config=JobConfig(), variables=("x",), blob=BLOB, size=len(DATA), chunks=3)


class Recorder:
    """A compute thread that records what it is told."""

    def __init__(self) -> None:
        self.said: list[tuple[object, ...]] = []

    def share(self, job: str, weight: float, user: str) -> None:
        self.said.append(("share", weight, user))

    def load(self, job: str, config: JobConfig, data: bytes) -> None:
        self.said.append(("load", len(data)))

    def discard_job(self, job: str) -> None:
        self.said.append(("discard", job))


def test_an_announcement_whose_numbers_do_not_fit_is_refused() -> None:
    datasets = Datasets(Recorder())  # type: ignore[arg-type]
    with pytest.raises(RemoteProtocolError, match="2 chunks"):
        datasets.announced(ANNOUNCEMENT.model_copy(update={"chunks": 2}))
    assert datasets.wanted() == {}


def test_an_announced_dataset_is_wanted_loaded_and_forgotten() -> None:
    compute = Recorder()
    datasets = Datasets(compute)  # type: ignore[arg-type]
    datasets.announced(ANNOUNCEMENT)
    assert datasets.wanted() == {BLOB: len(DATA)}
    datasets.announced(ANNOUNCEMENT.model_copy(update={"priority": 2, "submitter": "ann"}))
    datasets.arrived(BLOB, DATA)
    assert datasets.wanted() == {}
    assert compute.said == [("share", 4.0, "ann"), ("load", len(DATA))]
    datasets.announced(ANNOUNCEMENT.model_copy(update={"priority": -1}))
    assert datasets.jobs() == ("j",)
    datasets.forget("j")
    datasets.forget("j")
    assert compute.said[2:] == [("share", 0.5, ""), ("discard", "j")]


def test_a_dataset_that_is_on_its_way_is_no_longer_wanted_when_its_job_is_forgotten() -> None:
    datasets = Datasets(Recorder())  # type: ignore[arg-type]
    datasets.announced(ANNOUNCEMENT)
    datasets.forget("j")
    assert (datasets.wanted(), datasets.jobs()) == ({}, ())
