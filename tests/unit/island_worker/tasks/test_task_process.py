"""Task processes, real ones: what they say, what ends them, and that none outlives its work."""

import json
import logging
import os
import queue
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from atoll_core.errors import AtollError
from atoll_core.logs import JsonLines, TextLines
from atoll_core.task_frames import (
    OTHER_VERSION,
    Ask,
    BatchComputed,
    Begun,
    Ended,
    Failed,
    FromProcess,
    Give,
    Load,
    ProcessMessage,
    Run,
    Take,
    TaskBatch,
    TaskFinished,
)
from atoll_island_worker.tasks import task_process as module
from atoll_island_worker.tasks.task_process import IDLE_S, Interpreters, TaskProcess, cause_of
from tests.unit.island_worker.tasks.processes import LIMIT_S, is_gone, path_bytes, pid_in, until
from tests.unit.island_worker.tasks.strange_worker import KNOWING

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks at processes in /proc")


class Worker:
    """The loop of a worker, as far as its task process is concerned."""

    def __init__(self) -> None:
        self.now = 0.0
        self.said: queue.SimpleQueue[ProcessMessage] = queue.SimpleQueue()
        self.process = TaskProcess(clock=lambda: self.now)
        self.process.attach(self.said.put)  # type: ignore[arg-type]

    def begin(self, function: str, *inputs: bytes, seconds: float | None = None) -> int:
        return self.process.send(Run("t", function, inputs, seconds))

    def hear(self) -> FromProcess:
        return self.said.get(timeout=LIMIT_S).message

    def run(self, function: str, *inputs: bytes) -> FromProcess:
        """Return what comes of a task, behind its beginning."""
        self.begin(function, *inputs)
        assert self.hear() == Begun("t")
        return self.hear()

    def result(self, function: str, *inputs: bytes) -> bytes:
        made = self.run(function, *inputs)
        assert isinstance(made, TaskFinished), made
        return made.result


@pytest.fixture
def worker(monkeypatch: pytest.MonkeyPatch) -> Iterator[Worker]:
    monkeypatch.setattr(module, "_PROGRAM", KNOWING)
    worker = Worker()
    yield worker
    worker.process.stop()


def test_one_process_runs_task_after_task_elsewhere_until_it_has_done_enough(
    worker: Worker, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "MAX_TASKS", 3)
    assert not worker.process.is_started
    large = os.urandom(3_000_000)
    assert worker.result("echo", large) == large
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "printed by a task\nwritten by a task\n")
    pids = [int(worker.result("pid")) for _ in range(4)]
    assert pids[0] == pids[1] != pids[2] == pids[3]
    assert os.getpid() not in pids
    assert worker.process.is_started
    until(lambda: is_gone(pids[0]))
    monkeypatch.setattr(module, "MAX_MEMORY", 1)
    assert int(worker.result("pid")) != pids[3]


def test_what_breaks_or_has_no_room_is_a_failure_and_the_process_goes_on(
    worker: Worker, caplog: pytest.LogCaptureFixture
) -> None:
    pid = worker.result("pid")
    assert worker.run("fail") == Failed("t", "error", "RuntimeError: planted in two lines")
    (record,) = [record for record in caplog.records if record.getMessage() == "a task failed"]
    assert TextLines({}).format(record).endswith("RuntimeError: planted\nin two lines")
    assert worker.run("starve") == Failed("t", "memory", "memory ran out: no room for a table")
    worker.begin("unheard-of")
    unknown = worker.hear()
    assert isinstance(unknown, Failed)
    assert unknown.failure == "error"
    assert worker.result("pid") == pid


@pytest.mark.parametrize(
    ("function", "number", "failure", "words"),
    [
        ("die", b"9", "memory", "was ended by signal 9 (SIGKILL), as happens when memory runs out"),
        ("die", b"11", "crash", "was ended by signal 11 (SIGSEGV)"),
        ("leave", b"3", "crash", "ended with exit code 3"),
        ("leave_in_order", b"4", "crash", "ended with exit code 4"),
    ],
)
def test_a_process_that_dies_says_how_and_another_follows(
    worker: Worker, function: str, number: bytes, failure: str, words: str
) -> None:
    life = worker.begin(function, number)
    assert worker.hear() == Begun("t")
    said = worker.said.get(timeout=LIMIT_S)
    assert said == ProcessMessage(life, Ended(failure, f"its process {words}"))  # type: ignore[arg-type]
    until(lambda: not worker.process.is_started)
    assert worker.begin("pid") == life + 1
    assert worker.hear() == Begun("t")
    assert isinstance(worker.hear(), TaskFinished)


