"""Child processes: what they answer, that they are tried twice, and that none outlives its work or its coordinator."""

import dataclasses
import json
import logging
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.service.background import process_pool as module
from atoll_coordinator.service.background.child_process import ProcessDiedError, cause_of
from atoll_coordinator.service.background.dependencies import Dependencies
from atoll_coordinator.service.background.job_tasks import (
    JobPrepared,
    JobRefined,
    PreparationFailed,
    prepare_job,
    prepare_table,
    refine,
    refine_job,
)
from atoll_coordinator.service.background.process_pool import ProcessPool, TaskCancelledError
from atoll_coordinator.service.background.runner import TaskRunner
from atoll_coordinator.service.jobs.job import Prepared
from atoll_coordinator.service.monitoring.breakages import what_to_send
from atoll_coordinator.service.search.archipelago import Checkpoint
from atoll_coordinator.service.service_loop import Service
from atoll_coordinator.service.store.store import Store
from atoll_core.config import JobConfig, SpaceConfig
from atoll_core.errors import StoreError
from atoll_core.logs import JsonLines, TextLines
from tests.simulation.bus.network import SimulatedNetwork
from tests.task_pools import call
from tests.unit.coordinator.model.shooting.made import DECAY, pools, table
from tests.unit.coordinator.service.background import strange_tasks as strange
from tests.unit.documents import ROOT

LIMIT_S = 120.0


@pytest.fixture
def pool() -> Iterator[ProcessPool]:
    with closing(ProcessPool(at_once=1)) as pool:
        yield pool


def until(condition: Callable[[], bool]) -> None:
    """Wait until something is so."""
    end = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.01)


