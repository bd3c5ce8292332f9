"""Which task goes to which worker, and who helps with which. Pure.

A worker has one task at a time, its own or that of another, which it helps with. Tasks that wait go first, in the order
they are given in; workers that have nothing to do help with what runs.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from atoll_coordinator.service.tasks.task_table import Task
from atoll_core.wire.messages.tasks import TaskFunction

HELPED: frozenset[TaskFunction] = frozenset({"refine"})
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


def plan(waiting: Sequence[Task], running: Sequence[Task], slots: Sequence[Slot], busy_hosts: Counter[str]) -> Plan:
    """Return what to lease, and who is to help.

    Args:
        waiting: tasks that nobody has, the next one first.
        running: tasks that run.
        slots: workers without a task of their own.
        busy_hosts: how many tasks run on each host.
    """
    made, left = Plan(), list(slots)
    busy = Counter(busy_hosts)
    for task in waiting:
        slot = _best(task, left, busy)
        if slot is None:
            continue
        left.remove(slot)
        if slot.helps is not None:
            made.recalled.append(slot.worker)
        idle = sum(other.host == slot.host and other.helps is None for other in left)
        made.leases.append((task, slot.worker, 1 if task.is_alone else 1 + idle))
        busy[slot.host] += 1
    helped = sorted((task for task in running if task.function in HELPED and not task.is_alone), key=_need)
    idle_slots = [slot for slot in left if slot.helps is None]
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
