"""Tasks between coordinator and workers: what is leased, said again, taken in, released and posted."""

import hashlib

import pytest

from atoll_coordinator.service.tasks.analyses import MAX_OPEN, WANTED_S, RequestedAnalysis
from atoll_coordinator.service.tasks.background import (
    JobPrepared,
    PreparationBegun,
    PreparationFailed,
    RefiningFailed,
    ResultRead,
    TaskResult,
    read_result,
)
from atoll_coordinator.service.tasks.task_controller import HELP_AFTER_S, INLINE, SETTLED_S, TaskController
from atoll_coordinator.service.tasks.task_table import LIMIT_S
from atoll_coordinator.service.workers.membership import Membership
from atoll_coordinator.tasks.preparing import PreparationOutcome, Prepared, prepare
from atoll_coordinator.tasks.refining import Searched
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.config import JobConfig
from atoll_core.errors import RefusedError, RemoteProtocolError
from atoll_core.wire.messages import tasks as messages
from atoll_core.wire.messages.clients import AskAnalysis
from atoll_core.wire.messages.handshake import Hello
from atoll_core.wire.messages.limits import CHUNK_SIZE, MAX_MESSAGE
from atoll_core.wire.messages.views import WorkerState
from atoll_core.wire.messages.workers import ControlBody, WorkerStatus
from atoll_core.wire.values import decode_value, encode_value
from tests.simulation.harness.simulated_cluster import prepare as prepare_stub

TABLE = "c" * 64
CONFIG = JobConfig(seed=3)
PREPARED = prepare(b"x,y", CONFIG.model_dump_json().encode(), prepare_stub)


class Scene:
    """A controller, what it sends and posts, and workers that a test speaks for."""

    def __init__(self, *workers: str, ranks: dict[str, float] | None = None) -> None:
        self.sent: list[tuple[str, ControlBody]] = []
        self.posted: list[object] = []
        self.charged: list[tuple[str, float]] = []
        self.paused: set[str] = set()
        self.forgotten: list[str] = []
        self.following: set[str] = set()
        self.now = 0.0
        self.read_of: list[TaskResult] = []
        self._ended: dict[str, str] = {}
        self.membership = Membership()
        self.controller = TaskController(
            self,
            self.membership,
            self.posted.append,
            self.read,
            lambda waiting, running: sorted(
                (job for job in waiting if job not in self.paused), key=lambda job: (ranks or {}).get(job, 0.0)
            ),
            may_follow=lambda job: job in self.following,
            charge=lambda job, seconds: self.charged.append((job, seconds)),
            forget=self.forgotten.append,
        )
        self.controller.help_after_s = 0.0  # type: ignore[arg-type]
        for worker in workers:
            self.join(worker)

    def read(self, result: TaskResult) -> None:
        self.read_of.append(result)
        self.controller.take_result(read_result(result), self.now)

    def send(self, worker: str, body: ControlBody) -> None:
        self.sent.append((worker, body))

    def join(self, worker: str, host: str = "lab", instance: str = "i") -> None:
        hello = Hello(
            role="worker", name=worker, instance=instance, host=host, protocol=PROTOCOL_VERSION, version=VERSION,
            engine=ENGINE_REVISION,
        )  # fmt: skip
        assert self.membership.register(hello, self.now) is None
        self.beat(worker)

    def beat(self, worker: str, state: WorkerState = "ready", /, **tasks: messages.TaskState) -> None:
        """Let a worker say which tasks it has, by the job whose they are."""
        held = tuple(messages.TaskStatus(task=self.ids[job], job=job, state=what) for job, what in tasks.items())
        status = WorkerStatus(instance="i", incarnation=1, state=state, progress=0, tasks=held)
        self.membership.record_heartbeat(worker, status, self.now)
        self.controller.add_heartbeat(worker, status, self.now)
        self.controller.table.validate()

    @property
    def ids(self) -> dict[str, str]:
        return {**self._ended, **{task.job: task.id for task in self.controller.table}}

    def prepare(self, job: str = "j", config: JobConfig = CONFIG) -> None:
        self.controller.prepare(job, TABLE, 3, config, self.now)
        self._ended = {**self._ended, job: self.controller.table.of_job(job)[0].id}

    def chunk(  # what a worker says
        self, worker: str, job: str, result: bytes, offset: int = 0, data: bytes | None = None, seconds: float = 0.0
    ) -> None:  # fmt: skip
        data = result[offset : offset + CHUNK_SIZE] if data is None else data
        body = messages.TaskChunk(
            task=self.ids[job], digest=hashlib.sha256(result).hexdigest(), size=len(result), offset=offset, data=data,
            seconds=seconds,
        )  # fmt: skip
        self.controller.add_report(worker, messages.TaskReport(body=body), self.now)
        self.controller.table.validate()

    def fail(self, worker: str, job: str = "j", failure="error", term: int | None = None) -> None:
        task = self.controller.table.get(self.ids[job])
        body = messages.TaskFailed(
            task=self.ids[job], term=term or (task.term if task else 1), failure=failure, sentence="it broke"
        )
        self.controller.add_report(worker, messages.TaskReport(body=body), self.now)
        self.controller.table.validate()

    def said(self, kind: type = object) -> list[tuple[str, ControlBody]]:
        """Return, once, what was sent."""
        said, self.sent = self.sent, []
        return [(worker, body) for worker, body in said if isinstance(body, kind)]

    def leased_to(self) -> list[str]:
        return [worker for worker, _ in self.said(messages.Lease)]