def is_gone(pid: int) -> bool:
    """Tell whether a child of this process has ended and been seen off."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def pid_in(mark: Path) -> int:
    until(mark.exists)
    return int(mark.read_text("ascii"))


class Doing(threading.Thread):
    """A task under way in a thread; what it ended with."""

    def __init__(self, work: Callable[[], Any]) -> None:
        super().__init__(daemon=True)
        self._work = work
        self.error: Exception | None = None
        self.start()

    def run(self) -> None:
        try:
            self._work()
        except Exception as error:
            self.error = error

    def ended(self) -> Exception | None:
        self.join(LIMIT_S)
        assert not self.is_alive()
        return self.error


def test_a_child_runs_task_after_task_elsewhere(pool: ProcessPool) -> None:
    assert pool.run("j", partial(strange.echo, [1, "two", b"\0" * 1_000_000])) == [1, "two", b"\0" * 1_000_000]
    first = pool.run("j", strange.pid)
    assert first != os.getpid()
    assert pool.run("j", strange.pid, is_queued=True) == first


def plain(what: Any) -> Any:
    """Return data as nested tuples, arrays as their bytes: equal only if every bit is."""
    if isinstance(what, np.ndarray):
        return what.dtype.str, what.shape, what.tobytes()
    if dataclasses.is_dataclass(what):
        return tuple((field.name, plain(getattr(what, field.name))) for field in dataclasses.fields(what))
    if isinstance(what, Mapping):
        return tuple((plain(key), plain(value)) for key, value in what.items())
    if isinstance(what, list | tuple):
        return tuple(map(plain, what))
    return type(what), repr(what)


@pytest.mark.slow
def test_what_children_make_is_what_threads_make_to_the_last_bit(pool: ProcessPool) -> None:
    rows = table(DECAY, ([1.0], [-2.0]), 0.1 * np.arange(40.0), noise=0.02, seed=108)
    config = JobConfig(space=SpaceConfig(operators=("-", "*")))
    prepare = partial(prepare_job, prepare_table, "j", rows.to_bytes(), config)
    here, there = prepare(), pool.run("j", prepare)
    assert isinstance(here, JobPrepared)
    assert isinstance(there, JobPrepared)
    assert plain(there) == plain(here)
    pools_sent = pools(here.prepared.preparation, x=("x", "-0.4*x"))
    refined = [
        work(partial(refine_job, refine, "j", ready.prepared, pools_sent))
        for ready, work in ((here, lambda task: task()), (there, partial(pool.run, "j")))
    ]
    assert refined[0].refinement.simulation is not None
    assert plain(refined[1]) == plain(refined[0])


def test_a_child_starts_ahead_and_does_first_what_it_was_told_first(pool: ProcessPool, tmp_path: Path) -> None:
    pool.preload(partial(strange.sleep, tmp_path / "mark", ROOT))
    assert pool.run("j", strange.pid) == pid_in(tmp_path / "mark")


def test_what_is_awaited_does_not_wait_for_what_is_only_expected(pool: ProcessPool, tmp_path: Path) -> None:
    first = pool.run("j", strange.pid)
    pool.preload(partial(strange.sleep, tmp_path / "mark", tmp_path / "until"))
    assert pid_in(tmp_path / "mark") == first
    assert pool.run("j", strange.pid) != first
    (tmp_path / "until").touch()


def test_a_child_that_is_busy_is_not_without_work(tmp_path: Path) -> None:
    with closing(ProcessPool(idle_s=0.05)) as pool:
        pool.preload(partial(strange.sleep, tmp_path / "mark", tmp_path / "until"))
        pid = pid_in(tmp_path / "mark")
        time.sleep(0.3)
        assert not is_gone(pid)
        (tmp_path / "until").touch()
        until(partial(is_gone, pid))


@pytest.mark.slow
def test_a_child_that_takes_nothing_in_is_ended(tmp_path: Path) -> None:
    with closing(ProcessPool(limit_s=5.0)) as pool:
        os.kill(pool.run("j", strange.pid), signal.SIGSTOP)
        assert pool.run("j", partial(strange.echo, b"x" * (1 << 20))) == b"x" * (1 << 20)


def test_a_child_of_another_version_does_nothing(pool: ProcessPool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("atoll_coordinator.service.background.child_process.version", lambda: "0.0 1 1")
    with pytest.raises(
        ProcessDiedError, match="of another version than the coordinator, which must be started again, twice"
    ):
        pool.run("j", strange.pid)


def test_a_task_whose_process_is_killed_is_done_again(
    pool: ProcessPool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert pool.run("j", partial(strange.die, tmp_path, 1)) == 2
    assert "task lost, run again" in caplog.text


def test_a_task_whose_process_is_killed_twice_is_lost(pool: ProcessPool, tmp_path: Path) -> None:
    with pytest.raises(ProcessDiedError, match=r"signal 9 \(SIGKILL\), as happens when memory runs out, twice"):
        pool.run("j", partial(strange.die, tmp_path, 2))
    assert len(list(tmp_path.iterdir())) == 2


def test_an_error_that_no_task_should_let_through_is_a_death(
    pool: ProcessPool, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ProcessDiedError, match="ended with exit code 1, twice"):
        pool.run("j", strange.fail)
    assert "no task should let through" in capfd.readouterr().err


def test_what_hangs_is_ended(tmp_path: Path) -> None:
    with (
        closing(ProcessPool(limit_s=0.3)) as pool,
        pytest.raises(ProcessDiedError, match="took longer than 0 s and was ended") as caught,
    ):
        pool.run("j", partial(strange.sleep, tmp_path / "mark"))
    assert "twice" not in str(caught.value)  # an hour is lost already, to all who wait for their turn


@pytest.mark.parametrize("how", ["cancel", "close"])
def test_what_nobody_waits_for_ends_at_once(pool: ProcessPool, tmp_path: Path, how: str) -> None:
    doing = Doing(partial(pool.run, "j", partial(strange.spin, tmp_path / "mark")))
    pid = pid_in(tmp_path / "mark")
    pool.cancel("another")
    assert not is_gone(pid)
    _ = pool.cancel("j") if how == "cancel" else pool.close()
    assert isinstance(doing.ended(), TaskCancelledError)
    until(partial(is_gone, pid))


def test_a_cancelled_job_may_be_submitted_again_under_its_id(
    pool: ProcessPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcomes: queue.SimpleQueue[object] = queue.SimpleQueue()
    late: list[Callable[[], None]] = []
    with monkeypatch.context() as patched:
        patched.setattr(threading, "Thread", lambda target, **_: SimpleNamespace(start=lambda: late.append(target)))
        pool.submit("j", partial(strange.echo, 1), outcomes.put, outcomes.put)
    pool.cancel("j")
    pool.submit("j", partial(strange.echo, 2), outcomes.put, outcomes.put)
    late[0]()  # its thread comes late, and finds it cancelled
    assert outcomes.get(timeout=LIMIT_S) == 2
    assert outcomes.empty()


def test_who_waits_for_its_turn_is_stopped_too(pool: ProcessPool, tmp_path: Path) -> None:
    first = Doing(
        partial(pool.run, "first", partial(strange.sleep, tmp_path / "first", tmp_path / "go"), is_queued=True)
    )
    until((tmp_path / "first").exists)
    second, third = (
        Doing(partial(pool.run, name, partial(strange.sleep, tmp_path / name, tmp_path / "go"), is_queued=True))
        for name in ("second", "third")
    )
    assert pool.run("urgent", partial(strange.echo, 1)) == 1
    pool.cancel("second")
    assert isinstance(second.ended(), TaskCancelledError)
    assert not (tmp_path / "third").exists()
    (tmp_path / "go").touch()
    assert first.ended() is None
    assert third.ended() is None
    assert {file.name for file in tmp_path.iterdir()} == {"first", "third", "go"}


def test_a_service_that_ends_ends_its_children(pool: ProcessPool) -> None:
    pid = pool.run("j", strange.pid)
    dependencies = Dependencies(pool)
    stop = threading.Event()
    stop.set()
    with Store.open(None) as store:
        service = Service(SimulatedNetwork(0).bus("coordinator", is_router=True), store, dependencies=dependencies)
        service.run(stop)
    assert is_gone(pid)


def test_a_child_without_work_ends_and_another_follows() -> None:
    with closing(ProcessPool(idle_s=0.05)) as pool:
        first = pool.run("j", strange.pid)
        until(partial(is_gone, first))
        assert pool.run("j", strange.pid) != first


def test_a_child_that_has_done_enough_is_replaced(pool: ProcessPool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_TASKS", 2)
    pids = [pool.run("j", strange.pid) for _ in range(4)]
    assert pids[0] == pids[1] != pids[2] == pids[3]


def test_only_functions_of_modules_are_sent(pool: ProcessPool) -> None:
    with pytest.raises(Exception, match="pickle"):
        pool.run("j", lambda: 1)
    assert pool.run("j", partial(strange.echo, 1)) == 1


def test_signals_that_ask_for_an_end_are_for_the_coordinator(pool: ProcessPool, tmp_path: Path) -> None:
    doing = Doing(partial(pool.run, "j", partial(strange.sleep, tmp_path / "mark", tmp_path / "go")))
    pid = pid_in(tmp_path / "mark")
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(pid, number)
    (tmp_path / "go").touch()
    assert doing.ended() is None
    assert pool.run("j", strange.pid) == pid


def test_what_a_child_logs_is_in_the_log(pool: ProcessPool, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO):
        pool.run("j", strange.log)
    heard, broken = (record for record in caplog.records if record.name == "of.a.child")
    assert TextLines({}).format(heard).endswith("WARNING heard 1 job=j (of.a.child)")
    assert TextLines({}).format(broken).endswith("ValueError: a reason")
    assert json.loads(JsonLines({}).format(broken))["exception"].endswith("ValueError: a reason")


KILLED = """
import sys
from functools import partial
from pathlib import Path
from atoll_coordinator.service.background.process_pool import ProcessPool
from tests.unit.coordinator.service.background import strange_tasks
ProcessPool().run("j", partial(strange_tasks.spin, Path(sys.argv[1])))
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_child_ends_with_its_coordinator(number: signal.Signals, tmp_path: Path) -> None:
    command = [sys.executable, "-c", KILLED, str(tmp_path / "mark")]
    with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE) as coordinator:
        try:
            until((tmp_path / "mark").exists)
            coordinator.send_signal(number)
            _, said = coordinator.communicate(timeout=LIMIT_S)  # until the child, too, has closed its stderr
        finally:
            coordinator.kill()  # else one that does not end would leave a child that computes for ever
    assert said.count(b"Traceback") == (number == signal.SIGINT)  # of the coordinator alone


