"""The same stories with the real islands: fewer, for they take longer."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare as prepare_table
from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.refinement import Refinement
from atoll_core.config import BudgetConfig, DataConfig, EvolutionConfig, JobConfig, MigrationConfig
from atoll_core.data.dataset import Dataset, Target
from atoll_island_worker.compute.compute_thread import Engine
from atoll_island_worker.compute.run_queue import RunningEpoch
from atoll_island_worker.session.interface import EpochTask, ShardKey
from tests.simulation.bus.fault_plan import Plan
from tests.simulation.harness.simulated_cluster import World, comparable
from tests.simulation.harness.stub_islands import StubCompute
from tests.unit.coordinator.data.tables import table_of

CONFIG = JobConfig(
    seed=5,
    evolution=EvolutionConfig(islands=3, population=16),
    migration=MigrationConfig(generations=20),
    budget=BudgetConfig(max_epochs=4, target_error=1e-12),
)


def prepare(table: bytes, config: JobConfig) -> Preparation:
    """Return the equations of a made-up system of two variables, one of them beyond the reach of a few epochs."""
    names = tuple(table.decode().split(","))
    row = np.arange(60)
    x, y = 1.0 + (row % 7) / 4.0, 0.5 + (row % 11) / 6.0
    values = {"x": x * (3.0 - x - 2.0 * y), "y": np.sqrt(x * y + 1.0) / (x + y)}
    targets = tuple(Target(name, f"d{name}/dt", values[name], 0.0, float(values[name].std())) for name in names)
    return Preparation(Dataset(names, np.stack([x, y]), targets, {name: name for name in names}))


def prepare_process(table: bytes, config: JobConfig) -> Preparation:
    """Return the equations of a process of three states, one without noise of its own, uneven steps, two paths."""
    random, paths, times = np.random.default_rng(4), [], []
    for begin in (1.0, -1.0):
        steps = random.uniform(0.05, 0.15, 300)
        states = [np.array([begin, 0.0, 1.0])]
        for step, normal in zip(steps.tolist(), random.standard_normal((300, 2)), strict=True):
            x, v, z = states[-1]
            noise = 0.5 * np.sqrt(step) * normal
            states.append(np.array([x + step * v, v - step * (x + 0.5 * v) + noise[0], z - step * (z - x) + noise[1]]))
        paths.append(np.array(states).T)
        times.append(np.concatenate([[0.0], np.cumsum(steps)]))
    x, v, z = np.concatenate(paths, axis=1)
    columns = {"t": np.concatenate(times), "x": x, "v": v, "z": z}
    return prepare_table(table_of(columns, starts=(0, 301)), JobConfig(data=DataConfig(stochastic=True)))


def unrefined(*_: object) -> Refinement:
    """Leave what was found as it is: what follows the search takes far longer, and depends on its answer alone."""
    return Refinement()


@dataclass
class RealCompute(StubCompute):
    """The real engine in virtual time; how long it takes is drawn, as for the stub."""

    engine: Engine = field(default_factory=Engine)

    def load(self, job: str, config: JobConfig, dataset: bytes) -> None:
        self._later(0.01, self.engine.load(job, config, dataset))

    def discard(self, shard: ShardKey) -> None:
        super().discard(shard)
        self.engine.forget(shard)

    def discard_job(self, job: str) -> None:
        super().discard_job(job)
        self.engine.forget_job(job)

    def begin(self, task: EpochTask) -> RunningEpoch:
        if task.state is not None:
            self.restored.append((task.key.term, task.key.epoch, task.key.island))
        return self.engine.begin(task)


def answer(
    workers: int,
    seed: int,
    plan: Plan | None = None,
    crash_at_s: float | None = None,
    prepared: Callable[[bytes, JobConfig], Preparation] = prepare,
    config: JobConfig = CONFIG,
) -> str:
    world = World(workers=workers, seed=seed, plan=plan, compute=RealCompute, prepare=prepared, refiner=unrefined)
    if crash_at_s is not None:
        world.at(crash_at_s, lambda: world.crash("w1"))
    result = comparable(world.run(config))
    assert not world.service.rejects.counts
    return result


@pytest.mark.slow
def test_real_islands_go_on_from_their_states_as_if_nothing_had_happened(monkeypatch: pytest.MonkeyPatch) -> None:
    """Checkpoints at every epoch: a worker dies after the first, and another leaves at the same time."""
    calm = answer(workers=1, seed=0)
    monkeypatch.setattr("atoll_coordinator.service.search.archipelago.FIRST_INTERVAL", 1)
    monkeypatch.setattr("atoll_coordinator.service.search.checkpoint_schedule.LEAST_INTERVAL", 1)
    world = World(workers=3, seed=1, expected=3, compute=RealCompute, prepare=prepare, refiner=unrefined, slowness=20.0)

    def strike() -> None:
        jobs = world.service.controller.jobs.values()
        durable = [archipelago.durable for job in jobs for archipelago in job.archipelagos.values()]
        if durable and all(durable):
            world.crash("w1")
            world.workers["w2"].leave()
        else:
            world.at(world.network.now + 0.005, strike)

    world.at(0.5, strike)
    assert comparable(world.run(CONFIG)) == calm
    assert world.computes["w0"].restored


def test_real_islands_give_the_same_answer_whatever_happens() -> None:
    calm = answer(workers=1, seed=0)
    assert answer(workers=3, seed=1) == calm
    assert answer(workers=4, seed=2, plan=Plan(drop=0.05, duplicate=0.2, late=0.1)) == calm
    assert answer(workers=3, seed=3, crash_at_s=0.65) == calm


def test_a_stochastic_process_of_three_states_has_one_answer_on_any_number_of_workers() -> None:
    short = CONFIG.model_copy(update={"budget": BudgetConfig(max_epochs=1, target_error=1e-12)})
    calm = answer(workers=1, seed=0, prepared=prepare_process, config=short)
    assert "[v]" in calm
    assert answer(workers=3, seed=1, prepared=prepare_process, config=short) == calm
