"""What a worker makes of leases, inputs, its process and helpers; bus and process are played by the test."""

import hashlib

import pytest

from atoll_core.task_frames import (
    Ask,
    BatchComputed,
    Begun,
    Ended,
    Failed,
    FromProcess,
    Give,
    ProcessMessage,
    Progressed,
    Run,
    Take,
    TaskBatch,
    TaskFinished,
    ToProcess,
)
from atoll_core.wire.bus.interface import Query
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.epochs import NotYet, PullAnswer
from atoll_core.wire.messages.limits import CHUNK_SIZE
from atoll_core.wire.messages.tasks import (
    BatchResult,
    GivenBatch,
    Help,
    Lease,
    PullBatch,
    Release,
    TaskChunk,
    TaskFailed,
    TaskInput,
    TaskReport,
)
from atoll_island_worker.tasks.task_runner import TaskRunner

A, B = "a" * 64, "b" * 64
SMALL = b"small"
LARGE = b"x" * CHUNK_SIZE + b"y"


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def lease(task: str = A, *inputs: bytes, term: int = 1, function="prepare") -> Lease:
    given = tuple(
        TaskInput(digest=digest(data), size=len(data), data=data if data is SMALL else None)
        for data in inputs or (SMALL,)
    )
    return Lease(task=task, term=term, job="j", function=function, inputs=given, threads=2)


class Requests:
    """Records what is asked and reported."""

    def __init__(self) -> None:
        self.pulls: list[tuple[str, PullBatch]] = []
        self.reports: list[TaskChunk | TaskFailed] = []

    def ask_batch(self, peer: str, pull: PullBatch) -> None:
        self.pulls.append((peer, pull))

    def publish(self, part: str, message: TaskReport) -> None:
        assert part == "result"
        self.reports.append(message.body)


class Process:
    """Records what the process is told; a new life begins with the first task after an end."""

    def __init__(self) -> None:
        self.said: list[ToProcess] = []
        self.loaded: list[str] = []
        self.life = 0
        self.is_started = False

    def send(self, message: ToProcess) -> int:
        if isinstance(message, Run | TaskBatch) and not self.is_started:
            self.is_started, self.life = True, self.life + 1
        self.said.append(message)
        return self.life

    def load_next(self, function: str) -> None:
        self.loaded.append(function)

    def stop(self) -> None:
        self.is_started = False

    def told(self, kind: type) -> list:
        told, self.said = [one for one in self.said if isinstance(one, kind)], []
        return told


class Scene:
    """A runner among what a test plays."""

    def __init__(self) -> None:
        self.requests, self.process = Requests(), Process()
        self.replies: list[tuple[Query, object]] = []
        self.runner = TaskRunner(
            self.requests, self.process, lambda query, answer: self.replies.append((query, answer.body)), lambda: 0.0
        )  # type: ignore[arg-type]

    def say(self, message: FromProcess, life: int | None = None) -> bool:
        """Let the process say something."""
        return self.runner.process_said(ProcessMessage(self.process.life if life is None else life, message))

    def states(self) -> dict[str, str]:
        return {held.task: held.state for held in self.runner.statuses()}

    def running(self, task: str = A, function="refine") -> None:
        self.runner.handle(lease(task, function=function))
        self.say(Begun(task))
        self.process.said.clear()

    def give_batch(self, number: int = 7, context: bytes = b"a context", known: bool = False) -> None:
        given = GivenBatch(
            number=number, function="f", digest=digest(context), context=b"" if known else context, item=b"i"
        )
        self.runner.batch_came(B, encode(PullAnswer(body=given)))


@pytest.fixture
def scene() -> Scene:
    return Scene()


def test_a_lease_with_its_inputs_runs_and_its_result_is_pushed_and_kept(scene: Scene) -> None:
    assert scene.runner.is_idle
    scene.runner.handle(lease())
    assert scene.process.told(Run) == [Run(A, "prepare", (SMALL,), None, 2, "j")]
    assert (scene.states(), scene.runner.is_idle) == ({A: "waiting"}, False)
    assert scene.say(Begun(A))
    assert scene.states() == {A: "running"}
    assert scene.say(TaskFinished(A, b"made"))
    (chunk,) = scene.requests.reports
    assert (chunk.data, chunk.digest, chunk.size) == (b"made", digest(b"made"), 4)  # type: ignore[union-attr]
    assert scene.states() == {A: "done"}
    assert scene.process.loaded == ["refine"]
    scene.runner.handle(Release(task=A))
    assert scene.runner.is_idle
    assert scene.process.is_started  # it is kept for the next one