def test_what_is_stopped_in_the_middle_ends_and_says_nothing_more(worker: Worker, tmp_path: Path) -> None:
    worker.begin("spin", path_bytes(tmp_path / "mark"))
    pid = pid_in(tmp_path / "mark")
    assert worker.hear() == Begun("t")
    worker.process.stop()
    until(lambda: is_gone(pid))
    assert not worker.process.is_started
    assert worker.said.empty()
    worker.begin("spin", path_bytes(tmp_path / "other"))
    worker.process.stop()  # before it can have said its number
    assert all(isinstance(worker.hear(), Begun) for _ in range(worker.said.qsize()))


def test_signals_that_ask_for_an_end_are_for_the_worker(worker: Worker, tmp_path: Path) -> None:
    worker.begin("sleep", path_bytes(tmp_path / "mark"), path_bytes(tmp_path / "until"))
    pid = pid_in(tmp_path / "mark")
    assert os.getsid(pid) == pid  # a Ctrl-C at the terminal does not reach it
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(pid, number)
    (tmp_path / "until").touch()
    assert worker.hear() == Begun("t")
    assert isinstance(worker.hear(), TaskFinished)
    assert int(worker.result("pid")) == pid


def test_what_a_task_logs_is_in_the_worker_s_log(worker: Worker, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO):
        worker.result("log")
    heard, broken = (record for record in caplog.records if record.name == "of.a.task")
    assert TextLines({}).format(heard).endswith("WARNING heard 1 job=j (of.a.task)")
    assert TextLines({}).format(broken).endswith("ValueError: a reason")
    assert json.loads(JsonLines({}).format(broken))["exception"].endswith("ValueError: a reason")


def test_a_process_of_another_version_runs_nothing(worker: Worker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "version", lambda: "0.0/1/1")
    worker.begin("pid")
    assert worker.hear() == Ended("crash", cause_of(OTHER_VERSION)[1])
    assert "the worker must be started again" in cause_of(OTHER_VERSION)[1]


def test_a_process_that_takes_nothing_in_keeps_nobody_waiting(worker: Worker) -> None:
    pid = int(worker.result("pid"))
    os.kill(pid, signal.SIGSTOP)
    worker.begin("echo", b"x" * 10_000_000)
    worker.process.stop()
    until(lambda: is_gone(pid))
    assert worker.result("echo", b"x") == b"x"


def test_what_most_likely_follows_is_loaded_meanwhile(worker: Worker, caplog: pytest.LogCaptureFixture) -> None:
    worker.process.load_next("to load")  # without a process there is nothing to load it
    assert not worker.process.is_started
    assert worker.result("loaded") == b""
    worker.process.load_next("to load")
    until(lambda: "it is loaded" in caplog.text)
    assert worker.result("loaded") == b"loaded"
    assert worker.process.send(Load("unheard-of")) == 1
    assert isinstance(worker.hear(), Ended)


@pytest.mark.parametrize("is_announced", [True, False])
def test_a_process_that_lacks_modules_runs_one_task(
    worker: Worker, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, is_announced: bool
) -> None:
    lacking = KNOWING.replace("import main", "import Connection, serve")
    lacking = lacking.replace(
        "main(int(descriptor), int(level), version)", "serve(Connection(int(descriptor)), 0, is_complete=False)"
    )
    assert "is_complete" in lacking
    monkeypatch.setattr(module, "_PROGRAM", lacking)
    first = int(worker.result("pid"))
    monkeypatch.setattr(module, "_PROGRAM", KNOWING)
    if is_announced:
        worker.process.load_next("to load")
        assert worker.process.is_started
        until(lambda: "it is loaded" in caplog.text)
    second = int(worker.result("pid"))
    assert first != second == int(worker.result("pid"))
    until(lambda: is_gone(first))


def test_a_question_for_batches_is_answered_once_the_task_has_ended(worker: Worker, tmp_path: Path) -> None:
    assert worker.process.send(Ask(1)) == 0
    assert not worker.process.is_started
    worker.begin("sleep", path_bytes(tmp_path / "mark"), path_bytes(tmp_path / "until"))
    assert worker.hear() == Begun("t")
    worker.process.send(Ask(2))
    (tmp_path / "until").touch()
    heard = [worker.hear(), worker.hear()]
    assert Give(2, None) in heard
    assert any(isinstance(one, TaskFinished) for one in heard)


