"""Whatever happens on the way, one seed has one answer: whole stories of coordinator, workers and client."""

import json
from functools import cache, partial

import pytest

from atoll_coordinator.model.sparse import laws
from tests.simulation.bus.fault_plan import Partition, Plan
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World, comparable

FEW_SEEDS = range(4)
"""Where the number of workers or a moment varies as well; ``make soak`` plays thousands of seeds with all of it."""


config = partial(short_job, islands=4, generations=100, max_epochs=14)


@cache
def undisturbed(seed: int) -> str:
    """The answer of one worker on a perfect network."""
    world = World(workers=1, seed=seed)
    return comparable(world.run(config(seed)))


def answer(world: World, seed: int) -> str:
    result = comparable(world.run(config(seed)))
    dropped = [worker.rejects.counts for worker in world.workers.values() if worker.rejects.total]
    assert not dropped
    assert not world.service.rejects.counts
    return result


@pytest.mark.parametrize("workers", [2, 7, *(pytest.param(count, marks=pytest.mark.slow) for count in (3, 4))])
def test_any_number_of_workers_gives_the_same_answer(workers: int) -> None:
    for seed in FEW_SEEDS:
        assert answer(World(workers=workers, seed=seed), seed) == undisturbed(seed)


@pytest.mark.parametrize("duration_s", [1.0, 15.0])
def test_all_workers_cut_off_at_once_do_not_change_the_answer(duration_s: float) -> None:
    plan = Plan(partitions=tuple(Partition(name, 0.8, 0.8 + duration_s) for name in ("w0", "w1", "w2")))
    world = World(workers=3, seed=1, plan=plan)
    assert answer(world, 1) == undisturbed(1)
    assert world.network.now > 0.8 + duration_s


@pytest.mark.slow
def test_a_job_of_many_variables_has_one_answer_on_any_number_of_workers() -> None:
    variables = ",".join(f"x{place}" for place in range(8))
    chosen = config(3, islands=2, max_epochs=4)
    answers = {comparable(World(workers=workers, seed=3).run(chosen, variables)) for workers in (1, 3)}
    assert len(answers) == 1
    (answer,) = answers
    assert all(f"x{place}" in answer for place in range(8))


@pytest.mark.slow
def test_settled_equations_leave_the_workers_to_the_others_whatever_happens(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(laws, "settled_variables", lambda *_: frozenset({"x"}))
    for seed in FEW_SEEDS:
        alone = comparable(World(workers=1, seed=seed).run(config(seed)))
        world = World(workers=3, seed=seed, plan=Plan(drop=0.03, duplicate=0.05, late=0.05))
        world.at(1.0 + 0.1 * seed, lambda world=world: world.crash("w0"))  # type: ignore[misc]
        assert answer(world, seed) == alone
        epochs = {equation["variable"]: equation["epoch"] for equation in json.loads(alone)["equations"]}
        assert epochs["x"] == 1 < epochs["y"]


@pytest.mark.slow
def test_the_cuts_of_a_cancelled_job_given_as_epochs_give_its_digest() -> None:
    """`--max-time` and cancel depend on the clock, but what they leave can be repeated."""
    for seed in (1, 2, 5):
        world = World(workers=2, seed=seed)
        world.submit(config(seed, max_epochs=1000, stagnation=1000))
        world.at(world.network.now + 1.3, lambda world=world: world.service.controller.cancel("job", world.network.now))  # type: ignore[misc]
        assert world.finish().state in ("cancelled", "done")
        cancelled = world.result()
        epochs = {equation["variable"]: equation["epoch"] for equation in cancelled["equations"]}
        again = World(workers=3, seed=seed + 100).run(config(seed, max_epochs_of=epochs))
        assert again["digest"] == cancelled["digest"]


def test_max_time_cuts_at_complete_epochs_and_can_be_repeated() -> None:
    world = World(workers=2, seed=4, slowness=3.0)
    timed = world.run(config(4, max_epochs=1000, stagnation=1000, max_time=1.0))
    assert {equation["why"] for equation in timed["equations"]} <= {"max-time", "target"}
    epochs = {equation["variable"]: equation["epoch"] for equation in timed["equations"]}
    again = World(workers=1, seed=9).run(config(4, max_epochs_of=epochs))
    assert again["digest"] == timed["digest"]
