"""When the time of a task begins; what a process does with what it is told is tested with real ones, at the worker."""

import socket
from collections.abc import Sequence
from multiprocessing import Pipe

import pytest

from atoll.tasks import functions
from atoll.tasks.functions import FUNCTIONS, TaskHandler
from atoll.tasks.process import TaskLoop, main
from atoll_core.task_frames import OTHER_VERSION, Begun, Finished, Run


@pytest.mark.parametrize(("seconds", "expected"), [(None, ["load", "call"]), (20.0, ["ready", "call"])])
def test_the_time_of_a_task_begins_when_its_process_is_loaded(
    monkeypatch: pytest.MonkeyPatch, seconds: float | None, expected: list[str]
) -> None:
    happened: list[str] = []

    def call(inputs: Sequence[bytes], limit: float | None, team: object) -> bytes:
        assert ours.recv() == Begun("t")
        assert limit == seconds
        happened.append("call")
        return b"made"

    monkeypatch.setattr("logging.basicConfig", lambda **_: None)  # whose handlers would stay
    monkeypatch.setitem(
        FUNCTIONS, "prepare", TaskHandler(lambda: happened.append("load"), lambda: happened.append("ready"), call)
    )
    ours, theirs = Pipe()
    with ours, theirs:
        TaskLoop(theirs, 30)._run(Run("t", "prepare", (), seconds))
        finished = ours.recv()
    assert isinstance(finished, Finished)
    assert (finished.result, finished.memory_bytes > 0) == (b"made", True)
    assert happened == expected


def test_both_functions_are_known_and_each_loads_what_it_needs() -> None:
    assert {"prepare", "refine"} <= FUNCTIONS.keys()
    assert FUNCTIONS["prepare"].ready is functions.ready_preparation
    assert FUNCTIONS["refine"].load is FUNCTIONS["refine"].ready is functions.load_refinement


def test_a_process_of_another_version_ends_before_it_touches_its_pipe() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs, pytest.raises(SystemExit) as ended:
        main(theirs.fileno(), 30, "0.0/1/1")
    assert ended.value.code == OTHER_VERSION