def test_a_table_is_leased_begun_and_prepared() -> None:
    scene = Scene("w0")
    scene.prepare()
    ((worker, lease),) = scene.said()
    assert isinstance(lease, messages.Lease)
    assert (worker, lease.job, lease.function, lease.term, lease.seconds) == ("w0", "j", "prepare", 1, None)
    assert (lease.inputs[0].digest, lease.inputs[0].size, lease.inputs[0].data) == (TABLE, 3, None)
    assert lease.inputs[1].data == CONFIG.model_dump_json().encode()
    scene.beat("w0", j="running")
    scene.beat("w0", j="running")
    assert scene.posted == [PreparationBegun("j")]
    scene.chunk("w0", "j", PREPARED)
    assert isinstance(scene.posted[1], JobPrepared)
    assert hashlib.sha256(scene.posted[1].data).hexdigest() == scene.posted[1].prepared.blob
    assert scene.said() == [("w0", messages.Release(task=lease.task))]
    assert len(scene.controller.table) == 0
    assert decode_value(scene.controller.encoded("j"), Prepared).config == scene.posted[1].prepared.config


def test_refining_is_taken_over_though_less_of_its_time_is_left_then() -> None:
    before = refining("j", "w0", seconds=20.0)
    after = refining("j", "w1", seconds=19.5)
    assert after.ids["j"] == before.ids["j"]


def test_a_result_comes_in_chunks_also_from_the_beginning_again() -> None:
    scene = Scene("w0")
    scene.prepare()
    result = PREPARED
    for offset in (0, 100):
        scene.chunk("w0", "j", result, offset, result[offset : offset + 100])
    for offset in (0, 50):  # the worker was told again to push it
        scene.chunk("w0", "j", result, offset, result[offset : offset + 50])
    with pytest.raises(RemoteProtocolError, match="byte 50"):
        scene.chunk("w0", "j", result, 50, result[50:100])
    with pytest.raises(RemoteProtocolError, match="out of order"):
        scene.chunk("w0", "j", result, 100, result[100:] + b"x")
    scene.chunk("w0", "j", result, 100, result[100:])
    assert isinstance(scene.posted[0], JobPrepared)


def test_a_result_that_is_longer_than_can_be_given_to_anybody_is_not_taken_in() -> None:
    scene = refining("j", "w0")
    scene.posted.clear()
    for _ in range(2):
        assert scene.posted == []
        scene.chunk("w0", "j", bytes(2 * MAX_MESSAGE))
    (failed,) = scene.posted
    assert isinstance(failed, RefiningFailed)
    assert "its result has 32 MB; at most 16 MB are accepted, twice" in str(failed.refinement)


def test_a_dataset_that_is_not_the_one_that_is_named_counts_as_a_mistake_of_the_task() -> None:
    scene = Scene("w0")
    scene.prepare()
    made = decode_value(PREPARED, PreparationOutcome)
    for _ in range(2):
        assert scene.posted == []
        scene.chunk("w0", "j", encode_value(PreparationOutcome(made.encoded, made.data + b"x")))
    (failed,) = scene.posted
    assert isinstance(failed, PreparationFailed)
    assert "does not have the digest" in failed.sentence


def test_a_worker_speaks_for_its_own_task_only() -> None:
    scene = Scene("w0", "w1")
    scene.prepare()
    (worker,) = scene.leased_to()
    other = {"w0": "w1", "w1": "w0"}[worker]
    scene.chunk(other, "j", PREPARED)
    scene.fail(other)
    assert scene.posted == []
    assert scene.said() == [(other, messages.Release(task=scene.ids["j"]))] * 2
    assert scene.controller.table.on(worker) is not None


