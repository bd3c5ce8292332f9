"""Calls are computed once they come back, however often their workers die, and data travel once to each process."""

import queue
import random
import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from typing import Any

import pytest

from atoll.executors import tasks
from atoll.executors.dispatcher import Computed, Dispatcher, Finished
from atoll.executors.executors import ExecutorError, InlineExecutor, workers_of
from atoll.executors.tasks import MAX_LOSSES, Call, Done, FunctionFailed, Missing, OtherVersion, perform
from atoll_core.errors import RefusedError, UsageError
from atoll_core.task_frames import version


def joined(number: int, data: bytes) -> bytes:
    return data * number


def refuse(reason: str) -> None:
    raise ValueError(reason)


@pytest.fixture(autouse=True)
def _functions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tasks, "FUNCTIONS", {"joined": joined, "refuse": refuse})


class Losing(Executor):
    """Loses the calls that `is_lost` names by their order, before or after they were computed."""

    def __init__(self, is_lost: Callable[[int], bool], error: Exception | None = None) -> None:
        self._is_lost = is_lost
        self._error = error or RuntimeError("the worker was killed")
        self._threads = ThreadPoolExecutor(3)
        self._lock = threading.Lock()
        self.calls: list[Call] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        with self._lock:
            self.calls.append(args[0])
            number = len(self.calls)

        def run() -> Any:
            made = fn(*args, **kwargs)
            if self._is_lost(number):
                raise self._error
            return made

        return self._threads.submit(run)


def results(dispatcher: Dispatcher, count: int) -> dict[Any, Computed]:
    found: dict[Any, Computed] = {}
    while len(found) < count:
        computed = dispatcher.wait()
        if computed is not None:
            assert computed.tag not in found
            found[computed.tag] = computed
    return found


@pytest.mark.parametrize("seed", range(5))
def test_lost_calls_are_computed_again(seed: int) -> None:
    draw = random.Random(seed)
    lost = {number for number in range(1, 200) if draw.random() < 0.25}
    with Dispatcher(Losing(lost.__contains__), 3) as dispatcher:
        for number in range(40):
            dispatcher.submit(number, "joined", (number,), b"ab%d" % seed)
        found = results(dispatcher, 40)
    assert {number: computed.value for number, computed in found.items()} == {k: b"ab%d" % seed * k for k in range(40)}


def test_a_call_that_is_lost_every_time_is_an_error() -> None:
    executor = Losing(lambda number: True)
    with Dispatcher(executor, 1) as dispatcher:
        dispatcher.submit("a", "joined", (1,), b"x")
        with pytest.raises(ExecutorError, match="killed"):
            results(dispatcher, 1)
    assert len(executor.calls) == MAX_LOSSES + 1


def test_an_error_of_a_function_is_its_result_and_not_tried_again() -> None:
    executor = Losing(lambda number: False)
    with Dispatcher(executor, 1) as dispatcher:
        dispatcher.submit("a", "refuse", ("no such column",))
        assert "no such column" in results(dispatcher, 1)["a"].sentence
    assert len(executor.calls) == 1


def test_data_are_sent_to_about_as_many_processes_as_there_are_and_again_on_request() -> None:
    data = random.Random(3).randbytes(1000)
    executor = Losing(lambda number: False)
    with Dispatcher(executor, 2) as dispatcher:
        for number in range(10):
            dispatcher.submit(number, "joined", (number,), data)
        results(dispatcher, 10)
    assert sum(bool(call.data) for call in executor.calls) <= 3


def test_a_process_without_the_data_asks_for_them() -> None:
    call = Call(1, "joined", (2,), ("unheard",), {}, version())
    assert perform(call) == Missing(frozenset({"unheard"}))
    assert perform(Call(2, "joined", (2,), ("unheard",), {"unheard": b"z"}, version())) == Done(b"zz")
    assert perform(call) == Done(b"zz")


def test_a_worker_of_another_version_computes_nothing() -> None:
    assert perform(Call(1, "joined", (2, b"x"), of="0.0/0/0")) == OtherVersion(version())


def test_another_version_is_refused_with_both_versions() -> None:
    class Older(InlineExecutor):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
            return super().submit(lambda: OtherVersion("0.0/0/0"))

    with Dispatcher(Older(), 1) as dispatcher:
        dispatcher.submit(1, "joined", (1,), b"ab")
        with pytest.raises(RefusedError) as caught:
            dispatcher.wait()
    assert all(word in str(caught.value) for word in ("0.0/0/0", version(), "install"))
    assert caught.value.exit_code == 2


def test_a_lack_of_memory_is_not_an_internal_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def exhausts() -> None:
        raise MemoryError

    monkeypatch.setitem(tasks.FUNCTIONS, "exhausts", exhausts)  # type: ignore[arg-type]
    outcome = perform(Call(1, "exhausts", (), of=version()))
    assert isinstance(outcome, FunctionFailed)
    assert outcome.failure == "memory"
    assert "memory" in tasks.what_to_do(outcome.failure)


