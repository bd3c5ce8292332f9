"""Tasks, who has them, and which of them are tried again."""

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from atoll_coordinator.service.tasks.task_table import (
    LIMIT_S,
    MAX_LOSSES,
    Task,
    TaskTable,
    task_id,
)
from atoll_core.wire.messages.tasks import TaskInput

INPUT = TaskInput(digest="a" * 64, size=1, data=b"a")


def task(name: str = "a", job: str = "j") -> Task:
    return Task(name * 64, job, "prepare", (INPUT,), None, 0.0)


def table_with(*tasks: Task) -> TaskTable:
    table = TaskTable()
    for one in tasks:
        table.add(one)
    return table


def test_a_task_is_named_by_all_that_decides_its_result() -> None:
    other = INPUT.model_copy(update={"digest": "b" * 64})
    names = {
        task_id("j", "prepare", (INPUT,)), task_id("k", "prepare", (INPUT,)), task_id("j", "refine", (INPUT,)),
        task_id("j", "prepare", (other,)), task_id("j", "prepare", (INPUT, other)),
    }  # fmt: skip
    assert len(names) == 5
    assert task_id("j", "prepare", (INPUT,)) in names


def test_a_task_whose_worker_is_lost_waits_again_until_it_has_cost_too_many() -> None:
    one, other = task("a"), task("b")
    table = table_with(one, other)
    for number in range(1, MAX_LOSSES):
        table.lease(one, "w", 0.0)
        one.helpers["x"], one.parts, one.received = 0.0, [b"half"], 4
        assert table.lose("w", float(number)) == [(one, None)]
        assert (one.state, one.helpers, one.parts, one.received) == ("waiting", {}, [], 0)
    table.lease(one, "w", 0.0)
    (lost,) = table.lose("w", 9.0)
    assert lost == (one, f"its worker was lost, {MAX_LOSSES} times")
    assert list(table) == [other]


def test_workers_that_had_said_that_they_leave_cost_a_task_nothing_however_many() -> None:
    one = task()
    table = table_with(one)
    for number in range(2 * MAX_LOSSES):
        table.lease(one, "w", 0.0)
        assert table.lose("w", float(number), had_left=True) == [(one, None)]
    assert one.losses == 0


@pytest.mark.parametrize("seconds", [None, 3.0 * LIMIT_S])
def test_a_task_may_take_so_long_or_as_long_as_its_job_was_given(seconds: float | None) -> None:
    one, limit_s = task(), seconds or LIMIT_S
    one.seconds = seconds
    table = table_with(one)
    assert table.timed_out(9.0 * LIMIT_S) == []  # nobody has it
    table.lease(one, "w", 0.0)
    assert table.timed_out(limit_s) == []
    assert table.timed_out(limit_s + 1.0) == [one]


class Histories(RuleBasedStateMachine):
    """Tasks are leased, begun, lost, failed and ended as it comes; a model counts what each has gone through."""

    workers = st.sampled_from(["w0", "w1", "w2"])

    def __init__(self) -> None:
        super().__init__()
        self.table = TaskTable()
        self.added = 0
        self.now = 0.0

    def some(self, state: str) -> list[Task]:
        return [one for one in self.table if one.state == state]

    @rule()
    def add(self) -> None:
        self.added += 1
        self.table.add(Task(f"{self.added:064x}", "j", "prepare", (), None, self.now))

    @precondition(lambda self: self.some("waiting"))
    @rule(worker=workers)
    def lease(self, worker: str) -> None:
        if self.table.on(worker) is None:
            one = self.some("waiting")[0]
            before = one.term
            self.table.lease(one, worker, self.now)
            assert one.term == before + 1

    @precondition(lambda self: self.some("leased") or self.some("running"))
    @rule()
    def begin(self) -> None:
        one = (self.some("leased") or self.some("running"))[0]
        is_new = one.state == "leased"
        assert self.table.begin(one, self.now) is is_new

    @rule(worker=workers)
    def lose(self, worker: str) -> None:
        self.now += 1.0
        held = self.table.on(worker)
        lost = self.table.lose(worker, self.now)
        assert [one for one, _ in lost] == [one for one in [held] if one is not None]
        assert all((one.losses == MAX_LOSSES) is (why is not None) for one, why in lost)

    @precondition(lambda self: self.some("leased") or self.some("running"))
    @rule(failure=st.sampled_from(["error", "memory", "crash", "time"]))
    def fail(self, failure) -> None:
        self.now += 1.0
        one = (self.some("running") or self.some("leased"))[0]
        failed_before = len(one.failures)
        why = self.table.fail(one, failure, "a sentence", self.now)
        assert (why is None) is (failed_before == 0 and failure != "time")
        assert (self.table.get(one.id) is one) is (why is None)

    @precondition(lambda self: len(self.table))
    @rule()
    def end(self) -> None:
        self.table.end(next(iter(self.table)))

    @invariant()
    def is_valid(self) -> None:
        self.table.validate()
        assert all(one.losses < MAX_LOSSES and len(one.failures) < 2 for one in self.table)


TestHistories = Histories.TestCase
TestHistories.settings = settings(max_examples=40, stateful_step_count=30, deadline=None)
