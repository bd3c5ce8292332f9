"""The states of checkpoints take no more memory at the coordinator than they are given, and nobody waits for ever."""

from functools import partial

import pytest

from atoll_coordinator.service.search import pull_budget
from tests.simulation.bus.fault_plan import Plan
from tests.simulation.harness.fault_schedule import schedule_of
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World, comparable
from tests.simulation.soak import play

ISLANDS = 3
STATE_BYTES = 40
JOBS = 2


config = partial(short_job, islands=ISLANDS, max_epochs=18, stagnation=1000)


def run(monkeypatch: pytest.MonkeyPatch) -> tuple[list[str], list[int]]:
    """Have jobs of three variables searched; return their answers, and the bytes held at each look."""
    monkeypatch.setattr("tests.simulation.harness.stub_islands.HIT_EPOCHS", 10**9)
    world = World(workers=2, plan=Plan(delay_s=(0.02, 0.06)), slowness=5.0)
    checkpoints, held = world.service.controller.checkpoints, []
    add_states = checkpoints.add_states

    def observed_add_states(*arguments: object) -> None:
        add_states(*arguments)  # type: ignore[arg-type]
        held.append(checkpoints.held_bytes)

    monkeypatch.setattr(checkpoints, "add_states", observed_add_states)
    for seed in range(JOBS):
        world.submit(config(seed), "x,y,z", f"job{seed}")
    assert [world.finish(f"job{seed}").state for seed in range(JOBS)] == ["done"] * JOBS
    assert checkpoints.held_bytes == 0
    return [comparable(world.result(f"job{seed}")) for seed in range(JOBS)], held


@pytest.mark.slow
def test_without_any_memory_one_checkpoint_goes_through_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    answers, held = run(monkeypatch)
    assert max(held) > ISLANDS * STATE_BYTES
    with monkeypatch.context() as crowded:
        crowded.setattr(pull_budget, "MAX_BYTES", 0)
        crowded_answers, crowded_held = run(crowded)
    assert crowded_answers == answers
    assert 0 < max(crowded_held) <= ISLANDS * STATE_BYTES


@pytest.mark.slow
def test_nor_do_faults_make_anybody_wait_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pull_budget, "MAX_BYTES", 0)
    for seed in range(300, 308):
        outcome = play(schedule_of(seed))
        assert not outcome.wrong, outcome.wrong