def test_the_heartbeat_says_how_far_a_task_is(scene: Scene) -> None:
    scene.running()
    assert not scene.say(Progressed(A, 7)), "the next heartbeat is soon enough"
    scene.say(Progressed(A, 9), life=scene.process.life + 1)
    assert [held.compared for held in scene.runner.statuses()] == [7]
    scene.say(Progressed(B, 9))


def test_a_result_goes_in_chunks_also_an_empty_one(scene: Scene) -> None:
    scene.running()
    scene.say(TaskFinished(A, LARGE))
    assert [(one.offset, len(one.data)) for one in scene.requests.reports] == [(0, CHUNK_SIZE), (CHUNK_SIZE, 1)]  # type: ignore[union-attr]
    assert b"".join(one.data for one in scene.requests.reports) == LARGE  # type: ignore[union-attr]
    scene.runner.handle(Release(task=A))
    scene.requests.reports.clear()
    scene.running(B)
    scene.say(TaskFinished(B, b""))
    assert [(one.size, one.data) for one in scene.requests.reports] == [(0, b"")]  # type: ignore[union-attr]


def test_missing_inputs_are_wanted_and_kept_for_later_tasks(scene: Scene) -> None:
    scene.runner.handle(lease(A, SMALL, LARGE))
    assert scene.runner.wanted() == {digest(LARGE): len(LARGE)}
    assert (scene.process.said, scene.states()) == ([], {A: "fetching"})
    scene.runner.arrived(digest(b"of another job"), b"of another job")
    scene.runner.arrived(digest(LARGE), LARGE)
    assert [run.inputs for run in scene.process.told(Run)] == [(SMALL, LARGE)]
    scene.say(Failed(A, "error", "it broke"))
    scene.runner.handle(lease(B, LARGE))
    assert scene.runner.wanted() == {}
    assert [run.inputs for run in scene.process.told(Run)] == [(LARGE,)]


def test_a_lease_that_is_said_twice_is_one_task_and_pushes_what_is_there(scene: Scene) -> None:
    scene.runner.handle(lease())
    scene.runner.handle(lease())
    assert len(scene.process.told(Run)) == 1
    scene.say(Begun(A))
    scene.say(TaskFinished(A, b"made"))
    scene.runner.handle(lease(term=2))
    assert len(scene.requests.reports) == 2
    assert scene.requests.reports[0] == scene.requests.reports[1]


def test_a_failure_is_said_again_until_a_new_term_has_it_tried_again(scene: Scene) -> None:
    scene.runner.handle(lease())
    scene.say(Failed(A, "error", "it broke"))
    scene.runner.handle(lease())
    failed = TaskFailed(task=A, term=1, failure="error", sentence="it broke")
    assert scene.requests.reports == [failed, failed]
    assert len(scene.process.told(Run)) == 1
    scene.runner.handle(lease(term=2))  # though no release came
    assert len(scene.process.told(Run)) == 1
    scene.say(Failed(A, "error", "it broke"))
    assert scene.requests.reports[-1] == failed.model_copy(update={"term": 2})


def test_the_release_of_what_runs_ends_its_process(scene: Scene) -> None:
    scene.running()
    scene.runner.handle(Release(task=B))
    assert scene.process.is_started
    scene.runner.handle(Release(task=A))
    assert not scene.process.is_started
    assert not scene.say(TaskFinished(A, b"late"))
    assert scene.requests.reports == []


def test_what_a_process_said_that_was_stopped_is_not_taken_for_the_next_one_s(scene: Scene) -> None:
    scene.running()
    scene.runner.handle(Release(task=A))
    scene.runner.handle(lease(term=2, function="refine"))
    first = scene.process.life - 1
    for late in (Begun(A), TaskFinished(A, b"late"), Failed(A, "error", "late"), Ended("crash", "late")):
        assert not scene.say(late, first)
    assert (scene.states(), scene.requests.reports) == ({A: "waiting"}, [])
    scene.say(Begun(A))
    scene.say(TaskFinished(A, b"made"))
    assert scene.states() == {A: "done"}


def test_tasks_run_one_after_the_other_and_the_end_of_one_ends_no_other(scene: Scene) -> None:
    scene.running(A)
    scene.runner.handle(lease(B))
    assert scene.states() == {A: "running", B: "fetching"}
    scene.runner.handle(Release(task=A))
    assert [run.task for run in scene.process.told(Run)] == [B]
    scene.say(Begun(B))
    scene.runner.handle(lease(A, term=2))
    scene.say(TaskFinished(B, b"made"))
    assert [run.task for run in scene.process.told(Run)] == [A]
    assert scene.process.loaded == []  # there is something else to do
    scene.say(Ended("crash", "its process ended"))
    assert scene.states() == {B: "done", A: "failed"}