@pytest.mark.parametrize(("code", "said"), [(3, "exit code 3"), (-11, "signal 11 (SIGSEGV)"), (None, "did not end")])
def test_a_cause_is_named(code: int | None, said: str) -> None:
    assert said in cause_of(code)


TO_SEND = what_to_send(JobConfig(), is_certain=False)


def posted(pool: ProcessPool, refiner: Any = None) -> list[object]:
    """Return what a task runner posts that prepares (without `refiner`) or refines a job."""
    said: list[object] = []
    is_posted = threading.Event()
    dependencies = Dependencies(pool, preparer=strange.prepare_and_die, refiner=refiner)
    work = TaskRunner(dependencies, None, lambda what: (said.append(what), is_posted.set()))  # type: ignore[arg-type]
    nothing: Preparation = None  # type: ignore[assignment]
    if refiner is None:
        work.prepare("j", b"", JobConfig())
    else:
        work.refine("j", Prepared(nothing, JobConfig(), "", 0), {})
    assert is_posted.wait(LIMIT_S)
    return said


@pytest.mark.parametrize(
    ("times", "warning"),
    [
        (1, "try 2"),
        (
            2,
            "Refining broke (its process was ended by signal 9 (SIGKILL), as happens when memory runs out, twice); "
            f"equations are as found{TO_SEND}.",
        ),
    ],
)
def test_a_job_is_done_whatever_refining_dies_of(pool: ProcessPool, tmp_path: Path, times: int, warning: str) -> None:
    (said,) = posted(pool, partial(strange.refine_or_die, tmp_path, times))
    assert isinstance(said, JobRefined)
    assert said.refinement.warnings == (warning,)