def test_a_broken_task_asks_for_a_report() -> None:
    scene = refining("j", "w0")
    for _ in range(2):
        scene.fail("w0", failure="error")
    (refined,) = [item for item in scene.posted if isinstance(item, RefiningFailed)]
    (warning,) = refined.refinement.warnings
    assert refined.refinement.end == "not refined"
    assert "Refining failed (it broke, twice); equations are as the search found them" in warning
    assert all(part in warning for part in (f"Atoll {VERSION}", "seed 3", "command", "to_csv"))
    assert "a bug in Atoll" in warning
    scene = Scene("w0")
    scene.prepare()
    for _ in range(2):
        scene.fail("w0", failure="crash")
    (failed,) = scene.posted
    assert "preparing the data failed (it broke, twice)" in failed.sentence
    assert f"Atoll {VERSION}" in failed.sentence


def test_large_inputs_are_kept_as_long_as_one_of_the_jobs_needs_them() -> None:
    scene = Scene("w0")
    data = b"x" * (INLINE + 1)
    given = [scene.controller._input(job, data) for job in ("a", "b")]
    assert given[0] == given[1]
    assert given[0].data is None
    scene.controller.cancel("b")
    assert scene.controller.chunk(given[0].digest, 0) == data
    assert scene.controller.chunk(given[0].digest, 1) == b""
    scene.controller.cancel("a")
    assert scene.controller.chunk(given[0].digest, 0) is None


def test_tasks_go_out_by_the_rank_of_their_jobs_and_say_for_what_they_wait() -> None:
    scene = Scene(ranks={"late": 2.0, "early": 1.0})
    scene.prepare("late")
    scene.prepare("early")
    assert "none has joined" in (scene.controller.waiting_reason("early") or "")
    scene.join("w0")
    assert [body.job for _, body in scene.said(messages.Lease)] == ["early"]
    assert "no other task" in (scene.controller.waiting_reason("late") or "")
    assert scene.controller.waiting_reason("early") is None


def refining(job: str, *workers: str, seconds: float | None = None) -> Scene:
    """Return a scene in which the first worker has a job's refining."""
    scene = Scene(workers[0])
    scene.prepare(job)
    scene.chunk(workers[0], job, PREPARED)
    scene.controller.refine(Searched(job, ()), CONFIG, seconds, scene.now)
    scene._ended = {**scene._ended, job: scene.controller.table.of_job(job)[0].id}
    for worker in workers[1:]:
        scene.join(worker)
    scene.said()
    return scene


# ------------------------------------------------------------------------------- users, pauses and cordons


def test_users_are_charged_while_a_task_runs_and_for_what_no_heartbeat_has_told() -> None:
    scene = Scene("w0")
    scene.prepare()
    scene.now = 4.0
    scene.controller.tick(scene.now)
    assert scene.charged == []  # its process is loading
    scene.beat("w0", j="running")
    for scene.now in (6.0, 9.0):
        scene.controller.tick(scene.now)
    assert scene.charged == [("j", 2.0), ("j", 3.0)]
    scene.chunk("w0", "j", PREPARED, seconds=5.5)
    assert scene.charged[2:] == [("j", 0.5)]


def test_no_more_is_charged_for_a_task_than_the_time_since_it_was_leased() -> None:
    scene = Scene("w0")
    scene.prepare()
    scene.now = 3.0
    scene.chunk("w0", "j", PREPARED, seconds=1e6)
    assert scene.charged == [("j", 3.0)]


def test_a_task_is_helped_with_once_it_has_run_for_as_long_as_a_helper_takes_to_be_ready() -> None:
    scene = refining("j", "w0", "w1")
    scene.controller.help_after_s = HELP_AFTER_S
    scene.beat("w0", j="running")
    assert scene.said(messages.Help) == []
    scene.now += HELP_AFTER_S
    scene.controller.tick(scene.now)
    assert [worker for worker, _ in scene.said(messages.Help)] == ["w1"]


@pytest.mark.parametrize("result", [b"{", b"\xff", b"[]", b'{"job": "another"}'])
def test_a_result_that_is_none_of_its_job_is_made_again_and_then_given_up(result: bytes) -> None:
    scene = refining("j", "w0")
    scene.chunk("w0", "j", result)
    assert [body.function for _, body in scene.said(messages.Lease)] == ["refine"]
    scene.chunk("w0", "j", result)
    (failed,) = [item for item in scene.posted if isinstance(item, RefiningFailed)]
    assert "its result cannot be read" in failed.refinement.warnings[0]