@pytest.mark.parametrize("is_begun", [False, True])
def test_a_process_that_dies_fails_its_task_and_no_other(scene: Scene, is_begun: bool) -> None:
    scene.runner.handle(lease(A))
    if is_begun:
        scene.say(Begun(A))
    scene.runner.handle(lease(B, LARGE))
    assert scene.say(Ended("memory", "it was killed"))
    assert scene.requests.reports == [TaskFailed(task=A, term=1, failure="memory", sentence="it was killed")]
    assert scene.states() == {A: "failed", B: "fetching"}
    assert not scene.say(Ended("crash", "it was idle"))


def test_another_store_s_coordinator_leaves_nothing(scene: Scene) -> None:
    scene.running(A)
    scene.runner.handle(lease(B, LARGE))
    scene.runner.reset()
    assert (scene.runner.is_idle, scene.process.is_started) == (True, False)


# -------------------------------------------------------------------------------------------------- who helps


def test_a_helper_pulls_batch_after_batch_and_names_the_contexts_it_has(scene: Scene) -> None:
    scene.runner.handle(Help(task=B, job="j", worker="w1"))
    scene.runner.handle(Help(task=B, job="j", worker="w1"))
    assert scene.requests.pulls == [("w1", PullBatch(task=B))]
    assert scene.states() == {B: "helping"}
    scene.give_batch()
    assert scene.process.told(TaskBatch) == [TaskBatch(7, "f", digest(b"a context"), b"a context", b"i")]
    scene.say(BatchComputed(6, b"of another"))
    scene.say(BatchComputed(7, b"made"))
    pull = PullBatch(task=B, result=BatchResult(number=7, result=b"made"), contexts=(digest(b"a context"),))
    assert scene.requests.pulls[1:] == [("w1", pull)]
    scene.give_batch(8, known=True)
    assert [batch.context for batch in scene.process.told(TaskBatch)] == [b"a context"]
    scene.say(BatchComputed(8, None))
    assert scene.requests.pulls[-1][1].result == BatchResult(number=8, result=None)


def test_its_own_task_goes_before_helping(scene: Scene) -> None:
    scene.runner.handle(Help(task=B, job="j", worker="w1"))
    scene.give_batch()
    scene.runner.handle(lease(A))
    assert scene.states() == {A: "waiting"}
    scene.say(BatchComputed(7, b"made"))
    assert len(scene.requests.pulls) == 1
    scene.runner.handle(Help(task=B, job="j", worker="w1"))  # late
    assert scene.states() == {A: "waiting"}
    scene.say(Begun(A))
    scene.say(TaskFinished(A, b"made"))
    scene.runner.handle(Help(task=B, job="j", worker="w1"))
    assert scene.states() == {A: "done", B: "helping"}


def test_a_batch_that_ends_the_process_ends_helping(scene: Scene) -> None:
    scene.runner.handle(Help(task=B, job="j", worker="w1"))
    scene.give_batch()
    scene.say(Ended("crash", "its process ended"), scene.process.life - 1)
    assert scene.states() == {B: "helping"}
    assert not scene.say(Ended("crash", "its process ended"))
    assert scene.runner.is_idle


# ------------------------------------------------------------------------------------------- who has the task


def query(token: int) -> Query:
    return Query("a/key", b"", token)


def test_helpers_get_batches_of_what_runs_and_hand_in_results(scene: Scene) -> None:
    scene.running()
    scene.runner.batch_asked(query(1), PullBatch(task=A, contexts=(digest(b"a context"),)))
    (ask,) = scene.process.told(Ask)
    assert ask.contexts == {digest(b"a context")}
    scene.say(Give(ask.token, TaskBatch(7, "f", digest(b"c"), b"c", b"i")))
    ((asked, given),) = scene.replies
    assert asked == query(1)
    assert given == GivenBatch(number=7, function="f", digest=digest(b"c"), context=b"c", item=b"i")
    scene.runner.batch_asked(query(2), PullBatch(task=A, result=BatchResult(number=7, result=b"made")))
    assert scene.process.said[0] == Take(7, b"made")
    scene.say(Give(scene.process.told(Ask)[0].token, None))
    assert scene.replies[1:] == [(query(2), NotYet())]
