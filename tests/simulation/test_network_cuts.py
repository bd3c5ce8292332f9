"""A network that is cut loses time and nothing else: no result, no job, no worker that is still there."""

import pytest

from tests.simulation.bus.fault_plan import Partition, Plan
from tests.simulation.harness.simulated_cluster import World, comparable, patiently
from tests.simulation.test_same_answer import answer, config, undisturbed

CUT_S = 0.8
"""When a cut begins: in the midst of the search, which ends after 1.2 s where nothing is cut."""


@pytest.mark.parametrize("duration_s", [1.0, 15.0])
def test_all_workers_cut_off_at_once_do_not_change_the_answer(duration_s: float) -> None:
    plan = Plan(partitions=tuple(Partition(name, CUT_S, CUT_S + duration_s) for name in ("w0", "w1", "w2")))
    world = World(workers=3, seed=1, plan=plan)
    assert answer(world, 1) == undisturbed(1)
    assert world.network.now > CUT_S + duration_s
    assert sorted(view.worker for view in world.client.workers()) == ["w0", "w1", "w2"]


def test_the_job_of_a_client_that_is_cut_off_ends_and_its_result_is_there_afterwards() -> None:
    world = World(workers=2, seed=3)
    world.submit(config(3))
    world.network.disconnect("client")
    world.network.run(120.0)
    world.network.heal("client")
    assert patiently(world.finish).state == "done"
    assert comparable(world.result()) == undisturbed(3)