def asked(question: bytes = b"q", job: str = "ended") -> AskAnalysis:
    return AskAnalysis(job=job, function="report", question=question)


def analyse(scene: Scene, question: bytes = b"q") -> RequestedAnalysis:
    return scene.controller.analyse(asked(question), b'{"job": "ended"}', 0, "ann", scene.now)


def test_a_question_is_leased_with_the_result_and_answered_to_whoever_asks() -> None:
    scene = Scene("w0")
    analysis = analyse(scene)
    ((worker, lease),) = scene.said()
    assert isinstance(lease, messages.Lease)
    assert (worker, lease.function, [given.data for given in lease.inputs]) == (
        "w0", "report", [b'{"job": "ended"}', b"q"]
    )  # fmt: skip
    assert analysis.is_open
    scene.chunk("w0", "ended", b"page", seconds=0.0)
    assert scene.posted == []
    assert (analysis.answer, analysis.is_open) == (b"page", False)
    assert scene.controller.analyses.ask(asked(), 5.0) is analysis
    assert scene.said() == [("w0", messages.Release(task=lease.task))]


def test_a_question_that_nobody_asks_again_is_ended_and_forgotten() -> None:
    scene = Scene("w0")
    analysis = analyse(scene)
    scene.said()
    scene.now = WANTED_S
    scene.controller.tick(scene.now)
    assert scene.said() == []
    scene.controller.analyses.ask(asked(), scene.now)
    scene.now = 2.0 * WANTED_S
    scene.controller.tick(scene.now)
    assert len(scene.controller.table) == 1
    scene.now += 1.0
    scene.controller.tick(scene.now)
    assert scene.said() == [("w0", messages.Release(task=analysis.id))]
    assert len(scene.controller.table) == 0
    assert scene.controller.analyses.ask(asked(), scene.now) is None
    assert scene.forgotten == [analysis.id]


def test_questions_of_a_user_are_bounded_and_go_with_their_job() -> None:
    scene = Scene()
    for number in range(MAX_OPEN):
        analyse(scene, b"%d" % number)
    with pytest.raises(RefusedError, match=f"^{MAX_OPEN} of your questions"):
        analyse(scene)
    scene.controller.cancel("ended")
    assert len(scene.controller.table) == 0
    assert [*scene.controller.analyses] == []
    assert len(scene.forgotten) == MAX_OPEN


def test_answers_beyond_what_is_kept_go_first_asked_first_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("atoll_coordinator.service.tasks.analyses.MAX_KEPT", 10)
    scene = Scene("w0")
    for number in range(3):
        scene.now = float(number)
        analyse(scene, b"%d" % number)
        scene.chunk("w0", "ended", b"12345")
    scene.controller.tick(scene.now)
    assert [analysis.asked_at for analysis in scene.controller.analyses] == [1.0, 2.0]


def test_a_result_that_is_read_in_the_background_is_neither_asked_for_again_nor_overdue() -> None:
    scene = Scene("w1")
    scene.prepare()
    unread: list[TaskResult] = []
    scene.controller._read = unread.append
    scene.chunk("w1", "j", PREPARED)
    scene.sent.clear()
    scene.now += SETTLED_S + 1.0
    scene.chunk("w1", "j", PREPARED)
    scene.beat("w1", j="done")
    scene.now += 2 * LIMIT_S
    scene.controller.tick(scene.now)
    assert (len(unread), scene.sent, scene.posted) == (1, [], [])
    scene.controller.take_result(read_result(unread[0]), scene.now)
    assert [type(item) for item in scene.posted] == [JobPrepared]
    scene.controller.take_result(read_result(unread[0]), scene.now)
    assert len(scene.posted) == 1


@pytest.mark.parametrize("error", [ValueError("ours"), None])
def test_an_error_of_reading_passes_to_the_loop(error: Exception | None) -> None:
    scene = Scene("w1")
    scene.prepare()
    unread: list[TaskResult] = []
    scene.controller._read = unread.append
    scene.chunk("w1", "j", PREPARED)
    with pytest.raises(ValueError if error else RemoteProtocolError):
        scene.controller.take_result(ResultRead(unread[0], is_damaged=not error, error=error), scene.now)
