"""Checkpoints are written in the order in which they came, and not on the service's loop."""

import threading
from typing import Any

from atoll_coordinator.service.search.archipelago import Checkpoint
from atoll_coordinator.service.tasks.background import Background, CheckpointWritten, Dependencies
from atoll_core.errors import StoreError

LIMIT_S = 60.0


def checkpoint(epoch: int) -> Checkpoint:
    return Checkpoint("j", "x", 1, epoch, None, {})  # type: ignore[arg-type]


class Disk:
    """A store that notes what is written to it where, and is full from some epoch on."""

    def __init__(self, full_from: int = 1000) -> None:
        self.written: list[tuple[int, int]] = []
        self._full_from = full_from

    def commit_checkpoint(self, job: str, variable: str, epoch: int, *_: object) -> None:
        if epoch >= self._full_from:
            raise StoreError("the disk is full")
        self.written.append((epoch, threading.get_ident()))


def test_checkpoints_are_written_in_order_on_one_thread_that_is_not_ours() -> None:
    disk, posted, last = Disk(), [], threading.Event()

    def post(item: object) -> None:
        posted.append(item)
        if len(posted) == 20:
            last.set()

    background = Background(Dependencies().background, disk, post)  # type: ignore[arg-type]
    for epoch in range(20):
        background.write_checkpoint(checkpoint(epoch), b"", 1.0)
    assert last.wait(LIMIT_S)
    assert [epoch for epoch, _ in disk.written] == list(range(20))
    assert len({thread for _, thread in disk.written} - {threading.get_ident()}) == 1
    assert posted == [CheckpointWritten(checkpoint(epoch)) for epoch in range(20)]


def test_a_checkpoint_that_cannot_be_written_is_posted_with_its_error() -> None:
    posted: list[Any] = []
    background = Background(lambda work: work(), Disk(full_from=8), posted.append)  # type: ignore[arg-type]
    background.write_checkpoint(checkpoint(8), b"", 1.0)
    assert [str(item.error) for item in posted] == ["the disk is full"]
