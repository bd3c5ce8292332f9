"""Which task goes to which worker, and who helps with which."""

from collections import Counter
from typing import get_args

import pytest

from atoll_coordinator.service.tasks.task_table import Slot, Task, TaskPlan, plan_leases
from atoll_core.wire.messages.tasks import TaskFunction


def task(name: str, function: TaskFunction = "prepare", job: str = "", **more: object) -> Task:
    made = Task(name, job or name, function, (), None, 0.0)
    for key, value in more.items():
        setattr(made, key, value)
    return made


def running(name: str, function: TaskFunction = "refine", helpers: int = 0, since: float = 0.0) -> Task:
    helping = {f"{name}{number}": 0.0 for number in range(helpers)}
    return task(name, function, state="running", worker="owner-" + name, helpers=helping, waiting_since=since)


def slot(worker: str, host: str = "lab", **more: object) -> Slot:
    return Slot(worker, host, **more)  # type: ignore[arg-type]


def leases(made: TaskPlan) -> list[tuple[str, str, int]]:
    return [(one.id, worker, threads) for one, worker, threads in made.leases]


def helps(made: TaskPlan) -> list[tuple[str, str]]:
    return [(one.id, worker) for one, worker in made.helps]


def test_a_task_goes_where_its_data_are_then_where_a_process_is_loaded_then_where_islands_are_few() -> None:
    slots = [
        slot("w0", islands=9), slot("w1", islands=2), slot("w2", islands=2, is_loaded=True),
        slot("w3", islands=9, near=frozenset({"j"})),
    ]  # fmt: skip
    order = []
    while slots:
        ((_, worker, _),) = leases(plan_leases([task("a", job="j")], [], slots, Counter()))
        order.append(worker)
        slots = [one for one in slots if one.worker != worker]
    assert order == ["w3", "w2", "w1", "w0"]


def test_a_task_may_use_the_cores_of_workers_of_its_host_that_have_nothing_to_do() -> None:
    slots = [slot("w0", "a"), slot("w1", "a"), slot("w2", "a"), slot("w3", "a", helps="r"), slot("w4", "b")]
    first, second = task("t", "refine"), task("u", "refine")
    assert leases(plan_leases([first], [], slots, Counter())) == [("t", "w0", 3)]
    two = leases(plan_leases([first, second], [], slots, Counter()))
    assert two == [("t", "w0", 3), ("u", "w1", 2)]


def test_preparing_gets_helpers_in_place_of_threads() -> None:
    made = plan_leases([task("t", "prepare")], [], [slot("w0"), slot("w1")], Counter())
    assert leases(made) == [("t", "w0", 1)]
    assert helps(plan_leases([], [running("t", "prepare")], [slot("w1")], Counter({"lab": 1}))) == [("t", "w1")]


def test_who_is_idle_helps_with_what_has_fewest_helpers() -> None:
    tasks = [running("a", helpers=2), running("b", since=2.0), running("c", since=1.0)]
    made = plan_leases([], tasks, [slot(f"w{number}") for number in range(4)], Counter())
    assert helps(made) == [("c", "w0"), ("b", "w1"), ("a", "w2"), ("c", "w3")]


@pytest.mark.parametrize("function", get_args(TaskFunction))
def test_workers_help_with_every_function(function: TaskFunction) -> None:
    assert helps(plan_leases([], [running("t", function)], [slot("w1")], Counter({"lab": 1}))) == [("t", "w1")]


def test_a_helper_is_recalled_only_for_a_task_that_nobody_else_can_take() -> None:
    slots = [slot("w0", helps="r"), slot("w1", "b")]
    made = plan_leases([task("t")], [running("r")], slots, Counter())
    assert (leases(made), made.recalled) == ([("t", "w1", 1)], [])
    made = plan_leases([task("t"), task("u")], [running("r")], slots, Counter())
    assert (leases(made), made.recalled) == ([("t", "w1", 1), ("u", "w0", 1)], ["w0"])


def test_who_helps_already_gets_no_second_task_to_help_with() -> None:
    assert plan_leases([], [running("r")], [slot("w0", helps="r")], Counter()).helps == []


def test_what_must_be_alone_waits_for_a_host_without_tasks_and_that_host_is_kept_free_for_it() -> None:
    alone = task("t", is_alone=True)
    slots = [slot("w0", "a"), slot("w1", "b"), slot("w2", "b")]
    busy = Counter({"a": 2, "b": 1})
    made = plan_leases([alone, task("u"), task("v")], [running("r")], slots, busy)
    assert leases(made) == [("u", "w0", 1)]  # b has fewest tasks: nothing more is given to it
    assert made.helps == []
    made = plan_leases([alone, task("u")], [], slots, Counter({"a": 2}))
    assert leases(made) == [("t", "w1", 1), ("u", "w0", 1)]


def test_what_must_be_alone_has_no_helpers_and_no_neighbours() -> None:
    alone = task("t", "refine", is_alone=True)
    slots = [slot("w0", "a"), slot("w1", "a", helps="r"), slot("w2", "a")]
    made = plan_leases([alone], [running("r")], slots, Counter())
    assert (leases(made), made.recalled, made.helps) == ([("t", "w0", 1)], ["w1"], [])
    alone.state = "running"
    made = plan_leases([task("u")], [alone, running("r")], [slot("w2", "a"), slot("w3", "b")], Counter({"a": 1}), {"a"})
    assert (leases(made), made.helps) == ([("u", "w3", 1)], [])


def test_the_only_other_worker_of_a_host_whose_core_a_task_has_by_a_thread_does_not_help() -> None:
    one = running("b")
    one.threads = 2
    assert helps(plan_leases([], [one], [slot("w1")], Counter({"lab": 1}))) == []
    assert helps(plan_leases([], [one], [slot("w1", "other")], Counter({"lab": 1}))) == [("b", "w1")]
    assert helps(plan_leases([], [one], [slot("w1"), slot("w2")], Counter({"lab": 1}))) == [("b", "w1"), ("b", "w2")]