@pytest.mark.slow
def test_a_job_fails_when_preparing_it_dies_twice(pool: ProcessPool) -> None:
    said = PreparationFailed(
        "j", "internal", f"preparing the data broke (its process was ended by signal 11 (SIGSEGV), twice){TO_SEND}"
    )
    assert posted(pool) == [said]


def no_thread(*_: Any, **__: Any) -> None:
    raise RuntimeError("can't start new thread")


def test_a_machine_without_threads_to_spare_is_an_answer_too(
    pool: ProcessPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(threading.Thread, "start", no_thread)
    nothing: Preparation = None  # type: ignore[assignment]
    said: list[object] = []
    work = TaskRunner(Dependencies(pool), None, said.append)  # type: ignore[arg-type]
    work.prepare("j", b"", JobConfig())
    work.refine("j", Prepared(nothing, JobConfig(), "", 0), {})
    unprepared, refined = said
    assert isinstance(unprepared, PreparationFailed)
    assert "can't start new thread" in unprepared.sentence
    assert isinstance(refined, JobRefined)
    assert "can't start new thread" in refined.refinement.warnings[0]


def test_an_unforeseen_error_of_a_task_is_an_answer_too(
    pool: ProcessPool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(pool, "_run", no_thread)
    said: queue.SimpleQueue[object] = queue.SimpleQueue()
    pool.submit("j", strange.pid, said.put, said.put)
    assert said.get(timeout=LIMIT_S) == "RuntimeError: can't start new thread"
    assert "task failed" in caplog.text


def test_checkpoints_are_written_in_the_order_in_which_they_came_and_not_here(pool: ProcessPool) -> None:
    done: list[tuple[int, int]] = []
    ready = threading.Event()
    writer = Dependencies(pool).writer
    for number in range(20):
        writer(lambda number=number: done.append((number, threading.get_ident())))  # type: ignore[misc]
    writer(ready.set)
    assert ready.wait(LIMIT_S)
    assert [number for number, _ in done] == list(range(20))
    assert len({thread for _, thread in done} - {threading.get_ident()}) == 1


def test_a_checkpoint_that_cannot_be_written_is_posted_with_its_error(pool: ProcessPool) -> None:
    class FullStore:
        def commit_checkpoint(self, *_: object) -> bool:
            raise StoreError("the disk is full")

    said: list[Any] = []
    runner = TaskRunner(Dependencies(pool, writer=call), FullStore(), said.append)  # type: ignore[arg-type]
    checkpoint = Checkpoint("j", "x", 1, 8, None, {})  # type: ignore[arg-type]
    runner.write(checkpoint, b"", 1.0)
    assert [str(error.error) for error in said] == ["the disk is full"]
