"""Which task goes to which worker, and who helps with which. Pure.

A worker has one task at a time, its own or that of another, which it helps with. Tasks that wait go first, in the order
they are given in; workers that have nothing to do help with what runs. A task with which memory ran out has a host of
its own: one is kept free of other tasks for it, and of helpers.
"""

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Final

from atoll_coordinator.service.tasks.task_table import Task
from atoll_core.wire.messages.tasks import TaskFunction

MOST_THREADS: Final = 2
"""Of a task: Python runs one at a time between kernels, so that further cores of a host are used by helpers."""

HELPED: frozenset[TaskFunction] = frozenset({"refine", "profile"})
"""Functions whose work comes in batches."""


@dataclass(frozen=True, slots=True)
class Slot:
    """A worker that can be given a task.

    `is_loaded`: its process need not be started; `near` are the jobs whose tasks it has done; `islands` is how many it
    computes; `helps` is the task of another worker that it helps with now.
    """

    worker: str
    host: str
    is_loaded: bool = False
    near: frozenset[str] = frozenset()
    islands: int = 0
    helps: str | None = None


@dataclass(slots=True)
class Plan:
    """Leases: task, worker, threads. Helps: task, worker. Recalled: workers whose help a task that waits needs."""

    leases: list[tuple[Task, str, int]] = field(default_factory=list)
    helps: list[tuple[Task, str]] = field(default_factory=list)
    recalled: list[str] = field(default_factory=list)


def plan(
    waiting: Sequence[Task], running: Sequence[Task], slots: Sequence[Slot], busy_hosts: Counter[str],
    closed_hosts: Collection[str] = (),
) -> Plan:  # fmt: skip
    """Return what to lease, and who is to help.

    Args:
        waiting: tasks that nobody has, the next one first.
        running: tasks that run.
        slots: workers without a task of their own.
        busy_hosts: how many tasks are on each host.
        closed_hosts: those where a task is that must be alone.
    """
    made = Plan()
    left = [slot for slot in slots if slot.host not in closed_hosts]
    busy = Counter(busy_hosts)
    for task in waiting:
        slot = _best(task, left, busy)
        if slot is not None:
            left.remove(slot)
            made.recalled += [slot.worker] if slot.helps is not None else []
            idle = sum(other.host == slot.host and other.helps is None for other in left)
            made.leases.append((task, slot.worker, 1 if task.is_alone else min(1 + idle, MOST_THREADS)))
            busy[slot.host] += 1
        if task.is_alone and left:
            free = slot or min(left, key=lambda one: (busy[one.host], one.host))
            host = free.host  # nothing else is given to it, so that it will be free
            made.recalled += [one.worker for one in left if one.host == host and one.helps is not None]
            left = [one for one in left if one.host != host]
    helped = sorted((task for task in running if task.function in HELPED and not task.is_alone), key=_need)
    idle_slots = [slot for slot in left if slot.helps is None]
    if len(idle_slots) == 1 and len(helped) == 1 and helped[0].threads > 1 and busy_hosts[idle_slots[0].host]:
        return made  # a thread of the task has that worker's core, for which nothing need become bytes
    while idle_slots and helped:
        for task in helped:
            if idle_slots:
                made.helps.append((task, idle_slots.pop(0).worker))
    return made


def _need(task: Task) -> tuple[int, float]:
    return len(task.helpers), task.waiting_since


def _best(task: Task, slots: Sequence[Slot], busy: Counter[str]) -> Slot | None:
    """Return the worker for a task: near its data, loaded, with few islands; one that must be alone waits for that."""
    fit = [slot for slot in slots if not (task.is_alone and busy[slot.host])]

    def cost(slot: Slot) -> tuple[bool, bool, bool, int, str]:
        return slot.helps is not None, task.job not in slot.near, not slot.is_loaded, slot.islands, slot.worker

    return min(fit, key=cost, default=None)
