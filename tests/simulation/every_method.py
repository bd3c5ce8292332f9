"""Every method of the coordinator's service breaks once while two jobs run: none ends the loop, no job waits for ever.

    python -m tests.simulation.every_method

prints the methods for which that is not so, and how many are called at all, and returns 1 if there are any; about a
minute. `test_breakages.py` has those that matter most.
"""

import importlib
import inspect
import logging
import pkgutil
import sys
from collections.abc import Iterator

import atoll_coordinator.service
from atoll.errors import AtollError
from atoll_coordinator.cli.terminal.output import say
from atoll_coordinator.service.monitoring.breakages import Breakages
from atoll_coordinator.service.service import Service
from atoll_coordinator.service.workers.channel import WorkerChannel
from tests.simulation.harness import stub_islands
from tests.simulation.harness.schedule_run import hurried
from tests.simulation.harness.simulated_cluster import World
from tests.simulation.test_breakages import assert_it_goes_on, broken_once

LEFT_OUT = {
    (Breakages, "tolerated"),  # it is what holds the others
    (Service, "start"),  # before the loop begins
    (Service, "step"),
    (WorkerChannel, "take_pull"),  # one look into a dict; without it nobody knows whose answer came
}


def methods() -> Iterator[tuple[type, str]]:
    """Yield every method of the service but `validate`, which only the simulation calls."""
    room = atoll_coordinator.service
    for module in pkgutil.walk_packages(room.__path__, f"{room.__name__}."):
        if module.name.endswith("child_main"):  # the main program of another process
            continue
        for its in vars(importlib.import_module(module.name)).values():
            if inspect.isclass(its) and its.__module__ == module.name:
                names = [name for name, each in vars(its).items() if inspect.isfunction(each)]
                yield from ((its, name) for name in names if not name.startswith("__") and name != "validate")


def why_wrong(owner: type, name: str) -> str | None:
    """Break a method once; return what goes wrong by that, "" for nothing, None when it is never called."""
    world = World(workers=2)
    try:
        with broken_once(owner, name) as calls:
            assert_it_goes_on(world, calls)
    except (AssertionError, AtollError, ZeroDivisionError) as error:
        return f"{type(error).__name__}: {error}"[:300] if calls else None
    finally:
        world.close()
    return ""


def main() -> int:
    """Run from the command line."""
    logging.disable(logging.CRITICAL)
    stub_islands.HIT_EPOCHS = 10**9
    chosen = [each for each in methods() if each not in LEFT_OUT]
    with hurried():
        wrong = {f"{owner.__name__}.{name}": why_wrong(owner, name) for owner, name in chosen}
    found = [f"{name}: {why}" for name, why in wrong.items() if why]
    called = sum(why is not None for why in wrong.values())
    say("\n".join([*found, f"{len(wrong)} methods, {called} of them called, {len(found)} of those wrong"]))
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
