"""Every method of the coordinator's service breaks once while two jobs run: none ends the loop, no job waits for ever.

    python -m tests.simulation.every_method            # once
    python -m tests.simulation.every_method --always   # whenever it is called with the first job, or a part of it

prints the methods for which that is not so, and how many are called at all, and returns 1 if there are any; about a
minute each. `test_breakages.py` has those that matter most.
"""

import argparse
import logging
import sys
from collections.abc import Sequence

import pytest

from atoll.terminal.output import say
from atoll_core.errors import AtollError
from tests.simulation.harness import stub_islands
from tests.simulation.harness.schedule_run import hurried
from tests.simulation.harness.simulated_cluster import World
from tests.simulation.test_breakages import (
    LEFT_OUT,
    LEFT_OUT_ALWAYS,
    assert_it_goes_on,
    assert_others_go_on,
    broken_for,
    broken_once,
    methods,
)


def why_wrong(owner: type, name: str, is_always: bool) -> str | None:
    """Break a method; return what goes wrong by that, "" for nothing, None when it is never called."""
    world = World(workers=2, slowness=10.0 if is_always else 1.0)
    try:
        with broken_for(owner, name, "first") if is_always else broken_once(owner, name) as calls:
            (assert_others_go_on if is_always else assert_it_goes_on)(world, calls)
    except (AssertionError, AtollError, ZeroDivisionError, pytest.skip.Exception) as error:
        return f"{type(error).__name__}: {error}"[:300] if calls else None
    finally:
        world.close()
    return ""


def main(words: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="every_method", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--always", action="store_true", help="break whenever the first job is concerned, not once")
    is_always = parser.parse_args(words).always
    logging.disable(logging.CRITICAL)
    stub_islands.HIT_EPOCHS = 10**9
    left_out = LEFT_OUT | (LEFT_OUT_ALWAYS if is_always else set())
    chosen = [method for method in methods() if method not in left_out]
    with hurried():
        wrong = {f"{owner.__name__}.{name}": why_wrong(owner, name, is_always) for owner, name in chosen}
    faults = [f"{name}: {why}" for name, why in wrong.items() if why]
    called = sum(why is not None for why in wrong.values())
    say("\n".join([*faults, f"{len(wrong)} methods, {called} of them called, {len(faults)} of those wrong"]))
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
