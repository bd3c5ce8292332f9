"""When the time of a task begins; what a process does with what it is told is tested with real ones, at the worker."""

import socket

import pytest

from atoll.tasks.process import main
from atoll_core.task_frames import OTHER_VERSION


def test_a_process_of_another_version_ends_before_it_touches_its_pipe() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs, pytest.raises(SystemExit) as ended:
        main(theirs.fileno(), 30, "0.0/1/1")
    assert ended.value.code == OTHER_VERSION