def test_a_process_that_is_ended_for_idleness_is_not_given_a_task_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[object] = []

    class Idle:
        """A task process that is idle; while it is ended, another thread needs a task process."""

        def attach(self, post: Callable[[object], None]) -> None:
            """Do nothing."""

        def stop_if_idle(self) -> None:
            with tasks.borrowed_process(queue.SimpleQueue()) as other:
                assert other is not self
            ended.append(self)

    monkeypatch.setattr("atoll_island_worker.tasks.task_process.TaskProcess", Idle)
    monkeypatch.setattr(tasks, "_free", [])
    with tasks.borrowed_process(queue.SimpleQueue()) as first:
        pass
    tasks.end_idle_processes()
    assert ended == [first]
    with tasks.borrowed_process(queue.SimpleQueue()) as again:
        assert isinstance(again, Idle), "they are used again"


def test_a_broken_pool_is_replaced_if_the_user_gave_a_function() -> None:
    made: list[Losing] = []

    def make() -> Losing:
        is_first = not made
        made.append(Losing(lambda number: is_first and number > 2, BrokenExecutor("a process died")))
        return made[-1]

    with Dispatcher(make, 2) as dispatcher:
        for number in range(12):
            dispatcher.submit(number, "joined", (number,), b"ab")
        found = results(dispatcher, 12)
    assert [found[number].value for number in range(12)] == [b"ab" * number for number in range(12)]
    assert len(made) == 2


def test_a_broken_pool_that_cannot_be_replaced_is_an_error_that_says_what_to_give() -> None:
    with Dispatcher(Losing(lambda number: True, BrokenExecutor("a process died")), 2) as dispatcher:
        dispatcher.submit(1, "joined", (1,), b"ab")
        with pytest.raises(ExecutorError, match="lambda"):
            results(dispatcher, 1)


def test_an_error_of_the_function_that_makes_an_executor_has_a_sentence_and_its_cause() -> None:
    def make_pool() -> Executor:
        raise OSError("no such scheduler")

    with pytest.raises(ExecutorError, match=r"make_pool.*OSError: no such scheduler; correct") as caught:
        Dispatcher(make_pool)
    assert isinstance(caught.value.__cause__, OSError)


def test_a_broken_pool_whose_function_fails_the_second_time_has_the_same_error() -> None:
    made: list[Losing] = []

    def make_pool() -> Losing:
        if made:
            raise OSError("no such scheduler")
        made.append(Losing(lambda number: True, BrokenExecutor("a process died")))
        return made[-1]

    with Dispatcher(make_pool, 2) as dispatcher:
        dispatcher.submit(1, "joined", (1,), b"ab")
        with pytest.raises(ExecutorError, match="no such scheduler") as caught:
            results(dispatcher, 1)
    assert isinstance(caught.value.__cause__, OSError)


def test_a_function_that_returns_no_executor_the_second_time_is_an_error_of_the_executor() -> None:
    made: list[Losing] = []

    def make_pool() -> Losing | None:
        if made:
            return None
        made.append(Losing(lambda number: True, BrokenExecutor("a process died")))
        return made[-1]

    with Dispatcher(make_pool, 2) as dispatcher:
        dispatcher.submit(1, "joined", (1,), b"ab")
        with pytest.raises(ExecutorError, match="None was returned by the function"):
            results(dispatcher, 1)


def test_results_of_cancelled_calls_are_dropped() -> None:
    with Dispatcher(InlineExecutor(), 1) as dispatcher:
        for number in range(4):
            dispatcher.submit(number, "joined", (number,), b"ab")
        dispatcher.cancel(lambda number: number == 2)
        events = [dispatcher.inbox.get() for _ in range(4)]
        taken = [dispatcher.take(event) for event in events if isinstance(event, Finished)]
    assert [computed.tag for computed in taken if computed is not None] == [2]


def test_executors_of_users_are_not_shut_down() -> None:
    with ThreadPoolExecutor(1) as threads:
        with Dispatcher(threads) as dispatcher:
            assert dispatcher.workers == 1
        assert threads.submit(int).result() == 0


def test_an_executor_that_was_shut_down_is_an_error() -> None:
    threads = ThreadPoolExecutor(1)
    threads.shutdown()
    with Dispatcher(threads) as dispatcher, pytest.raises(ExecutorError, match="shut"):
        dispatcher.submit(1, "joined", (1,), b"ab")


@pytest.mark.parametrize("given", [3, "tcp://host:8786", lambda: 3])
def test_other_objects_are_refused(given: object) -> None:
    with pytest.raises(UsageError, match=r"concurrent\.futures"):
        Dispatcher(given)


def test_an_executor_of_unknown_size_has_as_many_workers_as_cores() -> None:
    assert workers_of(InlineExecutor()) >= 1


def test_results_come_within_a_time_or_not_at_all() -> None:
    never: Future[Any] = Future()

    class Silent(Executor):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
            return never

    with Dispatcher(Silent(), 1) as dispatcher:
        dispatcher.submit(1, "joined", (1,), b"ab")
        assert [*dispatcher.results(0.01)] == []
