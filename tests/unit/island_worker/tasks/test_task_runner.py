"""What a worker makes of leases, inputs, its process and helpers; bus and process are played by the test."""

import hashlib

import pytest

from atoll_core.task_frames import (
    BatchComputed,
    Begun,
    Ended,
    Failed,
    FromProcess,
    ProcessMessage,
    Progressed,
    Run,
    TaskBatch,
    TaskFinished,
    ToProcess,
)
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.epochs import PullAnswer
from atoll_core.wire.messages.limits import CHUNK_SIZE
from atoll_core.wire.messages.tasks import (
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
        self.runner = TaskRunner(self.requests, self.process, lambda query, answer: None, lambda: 0.0)  # type: ignore[arg-type]

    def say(self, message: FromProcess, life: int | None = None) -> bool:
        """Let the process say something."""
        return self.runner.handle_process_message(ProcessMessage(self.process.life if life is None else life, message))

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


def test_the_heartbeat_says_how_far_a_task_is(scene: Scene) -> None:
    scene.running()
    assert not scene.say(Progressed(A, 7)), "the next heartbeat is soon enough"
    scene.say(Progressed(A, 9), life=scene.process.life + 1)
    assert [held.compared for held in scene.runner.statuses()] == [7]
    scene.say(Progressed(B, 9))


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