@pytest.mark.slow
@pytest.mark.parametrize("is_killed", [False, True])
def test_another_s_process_computes_batches_of_a_task_and_may_die_with_one(worker: Worker, is_killed: bool) -> None:
    """Two workers as their runners have it: questions, batches and results go to and fro between their processes."""
    helper = Worker()
    helper.process.send(Run("h", "pid", ()))
    while not isinstance(first := helper.hear(), TaskFinished):
        pass
    helper.process.send(TaskBatch(0, "strange: made slowly", "", b"", b""))  # loads what it needs
    assert isinstance(helper.hear(), BatchComputed)
    worker.begin("shared", b"a context: ")
    assert worker.hear() == Begun("t")
    worker.process.send(Ask(0))
    given = 0
    while not isinstance(said := worker.hear(), TaskFinished):
        assert isinstance(said, Give)
        if said.batch is None:
            continue
        given += 1
        if is_killed and given == 3:
            os.kill(int(first.result), signal.SIGKILL)
        helper.process.send(said.batch)
        answer = helper.hear()
        if isinstance(answer, BatchComputed):
            worker.process.send(Take(answer.number, answer.result))
            worker.process.send(Ask(given))
        else:
            assert isinstance(answer, Ended)
    helper.process.stop()
    made = said.result.split(b",")[:-1]
    assert [one.partition(b" by ")[0] for one in made] == [b"a context: %d" % number for number in range(60)]
    by_helper = sum(one.endswith(b" by " + first.result) for one in made)
    assert 1 < by_helper <= given - is_killed


def test_a_process_without_work_ends(worker: Worker) -> None:
    pid = int(worker.result("pid"))
    worker.now = IDLE_S
    worker.process.stop_if_idle()
    assert not is_gone(pid)
    worker.now += 0.1
    worker.process.stop_if_idle()
    until(lambda: is_gone(pid))
    worker.process.stop_if_idle()


class Unresponsive(Interpreters):
    """Its processes end only when the test allows this, as forks of a server that is still loading."""

    def __init__(self) -> None:
        self.may_end = threading.Event()
        self.ends: queue.SimpleQueue[bool] = queue.SimpleQueue()

    def start(self, connection: object) -> module.StartedProcess:
        process = super().start(connection)  # type: ignore[arg-type]
        wait = process.wait

        def delayed(timeout: float) -> int | None:
            self.ends.put(self.may_end.wait(timeout))
            return wait(timeout)

        process.wait = delayed  # type: ignore[method-assign]
        return process


def test_to_stop_a_process_is_not_to_wait_for_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "END_LIMIT_S", LIMIT_S)
    starter = Unresponsive()
    process = TaskProcess(starter)
    process.send(Run("t", "pid", ()))
    process.stop()
    assert not process.is_started
    starter.may_end.set()
    assert starter.ends.get(timeout=2.0 * LIMIT_S), "the process was allowed to end after stop had returned"


class Nowhere(Interpreters):
    def start(self, connection: object) -> module.StartedProcess:
        raise AtollError("no process could be started for it: no room")


def test_a_machine_without_processes_to_spare_is_an_answer_too() -> None:
    said: list[object] = []
    process = TaskProcess(Nowhere())
    process.attach(said.append)
    assert process.send(Run("t", "pid", ())) == 1
    assert said == [ProcessMessage(1, Ended("crash", "no process could be started for it: no room"))]
    assert not process.is_started


def test_a_machine_without_threads_to_spare_is_an_answer_too(worker: Worker, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_thread(*_: object) -> None:
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patched:
        patched.setattr(threading.Thread, "start", no_thread)
        worker.begin("pid")
    ended = worker.hear()
    assert isinstance(ended, Ended)
    assert "can't start new thread" in ended.why
    assert isinstance(worker.run("pid"), TaskFinished)


@pytest.mark.parametrize(
    ("code", "failure", "said"),
    [(3, "crash", "exit code 3"), (-11, "crash", "signal 11 (SIGSEGV)"), (-9, "memory", "memory runs out"),
     (-99, "crash", "signal 99 (unknown)"), (None, "crash", "its process ended")],
)  # fmt: skip
def test_a_cause_is_named(code: int | None, failure: str, said: str) -> None:
    assert cause_of(code)[0] == failure
    assert said in cause_of(code)[1]
